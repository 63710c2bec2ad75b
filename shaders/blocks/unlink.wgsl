// From linked lists to lists without links, which everything that looks at lists reads.

@group(3) @binding(0) var<storage, read_write> heads: array<u32>;
@group(3) @binding(2) var<storage, read_write> next_nodes: array<u32>;
@group(3) @binding(3) var<storage, read_write> node_keys: array<vec2u>;
@group(3) @binding(4) var<storage, read_write> node_colors: array<vec4f>;

// Primitives give way to the places of their ranks.
override is_ranked: bool = false;

@compute @workgroup_size(8, 8)
fn count_nodes(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= frame.size.x || id.y >= frame.rows {
        return;
    }
    let place = place_of(vec2u(id.x, frame.first_row + id.y));
    var count = 0u;
    for (var node = heads[place]; node != 0u; node = next_nodes[node - 1u]) {
        count++;
    }
    atomicStore(&counts[place], count);
    if is_cut_short() {
        atomicOr(&counts[place], UNSORTED);
    }
}

@compute @workgroup_size(8, 8)
fn unlink(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= frame.size.x || id.y >= frame.rows {
        return;
    }
    let place = place_of(vec2u(id.x, frame.first_row + id.y));
    var end = atomicLoad(&places[place]);
    for (var node = heads[place]; node != 0u; node = next_nodes[node - 1u]) {
        if end < arrayLength(&colors) {
            keys[end] = node_keys[node - 1u];
            if is_ranked {
                keys[end].y = place_of_rank(keys[end].y);
            }
            colors[end] = node_colors[node - 1u];
        }
        end++;
    }
    atomicStore(&places[place], end);
    if is_cut_short() {
        atomicOr(&counts[place], UNSORTED);
    }
}
