//! What is done with the sums of many pixels at a time: plain loops over the pixels of a run, which a compiler makes
//! vectors of, wherever the run begins and ends.

use crate::raster::{Premultiplied, Run, Where};
use multiversion::multiversion;

/// The running sums of some pixels.
pub struct Places<'a> {
    pub transmittance: &'a mut [f64],
    pub counts: &'a mut [u32],
    pub sums: &'a mut [[f32; 4]],
}

/// Attenuates the background, counts the fragments, and adds the weights times one colour, in one go.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"))]
pub fn blend_flat(
    runs: &[Run],
    mut weights: &[f32],
    color: Premultiplied,
    transmittance: &mut [f64],
    counts: &mut [u32],
    sums: &mut [[f32; 4]],
) {
    let left = 1.0 - f64::from(color[3]);
    for run in runs {
        let (now, later) = weights.split_at(run.len as usize);
        weights = later;
        let background = transmittance[run.pixels()].iter_mut().zip(&mut counts[run.pixels()]);
        for ((sum, (t, n)), weight) in sums[run.pixels()].iter_mut().zip(background).zip(now) {
            *t *= left;
            *n += 1;
            let mut added = *sum;
            for channel in 0..4 {
                added[channel] += weight * color[channel];
            }
            *sum = added;
        }
    }
}

/// The same for few pixels.
#[inline(always)]
#[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
pub fn blend_few(pixels: &[u32], weights: &[f32], color: Premultiplied, places: Places<'_>) {
    let Places { transmittance, counts, sums } = places;
    let left = 1.0 - f64::from(color[3]);
    for (&pixel, weight) in pixels.iter().zip(weights) {
        let pixel = pixel as usize;
        transmittance[pixel] *= left;
        counts[pixel] += 1;
        let mut sum = sums[pixel];
        for channel in 0..4 {
            sum[channel] += weight * color[channel];
        }
        sums[pixel] = sum;
    }
}

/// Attenuates the background and counts the fragments.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"))]
pub fn attenuate(runs: &[Run], alpha: f64, transmittance: &mut [f64], counts: &mut [u32]) {
    let left = 1.0 - alpha;
    for run in runs {
        transmittance[run.pixels()].iter_mut().for_each(|t| *t *= left);
        counts[run.pixels()].iter_mut().for_each(|n| *n += 1);
    }
}

/// Adds to 1 - R what a faint primitive covers.
pub fn cover_faintly(at: Where<'_>, alpha: f64, coverage: &mut [f64]) {
    at.for_each(|_, i| coverage[i] += (1.0 - coverage[i]) * alpha);
}

/// Adds the same to every pixel.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"))]
pub fn add_constant(runs: &[Run], added: [f32; 4], sums: &mut [[f32; 4]]) {
    for run in runs {
        for sum in &mut sums[run.pixels()] {
            for channel in 0..4 {
                sum[channel] += added[channel];
            }
        }
    }
}

/// The same for few pixels.
pub fn add_constant_to_few(pixels: &[u32], added: [f32; 4], sums: &mut [[f32; 4]]) {
    for &pixel in pixels {
        let sum = &mut sums[pixel as usize];
        *sum = std::array::from_fn(|channel| sum[channel] + added[channel]);
    }
}

/// Adds the weights times one colour.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"))]
pub fn add_flat(runs: &[Run], mut weights: &[f32], color: Premultiplied, sums: &mut [[f32; 4]]) {
    for run in runs {
        let (now, later) = weights.split_at(run.len as usize);
        weights = later;
        for (sum, weight) in sums[run.pixels()].iter_mut().zip(now) {
            for channel in 0..4 {
                sum[channel] += weight * color[channel];
            }
        }
    }
}

/// The same for few pixels.
#[inline(always)]
#[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
pub fn add_few(pixels: &[u32], weights: &[f32], color: Premultiplied, sums: &mut [[f32; 4]]) {
    for (&pixel, weight) in pixels.iter().zip(weights) {
        let sum = &mut sums[pixel as usize];
        for channel in 0..4 {
            sum[channel] += weight * color[channel];
        }
    }
}

/// Adds a weight times a colour to one pixel.
#[inline]
pub fn add_weighted(weight: f32, color: Premultiplied, sum: &mut [f32; 4]) {
    for (sum, channel) in sum.iter_mut().zip(color) {
        *sum += weight * channel;
    }
}
