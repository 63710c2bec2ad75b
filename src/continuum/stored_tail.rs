//! The axis *normalisation* with tails in other storage formats.

use super::normalize::{Core, Normalize};
use super::stored_sums::{Recipe, StoredSums};
use super::sums::Sums;
use crate::fragments::List;
use crate::technique::{Pixel, Resolved};
use crate::weight::Weighting;

/// The stored blend of the fragments at these places of a list.
pub fn stored_sums_of(recipe: Recipe, weighting: Option<&Weighting>, list: List<'_>, places: &[u32]) -> Sums {
    let (mut sums, mut weights) = (StoredSums::CLEAR, Vec::new());
    let of = |numbers: &[f32]| places.iter().map(|&i| numbers[i as usize]).collect::<Vec<_>>();
    recipe.weigh(weighting, &of(list.depth), &of(list.alpha), &mut weights);
    for (&i, &weight) in places.iter().zip(&weights) {
        sums.add(recipe, weight, list.color[i as usize], list.alpha[i as usize]);
    }
    sums.read(recipe)
}

/// The stored blend of all fragments of a list.
pub fn stored_sums_of_all(recipe: Recipe, list: List<'_>) -> Sums {
    recipe.blend_list(None, list, &mut Vec::new()).read(recipe)
}

/// [`super::normalize::Tail`] in sums of a format.
pub struct StoredTail {
    /// The average's weights; without, all fragments weigh the same.
    pub weighting: Option<Weighting>,
    /// How sums are stored.
    pub recipe: Recipe,
}

impl Normalize for StoredTail {
    fn resolve(&self, pixel: &Pixel<'_>, core: &Core, lost: &[u32], _weights: &mut Vec<f32>) -> Resolved {
        let tail = stored_sums_of(self.recipe, self.weighting.as_ref(), pixel.list, lost);
        core.over_tail(tail.over(pixel.background))
    }
}

/// [`super::normalize::Global`] in sums of a format.
pub struct StoredGlobal {
    /// How sums are stored.
    pub recipe: Recipe,
}

impl Normalize for StoredGlobal {
    fn resolve(&self, pixel: &Pixel<'_>, core: &Core, lost: &[u32], _weights: &mut Vec<f32>) -> Resolved {
        let all = stored_sums_of_all(self.recipe, pixel.list);
        let tail = stored_sums_of(self.recipe, None, pixel.list, lost);
        let tail = (tail.color, tail.alpha);
        core.scale_sums_to(tail, all.coverage, all.transmittance, pixel.background)
    }
}
