// Lists as a stream: each pixel's fragments are handed over one by one to what the technique keeps.

@compute @workgroup_size(8, 8)
fn resolve_stream(@builtin(global_invocation_id) id: vec3u) {
    if is_outside(id) {
        return;
    }
    let pixel = pixel_of(id);
    let list = list_of(pixel);
    begin(pixel);
    loop {
        for (var i = 0u; i < list.y && !is_done; i++) {
            let place = select(list.x + i, list.x + list.y - 1u - i, backwards);
            let color = colors[place];
            if !shows_zero_fragments && all(color == vec4f(0.0)) {
                continue;
            }
            take(Fragment(pixel, bitcast<f32>(keys[place].x), color.rgb, color.a, keys[place].y));
        }
        if !again() {
            break;
        }
        walk++;
        is_done = false;
    }
    finish(id);
}
