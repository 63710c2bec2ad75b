// Per-pixel linked lists (Yang et al. 2010): one pass over the geometry puts every fragment into a node of a pool, in front of
// its pixel's others.

// per pixel of the rows at hand: its first node, counted from 1 on; 0 where there is none
@group(2) @binding(0) var<storage, read_write> heads: array<atomic<u32>>;
// nodes that were asked for, of which there may be more than there are
@group(2) @binding(1) var<storage, read_write> node_count: atomic<u32>;
// per node: the one behind it, as heads are counted, ...
@group(2) @binding(2) var<storage, read_write> next_nodes: array<u32>;
// ... and the fragment, as lists have it
@group(2) @binding(3) var<storage, read_write> node_keys: array<vec2u>;
@group(2) @binding(4) var<storage, read_write> node_colors: array<vec4f>;

@fragment
fn link_fragment(placed: Placed) -> @location(0) vec4f {
    let fragment = fragment_of(placed);
    let node = atomicAdd(&node_count, 1u);
    if node < arrayLength(&node_colors) {
        node_keys[node] = key_of(fragment);
        node_colors[node] = vec4f(fragment.color, fragment.alpha);
        next_nodes[node] = atomicExchange(&heads[place_of(fragment.pixel)], node + 1u);
    }
    return vec4f(0.0);
}
