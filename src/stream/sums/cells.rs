//! Neighbouring pixels of a row that the same primitives cover, each the same everywhere, have the same sums: a cell of
//! the tile. Where cells are far fewer than pixels, sums are kept and finished once per cell.

use super::rows::Stretch;
use crate::raster::Rect;
use std::ops::Range;

/// Cells pay off from so many pixels per cell on, on average.
const PIXELS_PER_CELL: usize = 8;

/// How a tile falls into cells, row by row from the top.
#[derive(Debug, Default)]
pub struct Cells {
    /// Per row, the columns where a cell begins, as bits.
    begins: Vec<u64>,
    /// The index of each row's first cell, and the number of all.
    firsts: Vec<u32>,
    /// One past the last pixel of each cell in the tile.
    ends: Vec<u32>,
}

impl Cells {
    /// Tiles with more columns have no cells: a row's ends are the bits of a word.
    const MOST_COLUMNS: usize = 64;

    /// Finds the cells of the tile `rect` under so many stretches, row by row; false if they are too many to pay off.
    pub fn find(&mut self, rect: &Rect, rows: &[Vec<Stretch>], stretches: usize) -> bool {
        let most = rect.area() / PIXELS_PER_CELL;
        if rect.width() > Self::MOST_COLUMNS || stretches > most {
            return false;
        }
        let ends = |stretch: &Stretch| bit(stretch.from) | bit(stretch.to);
        self.begins.clear();
        self.begins.extend(rows.iter().map(|row| row.iter().fold(1, |bits, stretch| bits | ends(stretch))));
        let inside = u64::MAX >> (Self::MOST_COLUMNS - rect.width());
        self.firsts.clear();
        let mut count = 0;
        for begins in &mut self.begins {
            *begins &= inside;
            self.firsts.push(count);
            count += begins.count_ones();
        }
        self.firsts.push(count);
        count as usize <= most && self.list_ends(rect.width())
    }

    /// True, for [`Cells::find`] to end with.
    #[expect(clippy::cast_possible_truncation, reason = "pixels of a tile")]
    fn list_ends(&mut self, columns: usize) -> bool {
        self.ends.clear();
        let mut row_end = 0;
        for begins in &self.begins {
            let first = row_end;
            row_end += columns as u32;
            // a cell ends where the next begins
            let mut later = begins & (begins - 1);
            while later != 0 {
                self.ends.push(first + later.trailing_zeros());
                later &= later - 1;
            }
            self.ends.push(row_end);
        }
        true
    }

    /// The cells of a stretch.
    pub fn of(&self, row: usize, stretch: &Stretch) -> Range<usize> {
        let before = |x| (self.begins[row] & (bit(x).wrapping_sub(1))).count_ones();
        let first = self.firsts[row];
        (first + before(stretch.from)) as usize..(first + before(stretch.to)) as usize
    }

    /// How many there are.
    pub fn count(&self) -> usize {
        self.ends.len()
    }

    /// How many pixels each has.
    pub fn pixels(&self) -> impl Iterator<Item = usize> {
        self.ends.iter().scan(0, |first, &end| Some((end - std::mem::replace(first, end)) as usize))
    }

    /// Row by row, its cells.
    pub fn rows(&self) -> impl Iterator<Item = RowOfCells<'_>> {
        let places = self.firsts.iter().zip(&self.firsts[1..]).map(|(&a, &b)| a as usize..b as usize);
        places.map(|places| RowOfCells { ends: &self.ends[places.clone()], places })
    }
}

/// The cells of a row of the tile.
pub struct RowOfCells<'a> {
    /// Which they are among all.
    pub places: Range<usize>,
    /// One past the last pixel of each in the tile.
    pub ends: &'a [u32],
}

/// The bit of a column; none beyond the last that a word has, whose predecessor is all bits.
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
        let of_rows: Vec<_> = cells.rows().map(|row| (row.places, row.ends)).collect();
        assert_eq!(of_rows, [(0..1, &[64][..]), (1..4, &[66, 76, 128]), (4..5, &[192]), (5..7, &[255, 256])]);
        let of = |row: usize, i: usize| cells.of(row, &rows[row][i]);
        assert_eq!([of(0, 0), of(1, 0), of(1, 1), of(3, 0)], [0..1, 2..4, 2..3, 6..7]);
    }

    #[test]
    fn narrow_tiles_end_with_their_rows() {
        let rect = Rect { x0: 0, y0: 0, x1: 9, y1: 2 };
        let mut cells = Cells::default();
        assert!(find(&mut cells, &rect, &rows([&[], &[(0, 9)]])));
        assert_eq!(cells.pixels().collect::<Vec<_>>(), [9, 9]);
        assert!(!find(&mut cells, &rect, &rows([&[], &[(2, 3)]])), "4 cells of 18 pixels");
    }

    #[test]
    fn many_cells_or_columns_do_not_pay_off() {
        let mut cells = Cells::default();
        assert!(!find(&mut cells, &Rect { x1: 193, ..RECT }, &rows([&[], &[], &[], &[]])));
        let crowd: Vec<_> = (0..60).map(|x| (1 + x, 4 + x)).collect();
        assert!(find(&mut cells, &RECT, &rows([&[], &crowd[..20], &[], &[]])));
        assert!(!find(&mut cells, &RECT, &rows([&[], &crowd[..32], &[], &[]])), "39 cells");
        assert!(!find(&mut cells, &RECT, &rows([&[(0, 1); 33], &[], &[], &[]])), "too many to look at");
    }
}
