//! Samples of a pixel, each of which shows the nearest fragment that covers it.

use super::masks::{Mask, RandomMasks, Words};
use super::sums::blend;
use crate::fragments::Fragment;
use crate::technique::{Pixel, Resolved};
use glam::{DVec3, Vec3};

/// What a pixel's samples show: fragments, and the background in those that nothing covers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shown {
    color: DVec3,
    covered: usize,
}

impl Shown {
    /// The background everywhere.
    pub const BACKGROUND: Self = Self { color: DVec3::ZERO, covered: 0 };

    /// `samples` samples more show the unmultiplied colour `color`.
    #[expect(clippy::cast_precision_loss, reason = "far fewer than 2^53 samples")]
    pub fn add(&mut self, samples: usize, color: DVec3) {
        self.color += samples as f64 * color;
        self.covered += samples;
    }

    /// The mean of `samples` samples, in front of the background.
    pub fn over(&self, samples: usize, background: DVec3) -> Resolved {
        #[expect(clippy::cast_precision_loss, reason = "far fewer than 2^53 samples")]
        let mean = self.color / samples as f64;
        blend(mean, 1.0, uncovered(self.covered, samples), background)
    }

    /// The mean of those of `samples` samples that are covered; none where there are none.
    #[expect(clippy::cast_precision_loss, reason = "far fewer than 2^53 samples")]
    pub fn average(&self, samples: usize) -> Option<DVec3> {
        let samples = samples as f64;
        (self.covered > 0).then(|| self.color / samples / (self.covered as f64 / samples))
    }
}

/// The share of samples that `covered` of them leave open.
#[expect(clippy::cast_precision_loss, reason = "far fewer than 2^53 samples")]
pub fn uncovered(covered: usize, samples: usize) -> f64 {
    (samples - covered) as f64 / samples as f64
}

/// The unmultiplied colour of a fragment that covers something.
pub fn unmultiplied(fragment: &Fragment) -> DVec3 {
    Vec3::from(fragment.color).as_dvec3() / f64::from(fragment.alpha)
}

/// The depth test of a pixel's samples.
#[derive(Debug, Default)]
pub struct DepthTest<W> {
    mask: Mask<W>,
    covered: Mask<W>,
}

impl<W: Words> DepthTest<W> {
    /// Calls `show` with every fragment that some sample shows, nearest first, and with how many do: a sample
    /// keeps the smallest (depth, primitive) among the fragments whose mask it is in, so going front to back
    /// the open samples of each mask are the ones that keep it.
    pub fn run(&mut self, masks: &RandomMasks, pixel: &Pixel<'_>, mut show: impl FnMut(&Fragment, usize)) {
        self.covered.reset(masks.bits);
        let mut open = masks.bits;
        for fragment in pixel.sorted.iter() {
            masks.draw(pixel.x, pixel.y, fragment.primitive, fragment.alpha, &mut self.mask);
            let visible = self.mask.count_outside(&self.covered);
            if visible > 0 {
                show(&fragment, visible);
                self.covered.unite(&self.mask);
                open -= visible;
            }
            if open == 0 {
                return;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn means_by_hand() {
        let mut shown = Shown::BACKGROUND;
        assert_eq!(shown.average(4), None);
        assert_eq!(shown.over(4, DVec3::ONE), Resolved::background(DVec3::ONE));
        shown.add(1, DVec3::X);
        shown.add(2, DVec3::new(0.0, 0.5, 8.0));
        assert_eq!(shown.average(4), Some(DVec3::new(1.0, 1.0, 16.0) / 3.0));
        assert_eq!(shown.over(4, DVec3::ONE), Resolved::new(DVec3::new(0.5, 0.5, 4.25), 0.25));
    }

    #[test]
    fn colors_of_hardly_any_coverage_stay_finite() {
        let fragment = Fragment { depth: 1.0, color: [1e30; 3], alpha: 1e-38, primitive: 0 };
        let mut shown = Shown::BACKGROUND;
        shown.add(3, unmultiplied(&fragment));
        assert!(shown.over(3, DVec3::ONE).color.as_vec3().is_finite());
    }
}
