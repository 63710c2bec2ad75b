//! Which pixel centres a triangle covers, many rows at a time: the same rule as in [`super::cover`], and the same
//! pixels, in floating point that is precise enough to be exact.

use super::cover::Rect;
use super::interpolate::LANES;
use super::project::{CENTER, SUBPIXELS};

/// Neighbouring pixels of a row.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Run {
    /// Column of the first pixel in the image.
    pub x: i32,
    /// Row in the image.
    pub y: i32,
    /// Index of the first pixel in the tile.
    pub first: u32,
    /// How many there are, at least one.
    pub len: u32,
}

impl Run {
    /// The pixels' indices in the tile.
    pub fn pixels(self) -> std::ops::Range<usize> {
        self.first as usize..(self.first + self.len) as usize
    }

    /// The groups of [`LANES`] pixels of the tile that it touches.
    pub fn groups(self) -> std::ops::Range<usize> {
        self.first as usize / LANES..((self.first + self.len) as usize).div_ceil(LANES)
    }
}

/// Rows that are looked at together, at most; in whole vectors.
const ROWS: usize = 64;

/// Adding it rounds to the nearest integer, which is in the last bits then.
const ROUND: f64 = 6_755_399_441_055_744.0; // 1.5 * 2^52

/// Beyond any column, that of the flattest edge's line far outside of the image included.
const FAR: f64 = f64::INFINITY;

/// One edge's line: the first pixel at or right of its crossing with a row, from the integers n and d > 0 of the
/// crossing n / d.
///
/// `ceil(n / d)` is what `(n - 1/2) / d + 1/2` rounds to. That is at least 1 / 2d from where rounding changes,
/// and computed to within 2^-51 times the numbers on the way. Where the crossing is in the image those are no
/// larger than 2^15 + r |dx| / |dy| with r rows, r |dx| < 2^40 and d = 256 |dy|, so that no crossing there is taken
/// for its neighbour; one that is outside, which may be by 2^42 pixels, is not taken for one in the image.
///
/// Rounding can wait until crossings have been compared with each other and with columns.
#[derive(Clone, Copy)]
struct Line {
    /// `(n - 1/2) / d + 1/2` at the first row, and from row to row.
    at_first: f64,
    step: f64,
}

impl Line {
    /// The line from `a` to `b` as seen from row `y` on. A horizontal one has no crossings, and counts as one far on the left.
    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    fn new(a: (i32, i32), b: (i32, i32), y: i32) -> Self {
        let (dx, dy) = (f64::from(b.0 - a.0), f64::from(b.1 - a.1));
        let flat = dy == 0.0;
        let (below, left_of) = (f64::from(y * SUBPIXELS + CENTER - a.1), f64::from(a.0 - CENTER));
        // both n and d change sign with dy
        let half = if dy < 0.0 { -0.5 } else { 0.5 };
        let inverse = 1.0 / (f64::from(SUBPIXELS) * if flat { 1.0 } else { dy });
        Self {
            at_first: if flat { -FAR } else { (left_of * dy + below * dx - half) * inverse + 0.5 },
            step: if flat { 0.0 } else { f64::from(SUBPIXELS) * dx * inverse },
        }
    }

    /// What the crossing with the row that many rows below the first rounds to.
    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    fn crossing(self, row: f64) -> f64 {
        self.at_first + row * self.step
    }
}

/// The edges of a triangle: one on the one side and two on the other. Of horizontal ones the triangle's bounds are limit enough.
#[derive(Clone, Copy)]
struct Edges {
    lone: Line,
    pair: [Line; 2],
    pair_is_left: bool,
}

impl Edges {
    /// As seen from row `y` on; `sign` is that of the triangle's area.
    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    fn new([a, b, c]: [(i32, i32); 3], y: i32, sign: f64) -> Self {
        let is_left = |a: (i32, i32), b: (i32, i32)| {
            let (from, to) = if sign > 0.0 { (a.1, b.1) } else { (b.1, a.1) };
            u8::from(to <= from)
        };
        // from the edge on that is alone on its side; neither side has all of them
        let left = is_left(a, b) | is_left(b, c) << 1 | is_left(c, a) << 2;
        let [a, b, c] = match left {
            0b010 | 0b101 => [b, c, a],
            0b100 | 0b011 => [c, a, b],
            _ => [a, b, c],
        };
        Self {
            lone: Line::new(a, b, y),
            pair: [Line::new(b, c, y), Line::new(c, a, y)],
            pair_is_left: left.count_ones() == 2,
        }
    }

    /// Whether all pixels of `rect`, whose first row is the edges', lie between them: lines are straight, so that the first and the
    /// last row tell.
    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    fn hold(&self, rect: &Rect) -> bool {
        let columns = (f64::from(rect.x0), f64::from(rect.x1));
        [0, rect.y1 - 1 - rect.y0].into_iter().all(|row| {
            let (mut from, mut to) = ([0], [0]);
            row_ends(self, row, columns, &mut from, &mut to);
            (from, to) == ([rect.x0], [rect.x1])
        })
    }

    /// What the row that many rows below the first rounds to begin and end at.
    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    fn ends<const PAIR_IS_LEFT: bool>(&self, row: f64) -> (f64, f64) {
        let (lone, [a, b]) = (self.lone.crossing(row), self.pair.map(|line| line.crossing(row)));
        if PAIR_IS_LEFT { (if a > b { a } else { b }, lone) } else { (lone, if a < b { a } else { b }) }
    }
}

/// A number rounded to an integer between the columns, which are so.
#[inline(always)]
#[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
#[expect(clippy::cast_possible_truncation, reason = "the last bits are wanted")]
fn column(x: f64, (x0, x1): (f64, f64)) -> i32 {
    let x = if x > x0 { x } else { x0 };
    let x = if x < x1 { x } else { x1 };
    (x + ROUND).to_bits() as i32
}

/// Where the lines of a triangle's edges let its rows begin and end, between two columns, from the row on that is `first` below
/// the edges' first.
#[inline(always)]
#[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
fn row_ends(edges: &Edges, first: i32, columns: (f64, f64), from: &mut [i32], to: &mut [i32]) {
    if edges.pair_is_left {
        row_ends_of::<true>(edges, first, columns, from, to);
    } else {
        row_ends_of::<false>(edges, first, columns, from, to);
    }
}

/// A plain loop over a number of rows that is not known before: of one over eight, a compiler makes scalars.
#[inline(always)]
#[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
fn row_ends_of<const PAIR_IS_LEFT: bool>(
    edges: &Edges,
    first: i32,
    columns: (f64, f64),
    from: &mut [i32],
    to: &mut [i32],
) {
    for ((from, to), row) in from.iter_mut().zip(to).zip(first..) {
        let (left, right) = edges.ends::<PAIR_IS_LEFT>(f64::from(row));
        *from = column(left, columns);
        *to = column(right, columns);
    }
}

/// Where the rows of `bounds` begin and end in a triangle, of which there are no more than room for them; an end that
/// is not behind its beginning is that of an empty row. The number of rows.
#[inline(always)]
#[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
pub fn ends_of_rows<const N: usize>(
    points: [(i32, i32); 3],
    sign: f64,
    bounds: &Rect,
    from: &mut [i32; N],
    to: &mut [i32; N],
) -> usize {
    let edges = Edges::new(points, bounds.y0, sign);
    let whole = bounds.height().next_multiple_of(LANES);
    let columns = (f64::from(bounds.x0), f64::from(bounds.x1));
    row_ends(&edges, 0, columns, &mut from[..whole], &mut to[..whole]);
    bounds.height()
}

/// The runs of the pixels of `bounds` that a triangle of nonzero area covers, row by row from the top; their
/// indices are those in `rect`, which holds `bounds`. Gives the number of pixels, or none, and no runs, where they are all of
/// `rect`'s.
///
/// A triangle is what lies between its edges' lines in the rows of its bounds, so that the ends of an edge need
/// not be looked at.
#[inline(always)]
#[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
pub fn triangle_runs(
    points: [(i32, i32); 3],
    sign: f64,
    rect: &Rect,
    bounds: &Rect,
    runs: &mut Vec<Run>,
) -> Option<usize> {
    let edges = Edges::new(points, bounds.y0, sign);
    if bounds == rect && edges.hold(rect) {
        return None;
    }
    let columns = (f64::from(bounds.x0), f64::from(bounds.x1));
    let width = rect.x1 - rect.x0;
    let mut start = (bounds.y0 - rect.y0) * width - rect.x0;
    let (mut from, mut to) = ([0; ROWS], [0; ROWS]);
    let mut pixels = 0;
    let mut y = bounds.y0;
    while y < bounds.y1 {
        let rows = ((bounds.y1 - y).cast_unsigned() as usize).min(ROWS);
        let whole = rows.next_multiple_of(LANES);
        row_ends(&edges, y - bounds.y0, columns, &mut from[..whole], &mut to[..whole]);
        for (&left, &right) in from[..rows].iter().zip(&to[..rows]) {
            if right > left {
                let len = (right - left).cast_unsigned();
                runs.push(Run { x: left, y, first: (start + left).cast_unsigned(), len });
                pixels += len as usize;
            }
            start += width;
            y += 1;
        }
    }
    Some(pixels)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::hash32;
    use crate::raster::cover::{doubled_area, pixel_bounds, spans};

    fn pixels(runs: &[Run]) -> Vec<u32> {
        runs.iter().flat_map(|run| run.first..run.first + run.len).collect()
    }

    #[test]
    fn agree_with_the_integer_spans() {
        let mut full = 0;
        for n in 0..20_000_u32 {
            let rect = Rect { x0: 3, y0: 2, x1: 3 + 12 + (n % 60).cast_signed(), y1: 40 };
            let scale = [64, 700, 1500, 4096, 12_000, 16_000_000][n as usize % 6];
            // coordinates on the centre grid now and then, so that ties happen
            let at = |k: u32| {
                let c = (hash32(n, k, 0, 0, 0) % (2 * scale)).cast_signed() - scale.cast_signed() / 3;
                if hash32(n, k, 1, 0, 0).is_multiple_of(2) { c.div_euclid(128) * 128 } else { c }
            };
            let t = [(at(0), at(1)), (at(2), at(3)), (at(4), at(5))];
            let area = doubled_area(&t);
            if area == 0 {
                continue;
            }
            let mut expected = Vec::new();
            let index = |x: i32, y: i32| ((y - rect.y0) * (rect.x1 - rect.x0) + x - rect.x0).cast_unsigned();
            spans(&t, &rect, |y, x0, x1| expected.extend((x0..x1).map(|x| index(x, y))));
            let mut runs = Vec::new();
            let sign = if area < 0 { -1 } else { 1 };
            let bounds = pixel_bounds(&t, &rect);
            let count = triangle_runs(t, f64::from(sign), &rect, &bounds, &mut runs);
            assert_eq!(count.is_none(), expected.len() == rect.area(), "{t:?}");
            if count.is_none() {
                full += 1;
                assert!(runs.is_empty());
                continue;
            }
            assert_eq!(pixels(&runs), expected, "{t:?}");
            assert_eq!(count, Some(expected.len()));
        }
        assert!(full > 100, "{full}");
    }
    /// The lines of edges that are flat or nearly so cross rows far outside of any image.
    #[test]
    fn flat_edges_limit_nothing_but_their_rows() {
        let mut covered = 0;
        for n in 0..4000_u32 {
            let random = |k: u32, below: u32| (hash32(n, k, 3, 0, 0) % below).cast_signed();
            let (x0, y0) = (random(0, 4000), random(1, 4000));
            let rect = Rect { x0, y0, x1: x0 + 1 + random(2, 70), y1: y0 + 1 + random(3, 70) };
            let wide = [1 << 12, 1 << 20, 1 << 23, (1 << 25) - (1 << 16)][n as usize % 4];
            let left = x0 * 256 - random(4, wide / 2);
            let top = y0 * 256 - random(5, 1 << 20) + random(6, 8000);
            let tilt = random(7, 5) - 2;
            let tip = (x0 * 256 + random(8, 20_000), rect.y1 * 256 + random(9, 1 << 20) - random(10, 9000));
            let (a, b) = ((left, top), (left + wide.cast_signed(), top + tilt));
            for t in [[a, b, tip], [b, a, tip], [(a.0, 2 * tip.1 - a.1), tip, (b.0, 2 * tip.1 - b.1)]] {
                let area = doubled_area(&t);
                let bounds = pixel_bounds(&t, &rect);
                if area == 0 || bounds.x0 >= bounds.x1 || bounds.y0 >= bounds.y1 {
                    continue;
                }
                let mut expected = 0;
                spans(&t, &rect, |_, x0, x1| expected += (x1 - x0).cast_unsigned() as usize);
                let sign = if area < 0 { -1.0 } else { 1.0 };
                let mut runs = Vec::new();
                let expected_count = (expected < rect.area()).then_some(expected);
                let count = triangle_runs(t, sign, &rect, &bounds, &mut runs);
                assert_eq!(count, expected_count, "{t:?} {rect:?}");
                covered += usize::from(expected > 0);
            }
        }
        assert!(covered > 3000, "{covered}");
    }
}
