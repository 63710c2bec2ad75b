// Every fragment of every pixel: counted, given a place, stored, sorted.

// per pixel of the rows at hand
@group(2) @binding(0) var<storage, read_write> counts: array<atomic<u32>>;
// where the next fragment goes: relative to the row's first one, then to all that are kept at a time
@group(2) @binding(1) var<storage, read_write> places: array<atomic<u32>>;
// per row: fragments, and those of its deepest pixel
@group(2) @binding(2) var<storage, read_write> row_sums: array<vec2u>;
// per row: where its first fragment goes
@group(2) @binding(3) var<storage, read_write> row_places: array<u32>;
// per fragment: the bits of its depth, which ascend with it, and its primitive
@group(2) @binding(4) var<storage, read_write> keys: array<vec2u>;
// ... and its premultiplied colour
@group(2) @binding(5) var<storage, read_write> colors: array<vec4f>;
// per primitive that is drawn, by ascending id: its id, and its place among those that are drawn
@group(2) @binding(6) var<storage, read_write> ranks: array<vec2u>;

@fragment
fn count_fragment(placed: Placed) -> @location(0) vec4f {
    let fragment = fragment_of(placed);
    atomicAdd(&counts[place_of(fragment.pixel)], 1u);
    return vec4f(0.0);
}

fn store_in_list(fragment: Fragment) {
    let place = atomicAdd(&places[place_of(fragment.pixel)], 1u);
    if place < arrayLength(&keys) {
        keys[place] = key_of(fragment);
        colors[place] = vec4f(fragment.color, fragment.alpha);
    }
}

@fragment
fn store_fragment(placed: Placed) -> @location(0) vec4f {
    store_in_list(fragment_of(placed));
    return vec4f(0.0);
}

// Where a primitive's rank is.
fn place_of_rank(id: u32) -> u32 {
    var first = 0u;
    var end = arrayLength(&ranks);
    while first < end {
        let middle = first + (end - first) / 2u;
        if ranks[middle].x < id {
            first = middle + 1u;
        } else {
            end = middle;
        }
    }
    return first;
}

// The same with the place of its rank for the primitive, until ids are restored: places of ranks ascend with ids.
@fragment
fn store_ranked_fragment(placed: Placed) -> @location(0) vec4f {
    var fragment = fragment_of(placed);
    fragment.primitive = place_of_rank(fragment.primitive);
    store_in_list(fragment);
    return vec4f(0.0);
}

const ROW_THREADS = 64u;
var<workgroup> part_sums: array<vec2u, ROW_THREADS>;

// The fragments of a row, and where in it each pixel's are: every thread has a part of the row.
@compute @workgroup_size(ROW_THREADS)
fn sum_rows(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) thread: u32) {
    let row = group.x; // of those at hand
    let width = frame.size.x;
    let part = (width + ROW_THREADS - 1u) / ROW_THREADS;
    let first = min(thread * part, width);
    let last = min(first + part, width);
    var sum = vec2u(0u);
    for (var x = first; x < last; x++) {
        let count = atomicLoad(&counts[row * width + x]);
        sum = vec2u(sum.x + count, max(sum.y, count));
    }
    part_sums[thread] = sum;
    workgroupBarrier();
    var before = vec2u(0u);
    for (var i = 0u; i < thread; i++) {
        before = vec2u(before.x + part_sums[i].x, max(before.y, part_sums[i].y));
    }
    if thread == ROW_THREADS - 1u {
        row_sums[frame.first_row + row] = vec2u(before.x + sum.x, max(before.y, sum.y));
    }
    var place = before.x;
    for (var x = first; x < last; x++) {
        atomicStore(&places[row * width + x], place);
        place += atomicLoad(&counts[row * width + x]);
    }
}

// From places in a row to places among all that are kept.
@compute @workgroup_size(8, 8)
fn shift_rows(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= frame.size.x || id.y >= frame.rows {
        return;
    }
    let row = frame.first_row + id.y;
    atomicAdd(&places[place_of(vec2u(id.x, row))], row_places[row]);
}

// What is added to the count of a list that was not sorted to its end.
const UNSORTED = 0x80000000u;

// The list of a pixel: where it begins, and its length.
fn list_of(pixel: vec2u) -> vec2u {
    let place = place_of(pixel);
    let counted = atomicLoad(&counts[place]);
    let count = counted & ~UNSORTED;
    was_cut_short = counted != count;
    return vec2u(atomicLoad(&places[place]) - count, count);
}

// How lists are sorted: by depth, or as they were submitted, in which order primitive ids ascend, or by ranks.
override sorting: u32 = 0;
const BY_SUBMISSION = 1u;
const BY_RANK = 2u;

fn comes_before(a: vec2u, b: vec2u) -> bool {
    if sorting == BY_SUBMISSION {
        return a.y < b.y;
    }
    if sorting == BY_RANK {
        return ranks[a.y].y < ranks[b.y].y;
    }
    return comes_before_by_depth(a, b);
}

const FEW = 24u;

fn insertion_sort(first: u32, count: u32) {
    for (var i = 1u; i < count; i++) {
        let key = keys[first + i];
        let color = colors[first + i];
        var hole = first + i;
        while hole > first && comes_before(key, keys[hole - 1u]) {
            keys[hole] = keys[hole - 1u];
            colors[hole] = colors[hole - 1u];
            hole--;
        }
        keys[hole] = key;
        colors[hole] = color;
    }
}

// Lets a node sink in the heap of the first `count` nodes until no child comes after it.
fn sink(first: u32, start: u32, count: u32) {
    let key = keys[first + start];
    let color = colors[first + start];
    var hole = start;
    loop {
        var child = 2u * hole + 1u;
        if child >= count {
            break;
        }
        if child + 1u < count && comes_before(keys[first + child], keys[first + child + 1u]) {
            child++;
        }
        if !comes_before(key, keys[first + child]) {
            break;
        }
        keys[first + hole] = keys[first + child];
        colors[first + hole] = colors[first + child];
        hole = child;
    }
    keys[first + hole] = key;
    colors[first + hole] = color;
}

// In place and without recursion, whatever the length.
fn heap_sort(first: u32, count: u32) {
    for (var start = count / 2u; start > 0u; start--) {
        sink(first, start - 1u, count);
    }
    for (var end = count - 1u; end > 0u; end--) {
        let key = keys[first];
        let color = colors[first];
        keys[first] = keys[first + end];
        colors[first] = colors[first + end];
        keys[first + end] = key;
        colors[first + end] = color;
        sink(first, 0u, end);
    }
}

// Each pixel's fragments by (depth, primitive), nearest first, or by primitive.
@compute @workgroup_size(8, 8)
fn sort_lists(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= frame.size.x || id.y >= frame.rows {
        return;
    }
    let list = list_of(vec2u(id.x, frame.first_row + id.y));
    if list.y <= FEW {
        insertion_sort(list.x, list.y);
    } else {
        heap_sort(list.x, list.y);
    }
    if is_cut_short() {
        atomicOr(&counts[place_of(vec2u(id.x, frame.first_row + id.y))], UNSORTED);
    }
}

@compute @workgroup_size(8, 8)
fn restore_ids(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= frame.size.x || id.y >= frame.rows {
        return;
    }
    let pixel = vec2u(id.x, frame.first_row + id.y);
    let list = list_of(pixel);
    for (var i = list.x; i < list.x + list.y; i++) {
        keys[i].y = ranks[keys[i].y].x;
    }
    if is_cut_short() {
        atomicOr(&counts[place_of(pixel)], UNSORTED);
    }
}

// Of each list so many fragments that do something are kept, the first ones, or the last; the others become nothing.
override list_capacity: u32 = 0xffffffff;
override drops_backwards: bool = false;

@compute @workgroup_size(8, 8)
fn drop_fragments(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= frame.size.x || id.y >= frame.rows {
        return;
    }
    let pixel = vec2u(id.x, frame.first_row + id.y);
    let list = list_of(pixel);
    var there = 0u;
    for (var i = 0u; i < list.y; i++) {
        let place = select(list.x + i, list.x + list.y - 1u - i, drops_backwards);
        if any(colors[place] != vec4f(0.0)) {
            there++;
            colors[place] = select(vec4f(0.0), colors[place], there <= list_capacity);
        }
    }
    atomicAdd(&counters[DROPPED], max(there, list_capacity) - list_capacity);
    if is_cut_short() {
        atomicOr(&counts[place_of(pixel)], UNSORTED);
    }
}

// The places of a list's first fragment that does anything, and behind the last one; equal where there is none.
fn ends_of(list: vec2u) -> vec2u {
    var first = list.x;
    var end = list.x + list.y;
    while first < end && all(colors[first] == vec4f(0.0)) {
        first++;
    }
    while first < end && all(colors[end - 1u] == vec4f(0.0)) {
        end--;
    }
    return vec2u(first, end);
}
