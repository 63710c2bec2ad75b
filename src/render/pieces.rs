//! Rows of tiles, in the order in which threads take them, and in pieces, each of which is written by one thread.

use super::Job;
use super::image::Patch;
use super::tally::Tally;
use crate::frame::Sample;
use crate::raster::{Raster, Rect};
use std::cmp::Reverse;
use std::ops::Range;

/// A piece of a row of tiles.
pub(super) enum Piece {
    /// The tile in this column.
    Tile(usize),
    /// Neighbouring tiles without anything to draw.
    Empty(Range<usize>),
}

impl Piece {
    /// Its pixels.
    pub(super) fn rect(&self, raster: &Raster<'_>, row: usize) -> Rect {
        match self {
            Self::Tile(column) => raster.rect(*column, row),
            Self::Empty(columns) => {
                Rect { x1: raster.rect(columns.end - 1, row).x1, ..raster.rect(columns.start, row) }
            }
        }
    }
}

impl Job<'_> {
    /// So many tiles without anything to draw.
    pub(super) fn clear<S: Sample>(
        raster: &Raster<'_>,
        tiles: usize,
        patch: &mut Patch<'_, S>,
        tally: &mut Tally,
    ) {
        patch.clear(raster.background());
        tally.empty_tiles += tiles as u64;
        tally.empty_pixels += patch.rect().area() as u64;
    }

    /// A row of tiles in pieces.
    pub(super) fn pieces(&self, raster: &Raster<'_>, row: usize) -> Vec<Piece> {
        let mut pieces: Vec<Piece> = Vec::with_capacity(raster.columns());
        for column in 0..raster.columns() {
            match pieces.last_mut() {
                _ if !(self.options.skip && raster.is_empty_tile(column, row)) => {
                    pieces.push(Piece::Tile(column));
                }
                Some(Piece::Empty(columns)) => columns.end += 1,
                _ => pieces.push(Piece::Empty(column..column + 1)),
            }
        }
        pieces
    }
}

/// Deals bands out like cards, the dearest first: threads, which begin with the first of an equal share each, end with the
/// cheapest, so that none waits long for another.
pub(super) fn deal<T>(bands: &mut Vec<T>, threads: usize, cost: impl Fn(&T) -> usize) {
    bands.sort_by_cached_key(|band| Reverse(cost(band)));
    let mut shares: Vec<Vec<T>> = (0..threads).map(|_| Vec::new()).collect();
    bands.drain(..).enumerate().for_each(|(rank, band)| shares[rank % threads].push(band));
    bands.extend(shares.into_iter().flatten());
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_thread_ends_with_the_cheapest() {
        let mut bands = vec![3, 9, 1, 7, 5];
        deal(&mut bands, 2, |band| *band);
        assert_eq!(bands, [9, 5, 1, 7, 3]);
        deal(&mut bands, 9, |band| *band);
        assert_eq!(bands, [9, 7, 5, 3, 1]);
        deal(&mut bands, 1, |_| 0);
        assert_eq!(bands, [9, 7, 5, 3, 1], "those of one cost stay as they are");
    }
}
