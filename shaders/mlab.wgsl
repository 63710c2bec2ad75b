// Multi-layer alpha blending (Salvi & Vaidyanathan 2014): one node too many, and the two furthest become one.

fn begin(pixel: vec2u) {
    node_count = 0u;
}

fn take(fragment: Fragment) {
    insert_fragment(fragment);
    if node_count > LAYERS {
        merge_furthest();
    }
}

fn finish(id: vec3u) {
    store_nodes(id, CLEAR);
}
