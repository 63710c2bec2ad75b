//! The two-pass template with its map and its targets in any storage format (sheet 0.3 and 1.3, "Storage").
//!
//! What pass A adds up is rounded to its format after every fragment's addition, in submission order; what one thread
//! writes for a whole pixel is rounded when it is written. Pass B blends with T̂ for a weight, as [`Recipe`] says.

use super::oracle::{Composite, Oracle, TwoPass};
use super::stored_pass::{look_through, watch_through};
use super::stored_sums::Recipe;
use crate::diagnosis::{Diagnosis, Faults};
use crate::format::{Format, FormatSet, Formats, Summation, Target};
use crate::fragments::{List, Lists};
use crate::order::sort_key;
use crate::params::Params;
use crate::technique::{AnyTechnique, Cost, DepthComplexity, Pixel, Properties, Resolved, Technique};

/// An oracle whose map can be stored in any of its formats.
pub trait StoredOracle: Oracle {
    /// Pass A with the map in these formats.
    fn build_stored(&self, pixel: &Pixel<'_>, formats: &Formats, map: &mut Self::Map);

    /// How many texels of each of the map's targets a pixel holds.
    fn texels(&self, complexity: &DepthComplexity) -> Vec<(&'static str, f64)>;
}

/// A target of numbers that add up, which the default keeps in f64.
pub const fn coefficients(name: &'static str, param: &'static str, doc: &'static str) -> Target {
    Target { name, param, doc, formats: FormatSet::FLOATS, channels: 1, double: true, active: |_| true }
}

/// Coefficients of a series.
pub const COEFFICIENTS: Target = coefficients(
    "coefficients",
    "coefficients_format",
    "format of the coefficients; format=\"f32\" keeps them in f64, \"f32\" here stands for R32F targets",
);

/// Sums of absorbance in bins.
pub const BINS: Target = coefficients(
    "bins",
    "bins_format",
    "format of the bins' absorbance; format=\"f32\" keeps it in f64, \"f32\" here stands for R32F targets",
);

/// Transmittance in the nodes of a polyline.
pub const NODES: Target = Target {
    name: "nodes",
    param: "nodes_format",
    doc: "format of the nodes' transmittance; format=\"f32\" keeps it in f64, \"f32\" here stands for what a buffer holds",
    formats: FormatSet::SHARES,
    channels: 1,
    double: true,
    active: |_| true,
};

/// Where the nodes of a polyline are. Both passes see fragments there, so that no node hides its own fragment.
pub const NODE_DEPTH: Target = Target {
    name: "node_depth",
    param: "node_depth_format",
    doc: "format of the nodes' depth, a distance; both passes round depths to it",
    formats: FormatSet::FLOATS,
    channels: 1,
    double: false,
    active: |_| true,
};

/// The technique of these params that looks through `oracle`: [`TwoPass`] where nothing is stored otherwise than by
/// default.
pub fn technique<O: StoredOracle>(
    oracle: O,
    targets: &'static [Target],
    params: &Params,
) -> Box<dyn AnyTechnique> {
    let composite = Composite::from_params(params);
    let storage = Storage::from_params(targets, params);
    if storage.formats.are_default() && storage.recipe.summation == Summation::Plain {
        return Box::new(TwoPass { oracle, composite });
    }
    Box::new(StoredTwoPass { oracle, composite, storage })
}

/// What is stored how.
struct Storage {
    formats: Formats,
    recipe: Recipe,
    /// The map's targets.
    map: Vec<Target>,
}

/// Whether a target is one of pass B.
fn is_accumulated(target: &Target) -> bool {
    target.name == Target::ACCUMULATION.name || target.name == Target::REVEALAGE.name
}

impl Storage {
    fn from_params(targets: &'static [Target], params: &Params) -> Self {
        let formats = Formats::from_params(targets, params);
        let recipe = Recipe { revealage: formats.of("revealage"), ..Recipe::from_params(&formats, params) };
        let map = targets.iter().filter(|target| !is_accumulated(target)).copied().collect();
        Self { formats, recipe, map }
    }

    /// Whether the map is kept as the default keeps it.
    fn has_default_map(&self) -> bool {
        let usual = |target: &Target| if target.double { Format::F64 } else { Format::F32 };
        self.map.iter().all(|target| self.formats.of(target.name) == usual(target))
    }

    /// Whether every format of the map is one of these. Depths are f32, so that no wider format adds to them.
    fn has_map_in(&self, formats: FormatSet) -> bool {
        let depths = FormatSet::of(&[Format::F32, Format::F64]);
        self.map.iter().all(|target| {
            let allowed = if target.name == NODE_DEPTH.name { depths } else { formats };
            allowed.has(self.formats.of(target.name))
        })
    }

    /// The format that both passes round depths to, if they do.
    fn depth(&self) -> Option<Format> {
        let target = self.map.iter().find(|target| target.name == NODE_DEPTH.name)?;
        let format = self.formats.of(target.name);
        (!matches!(format, Format::F64 | Format::F32)).then_some(format)
    }

    /// What the targets take, given how many texels of each there are.
    fn bytes_per_pixel(&self, texels: &[(&'static str, f64)]) -> f64 {
        let sums = self.recipe.bytes_per_pixel(&self.formats, self.formats.bytes_of("accumulation"));
        // of which each target is one already
        let more = texels.iter().map(|(name, count)| (count - 1.0) * self.formats.bytes_of(name));
        sums + more.sum::<f64>()
    }

    /// What a technique with these promises still promises.
    fn properties(&self, composite: Composite, promises: Properties) -> Properties {
        let double = self.has_map_in(FormatSet::of(&[Format::F64]));
        let single = self.has_map_in(FormatSet::of(&[Format::F64, Format::F32]));
        let kept = self.recipe.properties(promises);
        // a weighted average of one colour is exact whatever the weights are
        let looks = single || composite == Composite::Normalize;
        Properties {
            unbiased: kept.unbiased && single,
            consistent: kept.consistent && single,
            exact_for_one: kept.exact_for_one && looks,
            exact_for_one_color: kept.exact_for_one_color && looks,
            exact_coverage: kept.exact_coverage && (double || composite != Composite::None),
            ..kept
        }
    }
}

/// A technique that looks through an oracle whose targets are of other formats than its default.
struct StoredTwoPass<O> {
    oracle: O,
    composite: Composite,
    storage: Storage,
}

/// One pixel's map, and its fragments where their depths are rounded.
#[derive(Default)]
pub struct Scratch<M> {
    map: M,
    list: Lists,
    sorted: Lists,
}

#[expect(clippy::cast_possible_truncation, reason = "depths are read as f32")]
fn round_depth(format: Format, depth: f32) -> f32 {
    format.read(format.round(depth.into())) as f32
}

/// The fragments with their depths rounded.
fn with_depths(format: Format, list: List<'_>, out: &mut Lists, sort: bool) {
    let mut rounded: Vec<_> = list.iter().collect();
    rounded.iter_mut().for_each(|f| f.depth = round_depth(format, f.depth));
    if sort {
        rounded.sort_by_key(|f| sort_key(f.depth, f.primitive));
    }
    out.clear();
    rounded.into_iter().for_each(|f| out.push(f));
    out.end_row();
}

impl<O: StoredOracle> StoredTwoPass<O> {
    /// Pass A, then `see` the pixel through the map.
    fn look<R>(
        &self,
        pixel: &Pixel<'_>,
        scratch: &mut Scratch<O::Map>,
        see: impl FnOnce(&Pixel<'_>, &O::Map) -> R,
    ) -> R {
        let Scratch { map, list, sorted } = scratch;
        let Some(format) = self.storage.depth() else {
            self.build(pixel, map);
            return see(pixel, map);
        };
        with_depths(format, pixel.list, list, false);
        with_depths(format, pixel.sorted, sorted, true);
        let pixel = Pixel { list: list.as_ref().row(0), sorted: sorted.as_ref().row(0), ..*pixel };
        self.build(&pixel, map);
        see(&pixel, map)
    }

    fn build(&self, pixel: &Pixel<'_>, map: &mut O::Map) {
        if self.storage.has_default_map() {
            self.oracle.build(pixel, map);
        } else {
            self.oracle.build_stored(pixel, &self.storage.formats, map);
        }
    }
}

impl<O: StoredOracle> Technique for StoredTwoPass<O> {
    type Scratch = Scratch<O::Map>;
    const NEEDS_SORTED: bool = O::NEEDS_SORTED;

    fn resolve(&self, pixel: &Pixel<'_>, scratch: &mut Self::Scratch) -> Resolved {
        let (composite, recipe) = (self.composite, self.storage.recipe);
        self.look(pixel, scratch, |pixel, map| look_through(&self.oracle, map, pixel, composite, recipe))
    }

    fn transmittance(
        &self,
        pixel: &Pixel<'_>,
        depths: &[f32],
        scratch: &mut Self::Scratch,
    ) -> Option<Vec<f64>> {
        let rounded = |depth| self.storage.depth().map_or(depth, |format| round_depth(format, depth));
        Some(self.look(pixel, scratch, |_, map| {
            depths.iter().map(|&depth| self.oracle.at(map, rounded(depth))).collect()
        }))
    }

    fn faults(&self) -> Faults {
        self.oracle.faults().union(self.storage.recipe.faults())
    }

    fn diagnose(&self, pixel: &Pixel<'_>, scratch: &mut Self::Scratch) -> Diagnosis {
        let (composite, recipe) = (self.composite, self.storage.recipe);
        self.look(pixel, scratch, |pixel, map| {
            let of_sums = watch_through(&self.oracle, map, pixel, composite, recipe);
            self.oracle.diagnose(map, pixel.list).and(&of_sums)
        })
    }

    fn cost(&self, complexity: &DepthComplexity) -> Cost {
        const SINGLE: f64 = 4.0;
        let cost = self.oracle.cost(complexity);
        let texels = self.oracle.texels(complexity);
        // all that has no format of its own is as by default
        let by_default = SINGLE * (5.0 + texels.iter().map(|(_, count)| count).sum::<f64>());
        let bytes_per_pixel = cost.bytes_per_pixel - by_default + self.storage.bytes_per_pixel(&texels);
        Cost { bytes_per_pixel, ..cost }
    }

    fn properties(&self) -> Properties {
        self.storage.properties(self.composite, self.oracle.properties(self.composite))
    }
}

#[cfg(test)]
mod hazards;
#[cfg(test)]
mod tests;
