// No memory in the continuum: functions of depth.

fn begin(at: vec2u) {
    pixel = at;
    begin_core();
}

fn take(fragment: Fragment) {
    var weight = 1.0;
    if params.normalize != 0u {
        weight = weight_of(params.weight, fragment.depth, fragment.alpha);
    }
    sums = with_fragment(sums, weight, rgba(fragment));
}

fn again() -> bool {
    return false;
}

fn finish(id: vec3u) {
    let background = background_at(pixel);
    if params.normalize != 0u {
        let texel = over_background(sums, background);
        store(id, texel.rgb, texel.a);
        return;
    }
    let left = 1.0 - min(sums.weighted.a, LARGEST);
    store(id, min(sums.weighted.rgb, vec3f(LARGEST)) + left * background, left);
}
