//! Polynomials of at most the fourth degree: roots where all of them are real, and interpolation.
#![expect(clippy::inline_always, reason = "chunks of fragments call these in loops that vectorise")]

use super::linear::{MAX_SIZE, Scalar};

/// The largest degree.
pub const MAX_DEGREE: usize = MAX_SIZE - 1;

/// Newton's method with bisection to fall back on takes a handful of steps; towards a multiple root it halves
/// the distance each time.
pub const MAX_STEPS: usize = 64;

/// A step of Newton's method this small, relative, leaves an error of about its square; towards a multiple
/// root one of its own size, which is less than what rounded coefficients do to such a root.
pub const LAST_STEP: f64 = 1e-8;

/// The value at `x`, and the derivative there. Coefficients ascend.
fn evaluate(coefficients: &[f64], x: f64) -> (f64, f64) {
    coefficients.iter().rev().fold((0.0, 0.0), |(p, slope), c| (p * x + c, slope * x + p))
}

/// The roots, ascending, of a polynomial that has as many real roots as its degree, up to rounding. The
/// leading coefficient, which comes last, is not 0.
///
/// Between neighbouring zeros of the derivative lies exactly one root; where rounding has lifted a double
/// root off the axis, the zero of the derivative takes its place (a negative discriminant counts as 0).
pub fn real_roots(coefficients: &[f64]) -> [f64; MAX_DEGREE] {
    let n = coefficients.len() - 1;
    let mut monic = [0.0; MAX_SIZE];
    for (m, c) in monic.iter_mut().zip(coefficients) {
        *m = c / coefficients[n];
    }
    roots_of_monic(&monic[..=n])
}

fn roots_of_monic(p: &[f64]) -> [f64; MAX_DEGREE] {
    let n = p.len() - 1;
    let mut roots = [0.0; MAX_DEGREE];
    match n {
        0 => {}
        1 => roots[0] = -p[0],
        2 => roots[..2].copy_from_slice(&quadratic(p[0], p[1])),
        _ => {
            let turns = roots_of_monic(&derivative(p)[..n]);
            let (first, last) = bounds(p);
            let mut low = first.min(turns[0]);
            for i in 0..n {
                let high = if i + 1 < n { turns[i] } else { last.max(low) };
                roots[i] = root_between(p, low, high);
                low = high;
            }
        }
    }
    roots
}

/// The roots of x² + b x + c; the one of larger magnitude comes first into being, so that none cancels.
#[inline(always)]
pub fn quadratic(c: f64, b: f64) -> [f64; 2] {
    let root = (b * b - 4.0 * c).max(0.0).sqrt();
    let large = -0.5 * (b + root.copysign(b));
    let small = if large == 0.0 { 0.0 } else { c / large };
    if large < small { [large, small] } else { [small, large] }
}

/// The derivative, divided by the degree.
#[inline(always)]
#[expect(clippy::cast_precision_loss, reason = "degrees are small")]
pub fn derivative(p: &[f64]) -> [f64; MAX_SIZE] {
    let n = p.len() - 1;
    let mut derivative = [0.0; MAX_SIZE];
    for k in 1..=n {
        derivative[k - 1] = p[k] * (k as f64 / n as f64);
    }
    derivative
}

/// Between which numbers the roots lie, if all are real (Laguerre and Samuelson).
#[inline(always)]
#[expect(clippy::cast_precision_loss, reason = "degrees are small")]
pub fn bounds(p: &[f64]) -> (f64, f64) {
    let n = p.len() - 1;
    let degree = n as f64;
    let (a, b) = (p[n - 1], p[n - 2]);
    let spread = (a * a - 2.0 * degree / (degree - 1.0) * b).max(0.0).sqrt() * (degree - 1.0);
    // a little wider, so that a root on the bound is inside
    let (centre, radius) = (-a / degree, spread / degree * (1.0 + 1e-9));
    (centre - radius, centre + radius)
}

/// The root between `low` and `high`, where p changes sign; the end nearer to 0 where it does not.
fn root_between(p: &[f64], mut low: f64, mut high: f64) -> f64 {
    let (at_low, at_high) = (evaluate(p, low).0, evaluate(p, high).0);
    if (at_low < 0.0) == (at_high < 0.0) {
        return if at_low.abs() < at_high.abs() { low } else { high };
    }
    let mut x = 0.5 * (low + high);
    for _ in 0..MAX_STEPS {
        let (value, slope) = evaluate(p, x);
        let newton = x - value / slope;
        if value == 0.0 {
            return x;
        }
        if (newton - x).abs() <= LAST_STEP * x.abs() {
            return newton;
        }
        if (value < 0.0) == (at_low < 0.0) {
            low = x;
        } else {
            high = x;
        }
        x = if low < newton && newton < high { newton } else { 0.5 * (low + high) };
    }
    x
}

/// The polynomial in u = x − `origin` that has the same values.
#[inline(always)]
pub fn shifted(coefficients: &[f64], origin: f64) -> [f64; MAX_SIZE] {
    let mut shifted = [0.0; MAX_SIZE];
    let shifted_part = &mut shifted[..coefficients.len()];
    shifted_part.copy_from_slice(coefficients);
    for first in 0..coefficients.len() {
        for k in (first..coefficients.len() - 1).rev() {
            shifted_part[k] += origin * shifted_part[k + 1];
        }
    }
    shifted
}

/// The coefficients, ascending, of the polynomial that takes `values` at `nodes`, by Newton's divided
/// differences. Nodes that coincide count as one with the first one's value; they stand side by side.
#[inline(always)]
pub fn interpolate<S: Scalar>(nodes: &[S], values: &[f64]) -> [S; MAX_SIZE] {
    let n = nodes.len();
    let mut differences = [S::ZERO; MAX_SIZE];
    for (difference, value) in differences.iter_mut().zip(values) {
        *difference = S::real(*value);
    }
    for order in 1..n {
        for i in (order..n).rev() {
            differences[i] = quotient(differences[i] - differences[i - 1], nodes[i] - nodes[i - order]);
        }
    }
    expand(&differences[..n], nodes)
}

/// 0 where nothing is divided by nothing.
#[inline(always)]
fn quotient<S: Scalar>(difference: S, distance: S) -> S {
    let quotient = difference * distance.recip();
    if (distance * distance.conj()).re() == 0.0 { S::ZERO } else { quotient }
}

/// Newton's form in powers of x.
#[inline(always)]
fn expand<S: Scalar>(differences: &[S], nodes: &[S]) -> [S; MAX_SIZE] {
    let mut p = [S::ZERO; MAX_SIZE];
    let n = differences.len();
    for i in (0..n).rev() {
        // so far of degree n − 2 − i
        for k in (1..n - i).rev() {
            p[k] = p[k - 1] - nodes[i] * p[k];
        }
        p[0] = differences[i] - nodes[i] * p[0];
    }
    p
}

#[cfg(test)]
mod tests {
    use super::super::linear::Complex;
    use super::*;
    use crate::techniques::testing::Random;

    /// The coefficients of c Π (x − root).
    fn with_roots(roots: &[f64], c: f64) -> Vec<f64> {
        let mut p = vec![c];
        for root in roots {
            p.insert(0, 0.0);
            for k in 0..p.len() - 1 {
                p[k] -= root * p[k + 1];
            }
        }
        p
    }

    #[test]
    fn roots_are_found_in_order() {
        let mut random = Random::new(1);
        for degree in 1..=MAX_DEGREE {
            for _ in 0..500 {
                let mut roots: Vec<_> = (0..degree).map(|_| f64::from(random.unit()) * 4.0 - 2.0).collect();
                roots.sort_by(f64::total_cmp);
                let gap = roots.windows(2).map(|w| w[1] - w[0]).fold(1.0, f64::min);
                let found = real_roots(&with_roots(&roots, 3.0));
                for (x, root) in found.iter().zip(&roots) {
                    let far = (x - root).abs();
                    assert!(far * gap.powi(3) < 1e-13, "{found:?} for {roots:?}");
                }
            }
        }
    }

    #[test]
    fn roots_of_very_different_size_keep_their_relative_precision() {
        for roots in [[-3e6, -1.0, 2e-3, 5e4], [-1e-4, 0.5, 0.7, 2e7], [1e-3, 1.0, 1e3, 1e6]] {
            let found = real_roots(&with_roots(&roots, 1.0));
            for (x, root) in found.iter().zip(&roots) {
                assert!((x / root - 1.0).abs() < 1e-6, "{found:?} for {roots:?}");
            }
        }
    }

    #[test]
    fn multiple_roots_are_found_as_often_as_they_occur() {
        for roots in [&[1.0, 1.0][..], &[0.0; 3], &[-1.0, 2.0, 2.0], &[0.5; 4], &[-1.0, -1.0, 3.0, 3.0]] {
            let found = real_roots(&with_roots(roots, 0.1));
            for (x, root) in found.iter().zip(roots) {
                // the n-th root of the rounding error is all that coefficients tell of an n-fold root
                assert!((x - root).abs() < 2e-4, "{found:?} for {roots:?}");
            }
        }
        // x² + 1e-18: no root but for rounding
        assert_eq!(real_roots(&[1e-18, 0.0, 1.0])[..2], [0.0, 0.0]);
    }

    #[test]
    fn a_shift_keeps_values() {
        let p = [3.0, -1.0, 2.0, 0.5, -4.0];
        let shifted = shifted(&p, 0.75);
        for x in [-1.0, 0.0, 0.3, 2.0] {
            assert!((evaluate(&p, x).0 - evaluate(&shifted, x - 0.75).0).abs() < 1e-13);
        }
    }

    #[test]
    fn an_interpolant_takes_its_values() {
        let (nodes, values) = ([0.3, -0.9, -0.2, 0.5, 7.0], [0.25, 1.0, 1.0, 0.0, 0.0]);
        let p = interpolate(&nodes, &values);
        for (x, f) in nodes.iter().zip(values) {
            assert!((evaluate(&p, *x).0 - f).abs() < 1e-12);
        }
        let nodes = [0.5, 2.0, 4.0, 6.0].map(Complex::unit);
        let p = interpolate(&nodes, &values[..4]);
        for (x, f) in nodes.iter().zip(values) {
            let value = p.iter().rev().fold(Complex::ZERO, |sum, c| sum * *x + *c) - Complex::real(f);
            assert!(value.re.hypot(value.im) < 1e-14);
        }
    }

    #[test]
    fn coincident_nodes_do_no_harm() {
        let p = interpolate(&[0.0, 1.0, 1.0, 2.0], &[0.5, 0.0, 0.0, 0.0]);
        assert!(p.iter().all(|c| c.is_finite()));
        assert_eq!((evaluate(&p, 0.0).0, evaluate(&p, 1.0).0), (0.5, 0.0));
    }
}
