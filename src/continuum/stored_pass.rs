//! Pass B of the two-pass template with sums in other storage formats (sheets 0.3 and 1.3).

use super::oracle::{CHUNK, Composite, FLOOR, Oracle, chunks};
use super::stored_sums::{Recipe, StoredSums};
use super::sums::{Sums, blend};
use crate::format::Format;
use crate::technique::{Cost, DepthComplexity, Pixel, Properties, Resolved, Technique};

/// [`super::oracle::TwoPass`] whose sums are stored by a recipe.
pub struct StoredPass<O> {
    /// The transmittance function.
    pub oracle: O,
    /// The resolve.
    pub composite: Composite,
    /// How sums are stored.
    pub recipe: Recipe,
}

impl<O: Oracle> StoredPass<O> {
    fn accumulate(&self, map: &O::Map, pixel: &Pixel<'_>) -> Sums {
        let list = if O::NEEDS_SORTED { pixel.sorted } else { pixel.list };
        let floor = if self.composite == Composite::Normalize { FLOOR } else { 0.0 };
        let (mut sums, mut seen) = (StoredSums::CLEAR, [0.0; CHUNK]);
        for part in chunks(list) {
            self.oracle.see(map, part, &mut seen[..part.len()]);
            for ((t, &color), &alpha) in seen.iter().zip(part.color).zip(part.alpha) {
                sums.add(self.recipe, self.weight(t.max(floor)), color, alpha);
            }
        }
        sums.read(self.recipe)
    }

    /// T̂ as a shader hands it over.
    #[expect(clippy::cast_possible_truncation, reason = "shaders compute in f32")]
    fn weight(&self, transmittance: f64) -> f64 {
        if self.recipe.rgb == Format::F64 { transmittance } else { f64::from(transmittance as f32) }
    }
}

impl<O: Oracle> Technique for StoredPass<O> {
    type Scratch = O::Map;
    const NEEDS_SORTED: bool = O::NEEDS_SORTED;

    fn resolve(&self, pixel: &Pixel<'_>, map: &mut O::Map) -> Resolved {
        self.oracle.build(pixel, map);
        let sums = self.accumulate(map, pixel);
        match self.composite {
            Composite::None => blend(sums.color, 1.0, self.oracle.total(map), pixel.background),
            Composite::ExactBackground => blend(sums.color, 1.0, sums.transmittance, pixel.background),
            Composite::Normalize => sums.over(pixel.background),
        }
    }

    fn transmittance(&self, pixel: &Pixel<'_>, depths: &[f32], map: &mut O::Map) -> Option<Vec<f64>> {
        self.oracle.build(pixel, map);
        Some(depths.iter().map(|&depth| self.oracle.at(map, depth)).collect())
    }

    fn cost(&self, complexity: &DepthComplexity) -> Cost {
        self.oracle.cost(complexity)
    }

    fn properties(&self) -> Properties {
        self.recipe.properties(self.oracle.properties(self.composite))
    }
}
