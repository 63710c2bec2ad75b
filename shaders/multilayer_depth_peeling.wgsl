// Multi-layer depth peeling (Liu et al. 2009): the nearest fragments, as many as all passes keep; what lies behind them is
// missing.

struct Params {
    layers: u32,
}

@group(0) @binding(3) var<uniform> params: Params;

// Layers are kept in registers, where the furthest makes room; or else fragments come nearest first, and what they show is all
// that is there of them: then there may be any number of layers. COMES_SORTED is a constant that the form sets.
var<private> kept: Node;
var<private> layer_count: u32;

fn begin(pixel: vec2u) {
    node_count = 0u;
    layer_count = 0u;
    kept = CLEAR;
}

fn take(fragment: Fragment) {
    if COMES_SORTED == 0u {
        insert_fragment(fragment);
        node_count = min(node_count, LAYERS);
        return;
    }
    kept = over(kept, Node(key_of(fragment), fragment.color, 1.0 - fragment.alpha));
    layer_count++;
    is_done = layer_count >= params.layers;
}

fn finish(id: vec3u) {
    store_nodes(id, kept);
}
