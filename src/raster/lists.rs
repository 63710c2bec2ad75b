//! A tile's fragments as per-pixel lists: kept as (depth, primitive) and shaded only when they are asked for.

use super::cover::Rect;
use super::interpolate::{LANES, Surface};
use super::shade::{Paint, Premultiplied};
use super::tile::{Block, Cover, Sink, lanes, pixel_at};
use crate::fragments::{Fragment, Lists};
use crate::order::sort_key;

/// Collects a tile's fragments in submission order.
#[derive(Default)]
pub struct TileLists<'a> {
    rect: Option<Rect>,
    budget: usize,
    /// Every block as it came, with the tile's own number of its primitive.
    arrived: Vec<(Block, u32)>,
    depth: Vec<[f32; LANES]>,
    primitives: Vec<(u32, Colors)>,
    varying: Vec<(Surface<'a>, Paint)>,
    counts: Vec<u32>,
    fragments: usize,
    /// Per pixel, as `starts` says: depth in the upper half, the primitive's number in the lower, so that the
    /// integers' order is that of (depth, primitive).
    packed: Vec<u64>,
    starts: Vec<usize>,
    cursors: Vec<usize>,
}

/// A primitive's colours.
enum Colors {
    /// One for all pixels.
    Flat(Premultiplied),
    /// To be evaluated; the place in `varying`.
    Varying(usize),
}

impl TileLists<'_> {
    /// Forgets everything and gets ready for the pixels of `rect`, as long as they have `budget` fragments in
    /// all.
    pub fn begin(&mut self, rect: Rect, budget: usize) {
        self.rect = Some(rect);
        self.budget = budget;
        self.arrived.clear();
        self.depth.clear();
        self.primitives.clear();
        self.varying.clear();
        self.counts.clear();
        self.counts.resize(rect.area(), 0);
        self.fragments = 0;
    }

    /// Whether more fragments came than the budget allows; the lists are incomplete then.
    pub fn is_over_budget(&self) -> bool {
        self.fragments > self.budget
    }

    /// Fragments per pixel.
    pub fn counts(&self) -> &[u32] {
        &self.counts
    }

    /// Distributes what arrived over the pixels, each pixel's in arrival order.
    pub fn distribute(&mut self) {
        self.starts.clear();
        self.starts.push(0);
        let mut sum = 0;
        for &count in &self.counts {
            sum += count as usize;
            self.starts.push(sum);
        }
        self.cursors.clear();
        self.cursors.extend_from_slice(&self.starts);
        self.packed.resize(sum, 0);
        for ((block, number), depth) in self.arrived.iter().zip(&self.depth) {
            for lane in lanes(block.mask) {
                let cursor = &mut self.cursors[block.first as usize + lane];
                self.packed[*cursor] = sort_key(depth[lane], *number);
                *cursor += 1;
            }
        }
    }

    /// Sorts the fragments of pixels `first..last` by (depth, primitive).
    pub fn sort(&mut self, first: usize, last: usize) {
        for pixel in first..last {
            self.packed[self.starts[pixel]..self.starts[pixel + 1]].sort_unstable();
        }
    }

    /// Shades the fragments of pixels `first..last` into `out`, in the order they are in.
    pub fn shade(&self, first: usize, last: usize, out: &mut Lists) {
        out.clear();
        let rect = self.rect.unwrap_or(Rect { x0: 0, y0: 0, x1: 1, y1: 1 });
        for pixel in first..last {
            for &packed in &self.packed[self.starts[pixel]..self.starts[pixel + 1]] {
                let (depth, number) = unpack(packed);
                let (primitive, colors) = &self.primitives[number];
                let [r, g, b, alpha] = match colors {
                    Colors::Flat(color) => *color,
                    Colors::Varying(place) => {
                        let (surface, paint) = &self.varying[*place];
                        let (x, y) = pixel_at(&rect, pixel);
                        paint.at(&surface.at(x, y))
                    }
                };
                out.push(Fragment { depth, color: [r, g, b], alpha, primitive: *primitive });
            }
            out.end_row();
        }
    }
}

/// Depth and primitive number of a packed fragment.
#[expect(clippy::cast_possible_truncation, reason = "the halves of the key")]
fn unpack(packed: u64) -> (f32, usize) {
    (f32::from_bits((packed >> 32) as u32), packed as u32 as usize)
}

impl<'r> Sink<'r> for TileLists<'r> {
    fn take(&mut self, cover: &Cover<'_, 'r>) -> bool {
        #[expect(clippy::cast_possible_truncation, reason = "primitives of one tile")]
        let number = self.primitives.len() as u32;
        for block in cover.blocks {
            self.fragments += block.mask.count_ones() as usize;
            for lane in lanes(block.mask) {
                self.counts[block.first as usize + lane] += 1;
            }
        }
        self.arrived.extend(cover.blocks.iter().map(|&block| (block, number)));
        self.depth.extend_from_slice(cover.depth);
        let colors = match cover.paint {
            Paint::Flat(color) => Colors::Flat(*color),
            Paint::Varying(_) => {
                self.varying.push((*cover.surface, *cover.paint));
                Colors::Varying(self.varying.len() - 1)
            }
        };
        self.primitives.push((cover.primitive, colors));
        !self.is_over_budget()
    }
}
