//! The buffers of a render, and their distribution over threads without locks or overlap.

use crate::error::{Error, Result};
use crate::frame::Sample;
use crate::raster::Rect;
use crate::stream::{Cells, Strip};
use crate::technique::{FinishedPixels, Resolved};
use multiversion::multiversion;
use std::ops::Range;

/// One variant's images.
#[derive(Debug, Clone)]
pub struct VariantImage<S> {
    pub color: Vec<S>,
    pub transmittance: Vec<S>,
    /// Channels of the transmittance.
    pub channels: usize,
}

/// All images of a render.
#[derive(Debug)]
pub struct Target<S> {
    pub width: u32,
    pub height: u32,
    pub images: Vec<VariantImage<S>>,
}

impl<S: Sample> Target<S> {
    /// Images for variants whose transmittances have the given numbers of channels; what is in them is left of
    /// others.
    ///
    /// # Errors
    /// [`Error::Memory`] where there is no room for them.
    pub fn new(width: u32, height: u32, channels: &[usize]) -> Result<Self> {
        let pixels = width as usize * height as usize;
        let image = |&channels: &usize| {
            let color = buffer(3 * pixels)?;
            let transmittance = buffer(channels * pixels)?;
            Some(VariantImage { color, transmittance, channels })
        };
        let images = channels.iter().map(image).collect::<Option<_>>();
        let fault = || Error::Memory(format!("{} images of {width} x {height}", channels.len()));
        Ok(Self { width, height, images: images.ok_or_else(fault)? })
    }

    /// The buffers cut into bands of so many rows of pixels.
    pub fn bands(&mut self, rows: u32) -> Vec<Band<'_, S>> {
        let (width, rows) = (self.width as usize, rows as usize);
        let bands = (self.height as usize).div_ceil(rows);
        let mut bands: Vec<_> = (0..bands).map(|_| Band { width, images: Vec::new() }).collect();
        for VariantImage { color, transmittance, channels } in &mut self.images {
            let parts =
                color.chunks_mut(3 * width * rows).zip(transmittance.chunks_mut(*channels * width * rows));
            for (band, (color, transmittance)) in bands.iter_mut().zip(parts) {
                band.images.push(BandImage { color, transmittance, channels: *channels });
            }
        }
        bands
    }

    /// The buffers cut after the given ascending numbers of pixels, each part as one long row, with its first
    /// pixel.
    pub fn runs(&mut self, ends: &[usize]) -> Vec<(usize, Patch<'_, S>)> {
        let mut first = 0;
        let mut patches = Vec::with_capacity(ends.len());
        for &end in ends {
            #[expect(clippy::cast_possible_truncation, clippy::cast_possible_wrap, reason = "a run is short")]
            let rect = Rect { x0: 0, y0: 0, x1: (end - first) as i32, y1: 1 };
            patches.push((first, Patch { rect, rows: Vec::with_capacity(self.images.len()) }));
            first = end;
        }
        for image in &mut self.images {
            let (mut color, mut transmittance) = (&mut image.color[..], &mut image.transmittance[..]);
            for (_, patch) in &mut patches {
                let pixels = patch.rect.width();
                let (color_head, color_tail) = color.split_at_mut(3 * pixels);
                let (share_head, share_tail) = transmittance.split_at_mut(image.channels * pixels);
                patch.rows.push(Row {
                    color: color_head,
                    transmittance: share_head,
                    channels: image.channels,
                });
                (color, transmittance) = (color_tail, share_tail);
            }
        }
        patches
    }
}

/// So many samples of whatever value; none where there is no room for them.
fn buffer<S: Sample>(len: usize) -> Option<Vec<S>> {
    if let Some(spare) = S::spare().take(|samples| samples.len() == len) {
        return Some(spare);
    }
    // a failing vec! would abort
    Vec::<S>::new().try_reserve_exact(len).ok()?;
    Some(vec![S::default(); len])
}

/// Some rows of all images.
pub struct Band<'a, S> {
    width: usize,
    images: Vec<BandImage<'a, S>>,
}

/// Those of one image.
struct BandImage<'a, S> {
    color: &'a mut [S],
    transmittance: &'a mut [S],
    channels: usize,
}

impl<'a, S: Sample> Band<'a, S> {
    /// The band cut into pieces from left to right, which are these.
    pub fn pieces(self, rects: impl Iterator<Item = Rect>) -> Vec<Patch<'a, S>> {
        let (width, images) = (self.width, self.images.len());
        let patch = |rect: Rect| Patch { rect, rows: Vec::with_capacity(images * rect.height()) };
        let mut patches: Vec<_> = rects.map(patch).collect();
        for BandImage { color, transmittance, channels } in self.images {
            let rows = color.chunks_mut(3 * width).zip(transmittance.chunks_mut(channels * width));
            for (mut color, mut transmittance) in rows {
                for Patch { rect, rows } in &mut patches {
                    let columns = rect.width();
                    let (color_here, color_right) = color.split_at_mut(3 * columns);
                    let (share_here, share_right) = transmittance.split_at_mut(channels * columns);
                    rows.push(Row { color: color_here, transmittance: share_here, channels });
                    (color, transmittance) = (color_right, share_right);
                }
            }
        }
        patches
    }
}

/// A rectangle of all images, to be written by one thread.
pub struct Patch<'a, S> {
    rect: Rect,
    /// Those of the first image, then those of the next.
    rows: Vec<Row<'a, S>>,
}

/// Neighbouring pixels.
struct Row<'a, S> {
    color: &'a mut [S],
    transmittance: &'a mut [S],
    channels: usize,
}

impl<S: Sample> Patch<'_, S> {
    /// Which pixels they are.
    pub fn rect(&self) -> Rect {
        self.rect
    }

    /// Stores pixels of variant `v`, beginning with pixel `first` of the part `rect`, row by row.
    pub fn store(&mut self, v: usize, rect: &Rect, first: usize, resolved: &[Resolved]) {
        self.rows(v, rect, first, resolved.len(), |colors, shares, channels, now| {
            let now = &resolved[now];
            for (to, pixel) in colors.iter_mut().zip(now) {
                *to = pixel.color.to_array().map(S::from_f64);
            }
            for (to, pixel) in shares.chunks_exact_mut(channels).zip(now) {
                for (to, share) in to.iter_mut().zip(pixel.transmittance.to_array()) {
                    *to = S::from_f64(share);
                }
            }
        });
    }

    /// The same for pixels whose background has one share in all channels.
    pub fn store_finished(&mut self, v: usize, rect: &Rect, first: usize, pixels: &FinishedPixels) {
        let store = |colors: &mut [_], shares: &mut [_], _, now| S::store(pixels.planes(now), colors, shares);
        self.rows(v, rect, first, pixels.len(), store);
    }

    /// Stores one pixel of variant `v` in all places of a cell of the part `rect`, for each of its cells. As above, the
    /// background has one share in all channels.
    pub fn fill(&mut self, v: usize, rect: &Rect, cells: &Cells, pixels: &FinishedPixels) {
        let (mut strips, mut row, mut end) = (cells.strips(), 0, 0);
        let mut buffer = RowBuffer::default();
        let store = |colors: &mut [[S; 3]], shares: &mut [S], _, _| {
            // the other rows of a strip are as its first
            if row == end
                && let Some(Strip { rows, places, ends }) = strips.next()
            {
                end = rows.end;
                spread(pixels.planes(places), ends, &mut buffer);
            }
            buffer.copy_to(colors.as_flattened_mut(), shares);
            row += 1;
        };
        self.rows(v, rect, 0, rect.area(), store);
    }

    /// Hands out the rows that so many pixels go into: colours, transmittances with so many channels, and which of the
    /// pixels they are.
    fn rows(
        &mut self,
        v: usize,
        rect: &Rect,
        first: usize,
        pixels: usize,
        mut store: impl FnMut(&mut [[S; 3]], &mut [S], usize, Range<usize>),
    ) {
        let height = self.rect.height();
        let rows = &mut self.rows[v * height..(v + 1) * height];
        #[expect(clippy::cast_sign_loss, reason = "the part lies in the patch")]
        let (left, top) = ((rect.x0 - self.rect.x0) as usize, (rect.y0 - self.rect.y0) as usize);
        let (mut row, mut column) = (first / rect.width(), first % rect.width());
        let mut next = 0;
        while next < pixels {
            let now = next..pixels.min(next + rect.width() - column);
            let (from, to) = (left + column, left + column + now.len());
            let Row { color, transmittance, channels } = &mut rows[top + row];
            let colors = color[3 * from..3 * to].as_chunks_mut::<3>().0;
            let shares = &mut transmittance[*channels * from..*channels * to];
            (row, column, next) = (row + 1, 0, now.end);
            store(colors, shares, *channels, now);
        }
    }

    /// Fills some pixels of the part `rect` of variant `v` with the background.
    pub fn clear_part(&mut self, v: usize, rect: &Rect, pixels: Range<usize>, background: [f32; 3]) {
        let [r, g, b] = background.map(|channel| S::from_f64(channel.into()));
        self.rows(v, rect, pixels.start, pixels.len(), |colors, shares, _, _| {
            clear_row([r, g, b, S::from_f64(1.0)], colors.as_flattened_mut(), shares);
        });
    }

    /// Fills everything with the background.
    pub fn clear(&mut self, background: [f32; 3]) {
        let [r, g, b] = background.map(|channel| S::from_f64(channel.into()));
        for row in &mut self.rows {
            clear_row([r, g, b, S::from_f64(1.0)], row.color, row.transmittance);
        }
    }
}

/// Pixels that are written together.
const BLOCK: usize = 16;

/// The same pixel, a colour and a share, in a whole block.
#[inline(always)]
#[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
fn fill_block<S: Sample>(pixel: &[S; 4], colors: &mut [S; 3 * BLOCK], shares: &mut [S; BLOCK]) {
    // a third of the colours at a time, in loops that become a shuffle of the pixel's channels each
    for third in 0..3 {
        let mut repeated = [S::default(); BLOCK];
        for (i, sample) in repeated.iter_mut().enumerate() {
            *sample = pixel[(third * BLOCK + i) % 3];
        }
        colors[third * BLOCK..(third + 1) * BLOCK].copy_from_slice(&repeated);
    }
    *shares = [pixel[3]; BLOCK];
}

/// Writes the same pixel everywhere in a row; its transmittance may have several channels.
#[multiversion(
    targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"),
    dispatcher = "direct"
)]
fn clear_row<S: Sample>(pixel: [S; 4], colors: &mut [S], shares: &mut [S]) {
    let (mut block, mut ones) = ([pixel[0]; 3 * BLOCK], [pixel[3]; BLOCK]);
    fill_block(&pixel, &mut block, &mut ones);
    let (blocks, rest) = colors.as_chunks_mut();
    blocks.fill(block);
    rest.copy_from_slice(&block[..rest.len()]);
    shares.fill(pixel[3]);
}

/// A row of a tile that has cells, with room for a block behind it: whole blocks are written, the ends of which the next
/// cell writes over.
struct RowBuffer<S> {
    /// A pixel of each cell.
    cells: [[S; 4]; Cells::MOST_COLUMNS],
    colors: [S; 3 * (Cells::MOST_COLUMNS + BLOCK)],
    shares: [S; Cells::MOST_COLUMNS + BLOCK],
}

impl<S: Sample> Default for RowBuffer<S> {
    fn default() -> Self {
        let nothing = S::default();
        Self {
            cells: [[nothing; 4]; Cells::MOST_COLUMNS],
            colors: [nothing; 3 * (Cells::MOST_COLUMNS + BLOCK)],
            shares: [nothing; Cells::MOST_COLUMNS + BLOCK],
        }
    }
}

impl<S: Sample> RowBuffer<S> {
    /// The row's pixels, as many as there is room for.
    fn copy_to(&self, colors: &mut [S], shares: &mut [S]) {
        debug_assert_eq!(3 * shares.len(), colors.len());
        colors.copy_from_slice(&self.colors[..colors.len()]);
        shares.copy_from_slice(&self.shares[..shares.len()]);
    }
}

/// Makes a row of cells: each cell's pixel up to its end.
#[multiversion(
    targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"),
    dispatcher = "direct"
)]
fn spread<S: Sample>([r, g, b, share]: [&[f64]; 4], ends: &[u32], buffer: &mut RowBuffer<S>) {
    let cells = &mut buffer.cells[..ends.len()];
    let (r, g, b, share) = (&r[..ends.len()], &g[..ends.len()], &b[..ends.len()], &share[..ends.len()]);
    for (i, cell) in cells.iter_mut().enumerate() {
        // written out: `map` may be called, and not for the instruction set at hand
        *cell = [S::from_f64(r[i]), S::from_f64(g[i]), S::from_f64(b[i]), S::from_f64(share[i])];
    }
    let mut next = 0;
    for (cell, &end) in cells.iter().zip(ends) {
        let end = end as usize;
        while next < end {
            let block =
                (buffer.colors[3 * next..].first_chunk_mut(), buffer.shares[next..].first_chunk_mut());
            if let (Some(colors), Some(shares)) = block {
                fill_block(cell, colors, shares);
            }
            next += BLOCK;
        }
        next = end;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn spread_is_each_cells_pixel<S: Sample + PartialEq + std::fmt::Debug>() {
        let planes: Vec<Vec<f64>> =
            (0..4).map(|plane| (0..70).map(|cell| f64::from(100 * plane + cell)).collect()).collect();
        for columns in [1_usize, 7, 8, 9, 15, 16, 17, 64] {
            for length in [1, 2, 7, 8, 9, 20, 64] {
                let ends: Vec<u32> = (1..=columns.div_ceil(length))
                    .map(|n| u32::try_from((n * length).min(columns)).unwrap())
                    .collect();
                let cells = [0, 1, 2, 3].map(|plane: usize| &planes[plane][..ends.len()]);
                let (mut colors, mut shares) = (vec![S::default(); 3 * columns], vec![S::default(); columns]);
                let mut buffer = RowBuffer::default();
                spread(cells, &ends, &mut buffer);
                buffer.copy_to(&mut colors, &mut shares);
                for x in 0..columns {
                    let sample = |plane: usize| S::from_f64(cells[plane][x / length]);
                    assert_eq!(
                        colors[3 * x..3 * x + 3],
                        [sample(0), sample(1), sample(2)],
                        "{columns} {length} {x}"
                    );
                    assert_eq!(shares[x], sample(3), "{columns} {length} {x}");
                }
            }
        }
    }

    #[test]
    fn cells_fill_their_rows() {
        spread_is_each_cells_pixel::<f32>();
        spread_is_each_cells_pixel::<f64>();
    }
}
