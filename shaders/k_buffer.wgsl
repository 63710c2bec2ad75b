// The k-buffer (Bavoil et al. 2007): one node too many, and the nearest goes into an accumulator that counts as in front of
// whatever arrives later.

var<private> front: Node;

fn begin(pixel: vec2u) {
    node_count = 0u;
    front = CLEAR;
}

fn take(fragment: Fragment) {
    insert_fragment(fragment);
    if node_count > LAYERS {
        front = over(front, take_nearest());
    }
}

fn finish(id: vec3u) {
    store_nodes(id, front);
}
