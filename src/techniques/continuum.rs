//! The composer: the axes of Wyman's continuum (W16) as params, the published compositions and the holes
//! between them.

use super::alpha_testing::THRESHOLD;
use super::lwboit::LayeredWboit;
use super::wboit::Wboit;
use super::weighted_sum::WeightedSum;
use crate::continuum::absorbance::S_MAX;
use crate::continuum::coverage::Coverage;
use crate::continuum::door::Thresholds;
use crate::continuum::insertion::{Always, Insertion, Nearest, Threshold};
use crate::continuum::layers::{StoredLayers, StoredSteps, Stream};
use crate::continuum::masks::{ManyWords, OneWord, RandomMasks, Words, words};
use crate::continuum::merge::{
    DiscardFurthest, DiscardOccluded, DiscardOccupied, Merge, NoMerge, OverArrival, OverClosest,
    OverFurthest, OverNearest, SmallestError,
};
use crate::continuum::opacity::{Alpha, Opacity};
use crate::continuum::oracle::{Composite, Oracle, TwoPass};
use crate::continuum::placed::Placed;
use crate::continuum::range::DepthRange;
use crate::continuum::rounded_steps::RoundedSteps;
use crate::continuum::stochastic::{Visibility, VisibleByChance, VisibleSamples};
use crate::continuum::stored::Stored;
use crate::continuum::stored_layers::Kept;
use crate::continuum::stored_pass::StoredPass;
use crate::diagnosis::{Diagnosis, Faults};
use crate::error::{Error, Result};
use crate::params::{Default, Kind, ParamSpec, Params, Value, View};
use crate::technique::{
    AnyTechnique, Axes, Cost, DepthComplexity, Info, Pixel, Properties, Resolved, Streamed, Technique,
};
use crate::techniques::ANY_ORDER;
use crate::weight::{self, Weighting};
use binned::{AveragedBins, AveragedSteps, Binning, Gate, SummedBins};
use finish::Finish;
pub(super) use form::slab_as_submitted;
use setup::Setup;
use storage::{Storage, TARGETS};

mod binned;
mod finish;
mod form;
mod setup;
mod storage;

/// The registry entry.
pub static INFO: Info = Info {
    id: "continuum",
    aliases: &[],
    name: "Continuum composer",
    citation: &["Wyman2016"],
    doc: "Runs any combination of the continuum's axes that has a meaning, published or not. Published ones \
          give the same bits as the technique of that name; combinations without a meaning are refused with \
          the reason.",
    axes: Axes {
        memory: "memory",
        insertion: "insertion",
        merge: "merge",
        normalize: "normalize",
        opacity: "opacity",
    },
    params: PARAMS,
    targets: &TARGETS,
    submission_orders: ANY_ORDER,
    random: true,
    geometry_passes: "1, 1 more for accumulate=\"all\", 1 more for bins with range=\"pixel\"",
    bytes_per_pixel: "20 layers (masks: bits / 8 more each; over_nearest: 16 more), 28 n + 4 unbounded, 20 samples \
                      (all: 4, layers: 8), 20 bins (sum: 2); 20 more for a tail, global or all; about half of it in f16",
    build,
    gpu: Some(form::form),
};

const PARAMS: &[ParamSpec] = &[
    ParamSpec::new(
        "memory",
        Kind::Choice(&["none", "layers", "unbounded", "samples", "bins"]),
        Value::Text("layers"),
        "what is stored per pixel",
    ),
    ParamSpec::new(
        "insertion",
        Kind::Choice(&["always", "threshold", "nearest", "stochastic", "never"]),
        Value::Text("always"),
        "which fragments are stored: all, those of a larger alpha than threshold (as if opaque), those among \
         the layers nearest so far, those of which a random mask shows, or none",
    ),
    ParamSpec::new(
        "merge",
        Kind::Choice(&[
            "none",
            "discard_furthest",
            "over_furthest",
            "over_nearest",
            "over_closest",
            "smallest_error",
            "over_arrival",
            "discard_occluded",
            "sum",
            "average",
            "discard_occupied",
        ]),
        Value::Text("over_furthest"),
        "what gives way: the furthest layer is discarded or merged, the nearest is flushed to the front, the \
         closest two merge, or those that change transmittance least, or arrivals go on top; of a sample's \
         fragments the occluded; bins sum absorbance, average colour or keep the nearer",
    ),
    ParamSpec::new(
        "normalize",
        Kind::Choice(&["none", "tail", "global"]),
        Value::Text("none"),
        "what is done about fragments that are not stored: nothing, a blend behind what is stored, or \
         everything scaled to the exact coverage",
    ),
    ParamSpec::new(
        "opacity",
        Kind::Choice(&["alpha", "coverage"]),
        Value::Text("alpha"),
        "what a layer hides: its share of everything, or everything in its share of samples",
    ),
    ParamSpec::new(
        "accumulate",
        Kind::Choice(&["stored", "all"]),
        Value::Text("stored"),
        "composite what is stored, or all fragments in a second pass through its transmittance",
    ),
    ParamSpec::new("layers", Kind::at_least(1), Value::Int(4), "k: layers kept, or nearest fragments let in")
        .when(|p| p.text("memory") == "layers" || p.text("insertion") == "nearest"),
    ParamSpec::new("bins", Kind::at_least(1), Value::Int(32), "depth bins").when(in_bins),
    ParamSpec::new("samples", Kind::at_least(1), Value::Int(8), "samples per pixel")
        .when(|p| p.text("memory") == "samples"),
    ParamSpec::new(
        "bits",
        Kind::at_least(0),
        Value::Int(32),
        "bits of a layer's mask, or of the mask whose chance to show decides; 0, for chance, is without limit",
    )
    .when(|p| draws(p) && p.text("memory") != "samples"),
    THRESHOLD.when(|p| p.text("insertion") == "threshold"),
    ParamSpec::new(
        "probability",
        Kind::Choice(&["stratified", "random"]),
        Value::Text("stratified"),
        "a mask has alpha b bits, up to rounding, or each bit with probability alpha",
    )
    .when(draws),
    DepthRange::param("pixel").when(in_bins),
    ParamSpec { default: Default::Fixed(Value::Text("one")), ..weight::WEIGHT }.when(weighs),
    weight::WEIGHT_K.when(|p| weighs(p) && (weight::WEIGHT_K.active)(p)),
    weight::WEIGHT_SCALE.when(|p| weighs(p) && (weight::WEIGHT_SCALE.active)(p)),
    weight::WEIGHT_SHIFT.when(|p| weighs(p) && (weight::WEIGHT_SHIFT.active)(p)),
    weight::NEAR.when(|p| weighs(p) && (weight::NEAR.active)(p)),
    weight::FAR.when(|p| weighs(p) && (weight::FAR.active)(p)),
    S_MAX.when(|p| p.text("merge") == "sum"),
];

/// The chance of a wide mask to show is computed from a table of as many numbers as it has bits: 128 MB, at most.
const WIDEST_CHANCE: i64 = 1 << 24;

fn check_chances(params: &Params) -> Result<()> {
    let by_chance = params.text("insertion") == "stochastic" && params.text("memory") != "samples";
    let bits = params.int("bits");
    if by_chance && params.text("opacity") == "alpha" && bits > WIDEST_CHANCE {
        return Err(Error::Memory(format!("continuum under these params: it tabulates {bits} bits")));
    }
    Ok(())
}

fn in_bins(params: &Params) -> bool {
    params.text("memory") == "bins"
}

fn draws(params: &Params) -> bool {
    params.text("insertion") == "stochastic"
        || (params.text("opacity") == "coverage" && params.text("memory") != "samples")
}

/// Weights act where something is averaged: over all fragments, per bin, or in the tail.
fn weighs(params: &Params) -> bool {
    params.text("merge") == "average"
        || params.text("normalize") == "tail"
        || (params.text("memory") == "none" && params.text("normalize") == "global")
}

fn build(params: &Params, view: &View) -> Result<Box<dyn AnyTechnique>> {
    let setup = Setup::from_params(params, view)?;
    Weighting::from_params(params)?;
    check_chances(params)?;
    let composer = Composer { setup, params };
    Ok(match setup.memory {
        "none" => composer.functions(),
        "samples" => composer.samples(),
        "bins" if setup.merge != "discard_occupied" => composer.bins(),
        _ => composer.lists(),
    })
}

/// Makes techniques: each function fixes one axis, and passes the choice on as a type.
struct Composer<'a> {
    setup: Setup,
    params: &'a Params,
}

impl Composer<'_> {
    fn weighting(&self) -> Weighting {
        Weighting::from_params(self.params).expect("build has refused what is not a weight")
    }

    fn masks(&self, bits: usize) -> RandomMasks {
        RandomMasks {
            bits,
            stratified: self.params.text("probability") == "stratified",
            seed: self.params.size("seed") as u64,
        }
    }

    fn chance(&self) -> VisibleByChance {
        // where nothing is left to chance, a number of bits means nothing
        let bits = if self.setup.insertion == "stochastic" { self.setup.bits } else { 0 };
        let RandomMasks { bits, stratified, seed } = self.masks(bits);
        VisibleByChance { probability: Visibility::new(bits, stratified), seed }
    }

    fn threshold(&self) -> Threshold {
        Threshold(self.params.float("threshold"))
    }

    /// Memory none: functions of depth in place of what is stored.
    fn functions(&self) -> Box<dyn AnyTechnique> {
        let Storage { recipe, sums, .. } = self.setup.storage;
        let wboit = || Wboit { weighting: self.weighting(), listing3_clamp: false };
        match (self.setup.normalize, self.setup.storage.is_default()) {
            ("none", true) => self.setup.compose::<_, false>(WeightedSum),
            ("none", false) => self.setup.compose::<_, false>(Stored::new(WeightedSum, recipe, sums)),
            (_, true) => self.setup.compose::<_, false>(wboit()),
            (_, false) => self.setup.compose::<_, false>(Stored::new(wboit(), recipe, sums)),
        }
    }

    /// An opacity of samples with colours in other formats.
    fn kept<O>(&self, opacity: O) -> Kept<O> {
        Kept { opacity, nodes: self.setup.storage.nodes }
    }

    fn samples(&self) -> Box<dyn AnyTechnique> {
        let samples = self.setup.samples;
        let thresholds = Thresholds { samples };
        match self.setup.insertion {
            "stochastic" if words(samples) <= 1 => self.masked_samples::<OneWord>(),
            "stochastic" => self.masked_samples::<ManyWords>(),
            _ if self.setup.storage.is_default() => self.nested_samples(thresholds),
            _ => self.nested_samples(self.kept(thresholds)),
        }
    }

    fn nested_samples<O: Opacity>(&self, thresholds: O) -> Box<dyn AnyTechnique> {
        match self.setup.insertion {
            "threshold" => self.replayed(self.threshold(), DiscardOccluded, thresholds),
            "nearest" => self.list(Nearest(self.setup.layers), DiscardOccluded, thresholds),
            _ => self.replayed(Always, DiscardOccluded, thresholds),
        }
    }

    fn masked_samples<W: Words>(&self) -> Box<dyn AnyTechnique> {
        let coverage = Coverage::<W>::new(self.masks(self.setup.samples));
        if self.setup.storage.is_default() {
            self.replayed(Always, DiscardOccluded, coverage)
        } else {
            self.replayed(Always, DiscardOccluded, self.kept(coverage))
        }
    }

    /// Memory layers, unbounded, and bins of one fragment each.
    fn lists(&self) -> Box<dyn AnyTechnique> {
        match self.setup.opacity {
            "alpha" if self.setup.merge == "over_arrival" => self.arrivals(),
            "alpha" if self.setup.storage.is_default() => self.insertions(self.chance(), Alpha),
            "alpha" => self.stored_layers(),
            _ if words(self.setup.bits) <= 1 => self.masked_lists::<OneWord>(),
            _ => self.masked_lists::<ManyWords>(),
        }
    }

    fn masked_lists<W: Words>(&self) -> Box<dyn AnyTechnique> {
        let coverage = Coverage::<W>::new(self.masks(self.setup.bits));
        if self.setup.storage.is_default() {
            self.insertions(VisibleSamples, coverage)
        } else {
            self.insertions(VisibleSamples, self.kept(coverage))
        }
    }

    /// Layers of continuous alpha in nodes of other formats: those that never merge keep their alpha, the others what
    /// shows through, and a step function as adaptive transparency has it the transmittance behind each of its steps.
    fn stored_layers(&self) -> Box<dyn AnyTechnique> {
        let Setup { layers, storage: Storage { nodes, .. }, .. } = self.setup;
        match (self.setup.memory, self.setup.merge, self.setup.insertion, self.setup.accumulate) {
            ("unbounded", ..) => self.insertions(self.chance(), nodes.fragments()),
            (_, "smallest_error", "always", "all") => {
                let (cost, properties) = (COST, Properties::NONE);
                self.setup.second_pass::<_, false>(RoundedSteps {
                    layers,
                    protected: 1,
                    nodes,
                    cost,
                    properties,
                })
            }
            _ => self.insertions(self.chance(), nodes.alpha()),
        }
    }

    fn arrivals(&self) -> Box<dyn AnyTechnique> {
        match self.setup.insertion {
            "threshold" => self.list(self.threshold(), OverArrival, Alpha),
            "nearest" => self.list(Nearest(self.setup.layers), OverArrival, Alpha),
            "stochastic" => self.list(self.chance(), OverArrival, Alpha),
            _ => self.list(Always, OverArrival, Alpha),
        }
    }

    /// `stochastic` is how the opacity leaves insertion to chance.
    fn insertions<O: Opacity, S: Insertion<O>>(&self, stochastic: S, opacity: O) -> Box<dyn AnyTechnique> {
        match self.setup.insertion {
            "threshold" => self.merges(self.threshold(), opacity),
            "nearest" => self.merges(Nearest(self.setup.layers), opacity),
            "stochastic" => self.merges(stochastic, opacity),
            _ => self.merges(Always, opacity),
        }
    }

    fn merges<I: Insertion<O>, O: Opacity>(&self, insertion: I, opacity: O) -> Box<dyn AnyTechnique> {
        let Setup { bins, range, .. } = self.setup;
        match self.setup.merge {
            "discard_furthest" => self.list(insertion, DiscardFurthest, opacity),
            "over_furthest" => self.list(insertion, OverFurthest, opacity),
            "over_nearest" => self.list(insertion, OverNearest, opacity),
            "over_closest" => self.list(insertion, OverClosest { mean_depth: false }, opacity),
            "smallest_error" => self.list(insertion, SmallestError { protected: 1 }, opacity),
            "discard_occupied" => self.list(insertion, DiscardOccupied { bins, range }, opacity),
            _ if matches!(self.setup.insertion, "always" | "threshold") => {
                self.replayed(insertion, NoMerge, opacity)
            }
            _ => self.list(insertion, NoMerge, opacity),
        }
    }

    fn list<I: Insertion<O>, M: Merge<O>, O: Opacity>(
        &self,
        insertion: I,
        merge: M,
        opacity: O,
    ) -> Box<dyn AnyTechnique> {
        self.stored::<_, _, _, false>(insertion, merge, opacity)
    }

    /// A list that is the same in any order, and cheapest to build front to back.
    fn replayed<I: Insertion<O>, M: Merge<O>, O: Opacity>(
        &self,
        insertion: I,
        merge: M,
        opacity: O,
    ) -> Box<dyn AnyTechnique> {
        self.stored::<_, _, _, true>(insertion, merge, opacity)
    }

    fn stored<I: Insertion<O>, M: Merge<O>, O: Opacity, const SORTED: bool>(
        &self,
        insertion: I,
        merge: M,
        opacity: O,
    ) -> Box<dyn AnyTechnique> {
        let layers = if self.setup.memory == "layers" { self.setup.layers } else { usize::MAX };
        let stream = Stream { insertion, merge, opacity, layers };
        let (cost, properties) = (COST, Properties::NONE);
        // slab's tail is what its list did not store, and needs no second pass here
        if self.setup.accumulate == "stored" || self.setup.normalize == "tail" {
            let normalize = Finish::new(&self.setup, self.weighting());
            return self.setup.compose::<_, SORTED>(StoredLayers { stream, normalize, cost, properties });
        }
        self.setup.second_pass::<_, SORTED>(StoredSteps { stream, cost, properties })
    }

    fn bins(&self) -> Box<dyn AnyTechnique> {
        match self.setup.insertion {
            "threshold" => self.gated(self.threshold()),
            "nearest" => self.gated(Nearest(self.setup.layers)),
            "stochastic" => self.gated(self.chance()),
            _ => self.gated(Always),
        }
    }

    fn gated<G: Gate>(&self, gate: G) -> Box<dyn AnyTechnique> {
        let Setup { bins, range, .. } = self.setup;
        let binning = Binning { gate, bins, range };
        match (self.setup.merge, self.setup.accumulate) {
            ("sum", _) => {
                self.setup.second_pass::<_, false>(SummedBins { binning, s_max: self.params.float("s_max") })
            }
            (_, "all") => self.setup.second_pass::<_, false>(AveragedSteps(binning)),
            (_, _) => {
                let blend = LayeredWboit::naive(bins, range, self.weighting());
                let finish = Finish::new(&self.setup, self.weighting());
                self.setup.compose::<_, false>(AveragedBins { binning, blend, finish })
            }
        }
    }
}

/// Stands in for the parts' own costs: a composition's follow from all its choices.
const COST: Cost = Cost { geometry_passes: 1.0, bytes_per_pixel: 8.0 };

impl Setup {
    fn compose<T: Technique, const SORTED: bool>(self, technique: T) -> Box<dyn AnyTechnique> {
        let composed = Composed::<T, SORTED> { technique, setup: self };
        if self.storage.is_default() {
            Box::new(composed)
        } else {
            Box::new(Placed::new(composed, self.storage.nodes.depths))
        }
    }

    fn second_pass<O: Oracle, const SORTED: bool>(self, oracle: O) -> Box<dyn AnyTechnique> {
        let composite = match (self.normalize, self.memory) {
            ("global", _) => Composite::Normalize,
            (_, "samples") => Composite::ExactBackground,
            (_, _) => Composite::None,
        };
        if self.storage.is_default() {
            self.compose::<_, SORTED>(TwoPass { oracle, composite })
        } else {
            self.compose::<_, SORTED>(StoredPass { oracle, composite, recipe: self.storage.recipe })
        }
    }
}

/// A technique with the cost and the promises of its composition; `SORTED` shows it fragments front to back.
struct Composed<T, const SORTED: bool> {
    technique: T,
    setup: Setup,
}

impl<T, const SORTED: bool> Composed<T, SORTED> {
    fn shown<'a>(pixel: &Pixel<'a>) -> Pixel<'a> {
        if SORTED { Pixel { list: pixel.sorted, ..*pixel } } else { *pixel }
    }
}

impl<T: Technique, const SORTED: bool> Technique for Composed<T, SORTED> {
    type Scratch = T::Scratch;
    const NEEDS_SORTED: bool = SORTED || T::NEEDS_SORTED;
    const NEEDS_ARRIVAL: bool = !SORTED && T::NEEDS_ARRIVAL;

    fn resolve(&self, pixel: &Pixel<'_>, scratch: &mut T::Scratch) -> Resolved {
        self.technique.resolve(&Self::shown(pixel), scratch)
    }
    fn streamed(&self) -> Option<Streamed<'_>> {
        // sums and blends would be fed in submission order
        self.technique.streamed().filter(|streamed| !SORTED || matches!(streamed, Streamed::Over))
    }
    fn transmittance(&self, pixel: &Pixel<'_>, depths: &[f32], scratch: &mut T::Scratch) -> Option<Vec<f64>> {
        self.technique.transmittance(&Self::shown(pixel), depths, scratch)
    }
    fn faults(&self) -> Faults {
        self.technique.faults()
    }
    fn diagnose(&self, pixel: &Pixel<'_>, scratch: &mut T::Scratch) -> Diagnosis {
        self.technique.diagnose(&Self::shown(pixel), scratch)
    }
    fn cost(&self, complexity: &DepthComplexity) -> Cost {
        self.setup.cost(complexity)
    }
    fn properties(&self) -> Properties {
        self.setup.properties()
    }
}

#[cfg(test)]
mod tests;
