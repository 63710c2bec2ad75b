// A pixel's list of at most LAYERS nodes, nearest first. LAYERS is a constant that the technique's form sets.

struct Node {
    // the bits of its depth, and its primitive; of the nearer one where two were merged
    key: vec2u,
    // premultiplied
    color: vec3f,
    // 1 - coverage
    transmittance: f32,
}

// one more than are kept, since a newcomer is inserted before room is made
var<private> nodes: array<Node, LAYERS + 1u>;
var<private> node_count: u32;

// Inserts a fragment where it belongs, behind its equals, and says where; there has to be room.
fn insert_node(key: vec2u, fragment: vec4f) -> u32 {
    var place = node_count;
    while place > 0u && comes_before_by_depth(key, nodes[place - 1u].key) {
        nodes[place] = nodes[place - 1u];
        place--;
    }
    nodes[place] = Node(key, fragment.rgb, 1.0 - fragment.a);
    node_count++;
    return place;
}

fn insert_fragment(fragment: Fragment) {
    insert_node(key_of(fragment), rgba(fragment));
}

// One node over another. What overflows is the largest number, so that an opaque node hides it, too.
fn over(near: Node, far: Node) -> Node {
    let color = min(near.color + near.transmittance * far.color, vec3f(LARGEST));
    return Node(near.key, color, near.transmittance * far.transmittance);
}

// Node j and the one behind it become one.
fn merge_pair(j: u32) {
    nodes[j] = over(nodes[j], nodes[j + 1u]);
    node_count--;
    for (var i = j + 1u; i < node_count; i++) {
        nodes[i] = nodes[i + 1u];
    }
}

// The two furthest nodes become one.
fn merge_furthest() {
    merge_pair(node_count - 2u);
}

// Takes the nearest node out.
fn take_nearest() -> Node {
    let nearest = nodes[0];
    node_count--;
    for (var i = 0u; i < node_count; i++) {
        nodes[i] = nodes[i + 1u];
    }
    return nearest;
}

// All nodes, and whatever is in front of them, as one.
fn composite_nodes(in_front: Node) -> Node {
    var all = in_front;
    for (var i = 0u; i < node_count; i++) {
        all = over(all, nodes[i]);
    }
    return all;
}

const CLEAR = Node(vec2u(0u), vec3f(0.0), 1.0);

// All nodes, and whatever is in front of them, over the background.
fn store_nodes(id: vec3u, in_front: Node) {
    let all = composite_nodes(in_front);
    store(id, all.color + all.transmittance * background_at(pixel_of(id)), all.transmittance);
}

// The i-th fragment of a list in the order of submission, which may be the reverse of that of storage.
fn place_in(list: vec2u, i: u32, backwards: u32) -> u32 {
    return select(list.x + i, list.x + list.y - 1u - i, backwards != 0u);
}
