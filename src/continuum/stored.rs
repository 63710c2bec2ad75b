//! A blended technique whose targets are of other formats than its default: resolved from lists.

use super::stored_sums::Recipe;
use super::stored_sums::diagnose::{diagnose, faults};
use super::sums::Blended;
use crate::diagnosis::{Diagnosis, Faults};
use crate::technique::{AnyTechnique, Cost, DepthComplexity, Pixel, Properties, Resolved, Technique};

/// A blended technique and how its sums are stored.
pub struct Stored<T> {
    technique: T,
    recipe: Recipe,
    bytes_per_pixel: f64,
}

impl<T: Technique + Blended> Stored<T> {
    /// `technique` with sums that are stored by `recipe` in so many bytes.
    pub fn new(technique: T, recipe: Recipe, bytes_per_pixel: f64) -> Self {
        Self { technique, recipe, bytes_per_pixel }
    }

    /// The same behind a pointer.
    pub fn boxed(technique: T, recipe: Recipe, bytes_per_pixel: f64) -> Box<dyn AnyTechnique> {
        Box::new(Self::new(technique, recipe, bytes_per_pixel))
    }
}

impl<T: Technique + Blended> Technique for Stored<T> {
    type Scratch = Vec<f64>;
    const SEES_ZERO_FRAGMENTS: bool = T::SEES_ZERO_FRAGMENTS;

    fn resolve(&self, pixel: &Pixel<'_>, weights: &mut Vec<f64>) -> Resolved {
        let sums = self.recipe.blend_list(self.technique.weighting(), pixel.list, weights);
        Resolved {
            dropped: sums.saturated.into(),
            ..self.technique.finish(&sums.read(self.recipe), pixel.background)
        }
    }

    fn cost(&self, complexity: &DepthComplexity) -> Cost {
        Cost { bytes_per_pixel: self.bytes_per_pixel, ..Technique::cost(&self.technique, complexity) }
    }

    fn properties(&self) -> Properties {
        self.recipe.properties(Technique::properties(&self.technique))
    }

    fn faults(&self) -> Faults {
        faults(&self.technique, self.recipe)
    }

    fn diagnose(&self, pixel: &Pixel<'_>, _weights: &mut Vec<f64>) -> Diagnosis {
        diagnose(&self.technique, self.recipe, pixel.list)
    }
}
