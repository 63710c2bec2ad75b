// The first half of rasterisation in compute: primitives go into bins, and from bins into tiles, always in the order of
// submission.

struct Tiling {
    primitives: u32,
    // chunks of CHUNK primitives
    chunks: u32,
    // tiles along a bin's side
    bin_side: u32,
    bin_columns: u32,
    // the rows of bins at hand
    bin_rows: u32,
    first_bin_row: u32,
}

struct Bin {
    first: u32,
    count: u32,
    // of the entries of its tiles
    first_of_tiles: u32,
    count_of_tiles: atomic<u32>,
}

@group(2) @binding(0) var<uniform> tiling: Tiling;
// per primitive: the pixels that its outline may cover, from (x | y << 16) to before another
@group(2) @binding(1) var<storage, read_write> bounds: array<vec2u>;
// per chunk and bin: primitives, then those of the chunks before
@group(2) @binding(2) var<storage, read_write> chunk_counts: array<u32>;
@group(2) @binding(3) var<storage, read_write> bins: array<Bin>;
// primitives, bin by bin
@group(2) @binding(4) var<storage, read_write> bin_entries: array<u32>;
// where the entries of each bin's tiles begin, and how many each has
@group(2) @binding(5) var<storage, read_write> tiles: array<vec2u>;
@group(2) @binding(6) var<storage, read_write> tile_entries: array<u32>;

const CHUNK = 256u;
// bins at hand, and tiles of a bin, at most
const CELLS = 256u;
// more than a bin's tiles have: a loop was ended before it was done
const CUT_SHORT = 0xffffffffu;
const TILE = 8u;
const WORDS = CHUNK / 32u;

// per cell, a bit for each primitive of a chunk
var<workgroup> marks: array<atomic<u32>, CELLS * WORDS>;

// At the end of whatever loops; what is read back then says so.
fn tell_if_cut_short() {
    if is_cut_short() {
        atomicStore(&bins[0].count_of_tiles, CUT_SHORT);
    }
}

fn clear_marks(thread: u32) {
    for (var i = 0u; i < WORDS; i++) {
        atomicStore(&marks[i * CELLS + thread], 0u);
    }
}

fn mark(cell: u32, thread: u32) {
    atomicOr(&marks[cell * WORDS + thread / 32u], 1u << (thread % 32u));
}

// How many of a chunk's first `count` primitives have marked a cell.
fn marked(cell: u32, count: u32) -> u32 {
    var sum = 0u;
    for (var i = 0u; i < count / 32u; i++) {
        sum += countOneBits(atomicLoad(&marks[cell * WORDS + i]));
    }
    if count % 32u != 0u {
        let earlier = (1u << (count % 32u)) - 1u;
        sum += countOneBits(atomicLoad(&marks[cell * WORDS + count / 32u]) & earlier);
    }
    return sum;
}

// A rectangle of cells, or of pixels: from a column and row to before others.
struct Cells {
    first: vec2u,
    end: vec2u,
}

fn are_none(cells: Cells) -> bool {
    return any(cells.first >= cells.end);
}

// The pixels whose centres lie within the corners' bounds.
fn bounds_of(index: u32) -> Cells {
    let primitive = &primitives[index];
    let corners = (*primitive).corners;
    var least = min(min(corners[0], corners[1]), corners[2]);
    var most = max(max(corners[0], corners[1]), corners[2]);
    let outline = (*primitive).outline;
    if (*primitive).outline_count > 0u {
        least = outlines[outline];
        most = least;
        for (var i = 1u; i < (*primitive).outline_count; i++) {
            least = min(least, outlines[outline + i]);
            most = max(most, outlines[outline + i]);
        }
    }
    let size = vec2i(frame.size);
    // shifts round down, also what is negative
    let first = clamp((least + CENTER - 1) >> vec2u(8u), vec2i(0), size);
    let end = clamp((most + CENTER) >> vec2u(8u), vec2i(0), size);
    return Cells(vec2u(first), vec2u(end));
}

fn pixel_bounds_at(index: u32) -> Cells {
    let packed = bounds[index];
    return Cells(vec2u(packed.x & 0xffffu, packed.x >> 16u), vec2u(packed.y & 0xffffu, packed.y >> 16u));
}

// The cells of `size` pixels that some pixels are in, from `first` on, `extent` at most.
fn cells_of(pixels: Cells, size: u32, first: vec2u, extent: vec2u) -> Cells {
    if are_none(pixels) {
        return Cells(vec2u(0u), vec2u(0u));
    }
    let last = first + extent;
    let begin = clamp(pixels.first / size, first, last);
    let end = clamp((pixels.end - 1u) / size + 1u, first, last);
    return Cells(begin - first, end - first);
}

fn bins_of(pixels: Cells) -> Cells {
    let extent = vec2u(tiling.bin_columns, tiling.bin_rows);
    return cells_of(pixels, TILE * tiling.bin_side, vec2u(0u, tiling.first_bin_row), extent);
}

// The first tile of a bin.
fn corner_of(bin: u32) -> vec2u {
    let place = vec2u(bin % tiling.bin_columns, tiling.first_bin_row + bin / tiling.bin_columns);
    return place * tiling.bin_side;
}

fn tiles_of(pixels: Cells, bin: u32) -> Cells {
    return cells_of(pixels, TILE, corner_of(bin), vec2u(tiling.bin_side));
}

fn mark_cells(cells: Cells, columns: u32, thread: u32) {
    for (var y = cells.first.y; y < cells.end.y; y++) {
        for (var x = cells.first.x; x < cells.end.x; x++) {
            mark(y * columns + x, thread);
        }
    }
}

fn bin_count() -> u32 {
    return tiling.bin_columns * tiling.bin_rows;
}

// More chunks than a dispatch has columns take several rows.
fn chunk_of(group: vec3u, groups: vec3u) -> u32 {
    return group.y * groups.x + group.x;
}

// How many primitives of each chunk are in each bin, and how many entries its tiles have.
@compute @workgroup_size(CHUNK)
fn count_bins(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) thread: u32,
) {
    let chunk = chunk_of(group, groups);
    let index = chunk * CHUNK + thread;
    clear_marks(thread);
    workgroupBarrier();
    if index < tiling.primitives {
        let pixels = bounds_of(index);
        bounds[index] = vec2u(pixels.first.x | (pixels.first.y << 16u), pixels.end.x | (pixels.end.y << 16u));
        let cells = bins_of(pixels);
        mark_cells(cells, tiling.bin_columns, thread);
        for (var y = cells.first.y; y < cells.end.y; y++) {
            for (var x = cells.first.x; x < cells.end.x; x++) {
                let bin = y * tiling.bin_columns + x;
                let touched = tiles_of(pixels, bin);
                let extent = touched.end - touched.first;
                atomicAdd(&bins[bin].count_of_tiles, extent.x * extent.y);
            }
        }
    }
    workgroupBarrier();
    if thread < bin_count() && chunk < tiling.chunks {
        chunk_counts[chunk * bin_count() + thread] = marked(thread, CHUNK);
    }
}

var<workgroup> cell_counts: array<vec2u, CELLS>;

// The sum over all cells before.
fn before_cell(thread: u32) -> vec2u {
    var before = vec2u(0u);
    for (var i = 0u; i < thread; i++) {
        before += cell_counts[i];
    }
    return before;
}

// Where each bin's entries begin, and in it those of each chunk. One workgroup: an invocation is a bin.
@compute @workgroup_size(CELLS)
fn place_bins(@builtin(local_invocation_index) thread: u32) {
    var counts = vec2u(0u);
    if thread < bin_count() {
        for (var chunk = 0u; chunk < tiling.chunks; chunk++) {
            let place = chunk * bin_count() + thread;
            let count = chunk_counts[place];
            chunk_counts[place] = counts.x;
            counts.x += count;
        }
        counts.y = atomicLoad(&bins[thread].count_of_tiles);
    }
    cell_counts[thread] = counts;
    workgroupBarrier();
    if thread < bin_count() {
        let before = before_cell(thread);
        bins[thread].first = before.x;
        bins[thread].count = counts.x;
        bins[thread].first_of_tiles = before.y;
    }
    tell_if_cut_short();
}

@compute @workgroup_size(CHUNK)
fn fill_bins(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) thread: u32,
) {
    let chunk = chunk_of(group, groups);
    let index = chunk * CHUNK + thread;
    clear_marks(thread);
    workgroupBarrier();
    var cells = Cells(vec2u(0u), vec2u(0u));
    if index < tiling.primitives {
        cells = bins_of(pixel_bounds_at(index));
        mark_cells(cells, tiling.bin_columns, thread);
    }
    workgroupBarrier();
    for (var y = cells.first.y; y < cells.end.y; y++) {
        for (var x = cells.first.x; x < cells.end.x; x++) {
            let bin = y * tiling.bin_columns + x;
            let place = bins[bin].first + chunk_counts[chunk * bin_count() + bin] + marked(bin, thread);
            if place < arrayLength(&bin_entries) {
                bin_entries[place] = index;
            }
        }
    }
    tell_if_cut_short();
}

var<workgroup> bin_at_hand: vec3u;
// where the next entry of each tile goes
var<workgroup> tile_places: array<u32, CELLS>;

// The tiles of the bin that a primitive of the bin's list touches; none beyond the list's end.
fn touched_by(entry: u32, bin: u32, at_hand: vec3u) -> Cells {
    if entry >= at_hand.y {
        return Cells(vec2u(0u), vec2u(0u));
    }
    return tiles_of(pixel_bounds_at(bin_entries[at_hand.x + entry]), bin);
}

// From a bin to its tiles: a workgroup is a bin, which is gone through twice, chunk by chunk.
@compute @workgroup_size(CELLS)
fn fill_tiles(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) thread: u32) {
    let bin = group.x;
    let side = tiling.bin_side;
    if thread == 0u {
        bin_at_hand = vec3u(bins[bin].first, bins[bin].count, bins[bin].first_of_tiles);
    }
    let at_hand = workgroupUniformLoad(&bin_at_hand);
    var count = 0u;
    for (var base = 0u; base < at_hand.y; base += CHUNK) {
        clear_marks(thread);
        workgroupBarrier();
        mark_cells(touched_by(base + thread, bin, at_hand), side, thread);
        workgroupBarrier();
        count += marked(thread, CHUNK);
        workgroupBarrier();
    }
    cell_counts[thread] = vec2u(count, 0u);
    workgroupBarrier();
    let first = at_hand.z + before_cell(thread).x;
    if thread < side * side {
        tiles[bin * side * side + thread] = vec2u(first, count);
    }
    tile_places[thread] = first;
    for (var base = 0u; base < at_hand.y; base += CHUNK) {
        clear_marks(thread);
        workgroupBarrier();
        let touched = touched_by(base + thread, bin, at_hand);
        mark_cells(touched, side, thread);
        workgroupBarrier();
        for (var y = touched.first.y; y < touched.end.y; y++) {
            for (var x = touched.first.x; x < touched.end.x; x++) {
                let tile = y * side + x;
                let place = tile_places[tile] + marked(tile, thread);
                if place < arrayLength(&tile_entries) {
                    tile_entries[place] = bin_entries[at_hand.x + base + thread];
                }
            }
        }
        workgroupBarrier();
        tile_places[thread] += marked(thread, CHUNK);
        workgroupBarrier();
    }
    tell_if_cut_short();
}
