//! Absorbance: the logarithm of transmittance, in which layers add up (sheet 0.2).

use crate::params::{Kind, ParamSpec, Value};

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

#[cfg(test)]
mod tests {
    use super::{absorbance, transmittance};

    #[test]
    fn precise_for_faint_and_finite_for_opaque_fragments() {
        assert_eq!(absorbance(0.0, 10.0), 0.0);
        assert!((absorbance(1e-20, 10.0) / f64::from(1e-20_f32) - 1.0).abs() < 1e-15);
        assert!((absorbance(0.5, 10.0) - std::f64::consts::LN_2).abs() < 1e-15);
        assert_eq!(absorbance(1.0, 10.0), 10.0);
    }

    #[test]
    fn negative_absorbance_is_none() {
        assert_eq!([-3.0, 0.0].map(transmittance), [1.0, 1.0]);
        assert_eq!(transmittance(std::f64::consts::LN_2), 0.5);
    }
}
