//! How an image is cut into parts whose primitives, and entries in tiles, fit into buffers.

use super::{BIN, Bins, CELLS, TILE};
use crate::error::{Error, Result};
use crate::gpu::draw::{Gpu, Stop};
use crate::gpu::geometry::PRIMITIVE;
use crate::gpu::picture::{Picture, ToDraw, rows_of};
use crate::gpu::recorder::Recorder;
use std::ops::Range;
use std::sync::OnceLock;

/// How an image is cut into bins, and bins into parts that are drawn one after the other.
#[derive(Debug)]
pub struct Plan {
    /// Tiles along a bin's side.
    pub(super) side: u32,
    pub(super) columns: u32,
    pub(super) parts: Vec<Part>,
}

/// Some rows of bins.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Part {
    pub rows: Range<u32>,
    /// Entries of bins, and of their tiles.
    pub entries: u64,
    pub tile_entries: u64,
}

/// What is known of the tiles of a picture once they have been counted.
pub type Planned = OnceLock<Plan>;

/// Tiles along a bin's side: few, as long as there is room for so many bins.
fn bin_side(width: u32, height: u32) -> u32 {
    let bins = |side: u32| width.div_ceil(TILE * side) * height.div_ceil(TILE * side);
    if bins(8) <= CELLS { 8 } else { 16 }
}

/// The rows of pixels that rows of bins have.
pub(super) fn pixel_rows(height: u32, side: u32, rows: &Range<u32>) -> Range<u32> {
    rows.start * side * TILE..(rows.end * side * TILE).min(height)
}

/// As many rows of bins at a time as there may be, and as there is room for: `sums` has the entries of each row's bins and
/// tiles, from the `first` row on.
fn parts(first: u32, sums: &[(u64, u64)], most_rows: u32, most: u64, device: &str) -> Result<Vec<Part>> {
    let mut parts: Vec<Part> = Vec::new();
    for (row, &(entries, tile_entries)) in (first..).zip(sums) {
        if entries.max(tile_entries) > most {
            return Err(Error::Memory(format!(
                "the {tile_entries} primitives in the tiles of a row; {device} keeps {most} at a time: a smaller image has \
                 fewer, and path=\"hardware\" keeps none"
            )));
        }
        let fits = |part: &&mut Part| {
            part.rows.end - part.rows.start < most_rows
                && part.entries + entries <= most
                && part.tile_entries + tile_entries <= most
        };
        if let Some(part) = parts.last_mut().filter(fits) {
            part.rows.end = row + 1;
            part.entries += entries;
            part.tile_entries += tile_entries;
        } else {
            parts.push(Part { rows: row..row + 1, entries, tile_entries });
        }
    }
    Ok(parts)
}

/// As many rows of bins, of `size` pixels each, at a time as have no more primitives than there is room for: `begins` has the number of those that
/// begin in each row, `ends` of those that end in it.
fn bands(size: u32, begins: &[u64], ends: &[u64], most: u64, device: &str) -> Result<Vec<Range<u32>>> {
    let mut bands: Vec<Range<u32>> = Vec::new();
    // primitives of the band, and those of the row before that go on
    let (mut held, mut through) = (0, 0);
    for (row, (begin, end)) in (0..).zip(begins.iter().zip(ends)) {
        let here = through + begin;
        if here > most {
            let first = row * size;
            return Err(Error::Memory(format!(
                "the {here} primitives that reach into the {size} rows from {first} on; {device} keeps {most} at a time, and \
                 path=\"hardware\" draws them in parts"
            )));
        }
        held += begin;
        if let Some(band) = bands.last_mut().filter(|_| held <= most) {
            band.end = row + 1;
        } else {
            bands.push(row..row + 1);
            held = here;
        }
        through = here - end;
    }
    Ok(bands)
}

impl Gpu {
    /// Rows of the image that have no more primitives than one buffer holds.
    ///
    /// # Errors
    /// [`Error::Memory`] where a row of bins has more.
    pub fn bands_of_primitives(&self, drawn: &ToDraw<'_>) -> Result<Vec<Range<u32>>> {
        let (image, height) = (drawn.view.rect(), drawn.view.height);
        let side = bin_side(drawn.view.width, height);
        let size = TILE * side;
        let rows = height.div_ceil(size) as usize;
        let (mut begins, mut ends) = (vec![0; rows], vec![0; rows]);
        for rows in (drawn.primitives)().filter_map(|primitive| rows_of(&primitive, &image)) {
            begins[(rows.start / size) as usize] += 1;
            ends[((rows.end - 1) / size) as usize] += 1;
        }
        let most = self.most_bytes() / (4 * PRIMITIVE as u64);
        let bands = bands(size, &begins, &ends, most, &self.connection.info.name)?;
        Ok(bands.iter().map(|rows| pixel_rows(height, side, rows)).collect())
    }

    /// How the picture is cut up, which is counted once.
    pub(super) fn plan<'a>(&mut self, picture: &'a Picture, stop: Stop<'_>) -> Result<&'a Plan> {
        if let Some(plan) = picture.plan.get() {
            return Ok(plan);
        }
        let (width, height) = (picture.width, picture.height);
        let side = bin_side(width, height);
        let columns = width.div_ceil(TILE * side);
        let all_rows = picture.part.start / (TILE * side)..picture.part.end.div_ceil(TILE * side);
        // what is written at a time has to fit, too: colour and background's share
        let row_of_bins = 32 * u64::from(width) * u64::from(side * TILE);
        let most_rows = u32::try_from(self.most_bytes() / row_of_bins).unwrap_or(u32::MAX);
        let most_rows = most_rows.clamp(1, CELLS / columns);
        let bins = Bins::new(self, picture, (side, columns), (0, 0));
        let mut sums = Vec::new();
        for first in all_rows.clone().step_by(most_rows as usize) {
            let rows = first..(first + most_rows).min(all_rows.end);
            let frame = self.frame(picture, &pixel_rows(height, side, &rows), &[]);
            let Self { connection, layouts, .. } = &mut *self;
            let mut recorder = Recorder::new(connection, stop);
            bins.pass((connection, layouts), &mut recorder, &rows, &frame, None)?;
            let words = BIN * (columns * (rows.end - rows.start)) as usize;
            let (counts, _): (Vec<u32>, _) = recorder.finish(&bins.cells, 4 * words as u64)?;
            let row = |bins: &[u32]| {
                let sum = |which| bins.iter().skip(which).step_by(BIN).map(|n| u64::from(*n)).sum();
                (sum(1), sum(3))
            };
            sums.extend(counts.chunks(BIN * columns as usize).map(row));
        }
        let most = self.most_bytes() / 4;
        let parts = parts(all_rows.start, &sums, most_rows, most, &self.connection.info.name)?;
        Ok(picture.plan.get_or_init(|| Plan { side, columns, parts }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bins_are_few_enough_or_come_in_parts() {
        assert_eq!((bin_side(1280, 720), bin_side(3840, 2160), bin_side(1, 1)), (8, 16, 8));
        assert_eq!(pixel_rows(720, 8, &(11..12)), 704..720);
        let sums = [(1, 4), (2, 4), (1, 9), (0, 0), (0, 0), (0, 0)];
        let part = |rows, entries, tile_entries| Part { rows, entries, tile_entries };
        let cut = parts(0, &sums, 3, 10, "it").unwrap();
        assert_eq!(cut, [part(0..2, 3, 8), part(2..5, 1, 9), part(5..6, 0, 0)]);
        assert_eq!(parts(5, &sums[..1], 3, 10, "it").unwrap(), [part(5..6, 1, 4)]);
        assert!(
            parts(0, &sums, 3, 8, "it").unwrap_err().to_string().contains("the 9 primitives in the tiles")
        );
    }

    #[test]
    fn bands_hold_what_reaches_into_them() {
        // one primitive goes through all rows, two begin and end in each
        let (begins, ends) = ([3, 2, 2, 2], [2, 2, 2, 3]);
        let cut = |most| bands(64, &begins, &ends, most, "it");
        assert_eq!((cut(9).unwrap().len(), cut(9).unwrap()[0].clone()), (1, 0..4));
        assert_eq!(cut(8).unwrap(), [0..3, 3..4]);
        assert_eq!(cut(6).unwrap(), [0..2, 2..4]);
        assert_eq!(cut(3).unwrap(), [0..1, 1..2, 2..3, 3..4]);
        assert!(
            cut(2)
                .unwrap_err()
                .to_string()
                .contains("the 3 primitives that reach into the 64 rows from 0 on")
        );
        assert_eq!(bands(64, &[0, 0], &[0, 0], 5, "it").unwrap().first(), Some(&(0..2)));
    }
}
