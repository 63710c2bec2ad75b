// The k-buffer (Bavoil et al. 2007): one node too many, and the nearest goes into an accumulator that counts as in front of
// whatever arrives later.

struct Params {
    backwards: u32,
}

@group(0) @binding(3) var<uniform> params: Params;

@compute @workgroup_size(8, 8)
fn resolve(@builtin(global_invocation_id) id: vec3u) {
    if is_outside(id) {
        return;
    }
    let list = list_of(pixel_of(id));
    node_count = 0u;
    var front = CLEAR;
    for (var i = 0u; i < list.y; i++) {
        let place = place_in(list, i, params.backwards);
        if all(colors[place] == vec4f(0.0)) {
            continue;
        }
        insert_node(keys[place], colors[place]);
        if node_count > LAYERS {
            front = over(front, take_nearest());
        }
    }
    let all = composite_nodes(front);
    store(id, all.color + all.transmittance * background_at(pixel_of(id)), all.transmittance);
}
