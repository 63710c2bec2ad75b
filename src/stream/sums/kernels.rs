//! What is done with the sums of many pixels at a time: plain loops over the pixels of a run, which a compiler makes
//! vectors of, wherever the run begins and ends, or over groups of pixels that are a vector each.

use crate::raster::{LANES, Premultiplied, Run, Where};
use multiversion::multiversion;
use std::hint::black_box;

/// The running sums of some pixels.
pub struct Places<'a> {
    pub transmittance: &'a mut [f64],
    pub counts: &'a mut [u32],
    pub sums: &'a mut [[f32; 4]],
}

const CHANNELS: usize = 4;

/// Begins sums with what they are without fragments.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"))]
pub fn clear<T: Copy>(sums: &mut [T], nothing: T) {
    sums.fill(nothing);
}

/// Attenuates the background, counts the fragments, and adds the weights times one finite colour, in one go.
///
/// Runs are blended in groups of [`LANES`] that begin at multiples of it, where vectors lie in one cache line each: there is room for
/// as many numbers before the first weight and behind the last, and behind the last place. Pixels beside a run are multiplied by
/// one and get zero added, which changes no bit of theirs: sums begin at +0, so that none is -0, and zero times the colour is zero.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"))]
#[expect(clippy::cast_possible_truncation, reason = "a lane")]
pub fn blend_flat(runs: &[Run], weights: &[f32], color: Premultiplied, places: Places<'_>) {
    let Places { transmittance, counts, sums } = places;
    let left = 1.0 - f64::from(color[3]);
    let mut channels = [0.0; CHANNELS * LANES];
    for (i, channel) in channels.iter_mut().enumerate() {
        *channel = color[i % CHANNELS];
    }
    let (transmittance, counts, sums) =
        (transmittance.as_chunks_mut().0, counts.as_chunks_mut().0, sums.as_chunks_mut().0);
    // of one length, for one check per run
    let room = transmittance.len().min(counts.len()).min(sums.len());
    let (transmittance, counts, sums) = (&mut transmittance[..room], &mut counts[..room], &mut sums[..room]);
    let mut next = LANES;
    for run in runs {
        let before = run.first % LANES as u32;
        let groups = run.groups();
        let weights = weights[next - before as usize..].as_chunks().0;
        next += run.len as usize;
        // which pixel of the run each is, those before it beyond all of them
        let mut pixels = [0; LANES];
        for (lane, pixel) in pixels.iter_mut().enumerate() {
            *pixel = (lane as u32).wrapping_sub(before);
        }
        let transmittance = transmittance[groups.clone()].iter_mut();
        let (counts, sums) = (&mut counts[groups.clone()], &mut sums[groups]);
        for (((t, n), sums), weights) in transmittance.zip(counts).zip(sums).zip(weights) {
            let mut inside = [0; LANES];
            for (inside, pixel) in inside.iter_mut().zip(pixels) {
                *inside = if pixel < run.len { u32::MAX } else { 0 };
            }
            blend_group(&inside, weights, left, &channels, t, n, sums);
            for pixel in &mut pixels {
                *pixel = pixel.wrapping_add(LANES as u32);
            }
            // or a compiler makes vectors across groups, and of each group scalars
            black_box(());
        }
    }
}

/// The same for one group, whose pixels are in the run where all bits of `inside` are set.
#[inline(always)]
#[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
fn blend_group(
    inside: &[u32; LANES],
    weights: &[f32; LANES],
    left: f64,
    channels: &[f32; CHANNELS * LANES],
    transmittance: &mut [f64; LANES],
    counts: &mut [u32; LANES],
    sums: &mut [[f32; CHANNELS]; LANES],
) {
    for lane in 0..LANES {
        transmittance[lane] *= if inside[lane] != 0 { left } else { 1.0 };
    }
    for lane in 0..LANES {
        counts[lane] = counts[lane].wrapping_sub(inside[lane]);
    }
    let mut kept = [0.0; LANES];
    for lane in 0..LANES {
        kept[lane] = f32::from_bits(weights[lane].to_bits() & inside[lane]);
    }
    let mut of_channels = [0.0; CHANNELS * LANES];
    for (i, weight) in of_channels.iter_mut().enumerate() {
        *weight = kept[i / CHANNELS];
    }
    for (i, sum) in sums.as_flattened_mut().iter_mut().enumerate() {
        *sum += of_channels[i] * channels[i];
    }
}

/// The same for few pixels.
#[inline(always)]
#[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
pub fn blend_few(pixels: &[u32], weights: &[f32], color: Premultiplied, places: Places<'_>) {
    let Places { transmittance, counts, sums } = places;
    // of one length, for one check per pixel
    let room = transmittance.len().min(counts.len()).min(sums.len());
    let (transmittance, counts, sums) = (&mut transmittance[..room], &mut counts[..room], &mut sums[..room]);
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::hash32;

    #[test]
    fn groups_have_the_bits_of_single_pixels_and_leave_those_beside_alone() {
        for columns in [1_u32, 7, 8, 9, 64, 75] {
            let rows = 9;
            let places = (columns * rows) as usize;
            let run = |y: u32| {
                let (a, b) = (hash32(y, columns, 1, 0, 0) % columns, hash32(y, columns, 2, 0, 0) % columns);
                let (from, len) = (a.min(b), a.abs_diff(b) + 1);
                Run { x: from.cast_signed(), y: y.cast_signed(), first: y * columns + from, len }
            };
            // some rows are left out
            let runs: Vec<_> = (0..rows).filter(|y| y % 4 != 2).map(run).collect();
            let pixels: Vec<_> = runs.iter().flat_map(|run| run.pixels()).collect();
            let mut weights = vec![f32::NAN; LANES];
            weights.extend((0..=u16::MAX).take(pixels.len()).map(|n| f32::from(n.wrapping_mul(771)) * 1e-3));
            weights.extend([f32::INFINITY; LANES]);
            let color = [0.3, 1e-3, 7.0, 0.4];
            let (mut transmittance, mut counts) = (vec![0.7; places + LANES], vec![3; places + LANES]);
            let mut sums = vec![[0.1, 0.0, 2.5, 0.2]; places + LANES];
            let (mut expected_t, mut expected_n, mut expected) =
                (transmittance.clone(), counts.clone(), sums.clone());
            for (n, &i) in pixels.iter().enumerate() {
                expected_t[i] *= 1.0 - f64::from(color[3]);
                expected_n[i] += 1;
                add_weighted(weights[LANES + n], color, &mut expected[i]);
            }
            let all = Places { transmittance: &mut transmittance, counts: &mut counts, sums: &mut sums };
            blend_flat(&runs, &weights, color, all);
            assert_eq!((transmittance, counts, sums), (expected_t, expected_n, expected), "{columns}");
        }
    }
}
