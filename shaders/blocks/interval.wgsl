// Where in a depth interval something is. Bounds and differences are sums of two f32, so that a depth is in the cell that it
// is in on the CPU.

struct Interval {
    near: vec2f,
    far: vec2f,
}

struct Cell {
    index: u32,
    // how far inside
    fraction: f32,
}

// Depths of all sizes can be multiplied.
const UNIT = 2.3283064e-10;

// How far behind the near end a depth is, in units of 2^32.
fn offset_in(interval: Interval, depth: f32) -> vec2f {
    return UNIT * sum_of(vec2f(depth, 0.0), -interval.near);
}

fn length_of(interval: Interval) -> vec2f {
    return sum_of(interval.far, -interval.near);
}

fn extent_of(interval: Interval) -> vec2f {
    return UNIT * length_of(interval);
}

// A position in [0, 1]; 0 in an interval of a single depth.
fn position_in(interval: Interval, depth: f32) -> vec2f {
    let extent = extent_of(interval);
    let offset = offset_in(interval, depth);
    if extent.x <= 0.0 || offset.x <= 0.0 {
        return vec2f(0.0);
    }
    if !is_less(offset, extent) {
        return vec2f(1.0, 0.0);
    }
    return quotient(offset, extent);
}

// Which of `count` equal cells a depth is in, `last` being the last that counts.
fn cell_in(interval: Interval, depth: f32, count: f32, last: u32) -> Cell {
    let extent = extent_of(interval);
    var offset = offset_in(interval, depth);
    if extent.x <= 0.0 || offset.x <= 0.0 {
        return Cell(0u, 0.0);
    }
    if !is_less(offset, extent) {
        offset = extent;
    }
    // the quotient may be rounded to a neighbour
    var index = min(floor(offset.x / extent.x * count), f32(last));
    var inside = sum_of(times(offset, count), -times(extent, index));
    if inside.x < 0.0 && index > 0.0 {
        index -= 1.0;
        inside = sum_of(inside, extent);
    } else if !is_less(inside, extent) && index < f32(last) {
        index += 1.0;
        inside = sum_of(inside, -extent);
    }
    return Cell(u32(index), clamp(inside.x / extent.x, 0.0, 1.0));
}
