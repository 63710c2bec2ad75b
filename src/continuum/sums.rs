//! The accumulator of blended techniques: weighted sums and a product, as render targets hold them.

use crate::fragments::List;
use crate::technique::Resolved;
use crate::weight::Weighting;
use glam::{DVec3, Vec3, Vec4};

/// What additive and multiplicative blending leave of a set of fragments (MB13 Listing 3): Σ w (C, a) in f32,
/// and the background's share R = Π (1 − a).
///
/// R and 1 − R are both kept, in f64: the first is the small one behind opaque fragments, the second behind
/// faint ones, and "background coverage is exact" (MB13 §3.2) is worth having after 10⁴ layers too.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BlendSums {
    weighted: Vec4,
    transmittance: f64,
    coverage: f64,
}

impl BlendSums {
    /// The targets as they are cleared.
    pub const CLEAR: Self = Self { weighted: Vec4::ZERO, transmittance: 1.0, coverage: 0.0 };

    /// Blends in a fragment.
    pub fn add(&mut self, weight: f32, color: [f32; 3], alpha: f32) {
        let alpha64 = f64::from(alpha);
        self.add_share(weight, color, alpha, alpha64, 1.0 - alpha64);
    }

    /// Blends in a fragment that covers another part of what is behind than its alpha says: `coverage`, which
    /// leaves `transmittance`.
    pub fn add_share(&mut self, weight: f32, color: [f32; 3], alpha: f32, coverage: f64, transmittance: f64) {
        self.weighted += weight * Vec3::from(color).extend(alpha);
        self.transmittance *= transmittance;
        self.coverage += (1.0 - self.coverage) * coverage;
    }

    /// Sums that were kept elsewhere.
    pub fn from_parts(weighted: Vec4, transmittance: f64, coverage: f64) -> Self {
        Self { weighted, transmittance, coverage }
    }

    /// Σ w C; what overflows f32 counts as its largest number.
    pub fn color(&self) -> DVec3 {
        self.weighted.truncate().min(Vec3::MAX).as_dvec3()
    }

    /// Σ w a.
    pub fn alpha(&self) -> f64 {
        self.weighted.w.min(f32::MAX).into()
    }

    /// R = Π (1 − a).
    pub fn transmittance(&self) -> f64 {
        self.transmittance
    }

    /// 1 − R, precise where R is near 1.
    pub fn coverage(&self) -> f64 {
        self.coverage
    }

    /// The unmultiplied average colour Σ w C / Σ w a; none where nothing covers.
    pub fn average(&self) -> Option<DVec3> {
        let alpha = self.alpha();
        (alpha > 0.0).then(|| self.color() / alpha)
    }

    /// MB13 eq. 6: the average covers 1 − R of the background.
    pub fn over(&self, background: DVec3) -> Resolved {
        match self.average() {
            Some(average) => self.cover(average, background),
            None => Resolved::background(background),
        }
    }

    /// MB13 eq. 4: `count` copies of the mean fragment, one over the other.
    #[expect(clippy::cast_precision_loss, reason = "a pixel's list is far shorter than 2^52")]
    pub fn over_as_mean(&self, count: usize, background: DVec3) -> Resolved {
        let Some(average) = self.average() else { return Resolved::background(background) };
        let (coverage, transmittance) = self.mean_coverage(count as f64);
        blend(average, coverage, transmittance, background)
    }

    /// What `n` copies of the mean fragment cover of the background, and what they leave of it.
    pub fn mean_coverage(&self, n: f64) -> (f64, f64) {
        let mean_alpha = (self.alpha() / n.max(1.0)).min(1.0);
        let log_transmittance = n * (-mean_alpha).ln_1p();
        (-log_transmittance.exp_m1(), log_transmittance.exp())
    }

    /// `(1 − R) color + R background`.
    pub fn cover(&self, color: DVec3, background: DVec3) -> Resolved {
        blend(color, self.coverage, self.transmittance, background)
    }
}

/// A technique that is nothing but [`BlendSums`] over all fragments, in any order.
pub trait Blended: Send + Sync {
    /// The weight of a fragment; all count the same where there is none.
    fn weighting(&self) -> Option<&Weighting> {
        None
    }

    /// The pixel's colour from its sums over `count` fragments.
    fn finish(&self, sums: &BlendSums, count: usize, background: DVec3) -> Resolved;

    /// The pixel's colour from its fragments.
    fn blend_list(&self, list: List<'_>, background: DVec3, weights: &mut Vec<f32>) -> Resolved {
        let mut sums = BlendSums::CLEAR;
        if let Some(weighting) = self.weighting() {
            weighting.evaluate(list.depth, list.alpha, weights);
            for ((&weight, &color), &alpha) in weights.iter().zip(list.color).zip(list.alpha) {
                sums.add(weight, color, alpha);
            }
        } else {
            for (&color, &alpha) in list.color.iter().zip(list.alpha) {
                sums.add(1.0, color, alpha);
            }
        }
        self.finish(&sums, list.len(), background)
    }
}

/// `coverage color + transmittance background`, finite in f32 also where fragments that emit without covering
/// have driven the average beyond it (sheet R13).
pub fn blend(color: DVec3, coverage: f64, transmittance: f64, background: DVec3) -> Resolved {
    let blended = coverage * color + transmittance * background;
    Resolved::new(blended.min(DVec3::splat(f32::MAX.into())), transmittance)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sums(fragments: &[(f32, [f32; 3], f32)]) -> BlendSums {
        let mut sums = BlendSums::CLEAR;
        for &(w, c, a) in fragments {
            sums.add(w, c, a);
        }
        sums
    }

    #[test]
    fn sums_and_product_by_hand() {
        let sums = sums(&[(2.0, [0.5, 0.0, 0.25], 0.5), (1.0, [0.0, 0.25, 0.0], 0.25)]);
        assert_eq!(sums.color(), DVec3::new(1.0, 0.25, 0.5));
        assert_eq!(sums.alpha(), 1.25);
        assert_eq!(sums.average(), Some(DVec3::new(0.8, 0.2, 0.4)));
        assert_eq!((sums.transmittance(), sums.coverage()), (0.375, 0.625));
    }

    #[test]
    fn nothing_covers_nothing() {
        assert_eq!(BlendSums::CLEAR.average(), None);
        let background = DVec3::new(1.0, 2.0, 3.0);
        assert_eq!(sums(&[(1.0, [5.0; 3], 0.0)]).over(background), Resolved::background(background));
    }

    #[test]
    fn faint_and_opaque_layers_keep_their_relative_precision() {
        let faint = sums(&[(1.0, [1e-20; 3], 1e-20); 2]);
        assert!((faint.coverage() / f64::from(2e-20_f32) - 1.0).abs() < 1e-7);
        let deep = sums(&[(1.0, [0.0; 3], 0.999); 12]);
        let t: f64 = 1.0 - f64::from(0.999_f32);
        assert!((deep.transmittance() / t.powi(12) - 1.0).abs() < 1e-13);
        assert!(deep.coverage() <= 1.0);
    }

    #[test]
    fn overflow_saturates() {
        let sums = sums(&[(1e30, [1e30; 3], 0.5), (1e30, [1e30; 3], 0.5)]);
        assert!(sums.over(DVec3::ONE).color.is_finite());
    }
}
