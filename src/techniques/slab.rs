//! Stochastic layered alpha blending (Wyman 2016, section 4): the k nearest of the fragments that a random
//! mask would show. Between stochastic transparency (k = b masks) and hybrid transparency (b → ∞).

use crate::continuum::coverage::Coverage;
use crate::continuum::insertion::Insertion;
use crate::continuum::layers::{StoredLayers, StoredSteps, Stream};
use crate::continuum::masks::{ManyWords, OneWord, RandomMasks, TwoWords, Words, words};
use crate::continuum::merge::DiscardFurthest;
use crate::continuum::nodes::{Nodes, bytes_of_sums, sums};
use crate::continuum::normalize::{Tail, Unnormalized};
use crate::continuum::opacity::{Alpha, Opacity};
use crate::continuum::oracle::{Composite, TwoPass};
use crate::continuum::placed::Placed;
use crate::continuum::stochastic::{Visibility, VisibleByChance, VisibleSamples};
use crate::continuum::stored_layers::Kept;
use crate::continuum::stored_pass::StoredPass;
use crate::continuum::stored_sums::Recipe;
use crate::continuum::stored_tail::StoredTail;
use crate::diagnosis::{Diagnosis, Faults};
use crate::error::Result;
use crate::format::{Formats, Target};
use crate::gpu::form::{Form, Number, Path, Streaming, mask_size, masking, only_single_formats, saturated};
use crate::params::{Kind, ParamSpec, Params, Value, View};
use crate::technique::{
    AnyTechnique, Axes, Cost, DepthComplexity, Info, Pixel, Properties, Resolved, Technique,
};
use crate::techniques::ANY_ORDER;
use crate::techniques::continuum::slab_as_submitted;

/// The registry entry.
pub static INFO: Info = Info {
    id: "slab",
    aliases: &[],
    name: "Stochastic layered alpha blending",
    citation: &["Wyman2016"],
    doc: "A fragment enters the list of k layers if a random mask of its alpha would show behind the masks in \
          front; the furthest layer is discarded. With k = b bits and sorted replay these are stochastic \
          transparency's samples; with more bits noise falls and what is left is the bias of k layers. Layers \
          keep masks, or alphas with the masks' probability to show.",
    axes: Axes {
        memory: "k layers",
        insertion: "stochastic",
        merge: "discard furthest",
        normalize: "α-weighted average",
        opacity: "either",
    },
    params: &[
        ParamSpec::new("layers", Kind::at_least(1), Value::Int(4), "layers kept per pixel"),
        ParamSpec::new(
            "bits",
            Kind::Int { min: 0, max: 4096 },
            Value::Int(32),
            "bits of a mask; 0, for alpha alone, is without limit: every fragment enters",
        ),
        ParamSpec::new(
            "variant",
            Kind::Choice(&["mask", "alpha"]),
            Value::Text("mask"),
            "what a layer keeps: its mask, or its alpha, entering with the probability P_b that a mask shows",
        ),
        ParamSpec::new(
            "probability",
            Kind::Choice(&["stratified", "random"]),
            Value::Text("stratified"),
            "a mask has alpha b bits, up to rounding (W16 eq. 4), or each bit with probability alpha (eq. 3)",
        )
        .when(|p| p.int("bits") > 0),
        ParamSpec::new(
            "accumulate",
            Kind::Choice(&["stored", "all"]),
            Value::Text("all"),
            "the layers' own colours, or all fragments in a second pass through the layers' transmittance",
        ),
        ParamSpec::new(
            "correction",
            Kind::Choice(&["none", "global", "tail"]),
            Value::Text("global"),
            "in the second pass: none; everything scaled to the exact coverage (W16 eq. 9); or the layers as \
             they are, with the average of all other fragments behind them",
        )
        .when(|p| p.text("accumulate") == "all"),
        ParamSpec::new(
            "replay",
            Kind::Choice(&["sorted", "as_is"]),
            Value::Text("sorted"),
            "front to back, so that order of submission cannot matter, or as submitted: then a layer that \
             is hidden later may have pushed out a visible one",
        ),
    ],
    targets: &TARGETS,
    submission_orders: ANY_ORDER,
    random: true,
    geometry_passes: "stored: 1; all: 2",
    bytes_per_pixel: "all: layers (4 + b / 8) + 20 for masks, 8 layers + 20 for alphas; stored: layers (20 + b / 8) for \
                      masks, 20 layers for alphas; half of that in f16, b / 8 aside",
    build,
    gpu: Some(gpu),
};

static TARGETS: [Target; 5] = [
    Target::NODE_COLOR.when(|p| p.text("accumulate") == "stored"),
    Target::NODE_SHARE.when(|p| p.text("variant") == "alpha" && p.text("accumulate") == "all"),
    Target::NODE_DEPTH,
    Target::ACCUMULATION.when(|p| p.text("accumulate") == "all"),
    Target::REVEALAGE.when(|p| p.text("accumulate") == "all"),
];

fn build(params: &Params, view: &View) -> Result<Box<dyn AnyTechnique>> {
    let setup = Setup::from_params(params, view);
    let (bits, seed) = (setup.bits, params.size("seed") as u64);
    let stratified = params.text("probability") == "stratified";
    if !setup.masks {
        let probability = Visibility::new(bits, stratified);
        let chance = VisibleByChance { probability, seed };
        return Ok(if setup.nodes.are_default {
            setup.technique(chance, Alpha)
        } else {
            setup.stored_technique(chance, setup.nodes.alpha())
        });
    }
    let masks = RandomMasks { bits, stratified, seed };
    Ok(match words(bits) {
        0 => {
            let valid = "a mask has 1 to 4096 bits; bits=0, without limit, goes with variant=\"alpha\"";
            return Err(params.error("bits is 0 with variant=\"mask\"", valid));
        }
        1 => setup.masked::<OneWord>(masks),
        2 => setup.masked::<TwoWords>(masks),
        _ => setup.masked::<ManyWords>(masks),
    })
}

/// Its form on a GPU: fragments as they are sorted, or as a composition of the continuum; with nodes in f32 and the CPU's masks.
fn gpu(params: &Params, view: &View) -> Result<Form> {
    only_single_formats(params, INFO.targets)?;
    let setup = Setup::from_params(params, view);
    if !setup.sorted && !setup.properties().order_independent {
        let second_pass = match setup.accumulate {
            Accumulate::All(composite) => Some(composite),
            _ => None,
        };
        return slab_as_submitted(params, setup.accumulate == Accumulate::Tail, second_pass);
    }
    let sizes = vec![mask_size(params, "bits")?];
    let (accumulate, composite) = match setup.accumulate {
        Accumulate::Stored => (0, Composite::None),
        Accumulate::All(composite) => (1, composite),
        Accumulate::Tail => (2, Composite::None),
    };
    let more = [
        saturated(params.size("layers")),
        Number::Whole((params.text("variant") == "mask").into()),
        Number::Whole(accumulate),
        composite.number(),
    ];
    let masking = masking(params, "bits", params.text("probability") == "stratified");
    Ok(Form {
        weight: None,
        shader: include_str!("../../shaders/slab.wgsl"),
        numbers: masking.into_iter().chain(more).collect(),
        path: Path::Streamed(Streaming::nearest_first().of_sizes(sizes)),
        shows_zero_fragments: false,
        colored_transmittance: false,
    })
}

/// How colours are accumulated.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Accumulate {
    Stored,
    All(Composite),
    Tail,
}

/// The params that do not concern randomness.
#[derive(Debug, Clone, Copy)]
struct Setup {
    layers: usize,
    bits: usize,
    masks: bool,
    sorted: bool,
    accumulate: Accumulate,
    /// How layers are stored, the sums of a second pass, and the bytes of these.
    nodes: Nodes,
    recipe: Recipe,
    sums: f64,
}

impl Setup {
    fn from_params(params: &Params, view: &View) -> Self {
        let formats = Formats::from_params(INFO.targets, params);
        let nodes = Nodes::new(&formats, view);
        let masks = params.text("variant") == "mask";
        let accumulate = match (params.text("accumulate"), params.text("correction")) {
            ("stored", _) => Accumulate::Stored,
            (_, "tail") => Accumulate::Tail,
            (_, "none") => Accumulate::All(Composite::None),
            (_, _) => Accumulate::All(Composite::Normalize),
        };
        Self {
            layers: params.size("layers"),
            bits: params.size("bits"),
            masks,
            sorted: params.text("replay") == "sorted",
            accumulate,
            nodes: if masks { nodes.without_shares() } else { nodes },
            recipe: sums(&formats),
            sums: bytes_of_sums(&formats),
        }
    }

    fn masked<W: Words>(&self, masks: RandomMasks) -> Box<dyn AnyTechnique> {
        let (opacity, nodes) = (Coverage::<W>::new(masks), self.nodes);
        if nodes.are_default {
            self.technique(VisibleSamples, opacity)
        } else {
            self.stored_technique(VisibleSamples, Kept { opacity, nodes })
        }
    }

    fn technique<I: Insertion<O>, O: Opacity>(&self, insertion: I, opacity: O) -> Box<dyn AnyTechnique> {
        let stream = Stream { insertion, merge: DiscardFurthest, opacity, layers: self.layers };
        let (cost, properties) = (self.cost(), self.properties());
        match self.accumulate {
            Accumulate::Stored => {
                self.replay(StoredLayers { stream, normalize: Unnormalized, cost, properties })
            }
            Accumulate::Tail => {
                self.replay(StoredLayers { stream, normalize: Tail { weighting: None }, cost, properties })
            }
            Accumulate::All(composite) => {
                self.replay(TwoPass { oracle: StoredSteps { stream, cost, properties }, composite })
            }
        }
    }

    /// The same with nodes and sums in other formats.
    fn stored_technique<I: Insertion<O>, O: Opacity>(
        &self,
        insertion: I,
        opacity: O,
    ) -> Box<dyn AnyTechnique> {
        let stream = Stream { insertion, merge: DiscardFurthest, opacity, layers: self.layers };
        let (cost, recipe) = (self.cost(), self.recipe);
        let properties = self.nodes.promises(self.properties());
        match self.accumulate {
            Accumulate::Stored => {
                self.replay(StoredLayers { stream, normalize: Unnormalized, cost, properties })
            }
            Accumulate::Tail => {
                let normalize = StoredTail { weighting: None, recipe };
                let properties = recipe.properties(properties);
                self.replay(StoredLayers { stream, normalize, cost, properties })
            }
            Accumulate::All(composite) => {
                let oracle = StoredSteps { stream, cost, properties };
                self.replay(StoredPass { oracle, composite, recipe })
            }
        }
    }

    fn replay<T: Technique>(&self, technique: T) -> Box<dyn AnyTechnique> {
        match (self.sorted, self.nodes.are_default) {
            (true, true) => Box::new(Replay::<T, true>(technique)),
            (true, false) => Box::new(Placed::new(Replay::<T, true>(technique), self.nodes.depths)),
            (false, true) => Box::new(Replay::<T, false>(technique)),
            (false, false) => Box::new(Placed::new(Replay::<T, false>(technique), self.nodes.depths)),
        }
    }

    #[expect(clippy::cast_precision_loss, reason = "a cost estimate")]
    fn cost(&self) -> Cost {
        // a layer's depth, its colour or alpha, and its mask
        let mask = if self.masks { self.bits as f64 / 8.0 } else { 0.0 };
        let passes = if self.accumulate == Accumulate::Stored { 1.0 } else { 2.0 };
        Cost { geometry_passes: passes, ..Cost::list(self.layers, self.nodes.bytes + mask, self.sums) }
    }

    fn properties(&self) -> Properties {
        // a list without limit holds the k nearest, one layer the nearest that anything shows of, and of masks
        // of one bit the nearest shows alone
        let of_the_set = self.bits == 0 || self.layers == 1 || (self.masks && self.bits == 1);
        let base =
            Properties { order_independent: self.sorted || of_the_set, consistent: true, ..Properties::NONE };
        let exact =
            Properties { exact_for_one: true, exact_for_one_color: true, exact_coverage: true, ..base };
        match self.accumulate {
            Accumulate::Stored | Accumulate::All(Composite::None) => Properties {
                // every visible mask has a layer: stochastic transparency
                unbiased: self.masks && self.sorted && self.layers >= self.bits,
                exact_for_one: self.bits == 0,
                ..base
            },
            // alphas cover exactly what they should, stored or not; masks do on average
            Accumulate::Tail if self.masks => base,
            _ => exact,
        }
    }
}

/// A technique that sees fragments front to back, or as they are submitted.
pub(super) struct Replay<T, const SORTED: bool>(pub T);

impl<T: Technique, const SORTED: bool> Replay<T, SORTED> {
    fn replayed<'a>(pixel: &Pixel<'a>) -> Pixel<'a> {
        Pixel { list: if SORTED { pixel.sorted } else { pixel.list }, ..*pixel }
    }
}

impl<T: Technique, const SORTED: bool> Technique for Replay<T, SORTED> {
    type Scratch = T::Scratch;
    const NEEDS_SORTED: bool = SORTED;

    fn resolve(&self, pixel: &Pixel<'_>, scratch: &mut T::Scratch) -> Resolved {
        self.0.resolve(&Self::replayed(pixel), scratch)
    }
    fn transmittance(&self, pixel: &Pixel<'_>, depths: &[f32], scratch: &mut T::Scratch) -> Option<Vec<f64>> {
        self.0.transmittance(&Self::replayed(pixel), depths, scratch)
    }
    fn faults(&self) -> Faults {
        self.0.faults()
    }
    fn diagnose(&self, pixel: &Pixel<'_>, scratch: &mut T::Scratch) -> Diagnosis {
        self.0.diagnose(&Self::replayed(pixel), scratch)
    }
    fn cost(&self, complexity: &DepthComplexity) -> Cost {
        self.0.cost(complexity)
    }
    fn properties(&self) -> Properties {
        self.0.properties()
    }
}

#[cfg(test)]
mod tests;
