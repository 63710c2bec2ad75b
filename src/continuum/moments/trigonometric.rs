//! Trigonometric moments: the mean values of e^{ikφ}, k = 1..m for m = 2, 3 or 4, with depth as an angle.
#![expect(clippy::inline_always, reason = "chunks of fragments call these in loops that vectorise")]

use super::linear::{Complex, Ldl, MAX_SIZE, Scalar};
use super::polynomial::{MAX_DEGREE, interpolate};
use super::roots::{BLOCK, Column, Columns, in_whole_blocks, real_roots_of_monic};
use super::{Basis, MAX_STORED, Regularization, Width};
use crate::continuum::functions::sin_cos_of_turns;
use crate::continuum::oracle::CHUNK;
use multiversion::multiversion;
use std::f64::consts::{PI, TAU};

/// The first m harmonics.
#[derive(Debug, Clone, Copy)]
pub struct Harmonics {
    count: usize,
    /// The angle between the far end and the near one that depth leaves free. Mass found there is counted as
    /// in front of everything, the more the closer to the near end.
    wrapping_zone: f64,
    regularization: Regularization,
    /// The coefficients of iᵐ (1 + it)ʲ (1 − it)ᵐ⁻ʲ for each j.
    cayley: [[Complex; MAX_SIZE]; MAX_SIZE],
}

/// A pixel's trigonometric moments with their Toeplitz matrix factored.
#[derive(Debug, Clone, Copy, Default)]
pub struct Toeplitz {
    /// Biased moments from the zeroth on.
    moments: [Complex; MAX_SIZE],
    ldl: Option<Ldl<Complex>>,
    /// How often the bias had to be raised.
    pub retries: u32,
}

impl Harmonics {
    /// Of m = 2, 3 or 4 complex moments.
    pub fn new(count: usize, wrapping_zone: f64, regularization: Regularization) -> Self {
        assert!(matches!(count, 2..=4), "{count} trigonometric moments");
        Self { count, wrapping_zone, regularization, cayley: cayley(count) }
    }

    /// The bias that moments of that width ask for (M18).
    pub fn default_bias(count: usize, width: Width) -> f64 {
        match (count, width) {
            (2, Width::Single) => 4e-7,
            (3, Width::Single) => 8e-7,
            (_, Width::Single) => 1.5e-6,
            (2, Width::Half) => 4e-4,
            (3, Width::Half) => 6.5e-4,
            (_, Width::Half) => 8.5e-4,
        }
    }

    /// The angle of a depth, in turns.
    fn turns(&self, d: f64) -> f64 {
        (0.5 - self.wrapping_zone / (4.0 * PI)) * (d + 1.0)
    }

    /// How much of the mass in the wrapping zone counts as in front, at a place `t` of the line on which d, at
    /// `turns`, is infinitely far away.
    fn zone_counts(&self, t: f64, turns: f64) -> f64 {
        let angle = TAU * turns + PI + 2.0 * t.atan();
        ((angle - (TAU - self.wrapping_zone)) / self.wrapping_zone).clamp(0.0, 1.0)
    }
}

#[inline(always)]
fn powers(x: Complex) -> [Complex; MAX_SIZE] {
    let mut powers = [Complex::real(1.0); MAX_SIZE];
    for k in 1..MAX_SIZE {
        powers[k] = powers[k - 1] * x;
    }
    powers
}

fn cayley(count: usize) -> [[Complex; MAX_SIZE]; MAX_SIZE] {
    let mut all = [[Complex::ZERO; MAX_SIZE]; MAX_SIZE];
    for (j, p) in all.iter_mut().enumerate().take(count + 1) {
        p[0] = powers(Complex::I)[count];
        for factor in 0..count {
            let slope = Complex::I.scale(if factor < j { 1.0 } else { -1.0 });
            for k in (1..MAX_SIZE).rev() {
                p[k] = p[k] + slope * p[k - 1];
            }
        }
    }
    all
}

impl Basis for Harmonics {
    type Moments = Toeplitz;

    fn stored(&self) -> usize {
        2 * self.count
    }

    fn functions(&self, d: f64) -> [f64; MAX_STORED] {
        let powers = powers(unit(self.turns(d)));
        std::array::from_fn(|k| match powers[1 + k / 2] {
            _ if k >= self.stored() => 0.0,
            Complex { re, .. } if k % 2 == 0 => re,
            Complex { im, .. } => im,
        })
    }

    fn prepare(&self, means: &[f64; MAX_STORED]) -> Toeplitz {
        // biased towards uniform mass, all of whose moments but the zeroth are 0
        let moment = |bias: f64, k: usize| match k {
            0 => Complex::real(1.0),
            _ => Complex { re: means[2 * k - 2], im: means[2 * k - 1] }.scale(1.0 - bias),
        };
        // below the diagonal the row is the larger one
        let entry = |bias, i: usize, j: usize| moment(bias, i - j);
        let factored = self.regularization.factor(self.count + 1, entry);
        let mut moments = [Complex::ZERO; MAX_SIZE];
        for (k, m) in moments.iter_mut().enumerate().take(self.count + 1) {
            *m = moment(factored.bias, k);
        }
        Toeplitz { moments, ldl: Some(factored.ldl), retries: factored.retries }
    }

    fn retries(moments: &Toeplitz) -> u32 {
        moments.retries
    }

    #[expect(clippy::cast_possible_truncation, reason = "the sums are f32 targets")]
    fn add(&self, d: &[f64], s: &[f64], sums: &mut [f32; MAX_STORED]) {
        let mut units = [Complex::ZERO; CHUNK];
        units_at(self, d, &mut units);
        for (&unit, &s) in units.iter().zip(s).take(d.len()) {
            let mut power = Complex::real(1.0);
            for sum in sums.as_chunks_mut::<2>().0.iter_mut().take(self.count) {
                power = power * unit;
                *sum = [sum[0] + (s * power.re) as f32, sum[1] + (s * power.im) as f32];
            }
        }
    }

    fn shares_in_front(&self, toeplitz: &Toeplitz, d: &[f64], overestimation: f64, shares: &mut [f64]) {
        let Some(ldl) = &toeplitz.ldl else { return shares.fill(0.0) };
        for (d, shares) in d.chunks(BLOCK).zip(shares.chunks_mut(BLOCK)) {
            shares_of_canonical(self, toeplitz, ldl, d, overestimation, shares);
        }
    }
}

/// e^{i angle} of so many turns.
#[inline(always)]
fn unit(turns: f64) -> Complex {
    let (im, re) = sin_cos_of_turns(turns);
    Complex { re, im }
}

#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"))]
fn units_at(harmonics: &Harmonics, d: &[f64], units: &mut [Complex; CHUNK]) {
    for (u, &d) in units.iter_mut().zip(d) {
        *u = unit(harmonics.turns(d));
    }
}

#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"))]
fn shares_of_canonical(
    harmonics: &Harmonics,
    toeplitz: &Toeplitz,
    ldl: &Ldl<Complex>,
    d: &[f64],
    overestimation: f64,
    shares: &mut [f64],
) {
    match harmonics.count {
        2 => shares_of::<2, 3>(harmonics, toeplitz, ldl, d, overestimation, shares),
        3 => shares_of::<3, 4>(harmonics, toeplitz, ldl, d, overestimation, shares),
        _ => shares_of::<4, 5>(harmonics, toeplitz, ldl, d, overestimation, shares),
    }
}

/// With M points beside d, and N of them in all.
///
/// The angles of the other points are the zeros of the kernel polynomial K(ζ, x) = Σ gⱼ (−x/ζ)ʲ on the unit circle.
/// With x = −ζ (1 + it)/(1 − it) they become the real zeros t of a real polynomial, up to rounding, and ζ goes to
/// infinity: the leading coefficient is K(ζ, ζ) > 0.
#[inline(always)]
fn shares_of<const M: usize, const N: usize>(
    harmonics: &Harmonics,
    toeplitz: &Toeplitz,
    ldl: &Ldl<Complex>,
    d: &[f64],
    overestimation: f64,
    shares: &mut [f64],
) {
    let (d, count) = in_whole_blocks(d);
    let mut column = [0.0; BLOCK];
    let mut zeta = ComplexColumn::default();
    for (i, &d) in d[..count].iter().enumerate() {
        zeta.set(i, unit(harmonics.turns(d)));
    }
    let p = kernel_polynomials::<M, N>(harmonics, ldl, &zeta, count);
    let mut roots = [[0.0; BLOCK]; MAX_DEGREE];
    real_roots_of_monic::<M>(&p, count, &mut roots);
    let counts = counts::<M>(harmonics, &d, count, &roots);
    for i in 0..count {
        let zeta = zeta.get(i);
        let mut nodes = [zeta; N];
        let mut values = [overestimation; N];
        for k in 0..M {
            nodes[k + 1] = on_circle(zeta, roots[k][i]);
            values[k + 1] = counts[k][i];
        }
        let p = interpolate(&nodes, &values);
        let mut share = 0.0;
        for (p, moment) in p[..N].iter().zip(&toeplitz.moments[..N]) {
            share += (*p * *moment).re;
        }
        column[i] = share;
    }
    shares.copy_from_slice(&column[..shares.len()]);
}

/// A complex number for each fragment of a block.
#[derive(Clone, Copy)]
struct ComplexColumn {
    re: Column,
    im: Column,
}

impl Default for ComplexColumn {
    fn default() -> Self {
        Self { re: [0.0; BLOCK], im: [0.0; BLOCK] }
    }
}

impl ComplexColumn {
    #[inline(always)]
    fn get(&self, i: usize) -> Complex {
        Complex { re: self.re[i], im: self.im[i] }
    }

    #[inline(always)]
    fn set(&mut self, i: usize, value: Complex) {
        (self.re[i], self.im[i]) = (value.re, value.im);
    }
}

/// 1, ζ, ζ², ...
#[inline(always)]
fn column_powers<const N: usize>(zeta: &ComplexColumn, count: usize) -> [ComplexColumn; N] {
    let mut powers = [ComplexColumn { re: [1.0; BLOCK], im: [0.0; BLOCK] }; N];
    for k in 1..N {
        for i in 0..count {
            let power = powers[k - 1].get(i) * zeta.get(i);
            powers[k].set(i, power);
        }
    }
    powers
}

/// [`Ldl::solve`] for a right-hand side per fragment.
#[inline(always)]
fn solve_columns<const N: usize>(ldl: &Ldl<Complex>, v: &mut [ComplexColumn; N], count: usize) {
    for row in 0..N {
        for k in 0..row {
            subtract_product(v, row, k, ldl.lower(row, k), count);
        }
    }
    for row in (0..N).rev() {
        for i in 0..count {
            let scaled = v[row].get(i).scale(ldl.inverse_pivot(row));
            v[row].set(i, scaled);
        }
        for k in row + 1..N {
            subtract_product(v, row, k, ldl.lower(k, row).conj(), count);
        }
    }
}

#[inline(always)]
fn subtract_product<const N: usize>(
    v: &mut [ComplexColumn; N],
    row: usize,
    k: usize,
    factor: Complex,
    count: usize,
) {
    for i in 0..count {
        let difference = v[row].get(i) - factor * v[k].get(i);
        v[row].set(i, difference);
    }
}

/// The real polynomials in t, divided by their leading coefficients.
#[inline(always)]
fn kernel_polynomials<const M: usize, const N: usize>(
    harmonics: &Harmonics,
    ldl: &Ldl<Complex>,
    zeta: &ComplexColumn,
    count: usize,
) -> Columns {
    let powers = column_powers::<N>(zeta, count);
    let mut kernel = powers;
    solve_columns(ldl, &mut kernel, count);
    let (mut p, mut leading) = ([[0.0; BLOCK]; MAX_DEGREE], [0.0; BLOCK]);
    for j in 0..N {
        let sign = if j.is_multiple_of(2) { 1.0 } else { -1.0 };
        for (k, c) in harmonics.cayley[j].iter().enumerate().take(N) {
            let sums = if k < M { &mut p[k] } else { &mut leading };
            let c = c.scale(sign);
            for (i, sum) in sums[..count].iter_mut().enumerate() {
                *sum += (kernel[j].get(i).conj() * powers[j].get(i) * c).re;
            }
        }
    }
    for column in &mut p[..M] {
        for (p, leading) in column[..count].iter_mut().zip(&leading) {
            *p /= leading;
        }
    }
    p
}

/// −ζ (1 + it)/(1 − it).
#[inline(always)]
fn on_circle(zeta: Complex, t: f64) -> Complex {
    let square = t * t;
    let turn = Complex { re: square - 1.0, im: -2.0 * t };
    zeta.scale((1.0 + square).recip()) * turn
}

/// How much of each point counts as in front of d: nothing of those behind it, in the zone the more the closer to
/// its end, and all beyond that.
#[inline(always)]
fn counts<const M: usize>(harmonics: &Harmonics, d: &[f64], count: usize, roots: &Columns) -> Columns {
    let mut counts = [[0.0; BLOCK]; MAX_DEGREE];
    let mut limits = ([0.0; BLOCK], [0.0; BLOCK]);
    for (i, &d) in d[..count].iter().enumerate() {
        let turns = harmonics.turns(d);
        // 2 atan t is the angle from opposite d: up to the end of the circle, and to the zone
        limits.0[i] = cot_of_half(turns);
        limits.1[i] = cot_of_half(turns + harmonics.wrapping_zone / TAU);
    }
    let mut in_zone = [0; BLOCK];
    for k in 0..M {
        for i in 0..count {
            let t = roots[k][i];
            counts[k][i] = if t >= limits.0[i] { 1.0 } else { 0.0 };
            in_zone[i] |= u64::from(t > limits.1[i]) & u64::from(t < limits.0[i]);
        }
    }
    for i in (0..count).filter(|&i| in_zone[i] != 0) {
        for k in 0..M {
            let t = roots[k][i];
            if t > limits.1[i] && t < limits.0[i] {
                counts[k][i] = harmonics.zone_counts(t, harmonics.turns(d[i]));
            }
        }
    }
    counts
}

/// The cotangent of half of a turn or less, infinite at either end.
#[inline(always)]
fn cot_of_half(turns: f64) -> f64 {
    let (sin, cos) = sin_cos_of_turns(0.5 * turns);
    // at the far end rounding decides on the sign of the sine
    cos / sin.abs()
}
