// Multi-layer alpha blending with depth buckets (Kern et al. 2021): lists that do not merge with one another.

struct Params {
    backwards: u32,
    // nodes per list, and lists
    layers: u32,
    buckets: u32,
    // the first surface is of a larger alpha than this, an opaque one has this at least
    front_threshold: f32,
    opaque_threshold: f32,
    // a full list that lets less through is split
    transmittance_threshold: f32,
    // buckets divide this range, or the pixel's own
    range_of_pixel: u32,
    nearest: f32,
    farthest: f32,
}

@group(0) @binding(3) var<uniform> params: Params;

const BEHIND_ALL = vec2u(0xffffffffu);

fn is_nothing(place: u32) -> bool {
    return all(colors[place] == vec4f(0.0));
}

fn store_composite(id: vec3u, all: Node) {
    store(id, all.color + all.transmittance * background_at(pixel_of(id)), all.transmittance);
}

// The first surface and the nearest opaque fragment.
struct Surfaces {
    front: vec2u,
    opaque: vec2u,
}

fn surfaces_of(list: vec2u) -> Surfaces {
    var found = Surfaces(BEHIND_ALL, BEHIND_ALL);
    for (var place = list.x; place < list.x + list.y; place++) {
        let key = keys[place];
        let alpha = colors[place].a;
        if is_nothing(place) {
            continue;
        }
        if alpha > params.front_threshold && comes_before_by_depth(key, found.front) {
            found.front = key;
        }
        if alpha >= params.opaque_threshold && comes_before_by_depth(key, found.opaque) {
            found.opaque = key;
        }
    }
    return found;
}

// All that is in front of the first surface is one node; the others are a list of LAYERS - 1, which is one at least.
@compute @workgroup_size(8, 8)
fn resolve_min_depth(@builtin(global_invocation_id) id: vec3u) {
    if is_outside(id) {
        return;
    }
    let list = list_of(pixel_of(id));
    let surfaces = surfaces_of(list);
    node_count = 0u;
    for (var i = 0u; i < list.y; i++) {
        let place = place_in(list, i, params.backwards);
        let key = keys[place];
        if is_nothing(place) || comes_before_by_depth(surfaces.opaque, key) {
            continue;
        }
        insert_node(key, colors[place]);
        if node_count > 1u && comes_before_by_depth(nodes[1].key, surfaces.front) {
            merge_pair(0u);
        }
        let in_front = u32(comes_before_by_depth(nodes[0].key, surfaces.front));
        if node_count - in_front > LAYERS - 1u {
            merge_furthest();
        }
    }
    store_composite(id, composite_nodes(CLEAR));
}

// ln(b / a) for 0 < a <= b. Logarithms of devices are off by an absolute error near 1, where the series of the inverse
// hyperbolic tangent keeps all digits.
fn log_ratio(a: f32, b: f32) -> f32 {
    if b > 2.0 * a {
        return log(b / a);
    }
    let x = (0.5 * b - 0.5 * a) / (0.5 * b + 0.5 * a);
    let x2 = x * x;
    var sum = 0.0;
    for (var n = 15.0; n > 0.0; n -= 2.0) {
        sum = sum * x2 + 1.0 / n;
    }
    return 2.0 * x * sum;
}

// The bucket of a depth: equal intervals of its logarithm.
fn bucket_of(depth: f32, range: vec2f) -> u32 {
    let nearest = max(range.x, 1e-6 * range.y);
    if range.y <= nearest {
        return 0u;
    }
    let position = log_ratio(nearest, clamp(depth, nearest, range.y)) / log_ratio(nearest, range.y);
    return min(u32(position * f32(params.buckets)), params.buckets - 1u);
}

fn range_of(list: vec2u) -> vec2f {
    if params.range_of_pixel == 0u {
        return vec2f(params.nearest, params.farthest);
    }
    var range = vec2f(LARGEST, 0.0);
    for (var place = list.x; place < list.x + list.y; place++) {
        if !is_nothing(place) {
            let depth = bitcast<f32>(keys[place].x);
            range = vec2f(min(range.x, depth), max(range.y, depth));
        }
    }
    return range;
}

// Lists of depths do not meet, so one after the other is in registers, however many there are: each takes a walk over the
// fragments, which also finds the next one that is not empty.
@compute @workgroup_size(8, 8)
fn resolve_depth(@builtin(global_invocation_id) id: vec3u) {
    if is_outside(id) {
        return;
    }
    let list = list_of(pixel_of(id));
    let range = range_of(list);
    var all = CLEAR;
    var bucket = 0u;
    while bucket < params.buckets {
        var next = params.buckets;
        node_count = 0u;
        for (var i = 0u; i < list.y; i++) {
            let place = place_in(list, i, params.backwards);
            if is_nothing(place) {
                continue;
            }
            let own = bucket_of(bitcast<f32>(keys[place].x), range);
            if own > bucket {
                next = min(next, own);
            }
            if own == bucket {
                insert_node(keys[place], colors[place]);
                if node_count > LAYERS {
                    merge_furthest();
                }
            }
        }
        all = composite_nodes(all);
        bucket = next;
    }
    store_composite(id, all);
}

// where lists begin among the nodes
var<private> starts: array<u32, LAYERS + 1u>;
var<private> list_count: u32;

// Where a list ends.
fn end_of(own: u32) -> u32 {
    if own + 1u < list_count {
        return starts[own + 1u];
    }
    return node_count;
}

// What shows through a list.
fn transmittance_of(own: u32) -> f32 {
    var transmittance = 1.0;
    for (var i = starts[own]; i < end_of(own); i++) {
        transmittance *= nodes[i].transmittance;
    }
    return transmittance;
}

// The list of a newcomer: the last one that begins in front of it, or else the first. Those behind move by one place.
fn list_of_newcomer(newcomer: u32) -> u32 {
    var own = 0u;
    for (var i = 1u; i < list_count; i++) {
        if starts[i] < newcomer {
            own = i;
        } else {
            starts[i]++;
        }
    }
    return own;
}

// A list with one node too many becomes two where little light is left, if there may be more; else its furthest nodes
// merge.
fn split_or_merge(own: u32, newcomer: u32) {
    let is_dark = transmittance_of(own) < params.transmittance_threshold;
    if list_count < params.buckets && is_dark && newcomer != starts[own] {
        for (var i = list_count; i > own + 1u; i--) {
            starts[i] = starts[i - 1u];
        }
        starts[own + 1u] = newcomer;
        list_count++;
        return;
    }
    merge_pair(end_of(own) - 2u);
    for (var i = own + 1u; i < list_count; i++) {
        starts[i]--;
    }
}

@compute @workgroup_size(8, 8)
fn resolve_transmittance(@builtin(global_invocation_id) id: vec3u) {
    if is_outside(id) {
        return;
    }
    let list = list_of(pixel_of(id));
    node_count = 0u;
    list_count = 1u;
    starts[0] = 0u;
    for (var i = 0u; i < list.y; i++) {
        let place = place_in(list, i, params.backwards);
        if is_nothing(place) {
            continue;
        }
        let newcomer = insert_node(keys[place], colors[place]);
        let own = list_of_newcomer(newcomer);
        if end_of(own) - starts[own] > params.layers {
            split_or_merge(own, newcomer);
        }
    }
    store_composite(id, composite_nodes(CLEAR));
}
