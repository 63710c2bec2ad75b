//! Pass B of the two-pass template with sums in other storage formats (sheets 0.3 and 1.3).

use super::oracle::{CHUNK, Composite, FLOOR, Oracle, chunks};
use super::stored_sums::diagnose::diagnose_weighted;
use super::stored_sums::{Recipe, StoredSums};
use super::sums::blend;
use crate::diagnosis::{Diagnosis, Faults};
use crate::format::Format;
use crate::fragments::List;
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

/// Pass B: every fragment through the map, then the resolve.
pub fn look_through<O: Oracle>(
    oracle: &O,
    map: &O::Map,
    pixel: &Pixel<'_>,
    composite: Composite,
    recipe: Recipe,
) -> Resolved {
    let mut stored = StoredSums::CLEAR;
    each_weighed(oracle, map, pixel, composite, recipe, |weight, color, alpha| {
        stored.add(recipe, weight, color, alpha);
    });
    let sums = stored.read(recipe);
    let resolved = match composite {
        Composite::None => blend(sums.color, 1.0, oracle.total(map), pixel.background),
        Composite::ExactBackground => blend(sums.color, 1.0, sums.transmittance, pixel.background),
        Composite::Normalize => sums.over(pixel.background),
    };
    Resolved { dropped: stored.saturated.into(), ..resolved }
}

/// What goes wrong with the sums of pass B.
pub fn watch_through<O: Oracle>(
    oracle: &O,
    map: &O::Map,
    pixel: &Pixel<'_>,
    composite: Composite,
    recipe: Recipe,
) -> Diagnosis {
    let mut weights = Vec::new();
    each_weighed(oracle, map, pixel, composite, recipe, |weight, _, _| weights.push(weight));
    diagnose_weighted(recipe, &weights, looked_at::<O>(pixel)).0
}

/// The fragments in the order in which pass B blends them.
fn looked_at<'a, O: Oracle>(pixel: &Pixel<'a>) -> List<'a> {
    if O::NEEDS_SORTED { pixel.sorted } else { pixel.list }
}

/// Hands out every fragment's colour and alpha with what it weighs, seen through the map.
fn each_weighed<O: Oracle>(
    oracle: &O,
    map: &O::Map,
    pixel: &Pixel<'_>,
    composite: Composite,
    recipe: Recipe,
    mut blend: impl FnMut(f64, [f32; 3], f32),
) {
    let mut seen = [0.0; CHUNK];
    for part in chunks(looked_at::<O>(pixel)) {
        oracle.see(map, part, &mut seen[..part.len()]);
        for ((t, &color), &alpha) in seen.iter().zip(part.color).zip(part.alpha) {
            blend(weight(recipe, composite, *t), color, alpha);
        }
    }
}

/// T̂ as a shader hands it over for a weight, or its logarithm. The floor under it is lost in formats that cannot hold
/// it, unless sums are scaled.
#[expect(clippy::cast_possible_truncation, reason = "shaders compute in f32")]
fn weight(recipe: Recipe, composite: Composite, t: f64) -> f64 {
    let t = t.max(if composite == Composite::Normalize { FLOOR } else { 0.0 });
    match recipe.rgb {
        _ if recipe.summation.is_scaled() => t.log2(),
        Format::F64 => t,
        _ => f64::from(t as f32),
    }
}

impl<O: Oracle> Technique for StoredPass<O> {
    type Scratch = O::Map;
    const NEEDS_SORTED: bool = O::NEEDS_SORTED;

    fn resolve(&self, pixel: &Pixel<'_>, map: &mut O::Map) -> Resolved {
        self.oracle.build(pixel, map);
        look_through(&self.oracle, map, pixel, self.composite, self.recipe)
    }

    fn transmittance(&self, pixel: &Pixel<'_>, depths: &[f32], map: &mut O::Map) -> Option<Vec<f64>> {
        self.oracle.build(pixel, map);
        Some(depths.iter().map(|&depth| self.oracle.at(map, depth)).collect())
    }

    fn faults(&self) -> Faults {
        self.oracle.faults().union(self.recipe.faults())
    }

    fn diagnose(&self, pixel: &Pixel<'_>, map: &mut O::Map) -> Diagnosis {
        self.oracle.build(pixel, map);
        let of_sums = watch_through(&self.oracle, map, pixel, self.composite, self.recipe);
        self.oracle.diagnose(map, pixel.list).and(&of_sums)
    }

    fn cost(&self, complexity: &DepthComplexity) -> Cost {
        self.oracle.cost(complexity)
    }

    fn properties(&self) -> Properties {
        self.recipe.properties(self.oracle.properties(self.composite))
    }
}
