//! The axis *normalisation*, chosen per pixel at run time.

use super::setup::Setup;
use crate::continuum::normalize::{Core, Global, Normalize, Tail, Unnormalized, sums_of_all};
use crate::technique::{Pixel, Resolved};
use crate::weight::Weighting;
use glam::DVec3;

/// What becomes of fragments that are not stored.
pub enum Finish {
    /// They are lost.
    None,
    /// They blend behind what is stored.
    Tail(Tail),
    /// What is stored and they behind it are scaled to the exact coverage.
    Global,
    /// What covered samples show, on average, is scaled to the exact coverage.
    Samples,
}

impl Finish {
    /// As the params say; the tail's weights matter unless they are all 1.
    pub fn new(setup: &Setup, weighting: Weighting) -> Self {
        match (setup.normalize, setup.memory) {
            ("none", _) => Self::None,
            ("tail", _) => Self::Tail(Tail { weighting: (setup.weight != "one").then_some(weighting) }),
            (_, "samples") => Self::Samples,
            (_, _) => Self::Global,
        }
    }
}

impl Normalize for Finish {
    fn resolve(&self, pixel: &Pixel<'_>, core: &Core, lost: &[u32], weights: &mut Vec<f32>) -> Resolved {
        match self {
            Self::None => Unnormalized.resolve(pixel, core, lost, weights),
            Self::Tail(tail) => tail.resolve(pixel, core, lost, weights),
            Self::Global => Global.resolve(pixel, core, lost, weights),
            Self::Samples => {
                // where no sample is covered, nothing is known of the layers' colour
                let average = if core.coverage > 0.0 { core.color / core.coverage } else { DVec3::ZERO };
                sums_of_all(pixel.list).read(pixel.list.len()).cover(average, pixel.background)
            }
        }
    }
}
