// Depth peeling (Mammen 1989; Everitt 2001): each pass over the geometry finds the nearest fragment behind the last pass's, and
// puts it under what is there. Fragments are told apart by (depth, primitive), so that of coincident ones none is lost: the
// depth buffer decides by depth and then by who comes first, and primitives are drawn in the order of their ids.

struct Params {
    // a difference of exponents: what takes depths to window depths
    window_exponent: u32,
    // where less than that shows through, nothing more is peeled
    enough: f32,
    // at most
    passes: u32,
}

@group(0) @binding(3) var<uniform> params: Params;

// the frontier: the bits of the window depth of a pixel's last layer, and its primitive + 1
@group(2) @binding(0) var frontier: texture_2d<u32>;
// layers composited so far, or in the pass over the image the new one
@group(2) @binding(1) var layers_so_far: texture_2d<f32>;
@group(2) @binding(1) var layer: texture_2d<f32>;
@group(2) @binding(2) var<storage, read_write> has_peeled: atomic<u32>;

struct Layer {
    @builtin(frag_depth) depth: f32,
    @location(0) key: vec2u,
    @location(1) color: vec4f,
}

// a pixel of which nothing is left; what its target is cleared to
const NOTHING = 0xffffffffu;

@fragment
fn peel(placed: Placed) -> Layer {
    let fragment = fragment_of(placed);
    let key = vec2u(window_bits(fragment.depth, params.window_exponent), fragment.primitive + 1u);
    if !comes_before_by_depth(textureLoad(frontier, fragment.pixel, 0).xy, key) {
        discard;
    }
    if textureLoad(layers_so_far, fragment.pixel, 0).a < params.enough {
        discard;
    }
    return Layer(bitcast<f32>(key.x), key, vec4f(fragment.color, fragment.alpha));
}

@fragment
fn put_under(@builtin(position) position: vec4f) -> @location(0) vec4f {
    let pixel = vec2u(position.xy);
    if textureLoad(frontier, pixel, 0).y == NOTHING {
        discard;
    }
    atomicStore(&has_peeled, 1u);
    return textureLoad(layer, pixel, 0);
}

@group(2) @binding(0) var all_layers: texture_2d<f32>;

@fragment
fn resolve(@builtin(position) position: vec4f) -> @location(0) vec4f {
    let pixel = pixel_at(position);
    let all = load(all_layers, pixel);
    return image_texel(min(all.rgb, vec3f(LARGEST)) + all.a * background_at(pixel), all.a);
}

// In tiles fragments come nearest first: what is peeled so far, and how many.
var<private> front_color: vec3f;
var<private> shown: f32;
var<private> peeled: u32;

fn begin(pixel: vec2u) {
    front_color = vec3f(0.0);
    shown = 1.0;
    peeled = 0u;
}

fn take(fragment: Fragment) {
    front_color += shown * fragment.color;
    shown *= 1.0 - fragment.alpha;
    peeled++;
    is_done = peeled >= params.passes || shown < params.enough;
}

fn again() -> bool {
    return false;
}

fn finish(id: vec3u) {
    store(id, min(front_color, vec3f(LARGEST)) + shown * background_at(pixel_of(id)), shown);
}
