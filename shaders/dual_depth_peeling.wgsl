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
    let near = load(front, pixel);
    let far = load(back, pixel);
    let behind = min(far.rgb, vec3f(LARGEST)) + far.a * background_at(pixel);
    return image_texel(min(near.rgb, vec3f(LARGEST)) + near.a * behind, near.a * far.a);
}

// As a stream, nearest first, where passes are limited: how many of the fragments at one depth are within the limit is nothing
// that a blend unit could know. The first walk counts them.
var<private> count: u32;
var<private> taken: u32;
var<private> front_color: vec3f;
var<private> shown: f32;
var<private> back_color: vec3f;
var<private> shown_behind: f32;

fn begin(pixel: vec2u) {
    count = 0u;
    taken = 0u;
    front_color = vec3f(0.0);
    shown = 1.0;
    back_color = vec3f(0.0);
    shown_behind = 1.0;
}

// How many are peeled from in front.
fn count_from_front() -> u32 {
    return min(params.passes, (count + 1u) / 2u);
}

fn take(fragment: Fragment) {
    if walk == 0u {
        count++;
        return;
    }
    let from_front = count_from_front();
    let from_back = min(params.passes, count - from_front);
    // what overflows can still be hidden
    if taken < from_front {
        front_color = min(front_color + shown * fragment.color, vec3f(LARGEST));
        shown *= 1.0 - fragment.alpha;
    } else if taken >= count - from_back {
        back_color = min(back_color + shown_behind * fragment.color, vec3f(LARGEST));
        shown_behind *= 1.0 - fragment.alpha;
    }
    taken++;
}

fn again() -> bool {
    return walk == 0u;
}

fn finish(id: vec3u) {
    let behind = min(back_color + shown_behind * background_at(pixel_of(id)), vec3f(LARGEST));
    store(id, front_color + shown * behind, shown * shown_behind);
}
