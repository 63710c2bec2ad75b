// The continuum of Wyman (2016): the axes as params. This part has what all kinds of memory share, and what needs none; beside
// it is a part for layers, and one for lists, samples and bins.

struct Params {
    // of masks, of samples, or of the masks that decide by chance
    masking: Masking,
    weight: Weight,
    insertion: u32,
    merge: u32,
    // what becomes of fragments that are not stored
    normalize: u32,
    // layers cover samples, not their share of everything
    covers_samples: u32,
    // all fragments are added up, as far as what is stored lets them be seen
    second_pass: u32,
    composite: u32,
    backwards: u32,
    samples: u32,
    bins: u32,
    range_of_pixel: u32,
    nearest: f32,
    farthest: f32,
    threshold: f32,
    s_max: f32,
}

@group(0) @binding(3) var<uniform> params: Params;

// insertion
const THRESHOLD = 1u;
const NEAREST = 2u;
const STOCHASTIC = 3u;

// merge
const DISCARD_FURTHEST = 1u;
const OVER_FURTHEST = 2u;
const OVER_NEAREST = 3u;
const OVER_CLOSEST = 4u;
const SMALLEST_ERROR = 5u;
const OVER_ARRIVAL = 6u;
const DISCARD_OCCLUDED = 7u;
const SUM = 8u;
const AVERAGE = 9u;
const DISCARD_OCCUPIED = 10u;

// normalize
const TAIL = 1u;
const GLOBAL = 2u;

var<private> pixel: vec2u;

fn begin_pixel(id: vec3u) -> vec2u {
    pixel = pixel_of(id);
    return list_of(pixel);
}

fn is_nothing(fragment: vec4f) -> bool {
    return all(fragment == vec4f(0.0));
}

fn depth_in(key: vec2u) -> f32 {
    return bitcast<f32>(key.x);
}

// A fragment as it is stored: those that pass a threshold become opaque.
fn as_stored(fragment: vec4f) -> vec4f {
    if params.insertion == THRESHOLD {
        return vec4f(unmultiplied(fragment), 1.0);
    }
    return fragment;
}

// the keys of the nearest fragments so far
var<private> nearest_keys: array<vec2u, LAYERS>;
var<private> nearest_count: u32;

// Whether fewer than LAYERS of the fragments so far are nearer.
fn is_among_nearest(key: vec2u) -> bool {
    var place = nearest_count;
    while place > 0u && comes_before_by_depth(key, nearest_keys[place - 1u]) {
        place--;
    }
    if place >= LAYERS {
        return false;
    }
    nearest_count = min(nearest_count + 1u, LAYERS);
    for (var i = nearest_count - 1u; i > place; i--) {
        nearest_keys[i] = nearest_keys[i - 1u];
    }
    nearest_keys[place] = key;
    return true;
}

// what is stored, composited front to back: colour, coverage and transmittance
var<private> core_color: vec3f;
var<private> core: vec2f;
// of fragments that are not stored, or of all of them, as far as they are seen
var<private> sums: Sums;
// of all fragments
var<private> net: Sums;

fn begin_core() {
    core_color = vec3f(0.0);
    core = vec2f(0.0, 1.0);
    sums = NO_SUMS;
    net = NO_SUMS;
}

// Adds a fragment of which `seen` is to be seen, if it is not stored or if all are added up.
fn add_fragment(fragment: vec4f, depth: f32, seen: f32, is_stored: bool) {
    net = with_fragment(net, 1.0, fragment);
    if params.second_pass != 0u {
        sums = with_fragment(sums, weight_seen(params.composite, seen), fragment);
    } else if !is_stored {
        let weight = select(1.0, weight_of(params.weight, depth, fragment.a), params.normalize == TAIL);
        sums = with_fragment(sums, weight, fragment);
    }
}

// What is stored and what is not, over the background; `is_samples` says that shares of samples are scaled.
fn store_core(id: vec3u, is_samples: bool) {
    let background = background_at(pixel);
    if params.second_pass != 0u {
        let all = composite_sums(params.composite, sums, core.y, background);
        store(id, all.rgb, all.a);
    } else if params.normalize == TAIL {
        let tail = over_background(sums, background);
        store(id, core_color + core.y * tail.rgb, core.y * tail.a);
    } else if params.normalize == GLOBAL {
        // W16 eq. 9, the background's share included
        var all = vec4f(core_color, core.x);
        if !is_samples {
            all += core.y * min(sums.weighted, vec4f(LARGEST));
            if all.a <= 0.0 {
                store(id, background, 1.0);
                return;
            }
        }
        store(id, net.coverage * average_of(all) + net.transmittance * background, net.transmittance);
    } else {
        store(id, core_color + core.y * background, core.y);
    }
}
