//! The axis *normalisation*, chosen per pixel at run time.

use super::setup::Setup;
use crate::continuum::normalize::{Core, Global, Normalize, Tail, Unnormalized, sums_of_all};
use crate::continuum::stored_sums::Recipe;
use crate::continuum::stored_tail::{StoredGlobal, StoredTail, stored_sums_of_all};
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
    /// The same three with sums in other formats.
    StoredTail(StoredTail),
    StoredGlobal(StoredGlobal),
    StoredSamples(Recipe),
}

impl Finish {
    /// As the params say; the tail's weights matter unless they are all 1.
    pub fn new(setup: &Setup, weighting: Weighting) -> Self {
        let recipe = setup.storage.recipe;
        let weighting = setup.weighs.then_some(weighting);
        match (setup.normalize, setup.memory) {
            ("none", _) => Self::None,
            ("tail", _) if setup.storage.is_default() => Self::Tail(Tail { weighting }),
            ("tail", _) => Self::StoredTail(StoredTail { weighting, recipe }),
            (_, "samples") if !setup.storage.is_default() => Self::StoredSamples(recipe),
            _ if !setup.storage.is_default() => Self::StoredGlobal(StoredGlobal { recipe }),
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
            Self::StoredTail(tail) => tail.resolve(pixel, core, lost, weights),
            Self::StoredGlobal(global) => global.resolve(pixel, core, lost, weights),
            Self::Samples => {
                sums_of_all(pixel.list).read(pixel.list.len()).cover(average(core), pixel.background)
            }
            Self::StoredSamples(recipe) => {
                stored_sums_of_all(*recipe, pixel.list).cover(average(core), pixel.background)
            }
        }
    }
}

/// What covered samples show; where none is covered, nothing is known of the layers' colour.
fn average(core: &Core) -> DVec3 {
    if core.coverage > 0.0 { core.color / core.coverage } else { DVec3::ZERO }
}
