//! Power moments: the mean values of d, d², ..., dᵐ for m = 4, 6 or 8.

use super::linear::{Ldl, MAX_SIZE};
use super::polynomial::{MAX_DEGREE, interpolate, real_roots, shifted};
use super::roots::{BLOCK, in_whole_blocks, real_roots_of_monic};
use super::{Basis, MAX_STORED, Regularization, Width};
use multiversion::multiversion;

/// Moments that single precision ones are biased towards (M18's fp32 table). Odd ones are 0.
const SPREAD: [[f64; MAX_STORED]; 3] = [
    [0.0, 0.375, 0.0, 0.375, 0.0, 0.0, 0.0, 0.0],
    [0.0, 0.48, 0.0, 0.451, 0.0, 0.45, 0.0, 0.0],
    [0.0, 0.75, 0.0, 0.676_667, 0.0, 0.63, 0.0, 0.600_303],
];

/// The same for numbers of 16 bits (M18).
const SPREAD_HALF: [[f64; MAX_STORED]; 3] = [
    [0.0, 0.628, 0.0, 0.628, 0.0, 0.0, 0.0, 0.0],
    [0.0, 0.5566, 0.0, 0.489, 0.0, 0.478_694, 0.0, 0.0],
    [0.0, 0.424_749, 0.0, 0.224_078, 0.0, 0.153_692, 0.0, 0.129_004],
];

/// Roots farther away than this, in half ranges, are left out: as the moments are at most 1, their share of
/// the absorbance is at most the inverse of this to the power of m.
const FAR: f64 = 1e4;

/// The first m powers.
#[derive(Debug, Clone, Copy)]
pub struct Powers {
    /// Half of m: the number of points of mass beside the one at d.
    points: usize,
    regularization: Regularization,
    /// The moments that are mixed in.
    spread: [f64; MAX_STORED],
}

/// A pixel's power moments with their Hankel matrix factored.
#[derive(Debug, Clone, Copy, Default)]
pub struct Hankel {
    /// Biased moments from the zeroth on.
    moments: [f64; MAX_STORED + 1],
    ldl: Option<Ldl<f64>>,
    /// How often the bias had to be raised.
    pub retries: u32,
}

impl Powers {
    /// Of m = 4, 6 or 8 moments.
    pub fn new(count: usize, regularization: Regularization) -> Self {
        assert!(matches!(count, 4 | 6 | 8), "{count} power moments");
        let points = count / 2;
        Self { points, regularization, spread: SPREAD[points - 2] }
    }

    /// The same, biased towards what M18 recommends for moments of that width.
    pub fn of_width(self, width: Width) -> Self {
        let spread = if width == Width::Half { SPREAD_HALF } else { SPREAD };
        Self { spread: spread[self.points - 2], ..self }
    }

    /// The moments that are mixed in.
    pub fn spread(&self) -> [f64; MAX_STORED] {
        self.spread
    }

    /// The bias that moments of that width ask for (M18).
    pub fn default_bias(count: usize, width: Width) -> f64 {
        match (count, width) {
            (4, Width::Single) => 5e-7,
            (6, Width::Single) => 5e-6,
            (_, Width::Single) => 5e-5,
            (4, Width::Half) => 6e-5,
            (6, Width::Half) => 6e-4,
            (_, Width::Half) => 2.5e-3,
        }
    }

    /// Moment k of the mixture with the spread out distribution.
    fn biased(&self, means: &[f64; MAX_STORED], bias: f64, k: usize) -> f64 {
        if k == 0 { 1.0 } else { (1.0 - bias) * means[k - 1] + bias * self.spread[k - 1] }
    }
}

impl Basis for Powers {
    type Moments = Hankel;

    fn stored(&self) -> usize {
        2 * self.points
    }

    fn functions(&self, d: f64) -> [f64; MAX_STORED] {
        let mut power = 1.0;
        std::array::from_fn(|k| {
            power *= d;
            if k < self.stored() { power } else { 0.0 }
        })
    }

    fn prepare(&self, means: &[f64; MAX_STORED]) -> Hankel {
        let entry = |bias, i, j| self.biased(means, bias, i + j);
        let factored = self.regularization.factor(self.points + 1, entry);
        let mut moments = [0.0; MAX_STORED + 1];
        for (k, moment) in moments.iter_mut().enumerate().take(self.stored() + 1) {
            *moment = self.biased(means, factored.bias, k);
        }
        Hankel { moments, ldl: Some(factored.ldl), retries: factored.retries }
    }

    fn retries(moments: &Hankel) -> u32 {
        moments.retries
    }

    #[expect(clippy::cast_possible_truncation, reason = "the sums are f32 targets")]
    fn add(&self, d: &[f64], s: &[f64], sums: &mut [f32; MAX_STORED]) {
        for (&d, &s) in d.iter().zip(s) {
            let mut power = 1.0;
            for sum in &mut sums[..2 * self.points] {
                power *= d;
                *sum += (s * power) as f32;
            }
        }
    }

    fn shares_in_front(&self, hankel: &Hankel, d: &[f64], overestimation: f64, shares: &mut [f64]) {
        let Some(ldl) = &hankel.ldl else { return shares.fill(0.0) };
        for (d, shares) in d.chunks(BLOCK).zip(shares.chunks_mut(BLOCK)) {
            let mut far = [0; BLOCK];
            shares_among_near_roots(self.points, hankel, ldl, d, overestimation, shares, &mut far);
            for ((share, &d), far) in shares.iter_mut().zip(d).zip(far) {
                if far != 0 {
                    *share = self.share_among_near_roots(hankel, ldl, d, overestimation);
                }
            }
        }
    }
}

/// [`Powers::share_among_near_roots`] for a block; `far` is not 0 where a root is left out, of which nothing is
/// known here.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"))]
fn shares_among_near_roots(
    points: usize,
    hankel: &Hankel,
    ldl: &Ldl<f64>,
    d: &[f64],
    overestimation: f64,
    shares: &mut [f64],
    far: &mut [u64; BLOCK],
) {
    match points {
        2 => shares_among::<2, 3>(hankel, ldl, d, overestimation, shares, far),
        3 => shares_among::<3, 4>(hankel, ldl, d, overestimation, shares, far),
        _ => shares_among::<4, 5>(hankel, ldl, d, overestimation, shares, far),
    }
}

/// With P points beside d, and N of them in all.
#[inline(always)]
#[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
fn shares_among<const P: usize, const N: usize>(
    hankel: &Hankel,
    ldl: &Ldl<f64>,
    d: &[f64],
    overestimation: f64,
    shares: &mut [f64],
    far: &mut [u64; BLOCK],
) {
    let (d, count) = in_whole_blocks(d);
    let mut column = [0.0; BLOCK];
    let (mut p, mut inverses) = ([[0.0; BLOCK]; MAX_DEGREE], [[0.0; BLOCK]; MAX_DEGREE]);
    for i in 0..count {
        let kernel = reversed_kernel::<P, N>(ldl, d[i]);
        for k in 0..P {
            p[k][i] = kernel[k] / kernel[P];
        }
    }
    real_roots_of_monic::<P>(&p, count, &mut inverses);
    for i in 0..count {
        let mut nodes = [d[i]; N];
        let mut values = [overestimation; N];
        for k in 0..P {
            let inverse = inverses[k][i];
            nodes[k + 1] = d[i] + inverse.recip();
            values[k + 1] = if inverse < 0.0 { 1.0 } else { 0.0 };
            far[i] |= u64::from(inverse.abs() * FAR < 1.0);
        }
        let p = interpolate(&nodes, &values);
        column[i] = p.iter().zip(&hankel.moments).take(N).map(|(p, b)| p * b).sum();
    }
    shares.copy_from_slice(&column[..shares.len()]);
}

impl Powers {
    /// The share in front of d, given that of all roots but those too far away.
    fn share_among_near_roots(&self, hankel: &Hankel, ldl: &Ldl<f64>, d: f64, overestimation: f64) -> f64 {
        let mut nodes = [d; MAX_SIZE];
        let mut values = [overestimation; MAX_SIZE];
        let mut count = 1;
        for inverse in self.inverse_distances(ldl, d) {
            if inverse.abs() * FAR >= 1.0 {
                nodes[count] = d + inverse.recip();
                values[count] = if inverse < 0.0 { 1.0 } else { 0.0 };
                count += 1;
            }
        }
        let p = interpolate(&nodes[..count], &values[..count]);
        p.iter().zip(&hankel.moments).map(|(p, b)| p * b).sum()
    }

    /// 1/(x − d) for each other point x of the canonical distribution. The points are the zeros of the kernel
    /// polynomial K(d, x), whose value at d is positive: in 1/(x − d) it has that for a leading coefficient,
    /// and a point at infinity, where its degree is less, is at 0.
    fn inverse_distances(&self, ldl: &Ldl<f64>, d: f64) -> impl Iterator<Item = f64> + use<> {
        let kernel = match self.points {
            2 => reversed_kernel::<2, 3>(ldl, d),
            3 => reversed_kernel::<3, 4>(ldl, d),
            _ => reversed_kernel::<4, 5>(ldl, d),
        };
        real_roots(&kernel[..=self.points]).into_iter().take(self.points)
    }
}

/// K(d, x) in 1/(x − d), ascending.
#[inline(always)]
#[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
fn reversed_kernel<const P: usize, const N: usize>(ldl: &Ldl<f64>, d: f64) -> [f64; MAX_SIZE] {
    let mut powers = [1.0; MAX_SIZE];
    for k in 1..MAX_SIZE {
        powers[k] = d * powers[k - 1];
    }
    let mut kernel = shifted(&ldl.solve_of::<N>(powers)[..=P], d);
    kernel[..=P].reverse();
    kernel
}
