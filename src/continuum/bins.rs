//! Depth bins, each a blended layer of its own.

use super::functions::exp;
use super::normalize::Core;
use super::oracle::CHUNK;
use super::sums::BlendSums;
use crate::error::Result;
use crate::own::OwnFunction;
use crate::params::{Params, Reports};
use multiversion::multiversion;
use std::f64::consts::LN_2;

/// Bins that one pass of layered rendering fills (FEE21 §4: 32 geometry shader instances).
pub const BATCH: usize = 32;

/// How a fragment fades with its distance from the centre of a bin.
#[derive(Debug, Clone)]
pub enum BinFunction {
    /// `2^-(2x)²`: 1 at the centre, 1/2 at the edge (FEE21 §3.2, sheet R1).
    Bell,
    /// `max(0, 1 − |x|)`.
    Tent,
    /// Somebody's own.
    Own(OwnBins),
}

/// A bin function of somebody's own: a share for the distance x from a bin's centre in bin widths.
#[derive(Debug, Clone)]
pub struct OwnBins {
    function: OwnFunction,
    /// Whether shares fade coverage, so that more than all of it makes no sense.
    fades: bool,
    reports: Reports,
}

impl OwnBins {
    /// The function that the param `bin_function` is set to.
    ///
    /// # Errors
    /// `Error::Param` with what is wrong with its text.
    pub fn from_params(params: &Params, fades: bool) -> Result<Self> {
        let function = OwnFunction::from_params(params.setting("bin_function"), "bin_function", params)?;
        Ok(Self { function, fades, reports: params.reports().clone() })
    }

    /// The shares of all bins in reach. What is negative or not finite counts as nothing, and its fragment is reported; so
    /// is one that has no share in any bin, since it is lost.
    #[expect(clippy::cast_possible_truncation, reason = "shares are evaluated in f32")]
    #[expect(clippy::cast_precision_loss, reason = "a few bins")]
    fn share_out(&self, xs: &[f64], shares: &mut Shares) {
        let (mut is_invalid, mut is_lost) = ([false; CHUNK], [true; CHUNK]);
        for (j, shares) in shares.iter_mut().enumerate() {
            let mut distance = [0.0; CHUNK];
            let to = j as f64 - REACH as f64;
            distance.iter_mut().zip(xs).for_each(|(distance, x)| *distance = (x - to) as f32);
            let shares = &mut shares[..xs.len()];
            let is_known = self.function.evaluate(&[&distance[..xs.len()]], shares);
            for ((share, is_invalid), is_lost) in shares.iter_mut().zip(&mut is_invalid).zip(&mut is_lost) {
                if !(*share >= 0.0 && *share < f32::INFINITY) {
                    *is_invalid |= is_known;
                    *share = 0.0;
                } else if self.fades {
                    *share = share.min(1.0);
                }
                *is_lost &= is_known && *share == 0.0;
            }
        }
        let reported =
            is_invalid.iter().zip(&is_lost).take(xs.len()).filter(|(invalid, lost)| **invalid || **lost);
        self.reports.add_invalid(reported.count() as u64);
    }
}

/// A smooth fragment reaches this many bins beyond its own; the bell is below 1e-7 there.
pub const REACH: usize = 2;
/// The number of bins in reach.
pub const SUPPORT: usize = 2 * REACH + 1;

/// A published function at the bins `own − REACH ..= own + REACH`, for a fragment `x` bin widths behind the centre of
/// its own, `|x| <= 1/2`.
#[inline(always)]
#[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
#[expect(clippy::cast_possible_truncation, reason = "weights are evaluated in f32")]
fn bell(x: f64) -> [f32; SUPPORT] {
    let x = x as f32;
    // 2^-4(x−j)² = 2^-4x² 2^8xj 2^-4j²: two exponentials for all five bins
    let (own, step) = (exp2(-4.0 * x * x), exp2(8.0 * x));
    let (one, two) = (own * 0.0625, own * 2.0_f32.powi(-16));
    [two / (step * step), one / step, own, one * step, two * step * step]
}

/// The same for the tent.
#[inline(always)]
#[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
#[expect(clippy::cast_possible_truncation, reason = "weights are evaluated in f32")]
fn tent(x: f64) -> [f32; SUPPORT] {
    let x = x as f32;
    [0.0, (-x).max(0.0), 1.0 - x.abs(), x.max(0.0), 0.0]
}

/// 2^x, rounded once from f64.
#[inline(always)]
#[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
#[expect(clippy::cast_possible_truncation, reason = "weights are evaluated in f32")]
fn exp2(x: f32) -> f32 {
    exp(LN_2 * f64::from(x)) as f32
}

/// The shares of a chunk of fragments, bin by bin of their reach.
pub type Shares = [[f32; CHUNK]; SUPPORT];

/// The function of each fragment, `xs` bin widths behind the centre of its own bin, at the bins in reach.
pub fn share_out(function: &BinFunction, xs: &[f64], shares: &mut Shares) {
    match function {
        BinFunction::Bell => share_bells(xs, shares),
        BinFunction::Tent => share_tents(xs, shares),
        BinFunction::Own(own) => own.share_out(xs, shares),
    }
}

#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"))]
#[expect(
    clippy::redundant_closure,
    reason = "takes on the instruction set, which a function's name does not"
)]
fn share_bells(xs: &[f64], shares: &mut Shares) {
    share_with(xs, shares, |x| bell(x));
}

#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"))]
#[expect(
    clippy::redundant_closure,
    reason = "takes on the instruction set, which a function's name does not"
)]
fn share_tents(xs: &[f64], shares: &mut Shares) {
    share_with(xs, shares, |x| tent(x));
}

/// The shares of fragment `i`.
pub fn shares_of(shares: &Shares, i: usize) -> [f32; SUPPORT] {
    std::array::from_fn(|j| shares[j][i])
}

#[inline(always)]
#[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
fn share_with(xs: &[f64], shares: &mut Shares, function: impl Fn(f64) -> [f32; SUPPORT]) {
    let [a, b, c, d, e] = shares;
    for (i, x) in xs.iter().enumerate().take(CHUNK) {
        [a[i], b[i], c[i], d[i], e[i]] = function(*x);
    }
}

/// The bins of one pixel. Only those that a fragment touched cost anything, however many there are.
#[derive(Debug, Default)]
pub struct Bins {
    /// With [`REACH`] more at either end, which nothing sees, so that no fragment reaches beyond them.
    sums: Vec<BlendSums>,
    /// One bit per bin that holds something.
    touched: Vec<u64>,
}

impl Bins {
    /// Makes room for `count` empty bins.
    pub fn reset(&mut self, count: usize) {
        let all = count + 2 * REACH;
        self.sums.resize(all, BlendSums::CLEAR);
        self.touched.resize(all.div_ceil(64) + 1, 0);
    }

    /// Bin `k`, to be blended into.
    pub fn touch(&mut self, k: usize) -> &mut BlendSums {
        let k = k + REACH;
        self.touched[k / 64] |= 1 << (k % 64);
        &mut self.sums[k]
    }

    /// Bin `own` and those in its reach, to be blended into; some may not exist.
    pub fn touch_reach(&mut self, own: usize) -> &mut [BlendSums; SUPPORT] {
        const ALL: u64 = (1 << SUPPORT) - 1;
        let (word, bit) = (own / 64, own % 64);
        self.touched[word] |= ALL << bit;
        // what is shifted out at the top of the word
        self.touched[word + 1] |= ALL >> 1 >> (63 - bit);
        let reach = self.sums[own..].first_chunk_mut();
        reach.unwrap_or_else(|| unreachable!("bins have neighbours at either end"))
    }

    /// Composites the bins front to back (FEE21 eq. 4), and empties them.
    pub fn under_blend(&mut self) -> Core {
        let mut layers = Core::CLEAR;
        let exist = REACH..self.sums.len() - REACH;
        for (word, touched) in self.touched.iter_mut().enumerate() {
            while *touched != 0 {
                let k = word * 64 + touched.trailing_zeros() as usize;
                if exist.contains(&k) {
                    layers.put_bin_behind(&self.sums[k]);
                }
                self.sums[k] = BlendSums::CLEAR;
                *touched &= *touched - 1;
            }
        }
        layers
    }
}

impl Core {
    fn put_bin_behind(&mut self, bin: &BlendSums) {
        if let Some(average) = bin.average() {
            let share = self.transmittance * bin.coverage();
            self.color += share * average;
            self.coverage += share;
        }
        self.transmittance *= bin.transmittance();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    #[test]
    fn bin_functions_are_the_papers() {
        for i in -8..=8_i8 {
            let x = f64::from(i) / 16.0;
            for (j, (bell, tent)) in (-2..).zip(bell(x).into_iter().zip(tent(x))) {
                let distance = x - f64::from(j);
                let exact = (-4.0 * distance * distance).exp2();
                assert!((f64::from(bell) / exact - 1.0).abs() < 1e-6, "{x} {j}: {bell} for {exact}");
                assert_eq!(f64::from(tent), (1.0 - distance.abs()).max(0.0));
            }
        }
    }

    /// Sheet R2: bells sum to 1.0039 at a bin's edge and 1.125 at its centre, tents to 1.
    #[test]
    fn bells_are_no_partition_of_unity() {
        let sum = |shares: [f32; SUPPORT]| shares.iter().map(|b| f64::from(*b)).sum::<f64>();
        assert!((sum(bell(0.5)) - 1.0039).abs() < 1e-4);
        assert!((sum(bell(0.0)) - 1.1250).abs() < 1e-4);
        assert_eq!(sum(tent(0.3125)), 1.0);
    }

    #[test]
    fn what_overflows_can_still_be_hidden() {
        let mut bins = Bins::default();
        bins.reset(2);
        bins.touch(0).add(1.0, [0.5; 3], 1.0);
        for _ in 0..2 {
            bins.touch(1).add(1.0, [f32::MAX; 3], 0.5);
        }
        assert_eq!(bins.under_blend().color, DVec3::splat(0.5));
    }

    #[test]
    fn bins_composite_front_to_back_and_are_empty_afterwards() {
        let mut bins = Bins::default();
        for _ in 0..2 {
            bins.reset(512);
            bins.touch(511).add(1.0, [0.5, 0.0, 0.0], 0.5);
            bins.touch(3).add(2.0, [0.0, 0.25, 0.0], 0.25);
            bins.touch(32).add(1.0, [0.0, 0.0, 7.0], 0.0);
            let layers = bins.under_blend();
            assert_eq!(layers.color, DVec3::new(0.375, 0.25, 0.0));
            assert_eq!((layers.coverage, layers.transmittance), (0.625, 0.375));
        }
    }
}
