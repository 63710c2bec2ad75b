//! Neighbouring pixels that the same primitives cover, each the same everywhere, have the same sums: a cell of the tile, which
//! is a part of a row, and of the rows below that are like it. Where cells are far fewer than pixels, sums are kept and
//! finished once per cell.

use super::rows::{BLOCK, Stretch};
use crate::raster::Rect;
use multiversion::multiversion;
use std::ops::Range;

/// Cells pay off from so many pixels per cell on, on average.
const PIXELS_PER_CELL: usize = 4;
/// Stretches are worth looking at where there are so many pixels to each, at least: those that are whole rows make no cells.
const PIXELS_PER_STRETCH: usize = 2;

/// How a tile falls into cells, strip by strip from the top: a strip is a row, and those below with the same stretches.
#[derive(Debug, Default)]
pub struct Cells {
    /// The first row of each strip, and the number of all.
    tops: Vec<u32>,
    /// Per strip, the columns where a cell begins, as bits.
    begins: Vec<u64>,
    /// The index of each strip's first cell, and the number of all.
    firsts: Vec<u32>,
    /// One past the last column of each cell.
    ends: Vec<u32>,
}

impl Cells {
    /// Tiles with more columns have no cells: a row's ends are the bits of a word.
    pub const MOST_COLUMNS: usize = 64;

    /// Finds the cells of the tile `rect` under so many stretches, row by row; false if they are too many to pay off.
    pub fn find(&mut self, rect: &Rect, rows: &[Vec<Stretch>], stretches: usize) -> bool {
        let (most, columns) = (rect.area() / PIXELS_PER_CELL, rect.width());
        columns <= Self::MOST_COLUMNS
            && stretches <= rect.area() / PIXELS_PER_STRETCH
            && find_cells(self, columns, rows, most)
    }

    /// Finds where cells begin; false if there are more than `most`.
    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    fn begin(&mut self, columns: usize, rows: &[Vec<Stretch>], most: usize) -> bool {
        let inside = u64::MAX >> (Self::MOST_COLUMNS - columns);
        self.tops.clear();
        self.begins.clear();
        self.firsts.clear();
        let mut count = 0;
        let mut above = None;
        for (y, row) in (0..).zip(rows) {
            if above.replace(row) == Some(row) {
                continue;
            }
            let mut begins = 1;
            for stretch in row {
                begins |= bit(stretch.from) | bit(stretch.to);
            }
            begins &= inside;
            self.tops.push(y);
            self.begins.push(begins);
            self.firsts.push(count);
            count += begins.count_ones();
        }
        #[expect(clippy::cast_possible_truncation, reason = "rows of a tile")]
        self.tops.push(rows.len() as u32);
        self.firsts.push(count);
        count as usize <= most
    }

    /// Finds where they end.
    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    #[expect(clippy::cast_possible_truncation, reason = "columns of a tile")]
    fn end(&mut self, columns: usize) {
        self.ends.clear();
        for begins in &self.begins {
            // a cell ends where the next begins
            let mut later = begins & (begins - 1);
            while later != 0 {
                self.ends.push(later.trailing_zeros());
                later &= later - 1;
            }
            self.ends.push(columns as u32);
        }
    }

    /// The stretches of a strip's rows as ones of its cells, which are counted from its first on, in place of those in
    /// `in_cells`.
    pub fn convert(&self, strip: usize, stretches: &[Stretch], in_cells: &mut Vec<Stretch>) {
        in_cells.clear();
        convert(self.begins[strip], stretches, in_cells);
    }

    /// Where a strip's cells are among all, and as many more as make whole blocks.
    pub fn blocks_of(&self, strip: usize) -> Range<usize> {
        let (first, end) = (self.firsts[strip] as usize, self.firsts[strip + 1] as usize);
        first..first + (end - first).next_multiple_of(BLOCK)
    }

    /// Places for [`Cells::blocks_of`] all strips, and some to spare.
    pub fn room(&self) -> usize {
        self.count() + BLOCK
    }

    /// How many there are.
    pub fn count(&self) -> usize {
        self.ends.len()
    }

    /// How many pixels each has.
    pub fn pixels(&self) -> impl Iterator<Item = usize> {
        self.strips().flat_map(|Strip { rows, ends, .. }| {
            let widths =
                ends.iter().scan(0, |first, &end| Some((end - std::mem::replace(first, end)) as usize));
            widths.map(move |width| width * rows.len())
        })
    }

    /// The strips, from the top.
    pub fn strips(&self) -> impl Iterator<Item = Strip<'_>> {
        let range = |(&a, &b): (&u32, &u32)| a as usize..b as usize;
        let rows = self.tops.iter().zip(&self.tops[1..]).map(range);
        let places = self.firsts.iter().zip(&self.firsts[1..]).map(range);
        rows.zip(places).map(|(rows, places)| Strip { rows, ends: &self.ends[places.clone()], places })
    }
}

/// Counting and finding bits are instructions of their own, which the baseline does not have.
#[multiversion(targets("x86_64+avx2+popcnt+bmi1+bmi2"))]
fn find_cells(cells: &mut Cells, columns: usize, rows: &[Vec<Stretch>], most: usize) -> bool {
    let pays_off = cells.begin(columns, rows, most);
    if pays_off {
        cells.end(columns);
    }
    pays_off
}

/// The same for where stretches begin and end among the cells of a strip.
#[multiversion(targets("x86_64+avx2+popcnt+bmi1+bmi2"))]
#[expect(clippy::cast_possible_wrap, reason = "columns of a tile")]
fn convert(begins: u64, stretches: &[Stretch], in_cells: &mut Vec<Stretch>) {
    for stretch in stretches {
        let from = (begins & bit(stretch.from).wrapping_sub(1)).count_ones() as i32;
        let to = (begins & bit(stretch.to).wrapping_sub(1)).count_ones() as i32;
        in_cells.push(Stretch { from, to, ..*stretch });
    }
}

/// Rows of the tile that are alike, and their cells.
pub struct Strip<'a> {
    /// Which rows they are.
    pub rows: Range<usize>,
    /// Which the cells are among all.
    pub places: Range<usize>,
    /// One past the last column of each.
    pub ends: &'a [u32],
}

/// The bit of a column; none beyond the last that a word has, whose predecessor is all bits.
#[inline(always)]
#[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
fn bit(x: i32) -> u64 {
    1_u64.checked_shl(x.cast_unsigned()).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;

    const RECT: Rect = Rect { x0: 128, y0: 64, x1: 192, y1: 68 };

    /// Rows with stretches from column to column.
    fn rows<const N: usize>(rows: [&[(i32, i32)]; N]) -> Vec<Vec<Stretch>> {
        let stretches =
            |row: &[(i32, i32)]| row.iter().map(|&(from, to)| Stretch { from, to, layer: 0 }).collect();
        rows.into_iter().map(stretches).collect()
    }

    fn find(cells: &mut Cells, rect: &Rect, rows: &[Vec<Stretch>]) -> bool {
        cells.find(rect, rows, rows.iter().map(Vec::len).sum())
    }

    #[test]
    fn cells_begin_and_end_where_stretches_do() {
        let mut cells = Cells::default();
        let rows = rows([&[(0, 64)], &[(2, 64), (2, 12)], &[], &[(63, 64)]]);
        assert!(find(&mut cells, &RECT, &rows));
        assert_eq!(cells.pixels().collect::<Vec<_>>(), [64, 2, 10, 52, 64, 63, 1]);
        let strips: Vec<_> = cells.strips().map(|strip| (strip.rows, strip.places, strip.ends)).collect();
        let expected: [(_, _, &[u32]); 4] =
            [(0..1, 0..1, &[64]), (1..2, 1..4, &[2, 12, 64]), (2..3, 4..5, &[64]), (3..4, 5..7, &[63, 64])];
        assert_eq!(strips, expected);
        let mut in_cells = Vec::new();
        let mut of = |row: usize| {
            cells.convert(row, &rows[row], &mut in_cells);
            in_cells.iter().map(|stretch| (stretch.from, stretch.to)).collect::<Vec<_>>()
        };
        assert_eq!([of(0), of(1), of(2), of(3)], [vec![(0, 1)], vec![(1, 3), (1, 2)], vec![], vec![(1, 2)]]);
        assert_eq!([cells.blocks_of(1), cells.blocks_of(3)], [1..17, 5..21]);
        assert!(cells.room() >= 21);
    }

    #[test]
    fn rows_that_are_alike_share_their_cells() {
        let mut cells = Cells::default();
        let mut rows = rows([&[(2, 12)], &[(2, 12)], &[(2, 12), (2, 12)], &[(2, 12), (2, 12)]]);
        assert!(find(&mut cells, &RECT, &rows));
        assert_eq!(cells.pixels().collect::<Vec<_>>(), [4, 20, 104, 4, 20, 104]);
        rows[1][0].layer = 1;
        assert!(find(&mut cells, &RECT, &rows));
        let strips: Vec<_> = cells.strips().map(|strip| (strip.rows, strip.places)).collect();
        assert_eq!(strips, [(0..1, 0..3), (1..2, 3..6), (2..4, 6..9)], "another primitive, and one more");
    }

    #[test]
    fn narrow_tiles_end_with_their_rows() {
        let rect = Rect { x0: 0, y0: 0, x1: 9, y1: 2 };
        let mut cells = Cells::default();
        assert!(find(&mut cells, &rect, &rows([&[], &[(0, 9)]])));
        assert_eq!(cells.pixels().collect::<Vec<_>>(), [9, 9]);
        assert!(find(&mut cells, &rect, &rows([&[], &[(2, 3)]])), "4 cells of 18 pixels");
        assert!(!find(&mut cells, &rect, &rows([&[(1, 2)], &[(2, 3)]])), "6 cells of 18 pixels");
        assert!(find(&mut cells, &rect, &rows([&[(2, 3)], &[(2, 3)]])), "3 cells of 18 pixels");
    }

    #[test]
    fn many_cells_or_columns_do_not_pay_off() {
        let mut cells = Cells::default();
        assert!(!find(&mut cells, &Rect { x1: 193, ..RECT }, &rows([&[], &[], &[], &[]])));
        let crowd: Vec<_> = (0..60).map(|x| (1 + x, 4 + x)).collect();
        assert!(find(&mut cells, &RECT, &rows([&[], &crowd[..57], &[], &[(0, 64)]])), "64 cells");
        assert!(!find(&mut cells, &RECT, &rows([&[], &crowd[..58], &[], &[(0, 64)]])), "65 cells");
        assert!(find(&mut cells, &RECT, &rows([&[(0, 64); 128], &[], &[], &[]])));
        assert!(!find(&mut cells, &RECT, &rows([&[(0, 64); 129], &[], &[], &[]])), "too many to look at");
    }
}
