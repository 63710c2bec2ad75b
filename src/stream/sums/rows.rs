//! Many primitives, each the same everywhere, blended into one row of a tile: the sums of sixteen neighbouring pixels
//! stay in registers while all primitives pass.
//!
//! Pixels next to a primitive are multiplied by one and get zero added, which changes no bit of theirs: sums begin at
//! +0, so that none is -0.

use super::kernels::Places;
use crate::continuum::sums::FAINT;
use multiversion::multiversion;

/// Pixels whose sums are in registers together.
pub const BLOCK: usize = 16;
const PIXELS: usize = BLOCK;
const WIDTH: i32 = 16;
/// Channels of so many pixels are in a register.
const CHANNELS: usize = 4;

/// Neighbouring pixels of the row in one layer: of a primitive, or of some that look the same.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Stretch {
    /// Columns in the tile; one past the last.
    pub from: i32,
    pub to: i32,
    /// Which of the layers that wait.
    pub layer: u32,
}

impl Stretch {
    /// Takes in another that looks the same and begins where this one ends, or ends where it begins; false if it is not
    /// like that.
    #[inline]
    pub fn join(&mut self, other: &Self) -> bool {
        let joins = self.layer == other.layer && (self.to == other.from || other.to == self.from);
        if joins {
            (self.from, self.to) = (self.from.min(other.from), self.to.max(other.to));
        }
        joins
    }

    #[inline]
    fn layer(&self) -> usize {
        self.layer as usize
    }
}

/// The running sums of neighbouring pixels.
struct Block {
    transmittance: [f64; PIXELS],
    counts: [u32; PIXELS],
    sums: Weighted,
}

/// Σ w (r, g, b, a) of neighbouring pixels, four after four.
struct Weighted([[f32; PIXELS]; CHANNELS]);

impl Weighted {
    const NONE: Self = Self([[0.0; PIXELS]; CHANNELS]);

    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    fn load(sums: &[[f32; CHANNELS]; PIXELS]) -> Self {
        let (flat, mut loaded) = (sums.as_flattened(), [[0.0; PIXELS]; CHANNELS]);
        for quarter in 0..CHANNELS {
            for lane in 0..PIXELS {
                loaded[quarter][lane] = flat[quarter * PIXELS + lane];
            }
        }
        Self(loaded)
    }

    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    fn store(&self, sums: &mut [[f32; CHANNELS]; PIXELS]) {
        let flat = sums.as_flattened_mut();
        for quarter in 0..CHANNELS {
            for lane in 0..PIXELS {
                flat[quarter * PIXELS + lane] = self.0[quarter][lane];
            }
        }
    }

    /// Adds the same to all pixels.
    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    fn add_to_all(&mut self, added: [f32; CHANNELS]) {
        let mut lanes = [0.0; PIXELS];
        for (lane, channel) in lanes.iter_mut().enumerate() {
            *channel = added[lane % CHANNELS];
        }
        for sums in &mut self.0 {
            for (sum, channel) in sums.iter_mut().zip(lanes) {
                *sum += channel;
            }
        }
    }

    /// Adds the same to some.
    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    fn add(&mut self, pixels: Lanes, added: [f32; CHANNELS]) {
        for quarter in 0..CHANNELS {
            for lane in 0..PIXELS {
                let channel = if pixels.has((quarter * PIXELS + lane) / CHANNELS) {
                    added[lane % CHANNELS]
                } else {
                    0.0
                };
                self.0[quarter][lane] += channel;
            }
        }
    }
}

/// Some neighbouring pixels of a block.
#[derive(Clone, Copy)]
struct Lanes {
    first: i32,
    len: u32,
}

impl Lanes {
    /// Those of `first..end` that the block has.
    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    fn new(first: i32, end: i32) -> Self {
        let (first, end) = (first.max(0), end.min(WIDTH));
        Self { first, len: (end - first).cast_unsigned() }
    }

    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    #[expect(clippy::cast_possible_truncation, clippy::cast_possible_wrap, reason = "a lane")]
    fn has(self, lane: usize) -> bool {
        (lane as i32 - self.first).cast_unsigned() < self.len
    }
}

impl Block {
    /// No fragments.
    const NONE: Self = Self { transmittance: [1.0; PIXELS], counts: [0; PIXELS], sums: Weighted::NONE };

    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    fn add_to_all(&mut self, left: f64, added: [f32; CHANNELS]) {
        for lane in 0..PIXELS {
            self.transmittance[lane] *= left;
        }
        for lane in 0..PIXELS {
            self.counts[lane] += 1;
        }
        self.sums.add_to_all(added);
    }

    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    fn add(&mut self, pixels: Lanes, left: f64, added: [f32; CHANNELS]) {
        for lane in 0..PIXELS {
            self.transmittance[lane] *= if pixels.has(lane) { left } else { 1.0 };
        }
        for lane in 0..PIXELS {
            self.counts[lane] += u32::from(pixels.has(lane));
        }
        self.sums.add(pixels, added);
    }
}

/// Hands out the stretches that have pixels in the block that begins at column `x`: whole ones, and others.
#[inline(always)]
#[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
fn pass<B>(
    stretches: &[Stretch],
    x: i32,
    block: &mut B,
    all: impl Fn(&mut B, &Stretch),
    some: impl Fn(&mut B, &Stretch, Lanes),
) {
    for stretch in stretches {
        let (from, to) = (stretch.from - x, stretch.to - x);
        if from <= 0 && to >= WIDTH {
            all(block, stretch);
        } else if from < WIDTH && to > 0 {
            some(block, stretch, Lanes::new(from, to));
        }
    }
}

/// Attenuates the background to `left[layer]`, counts the fragments, and adds `added[layer]` to the sums, or to none in a fresh row.
/// Columns that fill no block of their own are worked on as a block that has others, too.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"))]
pub fn blend_row(
    stretches: &[Stretch],
    left: &[f64],
    added: &[[f32; CHANNELS]],
    row: Places<'_>,
    fresh: bool,
) {
    // of one length, for one check of both
    let left = &left[..added.len()];
    let blend = |x, transmittance: &mut [f64; PIXELS], counts: &mut [u32; PIXELS], sums: &mut _| {
        let mut block = if fresh {
            Block::NONE
        } else {
            Block { transmittance: *transmittance, counts: *counts, sums: Weighted::load(sums) }
        };
        pass(
            stretches,
            x,
            &mut block,
            |block, stretch| block.add_to_all(left[stretch.layer()], added[stretch.layer()]),
            |block, stretch, pixels| block.add(pixels, left[stretch.layer()], added[stretch.layer()]),
        );
        (*transmittance, *counts) = (block.transmittance, block.counts);
        block.sums.store(sums);
    };
    let (transmittance, transmittance_rest) = row.transmittance.as_chunks_mut();
    let (counts, counts_rest) = row.counts.as_chunks_mut();
    let (sums, sums_rest) = row.sums.as_chunks_mut();
    let mut x = 0;
    for ((transmittance, counts), sums) in transmittance.iter_mut().zip(counts).zip(sums) {
        blend(x, transmittance, counts, sums);
        x += WIDTH;
    }
    let rest = sums_rest.len();
    if rest > 0 {
        let (mut transmittance, mut counts, mut sums) =
            ([1.0; PIXELS], [0; PIXELS], [[0.0; CHANNELS]; PIXELS]);
        transmittance[..rest].copy_from_slice(transmittance_rest);
        counts[..rest].copy_from_slice(counts_rest);
        sums[..rest].copy_from_slice(sums_rest);
        blend(x, &mut transmittance, &mut counts, &mut sums);
        transmittance_rest.copy_from_slice(&transmittance[..rest]);
        counts_rest.copy_from_slice(&counts[..rest]);
        sums_rest.copy_from_slice(&sums[..rest]);
    }
}

/// Adds `added[layer]` to the sums of another weight, or to none in a fresh row.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"))]
pub fn add_row(stretches: &[Stretch], added: &[[f32; CHANNELS]], sums: &mut [[f32; CHANNELS]], fresh: bool) {
    let blend = |x, sums: &mut _| {
        let mut block = if fresh { Weighted::NONE } else { Weighted::load(sums) };
        pass(
            stretches,
            x,
            &mut block,
            |block, stretch| block.add_to_all(added[stretch.layer()]),
            |block, stretch, pixels| block.add(pixels, added[stretch.layer()]),
        );
        block.store(sums);
    };
    let (sums, sums_rest) = sums.as_chunks_mut();
    let mut x = 0;
    for sums in sums {
        blend(x, sums);
        x += WIDTH;
    }
    let rest = sums_rest.len();
    if rest > 0 {
        let mut sums = [[0.0; CHANNELS]; PIXELS];
        sums[..rest].copy_from_slice(sums_rest);
        blend(x, &mut sums);
        sums_rest.copy_from_slice(&sums[..rest]);
    }
}

/// Adds to 1 - R what faint primitives cover, given the alpha of each layer.
#[expect(clippy::cast_sign_loss, reason = "columns of the tile")]
pub fn cover_row(stretches: &[Stretch], alpha: &[f32], coverage: &mut [f64]) {
    for stretch in stretches {
        let covers = f64::from(alpha[stretch.layer()]);
        if covers <= FAINT {
            let covered = &mut coverage[stretch.from as usize..stretch.to as usize];
            covered.iter_mut().for_each(|c| *c += (1.0 - *c) * covers);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::hash32;

    /// Stretches of a row of so many columns: some that are whole, some that begin or end inside of blocks.
    fn stretches(columns: i32, count: u32) -> Vec<Stretch> {
        let column = |i, k| {
            (hash32(i, k, columns.cast_unsigned(), 0, 0) % (columns.cast_unsigned() + 1)).cast_signed()
        };
        let stretch = |layer| {
            let (a, b) = if layer % 3 == 0 { (0, columns) } else { (column(layer, 0), column(layer, 1)) };
            Stretch { from: a.min(b), to: a.max(b), layer }
        };
        (0..count).map(stretch).collect()
    }

    #[test]
    fn neighbours_of_one_layer_join() {
        let stretch = |from, to, layer| Stretch { from, to, layer };
        let joined = |other: Stretch| {
            let mut first = stretch(10, 20, 3);
            first.join(&other).then_some((first.from, first.to))
        };
        assert_eq!(joined(stretch(20, 25, 3)), Some((10, 25)));
        assert_eq!(joined(stretch(4, 10, 3)), Some((4, 20)));
        assert_eq!(joined(stretch(20, 25, 2)), None, "another layer");
        assert_eq!(joined(stretch(21, 25, 3)), None, "a gap");
        assert_eq!(joined(stretch(19, 25, 3)), None, "covers a pixel twice");
    }

    #[test]
    fn rows_have_the_bits_of_single_pixels() {
        for columns in [1, 15, 16, 17, 40, 64, 75] {
            let pixels = usize::try_from(columns).unwrap();
            let stretches = stretches(columns, 30);
            let alpha: Vec<f32> =
                (0..30_u8).map(|i| if i % 4 == 0 { 1e-5 } else { f32::from(i) / 31.0 }).collect();
            let left: Vec<_> = alpha.iter().map(|&a| 1.0 - f64::from(a)).collect();
            let added: Vec<_> = alpha.iter().map(|a| [a * 0.3, a * 1e-3, a * 1e6, *a]).collect();
            // what a fresh row held before is not looked at
            let (mut transmittance, mut counts) = (vec![7.0; pixels], vec![7; pixels]);
            let (mut sums, mut coverage) = (vec![[7.0; 4]; pixels], vec![0.0; pixels]);
            let (mut others, mut expected_coverage) = (sums.clone(), coverage.clone());
            for (part, fresh) in [(&stretches[..20], true), (&stretches[20..], false)] {
                let places =
                    Places { transmittance: &mut transmittance, counts: &mut counts, sums: &mut sums };
                blend_row(part, &left, &added, places, fresh);
                add_row(part, &added, &mut others, fresh);
                cover_row(part, &alpha, &mut coverage);
            }
            for x in 0..pixels {
                let (mut t, mut n, mut sum) = (1.0, 0, [0.0; 4]);
                let column = i32::try_from(x).unwrap();
                for stretch in stretches.iter().filter(|s| (s.from..s.to).contains(&column)) {
                    let layer = stretch.layer();
                    t *= left[layer];
                    n += 1;
                    sum = std::array::from_fn(|channel| sum[channel] + added[layer][channel]);
                    if alpha[layer] < 1e-4 {
                        expected_coverage[x] += (1.0 - expected_coverage[x]) * f64::from(alpha[layer]);
                    }
                }
                assert_eq!((transmittance[x], counts[x], sums[x]), (t, n, sum), "{columns} {x}");
                assert_eq!((others[x], coverage[x]), (sum, expected_coverage[x]), "{columns} {x}");
            }
        }
    }
}
