// Dual depth peeling (Bavoil & Myers 2008): a pass composites what is at the nearest and at the furthest depth that the last
// pass has found, and finds the next ones between them by MAX blending of (-depth, depth). Coincident fragments are peeled
// in one pass: the blend unit gets them in the order of their ids, and puts each under those before it.

struct Params {
    passes: u32,
}

@group(0) @binding(3) var<uniform> params: Params;

// (-nearest, furthest) depth of what is left
@group(2) @binding(0) var frontier: texture_2d<f32>;
// the layers that a pass has peeled from behind
@group(2) @binding(1) var far_layers: texture_2d<f32>;
@group(2) @binding(2) var<storage, read_write> has_peeled: atomic<u32>;

// What changes nothing: no depth is negative, and none the largest number.
const NO_DEPTHS = vec2f(-LARGEST, -1.0);

struct Layers {
    @location(0) frontier: vec2f,
    @location(1) near: vec4f,
    @location(2) far: vec4f,
}

@fragment
fn peel(placed: Placed) -> Layers {
    let fragment = fragment_of(placed);
    let depths = textureLoad(frontier, fragment.pixel, 0).xy;
    let nearest = -depths.x;
    let furthest = depths.y;
    if fragment.depth < nearest || fragment.depth > furthest {
        discard;
    }
    let color = vec4f(fragment.color, fragment.alpha);
    // the last layer is nearest and furthest at once, and counts as nearest
    if fragment.depth == nearest {
        return Layers(NO_DEPTHS, color, vec4f(0.0));
    }
    if fragment.depth == furthest {
        return Layers(NO_DEPTHS, vec4f(0.0), color);
    }
    return Layers(vec2f(-fragment.depth, fragment.depth), vec4f(0.0), vec4f(0.0));
}

@fragment
fn put_over(@builtin(position) position: vec4f) -> @location(0) vec4f {
    let pixel = vec2u(position.xy);
    if textureLoad(frontier, pixel, 0).y >= 0.0 {
        atomicStore(&has_peeled, 1u);
    }
    return textureLoad(far_layers, pixel, 0);
}

@group(2) @binding(0) var front: texture_2d<f32>;
@group(2) @binding(1) var back: texture_2d<f32>;

@fragment
fn resolve(@builtin(position) position: vec4f) -> @location(0) vec4f {
    let pixel = pixel_at(position);
    let near = textureLoad(front, pixel, 0);
    let far = textureLoad(back, pixel, 0);
    let behind = min(far.rgb, vec3f(LARGEST)) + far.a * background_at(pixel);
    return image_texel(min(near.rgb, vec3f(LARGEST)) + near.a * behind, near.a * far.a);
}

fn does_nothing(place: u32) -> bool {
    return all(colors[place] == vec4f(0.0));
}

// Over a sorted list, for a limited number of passes: how much of a depth that several fragments share is still to be peeled is
// nothing that a blend unit could know.
@compute @workgroup_size(8, 8)
fn resolve_list(@builtin(global_invocation_id) id: vec3u) {
    if is_outside(id) {
        return;
    }
    let list = list_of(pixel_of(id));
    var count = 0u;
    for (var i = 0u; i < list.y; i++) {
        count += select(1u, 0u, does_nothing(list.x + i));
    }
    let from_front = min(params.passes, (count + 1u) / 2u);
    let from_back = min(params.passes, count - from_front);
    var front_color = vec3f(0.0);
    var shown = 1.0;
    var peeled = 0u;
    for (var place = list.x; peeled < from_front; place++) {
        if does_nothing(place) {
            continue;
        }
        front_color += shown * colors[place].rgb;
        shown *= 1.0 - colors[place].a;
        peeled++;
    }
    var behind = background_at(pixel_of(id));
    var shown_behind = 1.0;
    peeled = 0u;
    for (var place = list.x + list.y; peeled < from_back; place--) {
        if does_nothing(place - 1u) {
            continue;
        }
        // what overflows can still be hidden
        behind = min(colors[place - 1u].rgb + (1.0 - colors[place - 1u].a) * behind, vec3f(LARGEST));
        shown_behind *= 1.0 - colors[place - 1u].a;
        peeled++;
    }
    store(id, min(front_color, vec3f(LARGEST)) + shown * behind, shown * shown_behind);
}
