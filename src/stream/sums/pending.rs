//! Primitives that are the same everywhere, kept until there are many, or until there are no more, and then blended into one
//! row of the tile after the other, or into its cells. A pixel gets its fragments in the same order.

use super::cells::{Cells, Strip};
use super::kernels::Places;
use super::rows::{Stretch, add_row, blend_row, cover_row};
use super::{Sums, Weight};
use crate::continuum::sums::FAINT;
use crate::raster::{Cover, Premultiplied, Rect, Where};
use crate::stream::touched::Touched;
use std::ops::Range;

/// Stretches, neighbours joined, that are worth keeping, at 12 bytes each.
const STRETCHES: usize = 1 << 13;
/// Stretches that would not have had to wait: all sums of the tile pass through the cache when they are blended.
const LITTLE: usize = 1 << 7;
/// Nothing waits any more in a tile where so little has so often been blended because something else came.
const INTERRUPTIONS: u32 = 4;
/// Room that rows have from the start.
const STRETCHES_OF_A_ROW: usize = 32;
/// Stretches up to which those of small primitives are, too, which are cheaper by themselves but would make an end of waiting ...
const FEW_STRETCHES: usize = 1 << 10;
/// ... and up to which they are where no large one waits yet: there may come none.
const STRETCHES_ALONE: usize = 1 << 6;

/// What waits to be blended.
#[derive(Default)]
pub struct Pending {
    /// Where it is, row by row of the tile.
    rows: Vec<Vec<Stretch>>,
    stretches: usize,
    /// Whether any of it is of a large primitive.
    any_large: bool,
    /// How often little had come to wait, in this tile, before something came that could not.
    interruptions: u32,
    layers: Layers,
    /// What each layer adds to the sums, weight by weight.
    added: Vec<Vec<[f32; 4]>>,
    /// The stretches of one row, in cells.
    in_cells: Vec<Stretch>,
}

/// What the primitives look like, one layer each; those that follow one that looks the same share its layer, as the halves of
/// a quad do.
#[derive(Default)]
struct Layers {
    colors: Vec<Premultiplied>,
    alpha: Vec<f32>,
    depth: Vec<f32>,
    /// What they leave of the background.
    left: Vec<f64>,
    /// Of all primitives that share the layer.
    pixels: Vec<u64>,
    /// Whether any alpha is faint.
    faint: bool,
}

impl Layers {
    /// The index of the last layer if it looks like this, or of a new one.
    #[expect(clippy::cast_possible_truncation, reason = "far fewer primitives than 2^32 wait")]
    fn layer_of(&mut self, color: Premultiplied, z: f32, more: u64) -> u32 {
        let Self { colors, alpha, depth, left, pixels, faint } = self;
        // a weight of somebody's own may tell 0 and -0 apart
        let same_alpha = alpha.last().is_some_and(|alpha| alpha.to_bits() == color[3].to_bits());
        let same = same_alpha && colors.last() == Some(&color) && depth.last() == Some(&z);
        if let (true, Some(pixels)) = (same, pixels.last_mut()) {
            *pixels += more;
        } else {
            let covers = f64::from(color[3]);
            colors.push(color);
            alpha.push(color[3]);
            depth.push(z);
            left.push(1.0 - covers);
            pixels.push(more);
            *faint |= covers <= FAINT;
        }
        colors.len() as u32 - 1
    }
}

impl Pending {
    /// For so many weights.
    pub fn with_weights(weights: usize) -> Self {
        Self { added: vec![Vec::new(); weights], ..Self::default() }
    }

    /// Begins with a tile of so many rows.
    pub fn begin(&mut self, rows: usize) {
        self.clear();
        self.interruptions = 0;
        self.rows.resize_with(rows, || Vec::with_capacity(STRETCHES_OF_A_ROW));
    }

    /// Finds the cells of the tile `rect` under all that waits; false if they are too many to pay off.
    pub fn find_cells(&self, rect: &Rect, cells: &mut Cells) -> bool {
        cells.find(rect, &self.rows, self.stretches)
    }

    /// Which of so many rows anything waits in.
    pub fn touched(&self, rows: usize) -> Touched {
        let mut touched = Touched::none(rows);
        let any = self.rows.iter().take(rows).enumerate().filter(|(_, stretches)| !stretches.is_empty());
        any.for_each(|(row, _)| touched.touch(&(row..row + 1)));
        touched
    }

    /// Whether nothing waits.
    pub fn is_empty(&self) -> bool {
        self.layers.pixels.is_empty()
    }

    /// Whether enough waits to be blended.
    pub fn is_full(&self) -> bool {
        self.stretches >= STRETCHES
    }

    /// Whether a primitive may wait; `first` says that the tile has no sums yet. Large ones may unless others come in between
    /// all the time, small ones where they are few, so that they need not make an end of waiting.
    pub fn may_take(&self, at: Where<'_>, first: bool) -> bool {
        match at {
            Where::Many(_) => self.interruptions < INTERRUPTIONS,
            Where::Few(_) => {
                first && self.stretches < if self.any_large { FEW_STRETCHES } else { STRETCHES_ALONE }
            }
        }
    }

    /// Has to come before what waits is blended because something comes that cannot wait.
    pub fn count_interruption(&mut self) {
        self.interruptions += u32::from(self.stretches < LITTLE);
    }

    /// Keeps a primitive of one colour, and one depth where weights look at it.
    pub fn push(&mut self, rect: &Rect, cover: &Cover<'_, '_>, color: Premultiplied) {
        let layer = self.layers.layer_of(color, cover.constant_depth.unwrap_or(1.0), cover.pixels as u64);
        match cover.at {
            Where::Many(runs) => {
                self.any_large = true;
                for run in runs {
                    let from = run.x - rect.x0;
                    self.put(run.y - rect.y0, Stretch { from, to: from + run.len.cast_signed(), layer });
                }
            }
            Where::Few(pixels) => {
                for (column, row) in pixels.places_in_tile() {
                    self.put(row, Stretch { from: column, to: column + 1, layer });
                }
            }
        }
    }

    #[inline]
    #[expect(clippy::cast_sign_loss, reason = "a row of the tile")]
    fn put(&mut self, row: i32, stretch: Stretch) {
        let row = &mut self.rows[row as usize];
        if !row.last_mut().is_some_and(|last| last.join(&stretch)) {
            row.push(stretch);
            self.stretches += 1;
        }
    }

    /// Finds what each layer adds to the sums of each weight: the weight at its depth times its colour. Has to come before
    /// anything is blended.
    pub fn weigh(&mut self, weights: &mut [Weight<'_>], numbers: &mut Vec<f32>) {
        let Layers { colors, alpha, depth, pixels, .. } = &self.layers;
        for (weight, added) in weights.iter_mut().zip(&mut self.added) {
            let Some(weighting) = weight.weighting else {
                added.extend_from_slice(colors);
                continue;
            };
            let times = |layer: usize| if colors[layer] == [0.0; 4] { 0 } else { pixels[layer] };
            weight.invalid += weighting.evaluate_counted(depth, alpha, numbers, times);
            added.extend(colors.iter().zip(&*numbers).map(|(color, w)| color.map(|channel| w * channel)));
        }
    }

    /// Blends what waits in these rows of the tile, in the order in which it came, into the sums of their pixels, or into
    /// none where the rows are fresh.
    pub fn blend_rows(&self, rows: Range<usize>, columns: usize, sums: &mut Sums, fresh: bool) {
        let rows = self.rows[rows].iter().enumerate();
        for (row, stretches) in rows.filter(|(_, stretches)| fresh || !stretches.is_empty()) {
            self.blend(stretches, row * columns..(row + 1) * columns, sums, fresh);
        }
    }

    /// Blends everything that waits into fresh sums of the tile's cells, for which there is [room](Cells::room).
    pub fn blend_cells(&mut self, cells: &Cells, sums: &mut Sums) {
        let mut in_cells = std::mem::take(&mut self.in_cells);
        for (strip, Strip { rows, .. }) in cells.strips().enumerate() {
            cells.convert(strip, &self.rows[rows.start], &mut in_cells);
            // whole blocks, the ends of which the next strip writes over
            self.blend(&in_cells, cells.blocks_of(strip), sums, true);
        }
        self.in_cells = in_cells;
    }

    /// Blends stretches of one row into the sums in these places.
    fn blend(&self, stretches: &[Stretch], places: Range<usize>, sums: &mut Sums, fresh: bool) {
        let Layers { left, alpha, faint, .. } = &self.layers;
        let Sums { weighted, transmittance, coverage, counts, faint: any_faint, .. } = sums;
        let mut weighted = weighted.iter_mut().map(|sums| &mut sums[places.clone()]).zip(&self.added);
        if let Some((sums, added)) = weighted.next() {
            let transmittance = &mut transmittance[places.clone()];
            let row = Places { transmittance, counts: &mut counts[places.clone()], sums };
            blend_row(stretches, left, added, row, fresh);
        }
        weighted.for_each(|(sums, added)| add_row(stretches, added, sums, fresh));
        if *faint {
            *any_faint = true;
            cover_row(stretches, alpha, &mut coverage[places]);
        }
    }

    /// Forgets what waits.
    pub fn clear(&mut self) {
        self.rows.iter_mut().for_each(Vec::clear);
        self.stretches = 0;
        self.any_large = false;
        let Layers { colors, alpha, depth, left, pixels, faint } = &mut self.layers;
        colors.clear();
        alpha.clear();
        depth.clear();
        left.clear();
        pixels.clear();
        *faint = false;
        self.added.iter_mut().for_each(Vec::clear);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_looks_the_same_shares_a_layer() {
        let mut layers = Layers::default();
        let red = [0.5, 0.0, 0.0, 0.5];
        assert_eq!([layers.layer_of(red, 2.0, 10), layers.layer_of(red, 2.0, 5)], [0, 0]);
        assert!(!layers.faint);
        assert_eq!(layers.layer_of(red, 3.0, 1), 1, "another depth");
        assert_eq!(layers.layer_of([0.5, 0.0, 0.0, 0.25], 3.0, 1), 2, "another alpha");
        assert_eq!(layers.layer_of([0.0, 0.5, 0.0, 0.25], 3.0, 1), 3, "another colour");
        assert_eq!(layers.layer_of([0.0, 0.5, 0.0, 0.0], 3.0, 1), 4);
        assert_eq!(layers.layer_of([0.0, 0.5, 0.0, -0.0], 3.0, 1), 5, "weights may see the sign");
        assert_eq!(layers.layer_of(red, 2.0, 1), 6, "not the one before");
        assert!(layers.faint);
        assert_eq!(layers.pixels, [15, 1, 1, 1, 1, 1, 1]);
    }
}
