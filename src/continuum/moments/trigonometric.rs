//! Trigonometric moments: the mean values of e^{ikφ}, k = 1..m for m = 2, 3 or 4, with depth as an angle.

use super::linear::{Complex, Ldl, MAX_SIZE, Scalar};
use super::polynomial::{interpolate, real_roots};
use super::{Basis, MAX_STORED, Regularization};
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

    /// The bias that single precision asks for (M18).
    pub fn default_bias(count: usize) -> f64 {
        match count {
            2 => 4e-7,
            3 => 8e-7,
            _ => 1.5e-6,
        }
    }

    /// The angle of a depth.
    fn angle(&self, d: f64) -> f64 {
        (PI - 0.5 * self.wrapping_zone) * (d + 1.0)
    }

    /// How much of the mass at `angle` in [0, 2π) counts as in front of `limit`.
    fn counts(&self, angle: f64, limit: f64) -> f64 {
        let into_zone = angle - (TAU - self.wrapping_zone);
        if angle < limit {
            1.0
        } else if into_zone > 0.0 {
            (into_zone / self.wrapping_zone).min(1.0)
        } else {
            0.0
        }
    }

    /// The angles of the canonical distribution's other points. They are the zeros of the kernel polynomial
    /// K(ζ, x) = Σ gⱼ (−x/ζ)ʲ on the unit circle. With x = −ζ (1 + it)/(1 − it) they become the real zeros t
    /// of a real polynomial, up to rounding, and ζ goes to infinity: the leading coefficient is K(ζ, ζ) > 0.
    fn other_points(&self, ldl: &Ldl<Complex>, angle: f64) -> impl Iterator<Item = f64> + use<> {
        let kernel = ldl.solve(powers(Complex::unit(angle)));
        let opposite = powers(Complex::unit(angle + PI));
        let mut polynomial = [0.0; MAX_SIZE];
        for j in 0..=self.count {
            let g = kernel[j].conj() * opposite[j];
            for (p, c) in polynomial.iter_mut().zip(self.cayley[j]) {
                *p += (g * c).re;
            }
        }
        let roots = real_roots(&polynomial[..=self.count]).into_iter().take(self.count);
        roots.map(move |t| (angle + PI + 2.0 * t.atan()).rem_euclid(TAU))
    }
}

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
        let powers = powers(Complex::unit(self.angle(d)));
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

    fn in_front(&self, toeplitz: &Toeplitz, d: f64, overestimation: f64) -> f64 {
        let Some(ldl) = &toeplitz.ldl else { return 0.0 };
        let angle = self.angle(d);
        let mut nodes = [Complex::unit(angle); MAX_SIZE];
        let mut values = [overestimation; MAX_SIZE];
        let others = self.other_points(ldl, angle);
        for ((node, value), other) in nodes[1..].iter_mut().zip(&mut values[1..]).zip(others) {
            *node = Complex::unit(other);
            *value = self.counts(other, angle);
        }
        let p = interpolate(&nodes[..=self.count], &values[..=self.count]);
        p.iter().zip(&toeplitz.moments).map(|(p, b)| (*p * *b).re).sum()
    }
}
