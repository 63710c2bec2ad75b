//! Absorbance: the logarithm of transmittance, in which layers add up (sheet 0.2).

use super::functions::{exp, ln_one_minus};
use crate::params::{Kind, ParamSpec, Value};
use multiversion::multiversion;

/// The param that bounds a fragment's absorbance, so that opaque ones stay finite.
pub const S_MAX: ParamSpec = ParamSpec::new(
    "s_max",
    Kind::float(1.0, 60.0),
    Value::Float(10.0),
    "largest absorbance of a fragment: an opaque one lets exp(-s_max) through",
);

/// The param that frees a fragment of its own absorbance (sheet 0.3).
pub const SELF_CORRECT: ParamSpec = ParamSpec::new(
    "self_correct",
    Kind::Bool,
    Value::Bool(true),
    "take from what hides a fragment the part that is the fragment's own: interpolation charges it with some, \
     and without this the error does not vanish however fine the map",
);

/// What absorbance `tau` lets through; series ring below zero, and nothing brightens.
pub fn transmittance(tau: f64) -> f64 {
    (-tau.max(0.0)).exp()
}

/// s = −ln(1 − alpha), at most `s_max`.
pub fn absorbance(alpha: f32, s_max: f64) -> f64 {
    (-(-f64::from(alpha)).ln_1p()).min(s_max)
}

/// [`absorbance`] of each alpha.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"))]
pub fn absorbances(alpha: &[f32], s_max: f64, s: &mut [f64]) {
    for (s, &alpha) in s.iter_mut().zip(alpha) {
        *s = (-ln_one_minus(alpha)).min(s_max);
    }
}

/// [`transmittance`] of each absorbance, in its place.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"))]
pub fn transmittances(taus: &mut [f64]) {
    for tau in taus {
        *tau = exp(-tau.max(0.0));
    }
}

#[cfg(test)]
mod tests {
    use super::{absorbance, absorbances, transmittance, transmittances};

    #[test]
    fn precise_for_faint_and_finite_for_opaque_fragments() {
        assert_eq!(absorbance(0.0, 10.0), 0.0);
        assert!((absorbance(1e-20, 10.0) / f64::from(1e-20_f32) - 1.0).abs() < 1e-15);
        assert!((absorbance(0.5, 10.0) - std::f64::consts::LN_2).abs() < 1e-15);
        assert_eq!(absorbance(1.0, 10.0), 10.0);
    }

    #[test]
    fn many_at_once_are_those_of_one() {
        let alphas = [0.0, 1e-20, 1e-3, 0.25, 0.5, 0.9, 0.999_999_9, 1.0, 0.3];
        let mut s = [0.0; 9];
        absorbances(&alphas, 10.0, &mut s);
        for (s, alpha) in s.iter().zip(alphas) {
            assert!((s - absorbance(alpha, 10.0)).abs() <= 4e-16 * s, "{alpha}: {s}");
        }
        let mut t = [-1.0, 0.0, 1e-9, 0.5, 3.0, 60.0, 1e4, 0.1, 10.0];
        let one = t.map(transmittance);
        transmittances(&mut t);
        for (t, one) in t.iter().zip(one) {
            assert!((t - one).abs() <= 4e-16 * one, "{t} {one}");
        }
    }

    #[test]
    fn negative_absorbance_is_none() {
        assert_eq!([-3.0, 0.0].map(transmittance), [1.0, 1.0]);
        assert_eq!(transmittance(std::f64::consts::LN_2), 0.5);
    }
}
