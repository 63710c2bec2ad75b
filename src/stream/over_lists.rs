//! Compositing of sorted lists, eight pixels at a time.

use crate::raster::{LANES, NOTHING, TileLists};
use crate::technique::FinishedPixels;
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
    out: &mut FinishedPixels,
) -> u64 {
    out.resize(pixels.len());
    over_groups(lists, pixels.start, &background[pixels], skip && lists.any_covers(), out.planes_mut())
}

#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"))]
fn over_groups(
    lists: &TileLists<'_>,
    first: usize,
    background: &[[f32; 3]],
    skip: bool,
    [r, g, b, share]: [&mut [f64]; 4],
) -> u64 {
    let mut hidden = 0;
    let colors = r.chunks_mut(LANES).zip(g.chunks_mut(LANES)).zip(b.chunks_mut(LANES));
    let pixels = background.chunks(LANES).zip(colors.zip(share.chunks_mut(LANES)));
    for (group, (background, (((r, g), b), share))) in (first / LANES..).zip(pixels) {
        let (mut sums, mut transmittance) = ([[0.0; LANES]; 3], [1.0; LANES]);
        let rows = lists.rows_of(group);
        for (i, row) in rows.iter().enumerate() {
            let [red, green, blue, alpha] = lists.colors_of(row, group * LANES);
            add(&mut sums[0], &transmittance, &red);
            add(&mut sums[1], &transmittance, &green);
            add(&mut sums[2], &transmittance, &blue);
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
        for (lane, background) in background.iter().enumerate() {
            let behind = background.map(|channel| transmittance[lane] * f64::from(channel));
            r[lane] = sums[0][lane] + behind[0];
            g[lane] = sums[1][lane] + behind[1];
            b[lane] = sums[2][lane] + behind[2];
        }
        share.copy_from_slice(&transmittance[..share.len()]);
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
