// The A-buffer (Carpenter 1984): every fragment, nearest first. With room for so many, BLENDS_TAIL, a constant that the form sets,
// says that fragments come as they are submitted, and that what there is no room for is one average behind the others.

var<private> front: Node;
var<private> tail: Sums;

fn begin(pixel: vec2u) {
    node_count = 0u;
    front = CLEAR;
    tail = NO_SUMS;
}

fn take(fragment: Fragment) {
    if BLENDS_TAIL == 0u {
        front = over(front, Node(key_of(fragment), fragment.color, 1.0 - fragment.alpha));
    } else if node_count < LAYERS {
        insert_fragment(fragment);
    } else {
        tail = with_fragment(tail, 1.0, rgba(fragment));
    }
}

fn finish(id: vec3u) {
    let all = composite_nodes(front);
    let behind = over_background(tail, background_at(pixel_of(id)));
    store(id, all.color + all.transmittance * behind.rgb, all.transmittance * behind.a);
}
