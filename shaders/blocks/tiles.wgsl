// The second half of rasterisation in compute: a workgroup per tile walks the primitives of its tile. An invocation is a pixel,
// which hands its fragments to `take`; what that keeps is in registers.

// A primitive as a tile sees it: the pixel (i, j) is inside where all at + x i + y j >= 0.
struct Prepared {
    at: vec3i,
    x: vec3i,
    y: vec3i,
    index: u32,
}

// A number of 64 bits: upper and lower half.
fn product_64(a: i32, b: i32) -> vec2u {
    let size = wide_product(u32(abs(a)), u32(abs(b)));
    return select(size, negative_64(size), (a < 0) != (b < 0));
}

fn negative_64(a: vec2u) -> vec2u {
    return vec2u(~a.x + select(0u, 1u, a.y == 0u), ~a.y + 1u);
}

fn sum_64(a: vec2u, b: vec2u) -> vec2u {
    let low = a.y + b.y;
    return vec2u(a.x + b.x + select(0u, 1u, low < a.y), low);
}

// (a b - c d + bias) / 256, rounded down, within +-2^30.
fn scaled_difference(a: i32, b: i32, c: i32, d: i32, bias: i32) -> i32 {
    let wide_bias = vec2u(bitcast<u32>(bias >> 31u), bitcast<u32>(bias));
    let difference = sum_64(sum_64(product_64(a, b), negative_64(product_64(c, d))), wide_bias);
    let high = bitcast<i32>(difference.x);
    let within = clamp(high, -64, 63);
    if high != within {
        return select(-0x40000000, 0x40000000, high > 0);
    }
    return (high << 24u) | bitcast<i32>(difference.y >> 8u);
}

// An edge whose inner side is where its function is positive: from p on to q, the function at a tile's first pixel and its steps
// of a pixel. What lies on the edge belongs to the primitive if the edge is its left or top one.
fn edge_function(p: vec2i, q: vec2i, center: vec2i) -> vec3i {
    let d = q - p;
    let is_left_or_top = d.y < 0 || (d.y == 0 && d.x > 0);
    let bias = select(-1, 0, is_left_or_top);
    let at = scaled_difference(d.x, center.y - p.y, d.y, center.x - p.x, bias);
    return vec3i(at, -d.y, d.x);
}

// Steps of a pixel are those of 256 sub-pixels, so that a 256th of the function, rounded down, has the same sign.
fn edges_of(index: u32, first_pixel: vec2u) -> Prepared {
    let primitive = &primitives[index];
    if (*primitive).outline_count > 0u {
        return Prepared(vec3i(0), vec3i(0), vec3i(0), index);
    }
    let center = vec2i(first_pixel) * 256 + CENTER;
    let a = (*primitive).corners[0];
    var b = (*primitive).corners[1];
    var c = (*primitive).corners[2];
    let area = sum_64(product_64(b.x - a.x, c.y - a.y), negative_64(product_64(b.y - a.y, c.x - a.x)));
    if all(area == vec2u(0u)) {
        return Prepared(vec3i(-1), vec3i(0), vec3i(0), index);
    }
    if bitcast<i32>(area.x) < 0 {
        let other = b;
        b = c;
        c = other;
    }
    let edges = mat3_of(edge_function(a, b, center), edge_function(b, c, center), edge_function(c, a, center));
    return Prepared(edges[0], edges[1], edges[2], index);
}

// The transpose.
fn mat3_of(a: vec3i, b: vec3i, c: vec3i) -> array<vec3i, 3> {
    return array<vec3i, 3>(vec3i(a.x, b.x, c.x), vec3i(a.y, b.y, c.y), vec3i(a.z, b.z, c.z));
}

// Whether the tile has a pixel that may be inside: each edge has one on its inner side.
fn touches_tile(edges: Prepared) -> bool {
    let steps = vec3i(i32(TILE) - 1);
    return all(edges.at + max(edges.x * steps, vec3i(0)) + max(edges.y * steps, vec3i(0)) >= vec3i(0));
}

const AT_A_TIME = TILE * TILE;
var<workgroup> prepared: array<Prepared, AT_A_TIME>;
// which of those at hand touch the tile
var<workgroup> touching: array<atomic<u32>, 2>;

// How many of the first `count` touch the tile.
fn touching_before(count: u32) -> u32 {
    let first = atomicLoad(&touching[0]);
    if count < 32u {
        return countOneBits(first & ((1u << count) - 1u));
    }
    // there is no shifting by 32
    let earlier = select((1u << (count - 32u)) - 1u, 0xffffffffu, count >= 64u);
    return countOneBits(first) + countOneBits(atomicLoad(&touching[1]) & earlier);
}
var<workgroup> tile_at_hand: vec2u;

fn tile_of(tile: vec2u) -> u32 {
    let side = tiling.bin_side;
    let bin = (tile.y / side) * tiling.bin_columns + tile.x / side;
    return bin * side * side + (tile.y % side) * side + tile.x % side;
}

// The tile's primitives, once; pixels that want its fragments meet them.
fn walk_tile(first_pixel: vec2u, local: vec2u, thread: u32, entries: vec2u, wants: bool) {
    let pixel = first_pixel + local;
    let step = vec2i(local);
    for (var base = 0u; base < entries.y; base += AT_A_TIME) {
        if thread < 2u {
            atomicStore(&touching[thread], 0u);
        }
        workgroupBarrier();
        var edges: Prepared;
        var touches = false;
        if base + thread < entries.y {
            edges = edges_of(tile_entries[entries.x + base + thread], first_pixel);
            touches = touches_tile(edges);
        }
        if touches {
            atomicOr(&touching[thread / 32u], 1u << (thread % 32u));
        }
        workgroupBarrier();
        if touches {
            prepared[touching_before(thread)] = edges;
        }
        let count = touching_before(AT_A_TIME);
        workgroupBarrier();
        for (var i = 0u; i < count; i++) {
            let values = prepared[i].at + prepared[i].x * step.x + prepared[i].y * step.y;
            if wants && !is_done && all(values >= vec3i(0)) {
                let placed = placed_at(prepared[i].index, vec4f(vec2f(pixel) + 0.5, 0.5, 1.0), 0u);
                var fragment: Fragment;
                if is_seen(placed, pixel, &fragment) {
                    meet(fragment);
                }
            }
        }
        workgroupBarrier();
    }
}

// how many of the tile's pixels want another walk
var<workgroup> wanting: atomic<u32>;
var<workgroup> wanting_at_hand: u32;

// Whether any pixel of the tile wants another walk.
fn any_wants(wants: bool, thread: u32) -> bool {
    if thread == 0u {
        atomicStore(&wanting, 0u);
    }
    workgroupBarrier();
    if wants {
        atomicAdd(&wanting, 1u);
    }
    workgroupBarrier();
    if thread == 0u {
        wanting_at_hand = atomicLoad(&wanting);
    }
    return workgroupUniformLoad(&wanting_at_hand) > 0u;
}

// A workgroup is a tile of the rows at hand.
@compute @workgroup_size(TILE, TILE)
fn draw_tiles(
    @builtin(workgroup_id) group: vec3u,
    @builtin(global_invocation_id) id: vec3u,
    @builtin(local_invocation_id) local: vec3u,
    @builtin(local_invocation_index) thread: u32,
) {
    if thread == 0u {
        // rows at hand may begin within the bins at hand
        let first_row = frame.first_row / TILE - tiling.first_bin_row * tiling.bin_side;
        tile_at_hand = tiles[tile_of(group.xy + vec2u(0u, first_row))];
    }
    let entries = workgroupUniformLoad(&tile_at_hand);
    let first_pixel = vec2u(group.x * TILE, frame.first_row + group.y * TILE);
    let is_in_image = !is_outside(id);
    if is_in_image {
        begin(pixel_of(id));
    }
    var wants = is_in_image;
    loop {
        walk_tile(first_pixel, local.xy, thread, entries, wants);
        if wants {
            wants = wants_more();
        }
        if !any_wants(wants, thread) {
            break;
        }
    }
    if is_in_image {
        finish(id);
    }
}
