// Multi-layer depth peeling (Liu et al. 2009): the nearest fragments, as many as all passes keep; what lies behind them is
// missing.

struct Params {
    layers: u32,
}

@group(0) @binding(3) var<uniform> params: Params;

// With as many layers as all passes keep together: the furthest makes room.
fn begin(pixel: vec2u) {
    node_count = 0u;
}

fn take(fragment: Fragment) {
    insert_fragment(fragment);
    node_count = min(node_count, LAYERS);
}

fn finish(id: vec3u) {
    let all = composite_nodes(CLEAR);
    store(id, all.color + all.transmittance * background_at(pixel_of(id)), all.transmittance);
}

// Over a list that is sorted already, with any number of layers.
@compute @workgroup_size(8, 8)
fn resolve(@builtin(global_invocation_id) id: vec3u) {
    if is_outside(id) {
        return;
    }
    let list = list_of(pixel_of(id));
    var color = vec3f(0.0);
    var transmittance = 1.0;
    var kept = 0u;
    for (var i = 0u; i < list.y && kept < params.layers; i++) {
        let fragment = colors[list.x + i];
        if all(fragment == vec4f(0.0)) {
            continue;
        }
        color += transmittance * fragment.rgb;
        transmittance *= 1.0 - fragment.a;
        kept++;
    }
    store(id, color + transmittance * background_at(pixel_of(id)), transmittance);
}
