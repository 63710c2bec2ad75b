//! Blended techniques fed straight from the rasteriser: sums per pixel of a tile, no fragment is kept.
//!
//! The arithmetic per pixel is that of [`BlendSums::add`], operation by operation, so that a tile's sums have the
//! bits of the same fragments blended from a list. Pixels outside a block's mask get a weight and an alpha of
//! zero, which changes nothing.

use crate::continuum::sums::{BlendSums, Blended};
use crate::raster::{Block, Cover, LANES, Paint, Rect, Sink, lanes, pixel_at};
use crate::resolve::nanos_since;
use crate::technique::Resolved;
use crate::weight::Weighting;
use glam::{DVec3, Vec4};
use multiversion::multiversion;
use std::time::Instant;

/// One number per lane.
type Lanes = [f32; LANES];

/// One in so many primitives has its blending timed; reading the clock costs as much as a small triangle.
const TIMED: usize = 16;

/// The sums of all blended variants over a tile.
#[derive(Default)]
pub struct TileSums<'a> {
    variants: Vec<VariantSums<'a>>,
    rect: Option<Rect>,
    /// R and 1 - R, which all variants share, as [`BlendSums`] keeps them.
    transmittance: Vec<f64>,
    coverage: Vec<f64>,
    counts: Vec<u32>,
    /// Alpha per block of the primitive at hand, zero outside the mask.
    alpha: Vec<Lanes>,
    color: Vec<[Lanes; 3]>,
    weights: Vec<f32>,
    primitives: usize,
}

struct VariantSums<'a> {
    technique: &'a dyn Blended,
    /// Σ w (r, g, b, a), a plane each.
    planes: [Vec<f32>; 4],
    nanos: u64,
}

impl<'a> TileSums<'a> {
    /// Sums for these techniques.
    pub fn new(techniques: impl Iterator<Item = &'a dyn Blended>) -> Self {
        let sums =
            |technique| VariantSums { technique, planes: std::array::from_fn(|_| Vec::new()), nanos: 0 };
        Self { variants: techniques.map(sums).collect(), ..Self::default() }
    }

    /// Whether there is nothing to sum for.
    pub fn is_empty(&self) -> bool {
        self.variants.is_empty()
    }

    /// Clears the sums for the pixels of `rect`.
    pub fn begin(&mut self, rect: Rect) {
        let size = rect.area() + LANES; // blocks may reach past the last pixel, with nothing
        self.rect = Some(rect);
        reset(&mut self.transmittance, size, 1.0);
        reset(&mut self.coverage, size, 0.0);
        reset(&mut self.counts, size, 0);
        for variant in &mut self.variants {
            variant.nanos = 0;
            variant.planes.iter_mut().for_each(|plane| reset(plane, size, 0.0));
        }
    }

    /// Fragments per pixel.
    pub fn counts(&self) -> &[u32] {
        &self.counts[..self.rect.map_or(0, |rect| rect.area())]
    }

    /// The pixels of variant `v`; the time that it took in all, and how much of that while rasterising.
    pub fn finish(&self, v: usize, background: &[[f32; 3]], out: &mut Vec<Resolved>) -> (u64, u64) {
        let start = Instant::now();
        let VariantSums { technique, planes: [r, g, b, a], nanos } = &self.variants[v];
        out.clear();
        out.extend(background.iter().enumerate().map(|(i, color)| {
            let background = DVec3::from(color.map(f64::from));
            if self.counts[i] == 0 {
                return Resolved::background(background);
            }
            let weighted = Vec4::new(r[i], g[i], b[i], a[i]);
            let sums = BlendSums::from_parts(weighted, self.transmittance[i], self.coverage[i]);
            technique.finish(&sums, self.counts[i] as usize, background)
        }));
        (nanos + nanos_since(start), *nanos)
    }

    /// Alpha and colour per lane, for a primitive that varies.
    fn shade(&mut self, cover: &Cover<'_, '_>) {
        let rect = self.rect.unwrap_or(Rect { x0: 0, y0: 0, x1: 1, y1: 1 });
        self.alpha.clear();
        self.color.clear();
        for block in cover.blocks {
            let (mut alpha, mut color) = ([0.0; LANES], [[0.0; LANES]; 3]);
            for lane in lanes(block.mask) {
                let (x, y) = pixel_at(&rect, block.first as usize + lane);
                let [r, g, b, a] = cover.paint.at(&cover.surface.at(x, y));
                (color[0][lane], color[1][lane], color[2][lane]) = (r, g, b);
                alpha[lane] = a;
            }
            self.alpha.push(alpha);
            self.color.push(color);
        }
    }
}

fn reset<T: Clone>(values: &mut Vec<T>, len: usize, value: T) {
    values.clear();
    values.resize(len, value);
}

impl<'r> Sink<'r> for TileSums<'_> {
    fn take(&mut self, cover: &Cover<'_, 'r>) -> bool {
        let flat = match cover.paint {
            Paint::Flat(color) => Some(*color),
            Paint::Varying(_) => None,
        };
        match flat {
            Some([.., alpha]) => spread(alpha, cover.blocks, &mut self.alpha),
            None => self.shade(cover),
        }
        attenuate(cover.blocks, &self.alpha, &mut self.transmittance, &mut self.coverage, &mut self.counts);
        let timed = self.primitives.is_multiple_of(TIMED);
        self.primitives += 1;
        for variant in &mut self.variants {
            let start = timed.then(Instant::now);
            let weighting = variant.technique.weighting();
            let planes = &mut variant.planes;
            match (weighting, flat, cover.constant_depth) {
                (None, Some(color), _) => add_constant(cover.blocks, 1.0, color, planes),
                (Some(weighting), Some(color), Some(depth)) => {
                    weighting.evaluate(&[depth], &[color[3]], &mut self.weights);
                    add_constant(cover.blocks, self.weights[0], color, planes);
                }
                (weighting, flat, _) => {
                    weigh(weighting, cover, flat, &self.alpha, &mut self.weights);
                    let weights = self.weights.as_chunks().0;
                    match flat {
                        Some(color) => add_flat(cover.blocks, weights, color, planes),
                        None => add_shaded(cover.blocks, weights, &self.color, &self.alpha, planes),
                    }
                }
            }
            variant.nanos += start.map_or(0, |start| nanos_since(start) * TIMED as u64);
        }
        true
    }
}

/// The weights of all lanes. A flat primitive's alpha is its own outside the mask too, so that lanes agree.
fn weigh(
    weighting: Option<&Weighting>,
    cover: &Cover<'_, '_>,
    flat: Option<[f32; 4]>,
    alpha: &[Lanes],
    weights: &mut Vec<f32>,
) {
    let depth = cover.depth.as_flattened();
    match (weighting, flat) {
        (None, _) => reset(weights, depth.len(), 1.0),
        (Some(weighting), _) => weighting.evaluate(depth, alpha.as_flattened(), weights),
    }
}

/// The value where the mask is set, zero elsewhere.
#[inline(always)]
#[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
fn masked(mask: u8, value: f32) -> Lanes {
    std::array::from_fn(|lane| if mask >> lane & 1 == 1 { value } else { 0.0 })
}

/// A block's lanes of a plane.
#[inline(always)]
#[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
fn lanes_of<'a, T>(values: &'a mut [T], block: &Block) -> &'a mut [T; LANES] {
    let first = block.first as usize;
    let lanes = values[first..first + LANES].first_chunk_mut();
    lanes.unwrap_or_else(|| unreachable!("the slice has that length"))
}

#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"))]
fn spread(value: f32, blocks: &[Block], out: &mut Vec<Lanes>) {
    out.clear();
    out.extend(blocks.iter().map(|block| masked(block.mask, value)));
}

/// Attenuates the background and counts the fragments.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"))]
fn attenuate(
    blocks: &[Block],
    alpha: &[Lanes],
    transmittance: &mut [f64],
    coverage: &mut [f64],
    counts: &mut [u32],
) {
    for (block, alpha) in blocks.iter().zip(alpha) {
        let (t, c) = (lanes_of(transmittance, block), lanes_of(coverage, block));
        for lane in 0..LANES {
            let a = f64::from(alpha[lane]);
            t[lane] *= 1.0 - a;
            c[lane] += (1.0 - c[lane]) * a;
        }
        for (lane, n) in lanes_of(counts, block).iter_mut().enumerate() {
            *n += u32::from(block.mask >> lane & 1);
        }
    }
}

/// Adds `weight * color` to every pixel.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"))]
fn add_constant(blocks: &[Block], weight: f32, color: [f32; 4], planes: &mut [Vec<f32>; 4]) {
    for (plane, channel) in planes.iter_mut().zip(color) {
        let added = weight * channel;
        for block in blocks {
            let lanes = lanes_of(plane, block);
            if block.mask == !0 {
                for sum in lanes {
                    *sum += added;
                }
            } else {
                let added = masked(block.mask, added);
                for lane in 0..LANES {
                    lanes[lane] += added[lane];
                }
            }
        }
    }
}

/// Adds the weights times one colour.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"))]
fn add_flat(blocks: &[Block], weights: &[Lanes], color: [f32; 4], planes: &mut [Vec<f32>; 4]) {
    let [r, g, b, a] = planes;
    for (block, weights) in blocks.iter().zip(weights) {
        let inside = masked(block.mask, 1.0);
        let (r, g) = (lanes_of(r, block), lanes_of(g, block));
        let (b, a) = (lanes_of(b, block), lanes_of(a, block));
        for lane in 0..LANES {
            let weight = if inside[lane] > 0.0 { weights[lane] } else { 0.0 };
            r[lane] += weight * color[0];
            g[lane] += weight * color[1];
            b[lane] += weight * color[2];
            a[lane] += weight * color[3];
        }
    }
}

/// Adds the weights times the colours of all lanes, which are zero outside the mask.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"))]
fn add_shaded(
    blocks: &[Block],
    weights: &[Lanes],
    color: &[[Lanes; 3]],
    alpha: &[Lanes],
    planes: &mut [Vec<f32>; 4],
) {
    for (((block, weights), color), alpha) in blocks.iter().zip(weights).zip(color).zip(alpha) {
        for (plane, channel) in planes.iter_mut().zip([&color[0], &color[1], &color[2], alpha]) {
            let sums = lanes_of(plane, block);
            for lane in 0..LANES {
                sums[lane] += weights[lane] * channel[lane];
            }
        }
    }
}
