// Transmittance function maps (Delalandre et al. 2011): a cosine series of a pixel's transmittance. It takes sorted fragments;
// their keys make room for where they are and for what the series is there.

struct Params {
    // depths are told apart between these, each a sum of two ...
    near: vec2f,
    far: vec2f,
    // ... or between those of the pixel
    range_of_pixel: u32,
    // as in the two-pass template
    composite: u32,
    frequencies: u32,
    unused: u32,
}

@group(0) @binding(3) var<uniform> params: Params;

const PI = 3.1415927;
const FLOOR = 1e-30;

// (cos, sin) of pi k d.
fn half_turns(d: f32, k: u32) -> vec2f {
    return unit_at(times(vec2f(0.5 * d, 0.0), f32(k)));
}

fn does_nothing(place: u32) -> bool {
    return all(colors[place] == vec4f(0.0));
}

fn interval_of(list: vec2u) -> Interval {
    if params.range_of_pixel == 0u {
        return Interval(params.near, params.far);
    }
    var first = list.x;
    var last = list.x + list.y - 1u;
    while first < last && does_nothing(first) {
        first++;
    }
    while first < last && does_nothing(last) {
        last--;
    }
    return Interval(vec2f(bitcast<f32>(keys[first].x), 0.0), vec2f(bitcast<f32>(keys[last].x), 0.0));
}

// c_k, the integral of 2 T cos(pi k x): every step takes what is behind it.
fn coefficient_of(list: vec2u, k: u32) -> f32 {
    var sum = 0.0;
    var reaches = 1.0;
    for (var place = list.x; place < list.x + list.y; place++) {
        sum += reaches * colors[place].a * half_turns(bitcast<f32>(keys[place].x), k).y;
        reaches *= 1.0 - colors[place].a;
    }
    return 2.0 * sum / (PI * f32(k));
}

// c_0, with the keys made places in [0, 1].
fn begin_series(list: vec2u) -> f32 {
    let interval = interval_of(list);
    var mean = 1.0;
    var reaches = 1.0;
    for (var place = list.x; place < list.x + list.y; place++) {
        let d = position_in(interval, bitcast<f32>(keys[place].x)).x;
        mean -= reaches * colors[place].a * (1.0 - d);
        reaches *= 1.0 - colors[place].a;
        keys[place].x = bitcast<u32>(d);
    }
    for (var place = list.x; place < list.x + list.y; place++) {
        keys[place].y = bitcast<u32>(mean);
    }
    return mean;
}

// T at the far end, with that at each fragment in its key.
fn sum_series(list: vec2u) -> f32 {
    var total = begin_series(list);
    for (var k = 1u; k <= params.frequencies; k++) {
        let c = coefficient_of(list, k);
        total += select(c, -c, k % 2u == 1u);
        for (var place = list.x; place < list.x + list.y; place++) {
            let so_far = bitcast<f32>(keys[place].y);
            keys[place].y = bitcast<u32>(so_far + c * half_turns(bitcast<f32>(keys[place].x), k).x);
        }
    }
    return clamp(total, 0.0, 1.0);
}

@compute @workgroup_size(8, 8)
fn resolve(@builtin(global_invocation_id) id: vec3u) {
    if is_outside(id) {
        return;
    }
    let list = list_of(pixel_of(id));
    let background = background_at(pixel_of(id));
    if list.y == 0u {
        store(id, background, 1.0);
        return;
    }
    let total = sum_series(list);
    let least = select(0.0, FLOOR, params.composite == 2u);
    var sums = vec4f(0.0);
    var share = 1.0;
    for (var place = list.x; place < list.x + list.y; place++) {
        let t = clamp(bitcast<f32>(keys[place].y), 0.0, 1.0);
        sums += max(t, least) * colors[place];
        share *= 1.0 - colors[place].a;
    }
    sums = min(sums, vec4f(LARGEST));
    switch params.composite {
        case 0u: {
            store(id, sums.rgb + total * background, total);
        }
        case 1u: {
            store(id, sums.rgb + share * background, share);
        }
        default: {
            let average = select(vec3f(0.0), sums.rgb * ((1.0 - share) / sums.a), sums.a > 0.0);
            store(id, average + share * background, share);
        }
    }
}
