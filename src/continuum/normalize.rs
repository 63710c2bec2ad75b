//! The axis *normalisation*: what becomes of the fragments that a list had no room for.

use super::sums::{BlendSums, blend};
use crate::fragments::List;
use crate::technique::{Pixel, Resolved};
use crate::weight::Weighting;
use glam::DVec3;

/// Stored layers composited front to back.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Core {
    /// Premultiplied colour.
    pub color: DVec3,
    /// How much of the background `color` covers, summed as it telescopes.
    pub coverage: f64,
    /// The background's share.
    pub transmittance: f64,
}

impl Core {
    /// Nothing yet.
    pub const CLEAR: Self = Self { color: DVec3::ZERO, coverage: 0.0, transmittance: 1.0 };

    /// Puts a layer of premultiplied `color` behind what is there.
    pub fn put_behind(&mut self, color: DVec3, coverage: f64, transmittance: f64) {
        self.color += self.transmittance * color;
        self.coverage += self.transmittance * coverage;
        self.transmittance *= transmittance;
    }

    /// The layers over the background.
    pub fn over(&self, background: DVec3) -> Resolved {
        blend(self.color, 1.0, self.transmittance, background)
    }

    /// The layers over what `tail` makes of the background.
    pub fn over_tail(&self, tail: Resolved) -> Resolved {
        Resolved {
            transmittance: self.transmittance * tail.transmittance,
            ..blend(self.color, 1.0, self.transmittance, tail.color)
        }
    }

    /// W16 eq. 9 with the background's share: the layers and what lies behind them, scaled to cover
    /// `coverage` = 1 − `transmittance` of the background.
    pub fn scale_to(
        &self,
        tail: &BlendSums,
        coverage: f64,
        transmittance: f64,
        background: DVec3,
    ) -> Resolved {
        self.scale_sums_to((tail.color(), tail.alpha()), coverage, transmittance, background)
    }

    /// [`Core::scale_to`] with Σ C and Σ a of what lies behind.
    pub fn scale_sums_to(
        &self,
        (color, alpha): (DVec3, f64),
        coverage: f64,
        transmittance: f64,
        background: DVec3,
    ) -> Resolved {
        let color = self.color + self.transmittance * color;
        let covered = self.coverage + self.transmittance * alpha;
        if covered > 0.0 {
            blend(color / covered, coverage, transmittance, background)
        } else {
            Resolved::background(background)
        }
    }
}

/// What to do about fragments that are not stored.
pub trait Normalize: Send + Sync + 'static {
    /// Whether fragments that neither cover nor emit count (sheet 0.1).
    const SEES_ZERO_FRAGMENTS: bool = false;

    /// The pixel, given its stored layers and the places in its list of the fragments that were refused or
    /// discarded.
    fn resolve(&self, pixel: &Pixel<'_>, core: &Core, lost: &[u32], weights: &mut Vec<f32>) -> Resolved;
}

/// They are lost, and the background shows in their place.
#[derive(Debug, Clone, Copy)]
pub struct Unnormalized;

impl Normalize for Unnormalized {
    fn resolve(&self, pixel: &Pixel<'_>, core: &Core, _lost: &[u32], _weights: &mut Vec<f32>) -> Resolved {
        core.over(pixel.background)
    }
}

/// Their average lies behind the stored layers and covers as much as they do together (hybrid transparency).
pub struct Tail {
    /// The average's weights; without, all fragments weigh the same.
    pub weighting: Option<Weighting>,
}

impl Normalize for Tail {
    fn resolve(&self, pixel: &Pixel<'_>, core: &Core, lost: &[u32], weights: &mut Vec<f32>) -> Resolved {
        let list = pixel.list;
        let Some(weighting) = &self.weighting else {
            return core.over_tail(sums_of(list, lost).over(pixel.background));
        };
        if !lost.is_empty() {
            let is_lost = |i| lost.iter().any(|&place| place as usize == i);
            weighting.evaluate_for(list.depth, list.alpha, weights, is_lost);
        }
        let mut sums = BlendSums::CLEAR;
        for i in lost.iter().map(|&i| i as usize) {
            sums.add(weights[i], list.color[i], list.alpha[i]);
        }
        core.over_tail(sums.over(pixel.background))
    }
}

/// They are added up behind the stored layers, then everything is scaled to the exact coverage (W16 eq. 9).
#[derive(Debug, Clone, Copy)]
pub struct Global;

impl Normalize for Global {
    fn resolve(&self, pixel: &Pixel<'_>, core: &Core, lost: &[u32], _weights: &mut Vec<f32>) -> Resolved {
        let all = sums_of_all(pixel.list);
        let tail = sums_of(pixel.list, lost);
        core.scale_to(&tail, all.coverage(), all.transmittance(), pixel.background)
    }
}

/// The blend of the fragments at these places of a list.
pub fn sums_of(list: List<'_>, places: &[u32]) -> BlendSums {
    let mut sums = BlendSums::CLEAR;
    for i in places.iter().map(|&i| i as usize) {
        sums.add(1.0, list.color[i], list.alpha[i]);
    }
    sums
}

/// The blend of all fragments of a list.
pub fn sums_of_all(list: List<'_>) -> BlendSums {
    let mut sums = BlendSums::CLEAR;
    for (&color, &alpha) in list.color.iter().zip(list.alpha) {
        sums.add(1.0, color, alpha);
    }
    sums
}
