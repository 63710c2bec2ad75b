//! Blended techniques fed straight from the rasteriser: sums per pixel of a tile.
//!
//! The arithmetic per pixel is that of [`BlendSums::add`], operation by operation, so that a tile's sums have the
//! bits of the same fragments blended from a list. Techniques of one weight share their sums.
//!
//! [`BlendSums::add`]: crate::continuum::sums::BlendSums::add

use super::{Stopwatch, flat_color, shade};
use crate::continuum::sums::{Blended, FAINT, SumsOf};
use crate::lanes::{Block, Group, LANES, at_mut, attenuate_block, count_block, reset};
use crate::raster::{Cover, Opaque, Premultiplied, Rect, Run, Sink};
use crate::technique::Finished;
use crate::weight::Weighting;
use multiversion::multiversion;

/// The sums of all blended variants over a tile.
#[derive(Default)]
pub struct TileSums<'a> {
    /// Per variant: the technique, and which of the sums are its own.
    variants: Vec<(&'a dyn Blended, usize)>,
    weighted: Vec<WeightedSums<'a>>,
    /// R, and 1 - R of faint fragments, which all variants share.
    transmittance: Vec<Group<f64>>,
    coverage: Vec<Group<f64>>,
    counts: Vec<Group<u32>>,
    /// Whether anything was added to `coverage`.
    faint: bool,
    /// The colours of the primitive at hand, if it has several.
    colors: Vec<Premultiplied>,
    alpha: Vec<f32>,
    weights: Vec<f32>,
    depth: Vec<f32>,
}

struct WeightedSums<'a> {
    /// All count the same where there is none.
    weighting: Option<&'a Weighting>,
    /// Σ w (r, g, b, a).
    sums: Vec<Group<[f32; 4]>>,
    stopwatch: Stopwatch,
}

impl<'a> TileSums<'a> {
    /// Sums for these techniques.
    pub fn new(techniques: impl Iterator<Item = &'a dyn Blended>) -> Self {
        let mut all = Self::default();
        for technique in techniques {
            let weighting = technique.weighting();
            let same = |other: &WeightedSums<'_>| match (other.weighting, weighting) {
                (None, None) => true,
                (Some(a), Some(b)) => a.is_same(b),
                _ => false,
            };
            let place = all.weighted.iter().position(same).unwrap_or(all.weighted.len());
            if place == all.weighted.len() {
                all.weighted.push(WeightedSums {
                    weighting,
                    sums: Vec::new(),
                    stopwatch: Stopwatch::default(),
                });
            }
            all.variants.push((technique, place));
        }
        all
    }

    /// Clears the sums for the pixels of `rect`.
    pub fn begin(&mut self, rect: Rect) {
        reset(&mut self.transmittance, rect.area(), 1.0);
        if self.faint || self.coverage.len() != rect.area().div_ceil(LANES) {
            reset(&mut self.coverage, rect.area(), 0.0);
            self.faint = false;
        }
        reset(&mut self.counts, rect.area(), 0);
        for weighted in &mut self.weighted {
            reset(&mut weighted.sums, rect.area(), [0.0; 4]);
        }
    }

    /// Fragments per pixel; the last group may have pixels too many, without fragments.
    pub fn counts(&self) -> &[Group<u32>] {
        &self.counts
    }

    /// Some pixels of variant `v`; the first is the first of a group.
    pub fn finish(
        &self,
        v: usize,
        pixels: std::ops::Range<usize>,
        background: &Opaque,
        out: &mut Vec<Finished>,
    ) {
        let (technique, place) = self.variants[v];
        let groups = pixels.start / LANES..pixels.end.div_ceil(LANES);
        let sums = SumsOf {
            weighted: &self.weighted[place].sums[groups.clone()],
            transmittance: &self.transmittance[groups.clone()],
            coverage: &self.coverage[groups.clone()],
            counts: &self.counts[groups],
            background: &background.colors()[pixels],
            one_background: background.is_one_color(),
        };
        technique.finish_all(&sums, out);
    }

    /// How long each variant took while rasterising, since the last look; variants of one weight share it.
    pub fn nanos(&mut self) -> impl Iterator<Item = u64> {
        let nanos: Vec<_> = self.weighted.iter_mut().map(|weighted| weighted.stopwatch.take()).collect();
        let sharers = |place| self.variants.iter().filter(|(_, other)| *other == place).count() as u64;
        self.variants.iter().map(move |&(_, place)| nanos[place] / sharers(place))
    }
}

impl<'r> Sink<'r> for TileSums<'_> {
    const BLOCKS: bool = true;

    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    fn take(&mut self, cover: &Cover<'_, 'r>) -> bool {
        let flat = flat_color(cover);
        let fused = self.take_constant(cover) || self.take_few(cover);
        if !fused {
            match flat {
                Some([.., alpha]) => self.attenuate_flat(cover, alpha),
                None => self.attenuate_shaded(cover),
            }
        }
        let Self { weighted, colors, alpha, weights, depth, .. } = self;
        let weighted = &mut weighted[usize::from(fused)..];
        for WeightedSums { weighting, sums, stopwatch } in weighted {
            let start = stopwatch.start();
            match (flat, *weighting, cover.constant_depth) {
                (Some(color), None, _) => add_same(cover, color, sums),
                (Some(color), Some(weighting), Some(depth)) => {
                    weighting.evaluate_here(&[depth], &[color[3]], weights);
                    add_same(cover, color.map(|channel| weights[0] * channel), sums);
                }
                (Some(color), Some(weighting), None) => {
                    weigh_flat(weighting, cover, color[3], alpha, weights);
                    if cover.is_small() {
                        add_few(cover.places, weights, color, sums);
                    } else {
                        add_flat(cover.blocks, weights, color, sums);
                    }
                }
                (None, weighting, _) => {
                    weigh_shaded(weighting, cover, alpha, depth, weights);
                    add_shaded(cover.runs, weights, colors, sums);
                }
            }
            stopwatch.stop(start);
        }
        true
    }
}

impl TileSums<'_> {
    /// Attenuates the background and adds to the first sums in one go, if the primitive is large and has one
    /// colour and one weight.
    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    fn take_constant(&mut self, cover: &Cover<'_, '_>) -> bool {
        let Some(color) = flat_color(cover).filter(|_| !cover.is_small()) else { return false };
        let Some(WeightedSums { weighting, sums, stopwatch }) = self.weighted.first_mut() else {
            return false;
        };
        let added = match (weighting, cover.constant_depth) {
            (None, _) => color,
            (Some(weighting), Some(depth)) => {
                weighting.evaluate_here(&[depth], &[color[3]], &mut self.weights);
                color.map(|channel| self.weights[0] * channel)
            }
            (Some(_), None) => return false,
        };
        let alpha = f64::from(color[3]);
        let start = stopwatch.start();
        blend_constant(cover.blocks, alpha, added, &mut self.transmittance, &mut self.counts, sums);
        stopwatch.stop(start);
        if alpha <= FAINT {
            self.faint = true;
            cover_faintly(cover.blocks, alpha, &mut self.coverage);
        }
        true
    }

    /// The same for a small primitive whose depth varies.
    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    fn take_few(&mut self, cover: &Cover<'_, '_>) -> bool {
        let (Some(color), None, true) = (flat_color(cover), cover.constant_depth, cover.is_small()) else {
            return false;
        };
        let Some(WeightedSums { weighting: Some(weighting), sums, stopwatch }) = self.weighted.first_mut()
        else {
            return false;
        };
        let Self { transmittance, counts, alpha: alphas, weights, .. } = self;
        let alpha = f64::from(color[3]);
        let start = stopwatch.start();
        weigh_flat(weighting, cover, color[3], alphas, weights);
        for (&pixel, weight) in cover.places.iter().zip(&*weights) {
            let (group, lane) = (pixel as usize / LANES, pixel as usize % LANES);
            transmittance[group].0[lane] *= 1.0 - alpha;
            counts[group].0[lane] += 1;
            let mut sum = sums[group].0[lane];
            for channel in 0..4 {
                sum[channel] += weight * color[channel];
            }
            sums[group].0[lane] = sum;
        }
        stopwatch.stop(start);
        self.cover_if_faint(cover, alpha);
        true
    }

    /// Adds to 1 - R what a primitive covers if it is faint.
    fn cover_if_faint(&mut self, cover: &Cover<'_, '_>, alpha: f64) {
        if alpha <= FAINT {
            self.faint = true;
            for pixel in cover.runs.iter().flat_map(|run| run.pixels()) {
                let coverage = at_mut(&mut self.coverage, pixel);
                *coverage += (1.0 - *coverage) * alpha;
            }
        }
    }

    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    fn attenuate_flat(&mut self, cover: &Cover<'_, '_>, alpha: f32) {
        let alpha = f64::from(alpha);
        if cover.is_small() {
            for &pixel in cover.places {
                *at_mut(&mut self.transmittance, pixel as usize) *= 1.0 - alpha;
                *at_mut(&mut self.counts, pixel as usize) += 1;
            }
        } else {
            attenuate(cover.blocks, alpha, &mut self.transmittance, &mut self.counts);
        }
        self.cover_if_faint(cover, alpha);
    }

    /// Attenuates the background by a primitive whose colour varies, which stays in `colors`, its alpha in
    /// `alpha`.
    fn attenuate_shaded(&mut self, cover: &Cover<'_, '_>) {
        shade(cover, &mut self.colors);
        self.faint = true;
        self.alpha.clear();
        self.alpha.extend(self.colors.iter().map(|color| color[3]));
        for (i, &alpha) in cover.runs.iter().flat_map(|run| run.pixels()).zip(&self.alpha) {
            let alpha = f64::from(alpha);
            let coverage = at_mut(&mut self.coverage, i);
            *coverage += (1.0 - *coverage) * if alpha <= FAINT { alpha } else { 0.0 };
            *at_mut(&mut self.transmittance, i) *= 1.0 - alpha;
            *at_mut(&mut self.counts, i) += 1;
        }
    }
}

/// The weights of all pixels of a primitive of one colour, and a few more: whole vectors are faster than exact
/// ends, and there are depths enough.
#[inline(always)]
#[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
fn weigh_flat(
    weighting: &Weighting,
    cover: &Cover<'_, '_>,
    alpha: f32,
    alphas: &mut Vec<f32>,
    weights: &mut Vec<f32>,
) {
    let len = cover.pixels.next_multiple_of(8);
    refill(alphas, len, alpha);
    weighting.evaluate_here(&cover.depth[..len], alphas, weights);
}

/// The weights of all pixels of a primitive whose colour varies.
fn weigh_shaded(
    weighting: Option<&Weighting>,
    cover: &Cover<'_, '_>,
    alphas: &[f32],
    constant: &mut Vec<f32>,
    weights: &mut Vec<f32>,
) {
    let Some(weighting) = weighting else { return refill(weights, cover.pixels, 1.0) };
    match cover.constant_depth {
        Some(depth) => {
            refill(constant, cover.pixels, depth);
            weighting.evaluate(constant, alphas, weights);
        }
        None => weighting.evaluate(&cover.depth[..cover.pixels], alphas, weights),
    }
}

fn refill(numbers: &mut Vec<f32>, len: usize, number: f32) {
    numbers.clear();
    numbers.resize(len, number);
}

/// Attenuates the background and counts the fragments.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"))]
fn attenuate(blocks: &[Block], alpha: f64, transmittance: &mut [Group<f64>], counts: &mut [Group<u32>]) {
    for &block in blocks {
        let (group, ones) = (block.index(), block.ones());
        attenuate_block(&mut transmittance[group].0, &ones, alpha);
        count_block(&mut counts[group].0, &ones);
    }
}

/// Adds to 1 - R what a faint primitive covers.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"))]
fn cover_faintly(blocks: &[Block], alpha: f64, coverage: &mut [Group<f64>]) {
    for &block in blocks {
        let (ones, mut c) = (block.ones(), coverage[block.index()].0);
        for lane in 0..LANES {
            c[lane] += (1.0 - c[lane]) * (alpha * f64::from(ones[lane]));
        }
        coverage[block.index()].0 = c;
    }
}

/// Attenuates the background, counts the fragments and adds the same to every pixel.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"))]
fn blend_constant(
    blocks: &[Block],
    alpha: f64,
    added: [f32; 4],
    transmittance: &mut [Group<f64>],
    counts: &mut [Group<u32>],
    sums: &mut [Group<[f32; 4]>],
) {
    let added = finite(added);
    for &block in blocks {
        let (group, ones) = (block.index(), block.ones());
        attenuate_block(&mut transmittance[group].0, &ones, alpha);
        count_block(&mut counts[group].0, &ones);
        add_block(&mut sums[group].0, &ones, added);
    }
}

/// An infinite number would spoil what is to be left alone, and sums end at the largest one anyway.
#[inline(always)]
#[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
fn finite(mut added: [f32; 4]) -> [f32; 4] {
    for channel in &mut added {
        *channel = if *channel < f32::MAX { *channel } else { f32::MAX };
    }
    added
}

#[inline(always)]
#[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
fn add_block(sums: &mut [[f32; 4]; LANES], ones: &[i32; LANES], added: [f32; 4]) {
    let mut pixels = *sums;
    for lane in 0..LANES {
        #[expect(clippy::cast_precision_loss, reason = "0 or 1")]
        let inside = ones[lane] as f32;
        for channel in 0..4 {
            pixels[lane][channel] += added[channel] * inside;
        }
    }
    *sums = pixels;
}

/// Adds the same to every pixel.
#[inline(always)]
#[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
fn add_same(cover: &Cover<'_, '_>, added: [f32; 4], sums: &mut [Group<[f32; 4]>]) {
    if !cover.is_small() {
        return add_constant(cover.blocks, added, sums);
    }
    for &pixel in cover.places {
        let sum = at_mut(sums, pixel as usize);
        for channel in 0..4 {
            sum[channel] += added[channel];
        }
    }
}

/// The same for many pixels.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"))]
fn add_constant(blocks: &[Block], added: [f32; 4], sums: &mut [Group<[f32; 4]>]) {
    let added = finite(added);
    for &block in blocks {
        add_block(&mut sums[block.index()].0, &block.ones(), added);
    }
}

/// Adds the weights times one colour.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"))]
fn add_flat(blocks: &[Block], weights: &[f32], color: Premultiplied, sums: &mut [Group<[f32; 4]>]) {
    let mut next = 0;
    for &block in blocks {
        let mut of_block = [0.0; LANES];
        if block.mask == !0 {
            of_block.copy_from_slice(&weights[next..next + LANES]);
            next += LANES;
        } else {
            for (lane, one) in block.ones().into_iter().enumerate() {
                if one == 1 {
                    of_block[lane] = weights[next];
                    next += 1;
                }
            }
        }
        let mut pixels = sums[block.index()].0;
        for lane in 0..LANES {
            for channel in 0..4 {
                pixels[lane][channel] += of_block[lane] * color[channel];
            }
        }
        sums[block.index()].0 = pixels;
    }
}

/// The same for few pixels.
#[inline(always)]
#[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
fn add_few(pixels: &[u32], weights: &[f32], color: Premultiplied, sums: &mut [Group<[f32; 4]>]) {
    for (&pixel, weight) in pixels.iter().zip(weights) {
        let sum = at_mut(sums, pixel as usize);
        for lane in 0..4 {
            sum[lane] += weight * color[lane];
        }
    }
}

/// Adds the weights times the colours.
fn add_shaded(runs: &[Run], weights: &[f32], colors: &[Premultiplied], sums: &mut [Group<[f32; 4]>]) {
    for ((i, weight), color) in runs.iter().flat_map(|run| run.pixels()).zip(weights).zip(colors) {
        for (sum, channel) in at_mut(sums, i).iter_mut().zip(color) {
            *sum += weight * channel;
        }
    }
}
