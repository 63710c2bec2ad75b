//! Compositing one layer after the other while rasterising: `over` front to back, and the blend unit's.
//!
//! The arithmetic per pixel is that of the techniques on lists, operation by operation, so that a scene and its
//! capture agree to the bit.

use super::{Stopwatch, flat_color, reset, shade};
use crate::raster::{Cover, Opaque, Premultiplied, Rect, Run, Sink};
use crate::technique::FinishedPixels;
use multiversion::multiversion;

/// `over` of a tile whose primitives come front to back.
#[derive(Default)]
pub struct TileOver {
    /// Red, green, blue, and the transmittance in front of what is to come.
    planes: [Vec<f64>; 4],
    counts: Vec<u32>,
    colors: Vec<Premultiplied>,
    skip: bool,
    /// Whether nothing behind can be seen in any pixel.
    covered: bool,
    /// Fragments that came after that.
    hidden: u64,
    stopwatch: Stopwatch,
}

impl TileOver {
    /// Clears the pixels of `rect`; `skip` says whether to leave out what nobody can see.
    pub fn begin(&mut self, rect: Rect, skip: bool) {
        self.skip = skip;
        (self.covered, self.hidden) = (false, 0);
        let [r, g, b, transmittance] = &mut self.planes;
        [r, g, b].into_iter().for_each(|plane| reset(plane, rect.area(), 0.0));
        reset(transmittance, rect.area(), 1.0);
        reset(&mut self.counts, rect.area(), 0);
    }

    /// Fragments per pixel.
    pub fn counts(&self) -> &[u32] {
        &self.counts
    }

    /// How long it took while rasterising, since the last look.
    pub fn nanos(&mut self) -> u64 {
        self.stopwatch.take()
    }

    /// Pixels `first..last` over their backgrounds.
    pub fn finish(&self, pixels: std::ops::Range<usize>, background: &Opaque, out: &mut FinishedPixels) {
        out.resize(pixels.len());
        let [r, g, b, transmittance] = &self.planes;
        let layers = [&r[pixels.clone()], &g[pixels.clone()], &b[pixels.clone()]];
        put_over(layers, &transmittance[pixels.clone()], &background.colors()[pixels], out.planes_mut());
    }
}

impl<'r> Sink<'r> for TileOver {
    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    fn take(&mut self, cover: &Cover<'_, 'r>) -> bool {
        let start = self.stopwatch.start();
        self.put_behind(cover);
        self.stopwatch.stop(start);
        true
    }
}

impl TileOver {
    /// Fragments that nobody can see and that were left out.
    pub fn hidden(&self) -> u64 {
        self.hidden
    }

    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    fn put_behind(&mut self, cover: &Cover<'_, '_>) {
        if self.covered {
            count(cover.runs, &mut self.counts);
            self.hidden += cover.pixels as u64;
            return;
        }
        if let (Some(color), false) = (flat_color(cover), cover.is_small()) {
            over_flat(cover.runs, color, &mut self.planes, &mut self.counts);
            self.covered = self.skip && color[3] == 1.0 && self.nothing_shows();
            return;
        }
        count(cover.runs, &mut self.counts);
        shade(cover, &mut self.colors);
        let [planes @ .., transmittance] = &mut self.planes;
        for (i, color) in cover.runs.iter().flat_map(|run| run.pixels()).zip(&self.colors) {
            let t = &mut transmittance[i];
            for (plane, &channel) in planes.iter_mut().zip(color) {
                plane[i] += *t * f64::from(channel);
            }
            *t *= 1.0 - f64::from(color[3]);
        }
    }

    /// Whether every pixel is covered.
    fn nothing_shows(&self) -> bool {
        self.planes[3].iter().all(|t| *t == 0.0)
    }
}

/// Layers over the background.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"))]
fn put_over(
    [r, g, b]: [&[f64]; 3],
    transmittance: &[f64],
    background: &[[f32; 3]],
    [to_r, to_g, to_b, share]: [&mut [f64]; 4],
) {
    // slices of one length need no checks, and the loop becomes one of vectors across the pixels
    let pixels = background.len();
    let (r, g, b, transmittance) = (&r[..pixels], &g[..pixels], &b[..pixels], &transmittance[..pixels]);
    let (to_r, to_g, to_b) = (&mut to_r[..pixels], &mut to_g[..pixels], &mut to_b[..pixels]);
    for i in 0..pixels {
        let (behind, t) = (background[i], transmittance[i]);
        to_r[i] = r[i] + t * f64::from(behind[0]);
        to_g[i] = g[i] + t * f64::from(behind[1]);
        to_b[i] = b[i] + t * f64::from(behind[2]);
    }
    share.copy_from_slice(transmittance);
}

fn count(runs: &[Run], counts: &mut [u32]) {
    for pixel in runs.iter().flat_map(|run| run.pixels()) {
        counts[pixel] += 1;
    }
}

#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"))]
fn over_flat(runs: &[Run], color: Premultiplied, planes: &mut [Vec<f64>; 4], counts: &mut [u32]) {
    let color = [f64::from(color[0]), f64::from(color[1]), f64::from(color[2]), f64::from(color[3])];
    let left = 1.0 - color[3];
    let [r, g, b, transmittance] = planes;
    for run in runs {
        let transmittance = &mut transmittance[run.pixels()];
        add(&mut r[run.pixels()], transmittance, color[0]);
        add(&mut g[run.pixels()], transmittance, color[1]);
        add(&mut b[run.pixels()], transmittance, color[2]);
        transmittance.iter_mut().for_each(|t| *t *= left);
        counts[run.pixels()].iter_mut().for_each(|n| *n += 1);
    }
}

#[inline(always)]
#[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
fn add(plane: &mut [f64], share: &[f64], channel: f64) {
    for (sum, share) in plane.iter_mut().zip(share) {
        *sum += share * channel;
    }
}

/// Alpha compositing of a tile, in the order in which its primitives come.
#[derive(Default)]
pub struct TileBlend {
    /// Red, green and blue; the fourth is for the alignment.
    target: Vec<[f32; 4]>,
    transmittance: Vec<f64>,
    counts: Vec<u32>,
    colors: Vec<Premultiplied>,
    stopwatch: Stopwatch,
}

impl TileBlend {
    /// Clears the pixels of `rect`.
    pub fn begin(&mut self, rect: Rect) {
        reset(&mut self.target, rect.area(), [0.0; 4]);
        reset(&mut self.transmittance, rect.area(), 1.0);
        reset(&mut self.counts, rect.area(), 0);
    }

    /// Fragments per pixel.
    pub fn counts(&self) -> &[u32] {
        &self.counts
    }

    /// How long it took while rasterising, since the last look.
    pub fn nanos(&mut self) -> u64 {
        self.stopwatch.take()
    }

    /// Pixels `first..last` over their backgrounds.
    pub fn finish(&self, pixels: std::ops::Range<usize>, background: &Opaque, out: &mut FinishedPixels) {
        out.resize(pixels.len());
        let (target, transmittance) = (&self.target[pixels.clone()], &self.transmittance[pixels.clone()]);
        blend_over(target, transmittance, &background.colors()[pixels], out.planes_mut());
    }
}

impl<'r> Sink<'r> for TileBlend {
    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    fn take(&mut self, cover: &Cover<'_, 'r>) -> bool {
        let start = self.stopwatch.start();
        self.blend_in(cover);
        self.stopwatch.stop(start);
        true
    }
}

impl TileBlend {
    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    fn blend_in(&mut self, cover: &Cover<'_, '_>) {
        if let (Some(color), false) = (flat_color(cover), cover.is_small()) {
            let Self { target, transmittance, counts, .. } = self;
            return blend_flat(cover.runs, color, target, transmittance, counts);
        }
        count(cover.runs, &mut self.counts);
        shade(cover, &mut self.colors);
        for (i, &[r, g, b, alpha]) in cover.runs.iter().flat_map(|run| run.pixels()).zip(&self.colors) {
            self.target[i] = blended(self.target[i], [r, g, b, 0.0], 1.0 - alpha);
            self.transmittance[i] *= 1.0 - f64::from(alpha);
        }
    }
}

/// What overflows counts as the largest number, so that it can still be hidden.
#[inline(always)]
#[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
fn blended(target: [f32; 4], color: [f32; 4], left: f32) -> [f32; 4] {
    let mut blended = [0.0; 4];
    for channel in 0..4 {
        let sum = color[channel] + left * target[channel];
        blended[channel] = if sum < f32::MAX { sum } else { f32::MAX };
    }
    blended
}

#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"))]
fn blend_flat(
    runs: &[Run],
    color: Premultiplied,
    target: &mut [[f32; 4]],
    transmittance: &mut [f64],
    counts: &mut [u32],
) {
    let [r, g, b, alpha] = color;
    let (left, left64) = (1.0 - alpha, 1.0 - f64::from(alpha));
    for run in runs {
        target[run.pixels()].iter_mut().for_each(|pixel| *pixel = blended(*pixel, [r, g, b, 0.0], left));
        transmittance[run.pixels()].iter_mut().for_each(|t| *t *= left64);
        counts[run.pixels()].iter_mut().for_each(|n| *n += 1);
    }
}

#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"))]
fn blend_over(
    target: &[[f32; 4]],
    transmittance: &[f64],
    background: &[[f32; 3]],
    [r, g, b, share]: [&mut [f64]; 4],
) {
    let pixels = background.len();
    let (target, transmittance) = (&target[..pixels], &transmittance[..pixels]);
    let (r, g, b) = (&mut r[..pixels], &mut g[..pixels], &mut b[..pixels]);
    for i in 0..pixels {
        let (layers, behind, t) = (target[i], background[i], transmittance[i]);
        r[i] = f64::from(layers[0]) + t * f64::from(behind[0]);
        g[i] = f64::from(layers[1]) + t * f64::from(behind[1]);
        b[i] = f64::from(layers[2]) + t * f64::from(behind[2]);
    }
    share.copy_from_slice(transmittance);
}
