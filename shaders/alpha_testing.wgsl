// Alpha testing: the nearest fragment of a larger alpha than the threshold, as if it were opaque.

struct Params {
    threshold: f32,
}

@group(0) @binding(3) var<uniform> params: Params;

// the nearest one so far; its coverage is 0 before there is any
var<private> nearest: vec4f;
var<private> nearest_key: vec2u;

fn begin(pixel: vec2u) {
    nearest = vec4f(0.0);
}

fn take(fragment: Fragment) {
    let key = key_of(fragment);
    let is_first = nearest.a == 0.0 || comes_before_by_depth(key, nearest_key);
    if fragment.alpha > params.threshold && is_first {
        nearest = rgba(fragment);
        nearest_key = key;
    }
}

fn finish(id: vec3u) {
    if nearest.a > 0.0 {
        store(id, nearest.rgb / nearest.a, 0.0);
    } else {
        store(id, background_at(pixel_of(id)), 1.0);
    }
}
