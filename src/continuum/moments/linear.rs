//! Hermitian systems of at most five unknowns, real or complex.

use std::ops::{Add, Mul, Sub};

/// The largest number of unknowns: eight power moments or four trigonometric ones.
pub const MAX_SIZE: usize = 5;

/// A field that moment matrices are made of.
pub trait Scalar: Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> {
    /// 0.
    const ZERO: Self;
    /// A real number.
    fn real(x: f64) -> Self;
    /// The complex conjugate.
    fn conj(self) -> Self;
    /// The real part.
    fn re(self) -> f64;
    /// The product with a real number.
    fn scale(self, factor: f64) -> Self;
    /// The multiplicative inverse.
    fn recip(self) -> Self {
        self.conj().scale((self * self.conj()).re().recip())
    }
}

impl Scalar for f64 {
    const ZERO: Self = 0.0;
    fn real(x: f64) -> Self {
        x
    }
    fn conj(self) -> Self {
        self
    }
    fn re(self) -> f64 {
        self
    }
    fn scale(self, factor: f64) -> Self {
        self * factor
    }
    fn recip(self) -> Self {
        Self::recip(self)
    }
}

/// A complex number.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Complex {
    /// Real part.
    pub re: f64,
    /// Imaginary part.
    pub im: f64,
}

impl Complex {
    /// i.
    pub const I: Self = Self { re: 0.0, im: 1.0 };

    /// The number `e^{i angle}`.
    pub fn unit(angle: f64) -> Self {
        let (im, re) = angle.sin_cos();
        Self { re, im }
    }
}

impl Add for Complex {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self { re: self.re + other.re, im: self.im + other.im }
    }
}

impl Sub for Complex {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        Self { re: self.re - other.re, im: self.im - other.im }
    }
}

impl Mul for Complex {
    type Output = Self;
    fn mul(self, other: Self) -> Self {
        Self { re: self.re * other.re - self.im * other.im, im: self.re * other.im + self.im * other.re }
    }
}

impl Scalar for Complex {
    const ZERO: Self = Self { re: 0.0, im: 0.0 };
    fn real(x: f64) -> Self {
        Self { re: x, im: 0.0 }
    }
    fn conj(self) -> Self {
        Self { re: self.re, im: -self.im }
    }
    fn re(self) -> f64 {
        self.re
    }
    fn scale(self, factor: f64) -> Self {
        Self { re: self.re * factor, im: self.im * factor }
    }
}

/// A Hermitian, positive definite matrix as L D Lᴴ with a unit lower triangular L.
#[derive(Debug, Clone, Copy)]
pub struct Ldl<S> {
    size: usize,
    lower: [[S; MAX_SIZE]; MAX_SIZE],
    inverse_pivots: [f64; MAX_SIZE],
}

impl<S: Scalar> Ldl<S> {
    /// Factors the matrix whose lower triangle is `entry(row, column)`; `None` if a pivot is not above
    /// `guard` times the diagonal entry that it comes from, and so may be made of rounding errors alone.
    pub fn factor(size: usize, entry: impl Fn(usize, usize) -> S, guard: f64) -> Option<Self> {
        let mut lower = [[S::ZERO; MAX_SIZE]; MAX_SIZE];
        let (mut pivots, mut inverse_pivots) = ([0.0; MAX_SIZE], [0.0; MAX_SIZE]);
        for j in 0..size {
            let reduced = |i: usize, row: &[S; MAX_SIZE], above: &[S; MAX_SIZE]| {
                (0..j).fold(entry(i, j), |sum, k| sum - (row[k] * above[k].conj()).scale(pivots[k]))
            };
            let pivot = reduced(j, &lower[j], &lower[j]).re();
            if pivot.is_nan() || pivot <= guard * entry(j, j).re() {
                return None;
            }
            inverse_pivots[j] = pivot.recip();
            for i in j + 1..size {
                lower[i][j] = reduced(i, &lower[i], &lower[j]).scale(inverse_pivots[j]);
            }
            pivots[j] = pivot;
        }
        Some(Self { size, lower, inverse_pivots })
    }

    /// An entry of L below its diagonal.
    pub fn lower(&self, row: usize, column: usize) -> S {
        self.lower[row][column]
    }

    /// The inverse of an entry of D.
    pub fn inverse_pivot(&self, row: usize) -> f64 {
        self.inverse_pivots[row]
    }

    /// Solves the system for the right-hand side `v`.
    pub fn solve(&self, v: [S; MAX_SIZE]) -> [S; MAX_SIZE] {
        match self.size {
            3 => self.solve_of::<3>(v),
            4 => self.solve_of::<4>(v),
            5 => self.solve_of::<5>(v),
            n => self.solve_first(n, v),
        }
    }

    /// [`Ldl::solve`] for a system of N unknowns.
    #[inline(always)]
    #[expect(clippy::inline_always, reason = "chunks of fragments call this in loops that vectorise")]
    pub fn solve_of<const N: usize>(&self, v: [S; MAX_SIZE]) -> [S; MAX_SIZE] {
        debug_assert!(self.size == N);
        self.solve_first(N, v)
    }

    #[inline(always)]
    #[expect(clippy::inline_always, reason = "so that n is a constant where it can be")]
    fn solve_first(&self, n: usize, mut v: [S; MAX_SIZE]) -> [S; MAX_SIZE] {
        for i in 0..n {
            v[i] = (0..i).fold(v[i], |sum, k| sum - self.lower[i][k] * v[k]);
        }
        for i in (0..n).rev() {
            let scaled = v[i].scale(self.inverse_pivots[i]);
            v[i] = (i + 1..n).fold(scaled, |sum, k| sum - self.lower[k][i].conj() * v[k]);
        }
        v
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn complex_numbers_by_hand() {
        let (a, b) = (Complex { re: 1.0, im: 2.0 }, Complex { re: 3.0, im: -1.0 });
        assert_eq!(a * b, Complex { re: 5.0, im: 5.0 });
        assert_eq!(Complex::I * Complex::I, Complex::real(-1.0));
        assert_eq!(a * a.conj(), Complex::real(5.0));
        assert_eq!(a.recip(), Complex { re: 0.2, im: -0.4 });
        assert!((Complex::unit(1.0) * Complex::unit(-1.0) - Complex::real(1.0)).re.abs() < 1e-15);
    }

    #[test]
    fn a_real_system_by_hand() {
        // [4 2; 2 3] (1, 2) = (8, 8)
        let ldl = Ldl::factor(2, |i, j| [[4.0, 2.0], [2.0, 3.0]][i][j], 0.0).unwrap();
        assert_eq!(ldl.solve([8.0, 8.0, 0.0, 0.0, 0.0])[..2], [1.0, 2.0]);
    }

    #[test]
    fn a_complex_system_satisfies_its_equations() {
        let unit = |i: u8, j: u8| Complex::unit(f64::from(i) * 0.7 + f64::from(j * j));
        // Gram matrix of three vectors, with a bit of identity
        let entry = |i: usize, j: usize| {
            let (row, column) = (u8::try_from(i).unwrap(), u8::try_from(j).unwrap());
            let gram = (0..3).fold(Complex::ZERO, |sum, k| sum + unit(row, k) * unit(column, k).conj());
            gram + Complex::real(if i == j { 0.5 } else { 0.0 })
        };
        let right = [1.0, -2.0, 0.5, 3.0, 0.0].map(Complex::real);
        let solution = Ldl::factor(5, entry, 0.0).unwrap().solve(right);
        for (i, right) in right.into_iter().enumerate() {
            let left = (0..5).fold(Complex::ZERO, |sum, j| sum + entry(i, j) * solution[j]);
            let far = left - right;
            assert!(far.re.hypot(far.im) < 1e-13, "{far:?}");
        }
    }

    #[test]
    fn pivots_are_judged_relative_to_their_diagonal() {
        let nearly_singular = |i: usize, j: usize| if i == j { 1e9 * (1.0 + 1e-8) } else { 1e9 };
        assert!(Ldl::<f64>::factor(2, nearly_singular, 1e-9).is_some());
        assert!(Ldl::<f64>::factor(2, nearly_singular, 1e-7).is_none());
        assert!(Ldl::<f64>::factor(2, |i, j| if i == j { 1.0 } else { 2.0 }, 0.0).is_none());
        assert!(Ldl::<f64>::factor(1, |_, _| f64::NAN, 0.0).is_none());
    }
}
