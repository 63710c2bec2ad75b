
// A pixel's weights depend on the mean depth of its list, which is walked twice.

// With twice the mean depth of the pixel for sigma.
@compute @workgroup_size(8, 8)
fn resolve_lists(@builtin(global_invocation_id) id: vec3u) {
    if is_outside(id) {
        return;
    }
    let list = list_of(pixel_of(id));
    var count = 0.0;
    var depths = 0.0;
    for (var place = list.x; place < list.x + list.y; place++) {
        if any(colors[place] != vec4f(0.0)) {
            count += 1.0;
            depths += bitcast<f32>(keys[place].x);
        }
    }
    let sigma = 2.0 * (depths / max(count, 1.0));
    var sums = vec4f(0.0);
    for (var place = list.x; place < list.x + list.y; place++) {
        sums += weight_at(bitcast<f32>(keys[place].x), sigma) * colors[place];
    }
    let average = average_at(pixel_of(id), min(sums, vec4f(LARGEST)));
    store(id, average.rgb, average.a);
}
