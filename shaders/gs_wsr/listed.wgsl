
// A pixel's weights depend on the mean depth of its fragments, which takes a walk.
var<private> count: f32;
var<private> depths: f32;
var<private> sums: vec4f;

fn begin(pixel: vec2u) {
    count = 0.0;
    depths = 0.0;
    sums = vec4f(0.0);
}

// With twice the mean depth of the pixel for sigma.
fn take(fragment: Fragment) {
    if walk == 0u {
        count += 1.0;
        depths += fragment.depth;
        return;
    }
    sums += weight_at(fragment.depth, 2.0 * (depths / count)) * rgba(fragment);
}

fn again() -> bool {
    return walk == 0u;
}

fn finish(id: vec3u) {
    let average = average_at(pixel_of(id), min(sums, vec4f(LARGEST)));
    store(id, average.rgb, average.a);
}
