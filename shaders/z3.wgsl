// Z3 (Jouppi & Chang 1999): one node too many, and the two neighbours with the smallest gap between them become one.

struct Params {
    // a merged node lies at the mean of its depths, not at the nearer one
    at_mean: u32,
}

@group(0) @binding(3) var<uniform> params: Params;

// The distance to the next node, exactly: equal gaps are decided by order, not by rounding.
fn gap_behind(j: u32) -> vec2f {
    return two_sum(bitcast<f32>(nodes[j + 1u].key.x), -bitcast<f32>(nodes[j].key.x));
}

fn is_smaller(a: vec2f, b: vec2f) -> bool {
    return a.x < b.x || (a.x == b.x && a.y < b.y);
}

// The nearest of the pairs that are closest.
fn closest_pair() -> u32 {
    var closest = 0u;
    var least = gap_behind(0u);
    for (var j = 1u; j + 1u < node_count; j++) {
        let gap = gap_behind(j);
        if is_smaller(gap, least) {
            least = gap;
            closest = j;
        }
    }
    return closest;
}

fn merge_closest() {
    let j = closest_pair();
    let near = bitcast<f32>(nodes[j].key.x);
    let far = bitcast<f32>(nodes[j + 1u].key.x);
    merge_pair(j);
    if params.at_mean != 0u {
        nodes[j].key.x = bitcast<u32>(clamp(0.5 * near + 0.5 * far, near, far));
    }
}

fn begin(pixel: vec2u) {
    node_count = 0u;
}

fn take(fragment: Fragment) {
    insert_fragment(fragment);
    if node_count > LAYERS {
        merge_closest();
    }
}

fn finish(id: vec3u) {
    store_nodes(id, CLEAR);
}
