//! The pixels of a small primitive, one by one: runs of a few pixels each would cost more than their pixels.

use super::cover::Rect;
use super::interpolate::LANES;
use super::project::{CENTER, SUBPIXELS};
use super::runs::{Run, ends_of_rows};
use std::ops::Range;

/// Pixels of one primitive up to which they are listed one by one; runs pay off from here on.
pub const FEW: usize = 64;
/// Triangles of no more columns and rows, whose corners are near, are listed, however many pixels they have.
const SMALL: i32 = 16;
/// Triangles of no more columns and rows are looked at pixel by pixel. No corner is farther away from a pixel of theirs
/// than twice as many pixels, so that edge functions fit 32 bits.
const TINY: i32 = 8;
/// Columns that are written together.
const COLUMNS: usize = 16;
const BESIDE: [u32; COLUMNS] = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15];
/// The most pixels of a small triangle, and as much as may be written behind them.
const ROOM: usize = 256 + COLUMNS;

/// Where a primitive is in a tile.
#[derive(Debug, Clone, Copy)]
pub enum Where<'a> {
    /// The pixels of a small one.
    Few(&'a Pixels),
    /// Row by row from the top.
    Many(&'a [Run]),
}

impl Where<'_> {
    /// Rows of the tile that it lies in, which there has to be; it need not be in all of them.
    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    #[expect(clippy::cast_sign_loss, reason = "rows of the tile")]
    pub fn rows(&self, tile: &Rect) -> Range<usize> {
        match self {
            Self::Few(pixels) => pixels.rows.clone(),
            Self::Many(runs) => {
                let (first, last) = (runs[0].y, runs[runs.len() - 1].y);
                (first - tile.y0) as usize..(last + 1 - tile.y0) as usize
            }
        }
    }

    /// Calls `visit(n, i)` for every pixel: the n-th of them, whose index in the tile is i.
    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    pub fn for_each(&self, mut visit: impl FnMut(usize, usize)) {
        match self {
            Self::Few(pixels) => {
                pixels.places().iter().enumerate().for_each(|(n, &place)| visit(n, place as usize));
            }
            Self::Many(runs) => {
                runs.iter().flat_map(|run| run.pixels()).enumerate().for_each(|(n, i)| visit(n, i));
            }
        }
    }

    /// Calls `visit(x, y)` for every pixel, in image coordinates.
    pub fn for_each_position(&self, mut visit: impl FnMut(i32, i32)) {
        match self {
            Self::Few(pixels) => pixels.positions().for_each(|(x, y)| visit(x, y)),
            Self::Many(runs) => {
                let pixels = |run: &Run| {
                    let (x, y) = (run.x, run.y);
                    (0..run.len.cast_signed()).map(move |i| (x + i, y))
                };
                runs.iter().flat_map(pixels).for_each(|(x, y)| visit(x, y));
            }
        }
    }
}

/// Pixels one by one; there is room for whole vectors, and what is in the room means nothing.
#[derive(Debug, Clone)]
pub struct Pixels {
    /// The tile.
    rect: Rect,
    /// Columns and rows in the tile, in the lower and the upper half of a number.
    at: [u32; ROOM],
    /// Indices in the tile.
    places: [u32; ROOM],
    count: usize,
    /// Rows of the tile that none lies outside of.
    rows: Range<usize>,
}

impl Default for Pixels {
    fn default() -> Self {
        Self { rect: Rect::default(), at: [0; ROOM], places: [0; ROOM], count: 0, rows: 0..0 }
    }
}

impl Pixels {
    /// No pixels, in the tile `rect` from now on.
    pub fn begin(&mut self, rect: Rect) {
        self.rect = rect;
        self.count = 0;
    }

    /// No pixels.
    pub fn clear(&mut self) {
        self.count = 0;
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// The pixels' indices in the tile.
    pub fn places(&self) -> &[u32] {
        &self.places[..self.count]
    }

    /// The pixels' columns and rows in the tile, in the lower and the upper half of a number, and some more: whole
    /// vectors.
    pub fn at(&self) -> &[u32] {
        &self.at[..self.count.next_multiple_of(LANES)]
    }

    /// The tile's first column and row.
    pub fn origin(&self) -> (i32, i32) {
        (self.rect.x0, self.rect.y0)
    }

    /// The pixels' columns and rows in the tile.
    pub fn places_in_tile(&self) -> impl Iterator<Item = (i32, i32)> {
        self.at[..self.count].iter().map(|&at| unpack(at))
    }

    fn positions(&self) -> impl Iterator<Item = (i32, i32)> {
        self.places_in_tile().map(|(column, row)| (self.rect.x0 + column, self.rect.y0 + row))
    }

    fn position(&self, at: u32) -> (i32, i32) {
        let (column, row) = unpack(at);
        (self.rect.x0 + column, self.rect.y0 + row)
    }

    /// Lists the pixels of some runs, which are no more than [`FEW`].
    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    pub fn list(&mut self, runs: &[Run]) {
        if let (Some(first), Some(last)) = (runs.first(), runs.last()) {
            self.set_rows(first.y, last.y + 1);
        }
        let mut next = 0;
        for run in runs {
            let end = next + run.len as usize;
            let mut first = packed(run.x - self.rect.x0, run.y - self.rect.y0);
            while next < end {
                // whole vectors, the ends of which the next run writes over
                self.write(next, first);
                (next, first) = (next + COLUMNS, first + BESIDE[COLUMNS - 1] + 1);
            }
            next = end;
        }
        self.set_count(next);
    }

    /// Lists a triangle's pixels within `bounds`, a part of the tile, if it is small; false if it is not.
    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    pub fn list_triangle(&mut self, points: [(i32, i32); 3], sign: i32, bounds: &Rect) -> bool {
        self.set_rows(bounds.y0, bounds.y1);
        let (columns, rows) = (bounds.x1 - bounds.x0, bounds.y1 - bounds.y0);
        let reach = |limit: i32| {
            let near = |at: i32, first: i32| (at - first * SUBPIXELS).abs() < 2 * limit * SUBPIXELS;
            columns <= limit
                && rows <= limit
                && points.iter().all(|p| near(p.0, bounds.x0) && near(p.1, bounds.y0))
        };
        if reach(TINY) {
            self.list_tiny(points, sign, bounds);
        } else if reach(SMALL) {
            self.list_rows(points, sign, bounds);
        } else {
            return false;
        }
        true
    }

    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    #[expect(clippy::cast_sign_loss, reason = "rows of the tile")]
    fn set_rows(&mut self, y0: i32, y1: i32) {
        self.rows = (y0 - self.rect.y0) as usize..(y1 - self.rect.y0) as usize;
    }

    /// By the edge functions of 8 x 8 pixels from the bounds' corner on, column by column.
    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    fn list_tiny(&mut self, points: [(i32, i32); 3], sign: i32, bounds: &Rect) {
        let (columns, rows) = (bounds.x1 - bounds.x0, bounds.y1 - bounds.y0);
        let in_rows = 0x0101_0101_0101_0101 * ((1_u64 << rows) - 1);
        let in_columns = u64::MAX >> (64 - 8 * columns);
        let mut covered = tiny_coverage(points, sign, bounds) & in_columns & in_rows;
        let count = covered.count_ones() as usize;
        let corner = packed(bounds.x0 - self.rect.x0, bounds.y0 - self.rect.y0);
        let mut next = 0;
        while next < count {
            // eight at a time, whether there are as many or not: how many cannot be foreseen
            let mut bits = [0; LANES];
            for bit in &mut bits {
                *bit = covered.trailing_zeros();
                covered &= covered.wrapping_sub(1);
            }
            let at = &mut self.at[next..next + LANES];
            for lane in 0..LANES {
                at[lane] = corner + (bits[lane] >> 3) + ((bits[lane] & 7) << 16);
            }
            next += LANES;
        }
        self.set_count(count);
    }

    /// By the ends of its rows.
    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    fn list_rows(&mut self, points: [(i32, i32); 3], sign: i32, bounds: &Rect) {
        let (mut from, mut to) = ([0; SMALL as usize], [0; SMALL as usize]);
        let rows = ends_of_rows(points, sign.into(), bounds, &mut from, &mut to);
        let mut start = packed(-self.rect.x0, bounds.y0 - self.rect.y0);
        let mut count = 0;
        for (&left, &right) in from[..rows].iter().zip(&to[..rows]) {
            // a whole row, the end of which the next one writes over
            self.write(count, start.wrapping_add_signed(left));
            count += (right - left).max(0).cast_unsigned() as usize;
            start = start.wrapping_add(1 << 16);
        }
        self.set_count(count);
    }

    /// A pixel and those beside it.
    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    fn write(&mut self, n: usize, first: u32) {
        for (at, column) in self.at[n..n + COLUMNS].iter_mut().zip(BESIDE) {
            *at = first.wrapping_add(column);
        }
    }

    /// Ends the list, and finds the places of what is in it.
    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    #[expect(clippy::cast_possible_truncation, reason = "columns of a tile")]
    fn set_count(&mut self, count: usize) {
        self.count = count;
        let (width, whole) = (self.rect.width() as u32, count.next_multiple_of(LANES));
        for (place, &at) in self.places[..whole].iter_mut().zip(&self.at[..whole]) {
            *place = (at & 0xFFFF).wrapping_add((at >> 16).wrapping_mul(width));
        }
    }

    /// Keeps the pixels that `keep(index, x, y, depth)` wants, and their depths; their number.
    pub fn retain(
        &mut self,
        depth: &mut [f32],
        constant_depth: Option<f32>,
        mut keep: impl FnMut(usize, i32, i32, f32) -> bool,
    ) -> usize {
        let mut to = 0;
        for from in 0..self.count {
            let ((x, y), place) = (self.position(self.at[from]), self.places[from]);
            let z = constant_depth.unwrap_or(depth[from]);
            if keep(place as usize, x, y, z) {
                (self.at[to], self.places[to], depth[to]) = (self.at[from], place, z);
                to += 1;
            }
        }
        self.count = to;
        to
    }
}

/// Column and row in one number.
#[inline(always)]
#[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
fn packed(column: i32, row: i32) -> u32 {
    column.wrapping_add(row << 16).cast_unsigned()
}

/// A byte per column and a bit per pixel of 8 x 8: those inside of all edges. Rows beyond the bounds are undefined.
#[inline(always)]
#[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
#[expect(clippy::cast_possible_truncation, reason = "a byte per column")]
#[expect(clippy::needless_bitwise_bool, reason = "without branches")]
fn tiny_coverage(points: [(i32, i32); 3], sign: i32, bounds: &Rect) -> u64 {
    let (px, py) = (bounds.x0 * SUBPIXELS + CENTER, bounds.y0 * SUBPIXELS + CENTER);
    let [a, b, c] = points;
    let (mut edges, mut down) = ([[0_i32; 8]; 3], [0; 3]);
    for ((edge, down), (from, to)) in edges.iter_mut().zip(&mut down).zip([(a, b), (b, c), (c, a)]) {
        let (dx, dy) = ((to.0 - from.0) * sign, (to.1 - from.1) * sign);
        // a centre on an edge is inside if the edge is a top or left one as the triangle is walked clockwise; which one
        // it is cannot be foreseen, so that branches would cost more
        let least = i32::from((dy > 0) | ((dy == 0) & (dx <= 0)));
        let at_corner = dx * (py - from.1) - dy * (px - from.0) - least;
        for (x, at) in (0..8).zip(edge) {
            *at = at_corner - dy * SUBPIXELS * x;
        }
        *down = dx * SUBPIXELS;
    }
    // a word per column and a bit per row of what is outside, from the signs
    let (mut outside, mut row) = ([0_u32; 8], 1);
    for _ in bounds.y0..bounds.y1 {
        let [first, second, third] = &mut edges;
        for x in 0..8 {
            outside[x] |= ((first[x] | second[x] | third[x]) >> 31).cast_unsigned() & row;
        }
        for (edge, down) in [first, second, third].into_iter().zip(down) {
            for at in edge {
                *at += down;
            }
        }
        row <<= 1;
    }
    // written out: `map` is called, and not for the instruction set at hand
    let mut bytes = [0; 8];
    for (byte, rows) in bytes.iter_mut().zip(outside) {
        *byte = rows as u8;
    }
    !u64::from_le_bytes(bytes)
}

/// A column and a row of the tile.
fn unpack(at: u32) -> (i32, i32) {
    ((at & 0xFFFF).cast_signed(), (at >> 16).cast_signed())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::hash32;
    use crate::raster::cover::{doubled_area, pixel_bounds, spans};

    fn sorted(pixels: &Pixels) -> Vec<(i32, i32)> {
        let mut all: Vec<_> = pixels.positions().collect();
        all.sort_unstable_by_key(|&(x, y)| (y, x));
        all
    }

    #[test]
    fn small_triangles_have_the_pixels_of_the_integer_spans() {
        let (mut tiny, mut small, mut others) = (0, 0, 0);
        let mut pixels = Pixels::default();
        for n in 0..20_000_u32 {
            let rect = Rect { x0: 30, y0: 20, x1: 30 + 12 + (n % 60).cast_signed(), y1: 60 };
            let scale = [300, 700, 1500, 4096, 9000, 16_000_000][n as usize % 6];
            let (left, top) = (hash32(n, 6, 0, 0, 0) % 20_000, hash32(n, 7, 0, 0, 0) % 18_000);
            // coordinates on the centre grid now and then, so that ties happen
            let at = |k: u32, first: u32| {
                let c = (first + hash32(n, k, 0, 0, 0) % scale).cast_signed();
                if hash32(n, k, 1, 0, 0).is_multiple_of(2) { c.div_euclid(128) * 128 } else { c }
            };
            let t = [(at(0, left), at(1, top)), (at(2, left), at(3, top)), (at(4, left), at(5, top))];
            let (area, bounds) = (doubled_area(&t), pixel_bounds(&t, &rect));
            if area == 0 || bounds.x0 >= bounds.x1 || bounds.y0 >= bounds.y1 {
                continue;
            }
            pixels.begin(rect);
            if !pixels.list_triangle(t, if area < 0 { -1 } else { 1 }, &bounds) {
                others += 1;
                continue;
            }
            let mut expected = Vec::new();
            spans(&t, &rect, |y, x0, x1| expected.extend((x0..x1).map(|x| (x, y))));
            assert_eq!(sorted(&pixels), expected, "{t:?}");
            let width = rect.x1 - rect.x0;
            let places =
                pixels.positions().map(|(x, y)| ((y - rect.y0) * width + x - rect.x0).cast_unsigned());
            assert!(places.eq(pixels.places().iter().copied()));
            let is_tiny = bounds.width() <= 8 && bounds.height() <= 8;
            (tiny, small) = (tiny + u32::from(is_tiny), small + u32::from(!is_tiny));
        }
        assert!(tiny > 1000 && small > 1000 && others > 500, "{tiny} {small} {others}");
    }

    #[test]
    fn listed_runs_are_their_pixels_and_some_can_be_kept() {
        let mut pixels = Pixels::default();
        pixels.begin(Rect { x0: 100, y0: 50, x1: 140, y1: 90 });
        let runs = [(103, 52, 1), (101, 53, 20), (100, 54, 40)];
        let run = |(x, y, len)| Run { x, y, first: (40 * (y - 50) + x - 100).cast_unsigned(), len };
        let runs = runs.map(run);
        pixels.list(&runs);
        let expected: Vec<_> = runs.iter().flat_map(|run| run.first..run.first + run.len).collect();
        assert_eq!(pixels.places(), expected);
        let mut depth: Vec<f32> = (0..61_u8).map(f32::from).collect();
        let kept = pixels.retain(&mut depth, None, |_, x, y, z| z > 1.0 && (x + y) % 2 == 0);
        assert_eq!(kept, pixels.places().len());
        assert!(sorted(&pixels).iter().all(|(x, y)| (x + y) % 2 == 0) && kept == 29, "{kept}");
        assert_eq!(&depth[..3], [3.0, 5.0, 7.0]);
    }
}
