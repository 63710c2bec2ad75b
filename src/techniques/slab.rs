//! Stochastic layered alpha blending (Wyman 2016, section 4): the k nearest of the fragments that a random
//! mask would show. Between stochastic transparency (k = b masks) and hybrid transparency (b → ∞).

use crate::continuum::coverage::Coverage;
use crate::continuum::insertion::Insertion;
use crate::continuum::layers::{StoredLayers, StoredSteps, Stream};
use crate::continuum::masks::{ManyWords, OneWord, RandomMasks, TwoWords, words};
use crate::continuum::merge::DiscardFurthest;
use crate::continuum::normalize::{Tail, Unnormalized};
use crate::continuum::opacity::{Alpha, Opacity};
use crate::continuum::oracle::{Composite, TwoPass};
use crate::continuum::stochastic::{Visibility, VisibleByChance, VisibleSamples};
use crate::error::Result;
use crate::params::{Kind, ParamSpec, Params, Value, View};
use crate::technique::{
    AnyTechnique, Axes, Cost, DepthComplexity, Info, Pixel, Properties, Resolved, Technique,
};
use crate::techniques::ANY_ORDER;

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
    targets: &[],
    submission_orders: ANY_ORDER,
    random: true,
    geometry_passes: "stored: 1; all: 2",
    bytes_per_pixel: "all: layers (4 + b / 8) + 12 for masks, 8 layers + 12 for alphas; stored: 4 more per layer \
                      of masks for its colour, 12 less",
    build,
};

fn build(params: &Params, _view: &View) -> Result<Box<dyn AnyTechnique>> {
    let setup = Setup::from_params(params);
    let (bits, seed) = (setup.bits, params.size("seed") as u64);
    let stratified = params.text("probability") == "stratified";
    if !setup.masks {
        let probability = Visibility::new(bits, stratified);
        return Ok(setup.technique(VisibleByChance { probability, seed }, Alpha));
    }
    let masks = RandomMasks { bits, stratified, seed };
    Ok(match words(bits) {
        0 => {
            let valid = "a mask has 1 to 4096 bits; bits=0, without limit, goes with variant=\"alpha\"";
            return Err(params.error("bits is 0 with variant=\"mask\"", valid));
        }
        1 => setup.technique(VisibleSamples, Coverage::<OneWord>::new(masks)),
        2 => setup.technique(VisibleSamples, Coverage::<TwoWords>::new(masks)),
        _ => setup.technique(VisibleSamples, Coverage::<ManyWords>::new(masks)),
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
}

impl Setup {
    fn from_params(params: &Params) -> Self {
        let accumulate = match (params.text("accumulate"), params.text("correction")) {
            ("stored", _) => Accumulate::Stored,
            (_, "tail") => Accumulate::Tail,
            (_, "none") => Accumulate::All(Composite::None),
            (_, _) => Accumulate::All(Composite::Normalize),
        };
        Self {
            layers: params.size("layers"),
            bits: params.size("bits"),
            masks: params.text("variant") == "mask",
            sorted: params.text("replay") == "sorted",
            accumulate,
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

    fn replay<T: Technique>(&self, technique: T) -> Box<dyn AnyTechnique> {
        if self.sorted {
            Box::new(Replay::<T, true>(technique))
        } else {
            Box::new(Replay::<T, false>(technique))
        }
    }

    #[expect(clippy::cast_precision_loss, reason = "a cost estimate")]
    fn cost(&self) -> Cost {
        let opacity = if self.masks { self.bits as f64 / 8.0 } else { 4.0 };
        let layers = self.layers as f64;
        match (self.accumulate, self.masks) {
            // an alpha layer's depth and RGBA8; a mask's colour comes on top
            (Accumulate::Stored, false) => Cost { geometry_passes: 1.0, bytes_per_pixel: 8.0 * layers },
            (Accumulate::Stored, true) => {
                Cost { geometry_passes: 1.0, bytes_per_pixel: layers * (8.0 + opacity) }
            }
            _ => Cost { geometry_passes: 2.0, bytes_per_pixel: layers * (4.0 + opacity) + 12.0 },
        }
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
struct Replay<T, const SORTED: bool>(T);

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
    fn cost(&self, complexity: &DepthComplexity) -> Cost {
        self.0.cost(complexity)
    }
    fn properties(&self) -> Properties {
        self.0.properties()
    }
}

#[cfg(test)]
mod tests;
