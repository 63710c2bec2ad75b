// Multi-layer alpha blending with depth buckets (Kern et al. 2021): lists that do not merge with one another.

struct Params {
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

// MODE is a constant that the form sets.
const DEPTH = 0u;
const TRANSMITTANCE = 1u;
const MIN_DEPTH = 2u;

const BEHIND_ALL = vec2u(0xffffffffu);

// the first surface and the nearest opaque fragment
var<private> first_surface: vec2u;
var<private> nearest_opaque: vec2u;

fn find_surfaces(fragment: Fragment) {
    let key = key_of(fragment);
    if fragment.alpha > params.front_threshold && comes_before_by_depth(key, first_surface) {
        first_surface = key;
    }
    if fragment.alpha >= params.opaque_threshold && comes_before_by_depth(key, nearest_opaque) {
        nearest_opaque = key;
    }
}

// All that is in front of the first surface is one node; the others are a list of LAYERS - 1, which is one at least.
fn take_by_surfaces(fragment: Fragment) {
    if comes_before_by_depth(nearest_opaque, key_of(fragment)) {
        return;
    }
    insert_fragment(fragment);
    if node_count > 1u && comes_before_by_depth(nodes[1].key, first_surface) {
        merge_pair(0u);
    }
    let in_front = u32(comes_before_by_depth(nodes[0].key, first_surface));
    if node_count - in_front > LAYERS - 1u {
        merge_furthest();
    }
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

// The depths that buckets divide. Lists of depths do not meet, so one after the other is in registers, however many there are:
// each takes a walk over the fragments, which also finds the next one that is not empty.
var<private> range: vec2f;
var<private> bucket: u32;
var<private> next_bucket: u32;
// what lies in front of the bucket
var<private> in_front: Node;

fn take_in_bucket(fragment: Fragment) {
    let own = bucket_of(fragment.depth, range);
    if own > bucket {
        next_bucket = min(next_bucket, own);
    }
    if own == bucket {
        insert_fragment(fragment);
        if node_count > LAYERS {
            merge_furthest();
        }
    }
}

// Whether there is another bucket.
fn go_to_next_bucket() -> bool {
    in_front = composite_nodes(in_front);
    node_count = 0u;
    bucket = next_bucket;
    next_bucket = params.buckets;
    return bucket < params.buckets;
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

fn take_by_transmittance(fragment: Fragment) {
    let newcomer = insert_node(key_of(fragment), rgba(fragment));
    let own = list_of_newcomer(newcomer);
    if end_of(own) - starts[own] > params.layers {
        split_or_merge(own, newcomer);
    }
}

fn begin(pixel: vec2u) {
    node_count = 0u;
    list_count = 1u;
    starts[0] = 0u;
    first_surface = BEHIND_ALL;
    nearest_opaque = BEHIND_ALL;
    bucket = 0u;
    next_bucket = params.buckets;
    in_front = CLEAR;
    range = select(vec2f(params.nearest, params.farthest), vec2f(LARGEST, 0.0), params.range_of_pixel != 0u);
}

// Whether the first walk finds out what the others have to know.
fn is_finding() -> bool {
    return walk == 0u && (MODE == MIN_DEPTH || params.range_of_pixel != 0u);
}

fn find(fragment: Fragment) {
    if MODE == MIN_DEPTH {
        find_surfaces(fragment);
    } else {
        range = vec2f(min(range.x, fragment.depth), max(range.y, fragment.depth));
    }
}

fn take(fragment: Fragment) {
    if MODE == TRANSMITTANCE {
        take_by_transmittance(fragment);
    } else if is_finding() {
        find(fragment);
    } else if MODE == MIN_DEPTH {
        take_by_surfaces(fragment);
    } else {
        take_in_bucket(fragment);
    }
}

fn again() -> bool {
    if MODE == TRANSMITTANCE {
        return false;
    }
    if is_finding() {
        return true;
    }
    return MODE == DEPTH && go_to_next_bucket();
}

fn finish(id: vec3u) {
    store_nodes(id, in_front);
}
