//! Compositing of sorted lists, eight pixels at a time.

use crate::raster::{LANES, NOTHING, TileLists};
use crate::technique::Finished;
use multiversion::multiversion;
use std::ops::Range;

/// Composites sorted lists front to back in double precision (sheet 0.1), and with `skip` no further than to where
/// nothing can be seen any more. The first pixel is the first of a group. Gives the number of fragments that were
/// left out behind such places.
pub fn over_lists(
    lists: &TileLists<'_>,
    pixels: Range<usize>,
    background: &[[f32; 3]],
    skip: bool,
    out: &mut Vec<Finished>,
) -> u64 {
    out.resize(pixels.len(), [0.0; 4]);
    over_groups(lists, pixels.start, &background[pixels], skip && lists.any_covers(), out)
}

#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"))]
fn over_groups(
    lists: &TileLists<'_>,
    first: usize,
    background: &[[f32; 3]],
    skip: bool,
    out: &mut [Finished],
) -> u64 {
    let mut hidden = 0;
    let pixels = background.chunks(LANES).zip(out.chunks_mut(LANES));
    for (group, (background, out)) in (first / LANES..).zip(pixels) {
        let (mut sums, mut transmittance) = ([[0.0; LANES]; 3], [1.0; LANES]);
        let rows = lists.rows_of(group);
        for (i, row) in rows.iter().enumerate() {
            let [r, g, b, alpha] = lists.colors_of(row, group * LANES);
            add(&mut sums[0], &transmittance, &r);
            add(&mut sums[1], &transmittance, &g);
            add(&mut sums[2], &transmittance, &b);
            let mut behind = transmittance;
            for lane in 0..LANES {
                behind[lane] *= 1.0 - f64::from(alpha[lane]);
            }
            transmittance = behind;
            if skip && transmittance == [0.0; LANES] {
                let left = rows[i + 1..].as_flattened();
                hidden += left.iter().map(|&packed| u64::from(packed != NOTHING)).sum::<u64>();
                break;
            }
        }
        for (lane, (background, out)) in background.iter().zip(out).enumerate() {
            let layers = [sums[0][lane], sums[1][lane], sums[2][lane]];
            for channel in 0..3 {
                out[channel] = layers[channel] + transmittance[lane] * f64::from(background[channel]);
            }
            out[3] = transmittance[lane];
        }
    }
    hidden
}

/// `sum += transmittance * channel`
#[inline(always)]
#[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
fn add(sum: &mut [f64; LANES], transmittance: &[f64; LANES], channel: &[f32; LANES]) {
    let mut sums = *sum;
    for lane in 0..LANES {
        sums[lane] += transmittance[lane] * f64::from(channel[lane]);
    }
    *sum = sums;
}
