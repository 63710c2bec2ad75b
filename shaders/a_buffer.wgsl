// The A-buffer (Carpenter 1984): every fragment, sorted, front to back.

@compute @workgroup_size(8, 8)
fn composite(@builtin(global_invocation_id) id: vec3u) {
    if is_outside(id) {
        return;
    }
    let list = list_of(pixel_of(id));
    var color = vec3f(0.0);
    var transmittance = 1.0;
    for (var i = 0u; i < list.y; i++) {
        let fragment = colors[list.x + i];
        color += transmittance * fragment.rgb;
        transmittance *= 1.0 - fragment.a;
    }
    store(id, color + transmittance * background_at(pixel_of(id)), transmittance);
}
