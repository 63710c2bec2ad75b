//! Trigonometric series of steps.

use std::f64::consts::PI;

/// cos kθ and sin kθ for k = 1, 2, ..., by rotation: an error of k ulp, and two functions for all of them.
pub fn harmonics(theta: f64) -> impl Iterator<Item = (f64, f64)> {
    let (sin, cos) = theta.sin_cos();
    let turn = move |&(c, s): &(f64, f64)| Some((c * cos - s * sin, s * cos + c * sin));
    std::iter::successors(Some((cos, sin)), turn)
}

/// πk for k = 1, 2, ...
pub fn half_turns() -> impl Iterator<Item = f64> {
    (1_u32..).map(|k| PI * f64::from(k))
}

/// What the series of a unit step at `d` is there: `d + Σ σ_k sin(2πk d)/(πk)`, 1/2 in the limit.
pub fn at_own_step(d: f64, sigma: impl Iterator<Item = f64>) -> f64 {
    let terms = sigma.zip(half_turns()).zip(harmonics(2.0 * PI * d));
    d + terms.map(|((sigma, pi_k), (_, sin))| sigma * sin / pi_k).sum::<f64>()
}

#[cfg(test)]
mod tests {
    use super::{at_own_step, harmonics};

    #[test]
    fn rotation_keeps_its_precision() {
        for (k, (cos, sin)) in (1..=2000).zip(harmonics(0.7)) {
            let theta = 0.7 * f64::from(k);
            assert!((cos - theta.cos()).abs() < 1e-12 && (sin - theta.sin()).abs() < 1e-12, "{k}");
        }
    }

    #[test]
    fn half_of_a_step_is_in_front_of_it() {
        let share = |d, count| at_own_step(d, std::iter::repeat_n(1.0, count));
        assert_eq!((share(0.3, 0), share(0.0, 9), share(0.5, 9)), (0.3, 0.0, 0.5));
        assert!((share(0.3, 1000) - 0.5).abs() < 1e-3 && (share(1.0, 50) - 1.0).abs() < 1e-13);
    }
}
