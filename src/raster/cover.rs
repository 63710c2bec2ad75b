//! Which pixel centres a snapped polygon covers, in exact integer arithmetic.
//!
//! A centre belongs to the polygon when a ray from it to the left crosses the outline an odd number of times,
//! with edges half open in y (top in, bottom out) and centres on an edge counted as right of it. For triangles
//! this is the top-left rule of D3D and Vulkan, and for any set of polygons that share their edges it hands
//! every centre to exactly one of them.

use super::project::{CENTER, SUBPIXELS};

/// A rectangle of pixels, right and bottom exclusive.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Rect {
    /// First column.
    pub x0: i32,
    /// First row.
    pub y0: i32,
    /// One past the last column.
    pub x1: i32,
    /// One past the last row.
    pub y1: i32,
}

impl Rect {
    /// Columns.
    #[expect(clippy::cast_sign_loss, reason = "never negative by construction")]
    pub fn width(&self) -> usize {
        (self.x1 - self.x0) as usize
    }
    /// Rows.
    #[expect(clippy::cast_sign_loss, reason = "never negative by construction")]
    pub fn height(&self) -> usize {
        (self.y1 - self.y0) as usize
    }
    /// The rectangle cut in two across its longer side.
    pub fn halves(&self) -> [Self; 2] {
        if self.x1 - self.x0 >= self.y1 - self.y0 {
            let x = i32::midpoint(self.x0, self.x1);
            [Self { x1: x, ..*self }, Self { x0: x, ..*self }]
        } else {
            let y = i32::midpoint(self.y0, self.y1);
            [Self { y1: y, ..*self }, Self { y0: y, ..*self }]
        }
    }
    /// Pixels.
    pub fn area(&self) -> usize {
        self.width() * self.height()
    }
}

/// The pixels whose centres lie in the sub-pixel interval `min..=max`, as a half-open range.
pub fn centers(min: i32, max: i32) -> (i32, i32) {
    let first = |subpixel: i32| (subpixel - CENTER).div_euclid(SUBPIXELS);
    (first(min + SUBPIXELS - 1), first(max) + 1)
}

/// Twice the polygon's signed area in sub-pixels squared; positive when clockwise on the screen (y down).
pub fn doubled_area(points: &[(i32, i32)]) -> i64 {
    let n = points.len();
    let (ox, oy) = points[0];
    let cross = |(ax, ay): (i32, i32), (bx, by): (i32, i32)| {
        i64::from(ax - ox) * i64::from(by - oy) - i64::from(bx - ox) * i64::from(ay - oy)
    };
    (1..n - 1).map(|i| cross(points[i], points[i + 1])).sum()
}

/// Whether all pixel centres of a rectangle lie beyond one of a triangle's edges; `sign` is that of its area. False does
/// not say that it covers any: they may lie beyond two edges, where these meet.
#[inline(always)]
#[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
pub fn lies_beside([a, b, c]: [(i32, i32); 3], sign: i32, rect: &Rect) -> bool {
    let center = |pixel: i32| pixel * SUBPIXELS + CENTER;
    let (left, right) = (center(rect.x0), center(rect.x1 - 1));
    let (top, bottom) = (center(rect.y0), center(rect.y1 - 1));
    [(a, b), (b, c), (c, a)].into_iter().any(|(from, to)| {
        let (dx, dy) = (sign * (to.0 - from.0), sign * (to.1 - from.1));
        // the centre that is farthest on the inner side
        let x = if dy < 0 { right } else { left };
        let y = if dx > 0 { bottom } else { top };
        i64::from(dx) * i64::from(y - from.1) < i64::from(dy) * i64::from(x - from.0)
    })
}

/// Where an edge crosses the rows: the first pixel at or right of the crossing, stepped exactly from row to row.
#[derive(Debug, Clone, Copy, Default)]
struct Edge {
    /// First row that the edge crosses.
    first: i32,
    /// One past the last row.
    last: i32,
    /// `ceil(numerator / denominator)` at the current row ...
    column: i64,
    /// ... and what the ceiling added, times the denominator.
    excess: i64,
    step: i64,
    step_excess: i64,
    denominator: i64,
}

/// `(ceil(n / d), ceil(n / d) * d - n)` for d > 0.
fn ceil_div(n: i64, d: i64) -> (i64, i64) {
    let q = -((-n).div_euclid(d));
    (q, q * d - n)
}

impl Edge {
    /// The edge between two points, or none where it crosses no row of the rectangle.
    fn new(a: (i32, i32), b: (i32, i32), rect: &Rect) -> Option<Self> {
        let (top, bottom) = if a.1 < b.1 { (a, b) } else { (b, a) };
        let (first, last) = centers(top.1, bottom.1 - 1);
        let (first, last) = (first.max(rect.y0), last.min(rect.y1));
        if first >= last {
            return None;
        }
        let (dx, dy) = (i64::from(bottom.0 - top.0), i64::from(bottom.1 - top.1));
        let below = i64::from(first) * i64::from(SUBPIXELS) + i64::from(CENTER) - i64::from(top.1);
        let denominator = i64::from(SUBPIXELS) * dy;
        let numerator = i64::from(top.0 - CENTER) * dy + below * dx;
        let (column, excess) = ceil_div(numerator, denominator);
        let (step, step_excess) = ceil_div(i64::from(SUBPIXELS) * dx, denominator);
        Some(Self { first, last, column, excess, step, step_excess, denominator })
    }

    /// The crossing at the current row; moves on to the next.
    #[expect(clippy::cast_possible_truncation, reason = "columns are within the guard band")]
    fn advance(&mut self) -> i32 {
        let column = self.column;
        self.column += self.step;
        self.excess += self.step_excess;
        if self.excess >= self.denominator {
            self.excess -= self.denominator;
            self.column -= 1;
        }
        column as i32
    }
}

/// The most vertices a clipped triangle has: one more for each of the six planes.
pub const MAX_VERTICES: usize = 9;

/// Calls `span(y, x0, x1)` for every run of covered pixels within `rect`, row by row from the top.
pub fn spans(points: &[(i32, i32)], rect: &Rect, mut span: impl FnMut(i32, i32, i32)) {
    let mut edges = [Edge::default(); MAX_VERTICES];
    let mut count = 0;
    let (mut y0, mut y1) = (i32::MAX, i32::MIN);
    for (i, &a) in points.iter().enumerate() {
        let b = points[if i + 1 == points.len() { 0 } else { i + 1 }];
        if let Some(edge) = Edge::new(a, b, rect) {
            (y0, y1) = (y0.min(edge.first), y1.max(edge.last));
            edges[count] = edge;
            count += 1;
        }
    }
    let edges = &mut edges[..count];
    let mut crossings = [0_i32; MAX_VERTICES + 1];
    for y in y0..y1 {
        let mut n = 0;
        for edge in edges.iter_mut().filter(|edge| edge.first <= y && y < edge.last) {
            crossings[n] = edge.advance();
            n += 1;
        }
        debug_assert!(n % 2 == 0, "a closed outline crosses every row an even number of times");
        let crossings = &mut crossings[..n];
        if let [a, b] = crossings {
            emit(y, *(a.min(b)), *(a.max(b)), rect, &mut span);
        } else {
            crossings.sort_unstable();
            crossings.chunks_exact(2).for_each(|pair| emit(y, pair[0], pair[1], rect, &mut span));
        }
    }
}

fn emit(y: i32, x0: i32, x1: i32, rect: &Rect, span: &mut impl FnMut(i32, i32, i32)) {
    let (x0, x1) = (x0.max(rect.x0), x1.min(rect.x1));
    if x0 < x1 {
        span(y, x0, x1);
    }
}

/// The pixels of `rect` whose centres can be in the triangle by its bounding box, in rows that have their top in
/// and their bottom out; may be empty.
pub fn pixel_bounds([a, b, c]: &[(i32, i32); 3], rect: &Rect) -> Rect {
    let (x0, x1) = centers(a.0.min(b.0).min(c.0), a.0.max(b.0).max(c.0));
    let (y0, y1) = centers(a.1.min(b.1).min(c.1), a.1.max(b.1).max(c.1) - 1);
    Rect { x0: x0.max(rect.x0), y0: y0.max(rect.y0), x1: x1.min(rect.x1), y1: y1.min(rect.y1) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::hash32;

    const RECT: Rect = Rect { x0: 0, y0: 0, x1: 12, y1: 10 };

    fn covered(points: &[(i32, i32)], rect: &Rect) -> Vec<(i32, i32)> {
        let mut pixels = Vec::new();
        spans(points, rect, |y, x0, x1| pixels.extend((x0..x1).map(|x| (x, y))));
        pixels
    }

    /// The D3D rule by edge functions in wide integers: an independent statement of the same coverage.
    fn top_left_rule(mut t: [(i32, i32); 3], rect: &Rect) -> Vec<(i32, i32)> {
        let area = doubled_area(&t);
        if area == 0 {
            return vec![];
        }
        if area < 0 {
            t.swap(1, 2);
        }
        let mut pixels = Vec::new();
        for y in rect.y0..rect.y1 {
            for x in rect.x0..rect.x1 {
                let (px, py) = (i128::from(x * 256 + 128), i128::from(y * 256 + 128));
                let inside = (0..3).all(|i| {
                    let ((ax, ay), (bx, by)) = (t[i], t[(i + 1) % 3]);
                    let (dx, dy) = (i128::from(bx - ax), i128::from(by - ay));
                    let e = dx * (py - i128::from(ay)) - dy * (px - i128::from(ax));
                    let top_left = dy < 0 || (dy == 0 && dx > 0);
                    e > 0 || (e == 0 && top_left)
                });
                if inside {
                    pixels.push((x, y));
                }
            }
        }
        pixels
    }

    #[test]
    fn agrees_with_the_top_left_rule_on_random_triangles() {
        for n in 0..4000_u32 {
            let scale = [64, 700, 4096, 20_000_000][n as usize % 4];
            // coordinates on the centre grid now and then, so that ties happen
            let at = |k: u32| {
                let c = (hash32(n, k, 0, 0, 0) % (2 * scale)).cast_signed() - scale.cast_signed() / 2;
                if hash32(n, k, 1, 0, 0).is_multiple_of(2) { c.div_euclid(128) * 128 } else { c }
            };
            let t = [(at(0), at(1)), (at(2), at(3)), (at(4), at(5))];
            assert_eq!(covered(&t, &RECT), top_left_rule(t, &RECT), "{t:?}");
        }
    }

    /// Pieces small enough that many lie beside: none of them has a pixel, and of those that have none few are missed.
    #[test]
    fn what_lies_beside_has_no_pixels() {
        let (mut beside, mut empty) = (0, 0);
        for n in 0..20_000_u32 {
            let scale = [700, 4096, 60_000, 40_000_000][n as usize % 4];
            let at = |k: u32| {
                let c = (hash32(n, k, 2, 0, 0) % scale).cast_signed() - scale.cast_signed() / 3;
                if hash32(n, k, 3, 0, 0).is_multiple_of(2) { c.div_euclid(128) * 128 } else { c }
            };
            let t = [(at(0), at(1)), (at(2), at(3)), (at(4), at(5))];
            let area = doubled_area(&t);
            let of = |k: u32, below: u32| (hash32(n, k, 4, 0, 0) % below).cast_signed();
            let (x0, y0) = (of(0, 16), of(1, 16));
            let rect = Rect { x0, y0, x1: x0 + 1 + of(2, 4), y1: y0 + 1 + of(3, 4) };
            if area == 0 {
                continue;
            }
            let sign = if area < 0 { -1 } else { 1 };
            let none = covered(&t, &rect).is_empty();
            let is_beside = lies_beside(t, sign, &rect);
            assert!(none || !is_beside, "{t:?} {rect:?}");
            beside += u32::from(is_beside);
            empty += u32::from(none);
        }
        assert!(empty > 5000 && f64::from(beside) > 0.9 * f64::from(empty), "{beside} of {empty}");
    }

    #[test]
    fn pieces_of_the_rectangle_see_the_same_pixels() {
        let t = [(-500, 100), (2900, 700), (600, 2500)];
        let whole = covered(&t, &RECT);
        let mut pieces = Vec::new();
        for y0 in (0..10).step_by(3) {
            for x0 in (0..12).step_by(5) {
                let piece = Rect { x0, y0, x1: (x0 + 5).min(12), y1: (y0 + 3).min(10) };
                pieces.extend(covered(&t, &piece));
            }
        }
        pieces.sort_by_key(|&(x, y)| (y, x));
        assert_eq!(whole, pieces);
    }

    #[test]
    fn two_halves_of_a_quadrilateral_share_no_centre() {
        let q = [(130, 77), (2944, 384), (2700, 2400), (0, 1920)];
        let mut halves = covered(&[q[0], q[1], q[2]], &RECT);
        halves.extend(covered(&[q[0], q[2], q[3]], &RECT));
        halves.sort_by_key(|&(x, y)| (y, x));
        assert_eq!(halves, covered(&q, &RECT));
    }

    #[test]
    fn centre_ranges() {
        assert_eq!(centers(0, 256), (0, 1));
        assert_eq!(centers(128, 128), (0, 1));
        assert_eq!(centers(129, 383), (1, 1));
        assert_eq!(centers(-128, -128), (-1, 0));
    }
}
