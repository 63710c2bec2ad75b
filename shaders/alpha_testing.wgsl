// Alpha testing: the nearest fragment of a larger alpha than the threshold, as if it were opaque.

struct Params {
    threshold: f32,
}

@group(0) @binding(3) var<uniform> params: Params;

// Over a list that is sorted already.
@compute @workgroup_size(8, 8)
fn resolve(@builtin(global_invocation_id) id: vec3u) {
    if is_outside(id) {
        return;
    }
    let list = list_of(pixel_of(id));
    for (var i = 0u; i < list.y; i++) {
        let fragment = colors[list.x + i];
        if fragment.a > params.threshold {
            store(id, fragment.rgb / fragment.a, 0.0);
            return;
        }
    }
    store(id, background_at(pixel_of(id)), 1.0);
}
