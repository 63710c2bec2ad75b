//! Compositing of sorted lists, eight pixels at a time.

use crate::raster::{LANES, NOTHING, Premultiplied, Row, TileLists};
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
    for (group, (((r, g), b), share)) in (first / LANES..).zip(colors.zip(share.chunks_mut(LANES))) {
        let mut over = Over::nothing();
        let rows = lists.rows_of(group);
        if skip {
            hidden += over.put_behind_until_covered(lists, group * LANES, rows);
        } else {
            rows.iter().for_each(|row| over.put_behind(&lists.colors_of(row, group * LANES)));
        }
        for lane in 0..share.len() {
            [r[lane], g[lane], b[lane], _] = over.sums[lane];
            share[lane] = over.transmittance[lane];
        }
    }
    // slices of one length need no checks, and the loop becomes one of vectors across the pixels
    let pixels = background.len();
    let (r, g, b, share) = (&mut r[..pixels], &mut g[..pixels], &mut b[..pixels], &share[..pixels]);
    for i in 0..pixels {
        let (behind, transmittance) = (background[i], share[i]);
        r[i] += transmittance * f64::from(behind[0]);
        g[i] += transmittance * f64::from(behind[1]);
        b[i] += transmittance * f64::from(behind[2]);
    }
    hidden
}

/// What has been composited of a group of pixels. A pixel's channels lie together, as colours do: pixels side by side
/// would have to be put there one by one.
struct Over {
    /// Red, green and blue; the fourth is for the alignment.
    sums: [[f64; 4]; LANES],
    transmittance: [f64; LANES],
}

impl Over {
    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    fn nothing() -> Self {
        Self { sums: [[0.0; 4]; LANES], transmittance: [1.0; LANES] }
    }

    /// One more fragment behind those of each pixel.
    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    #[expect(clippy::needless_range_loop, reason = "three arrays are walked together")]
    fn put_behind(&mut self, colors: &[Premultiplied; LANES]) {
        for lane in 0..LANES {
            let (color, transmittance) = (colors[lane], self.transmittance[lane]);
            let mut sums = self.sums[lane];
            for channel in 0..4 {
                sums[channel] += transmittance * f64::from(color[channel]);
            }
            self.sums[lane] = sums;
            self.transmittance[lane] = transmittance * (1.0 - f64::from(color[3]));
        }
    }

    /// All rows, or those up to where nothing behind can be seen; the number of fragments after that.
    fn put_behind_until_covered(&mut self, lists: &TileLists<'_>, pixel: usize, rows: &[Row]) -> u64 {
        for (i, row) in rows.iter().enumerate() {
            self.put_behind(&lists.colors_of(row, pixel));
            if self.transmittance == [0.0; LANES] {
                let left = rows[i + 1..].as_flattened();
                return left.iter().map(|&packed| u64::from(packed != NOTHING)).sum();
            }
        }
        0
    }
}
