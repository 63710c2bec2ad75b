//! Tests of random techniques: means over seeds, and how far they may be from what is expected.
#![expect(clippy::cast_precision_loss, clippy::cast_possible_wrap, reason = "small counts")]

use super::testing::{Scene, resolve_all};
use crate::fragments::Fragment;
use crate::params::Input;
use glam::{DVec3, DVec4};

/// Seeds over which means are taken.
pub const SEEDS: usize = 4096;
/// Standard scores beyond this one are no accident: among the 1000 comparisons that a test makes at most, chance
/// makes one in less than 1 of 100 tests (Bonferroni), and seeds are fixed.
pub const SIGNIFICANT: f64 = 4.5;
/// Where there is no noise, what the rounding of f32 state leaves.
const ROUNDING: f64 = 2e-6;

/// Mean and standard error of a pixel's colour and transmittance.
#[derive(Debug, Clone, Copy)]
pub struct Sampled {
    pub mean: DVec4,
    pub error: DVec4,
    /// Of one draw.
    pub variance: DVec4,
}

impl Sampled {
    /// Of draws of colour and transmittance.
    pub fn of(draws: Vec<DVec4>) -> Self {
        let n = draws.len() as f64;
        let mean = draws.iter().sum::<DVec4>() / n;
        let variance = draws.iter().map(|d| (d - mean) * (d - mean)).sum::<DVec4>() / (n - 1.0);
        Self { mean, error: (variance / n).map(f64::sqrt), variance }
    }

    /// The distance from an expected value in standard errors, the largest over the channels.
    pub fn score(&self, (color, transmittance): (DVec3, f64)) -> f64 {
        ((self.mean - color.extend(transmittance)).abs() / self.error.max(DVec4::splat(ROUNDING)))
            .max_element()
    }
}

/// What technique `id` makes of the pixels, over `seeds` seeds.
pub fn over_seeds(id: &str, inputs: &[(&str, Input)], scene: &Scene, seeds: usize) -> Vec<Sampled> {
    let mut draws = vec![Vec::with_capacity(seeds); scene.len()];
    for seed in 0..seeds {
        let mut inputs = inputs.to_vec();
        inputs.push(("seed", Input::Int(seed as i64)));
        for (draws, got) in draws.iter_mut().zip(resolve_all(id, &inputs, scene)) {
            draws.push(got.color.extend(got.transmittance.x));
        }
    }
    draws.into_iter().map(Sampled::of).collect()
}

/// Asserts that the mean over seeds is what `expected` says of each pixel.
#[track_caller]
pub fn assert_mean(
    id: &str,
    inputs: &[(&str, Input)],
    scene: &Scene,
    expected: impl Fn(&[Fragment]) -> (DVec3, f64),
) {
    for (sampled, pixel) in over_seeds(id, inputs, scene, SEEDS).iter().zip(scene) {
        let score = sampled.score(expected(pixel));
        assert!(score < SIGNIFICANT, "{id} {inputs:?}: {score} in {sampled:?} for {:?}", expected(pixel));
    }
}

#[test]
fn scores_by_hand() {
    let draws = [DVec4::splat(1.0), DVec4::splat(3.0)];
    let sampled = Sampled::of(draws.to_vec());
    assert_eq!(
        (sampled.mean, sampled.variance, sampled.error),
        (DVec4::splat(2.0), DVec4::splat(2.0), DVec4::ONE)
    );
    assert_eq!(sampled.score((DVec3::new(2.0, 4.0, 1.0), 2.0)), 2.0);
}
