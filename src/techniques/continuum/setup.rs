//! A composition: which choices go together and what they promise.

use super::storage::Storage;
use crate::continuum::range::DepthRange;
use crate::error::Result;
use crate::params::{Params, View};
use crate::technique::{Cost, DepthComplexity, Properties};

/// One choice on every axis, and their sizes.
#[derive(Debug, Clone, Copy)]
pub struct Setup {
    pub memory: &'static str,
    pub insertion: &'static str,
    pub merge: &'static str,
    pub normalize: &'static str,
    pub opacity: &'static str,
    pub accumulate: &'static str,
    /// Whether fragments of a tail are weighed.
    pub weighs: bool,
    pub layers: usize,
    pub bins: usize,
    pub samples: usize,
    pub bits: usize,
    pub range: DepthRange,
    pub storage: Storage,
    range_covers_scene: bool,
}

/// FEE21's bins are blended, 512 at most.
const MAX_AVERAGED_BINS: usize = 512;

impl Setup {
    /// The composition that the params ask for.
    ///
    /// # Errors
    /// `Error::Param` with the reason if it has no meaning.
    pub fn from_params(params: &Params, view: &View) -> Result<Self> {
        let range = DepthRange::from_params(params, view);
        let setup = Self {
            memory: params.text("memory"),
            insertion: params.text("insertion"),
            merge: params.text("merge"),
            normalize: params.text("normalize"),
            opacity: params.text("opacity"),
            accumulate: params.text("accumulate"),
            weighs: !params.is("weight", "one"),
            layers: params.size("layers"),
            bins: params.size("bins"),
            samples: params.size("samples"),
            bits: params.size("bits"),
            range,
            storage: Storage::from_params(params, view),
            range_covers_scene: range.covers(view),
        };
        match setup.refusal() {
            Some((problem, valid)) => Err(params.error(problem, valid)),
            None => Ok(setup),
        }
    }

    /// Why the choices have no meaning together, and what has (sheet 2.8).
    fn refusal(&self) -> Option<(String, &'static str)> {
        (self.memory_refusal())
            .or_else(|| self.merge_refusal())
            .or_else(|| self.opacity_refusal())
            .or_else(|| self.accumulate_refusal())
            .or_else(|| self.normalize_refusal())
            .or_else(|| self.format_refusal())
    }

    /// Formats are those of nodes and sums; what is stored otherwise is left to the techniques of that name.
    fn format_refusal(&self) -> Option<(String, &'static str)> {
        if self.storage.is_default() {
            return None;
        }
        let valid = match self.merge {
            "over_arrival" => "a framebuffer's format is the color_format of \"alpha_compositing\"",
            "sum" => "sums of absorbance in other formats are those of \"opacity_shadow_maps\"",
            "average" => "blended bins in other formats are those of \"lwboit\"",
            _ => return None,
        };
        Some((format!("merge=\"{}\" with a format other than the default", self.merge), valid))
    }

    fn memory_refusal(&self) -> Option<(String, &'static str)> {
        match (self.memory, self.insertion) {
            ("none", "never") => None,
            (memory, "never") => Some((
                format!("insertion=\"never\" leaves memory=\"{memory}\" empty"),
                "insertion=\"never\" goes with memory=\"none\" alone",
            )),
            ("none", insertion) => Some((
                format!("insertion=\"{insertion}\" has nowhere to store a fragment with memory=\"none\""),
                "memory=\"none\" goes with insertion=\"never\" alone",
            )),
            _ => None,
        }
    }

    fn merge_refusal(&self) -> Option<(String, &'static str)> {
        let (fits, valid): (&[&str], _) = match self.memory {
            "layers" => (
                &[
                    "discard_furthest",
                    "over_furthest",
                    "over_nearest",
                    "over_closest",
                    "smallest_error",
                    "over_arrival",
                ],
                "layers fill up: merge is one of \"discard_furthest\", \"over_furthest\", \"over_nearest\", \
                 \"over_closest\", \"smallest_error\", \"over_arrival\"",
            ),
            "samples" => {
                (&["discard_occluded"], "a sample keeps its nearest fragment: merge is \"discard_occluded\"")
            }
            "bins" => (
                &["sum", "average", "discard_occupied"],
                "fragments meet in bins: merge is one of \"sum\", \"average\", \"discard_occupied\"",
            ),
            "unbounded" => (&["none"], "an unbounded list never fills up: merge is \"none\""),
            _ => (&["none"], "nothing is stored that could merge: merge is \"none\""),
        };
        if !fits.contains(&self.merge) {
            let problem = format!("merge=\"{}\" does not go with memory=\"{}\"", self.merge, self.memory);
            return Some((problem, valid));
        }
        if self.merge == "over_arrival" && (self.layers > 1 || self.opacity == "coverage") {
            let problem = format!(
                "merge=\"over_arrival\" ignores depth, but there are layers={} of opacity=\"{}\" to keep in order",
                self.layers, self.opacity
            );
            return Some((problem, "\"over_arrival\" goes with layers=1 and opacity=\"alpha\""));
        }
        (self.merge == "average" && self.bins > MAX_AVERAGED_BINS)
            .then(|| (format!("merge=\"average\" with bins={}", self.bins), "blended bins are 512 at most"))
    }

    fn opacity_refusal(&self) -> Option<(String, &'static str)> {
        let refuse =
            |valid| Some((format!("opacity=\"{}\" with memory=\"{}\"", self.opacity, self.memory), valid));
        match (self.memory, self.opacity) {
            ("bins" | "none", "coverage") => {
                refuse("masks of what adds up have no meaning: opacity is \"alpha\"")
            }
            ("samples", "alpha") => refuse("a sample is covered or it is not: opacity is \"coverage\""),
            ("layers" | "unbounded", "coverage") if self.bits == 0 => {
                Some(("opacity=\"coverage\" with bits=0".into(), "a mask has at least 1 bit"))
            }
            _ => None,
        }
    }

    fn accumulate_refusal(&self) -> Option<(String, &'static str)> {
        let refuse =
            |what: String, valid| Some((format!("accumulate=\"{}\" with {what}", self.accumulate), valid));
        match (self.accumulate, self.memory, self.merge) {
            ("all", "none", _) => refuse(
                "memory=\"none\"".into(),
                "nothing is stored through which a second pass could see: accumulate is \"stored\"",
            ),
            ("all", "unbounded", _) => refuse(
                "memory=\"unbounded\"".into(),
                "every fragment is stored with its colour, a second pass has nothing to add: accumulate is \
                 \"stored\"",
            ),
            ("all", _, "over_nearest") => refuse(
                "merge=\"over_nearest\"".into(),
                "the front accumulator has no depth that a fragment could be compared with: accumulate is \
                 \"stored\"",
            ),
            ("stored", _, "sum") => refuse(
                "merge=\"sum\"".into(),
                "sums of absorbance have no colour to composite: accumulate is \"all\"",
            ),
            _ => None,
        }
    }

    /// Whether the list is one that [`super::super::slab`] keeps.
    pub fn is_slab(&self) -> bool {
        (self.memory, self.insertion, self.merge) == ("layers", "stochastic", "discard_furthest")
    }

    fn normalize_refusal(&self) -> Option<(String, &'static str)> {
        if self.normalize == "tail" && self.accumulate == "all" && !self.is_slab() {
            let valid = "a second pass adds up all fragments, so that none are left for a tail: normalize is \
                         \"none\" or \"global\" (a tail goes with it in slab's list: layers, stochastic, \
                         discard_furthest)";
            return Some(("normalize=\"tail\" with accumulate=\"all\"".into(), valid));
        }
        let loses_nothing = match self.merge {
            "over_furthest" | "over_nearest" | "over_closest" | "over_arrival" | "smallest_error" => true,
            "none" => self.memory == "unbounded" && self.insertion == "always",
            "average" => self.normalize == "tail" && self.insertion == "always",
            _ => false,
        };
        (self.normalize != "none" && self.accumulate == "stored" && loses_nothing).then(|| {
            let problem = format!(
                "normalize=\"{}\" with insertion=\"{}\" and merge=\"{}\"",
                self.normalize, self.insertion, self.merge
            );
            (problem, "such a memory loses nothing that could be made good: normalize is \"none\"")
        })
    }

    /// The modelled cost (sheet 1.2), by what is stored.
    #[expect(clippy::cast_precision_loss, reason = "a cost estimate")]
    pub fn cost(&self, complexity: &DepthComplexity) -> Cost {
        let stored = self.accumulate == "stored";
        let masks = self.opacity == "coverage" && self.memory != "samples";
        let nodes = self.storage.nodes;
        let node = nodes.bytes + if masks { self.bits as f64 / 8.0 } else { 0.0 };
        let finds_range = self.memory == "bins" && self.range == DepthRange::Pixel;
        let bytes = match self.memory {
            "layers" => {
                let front = if self.merge == "over_nearest" { nodes.color_bytes } else { 0.0 };
                self.layers as f64 * node + front
            }
            "unbounded" => (node + 8.0) * complexity.mean + 4.0,
            "samples" => self.samples as f64 * node,
            "bins" => {
                let bin = match self.merge {
                    "sum" => 2.0,
                    "average" => Storage::BIN,
                    _ => node,
                };
                self.bins as f64 * bin
            }
            _ => 0.0,
        };
        Cost {
            geometry_passes: 1.0 + f64::from(u8::from(!stored)) + f64::from(u8::from(finds_range)),
            bytes_per_pixel: bytes + self.storage.sums + if finds_range { 8.0 } else { 0.0 },
        }
    }

    /// The promises. Order independence is said exactly; the others, where they are plain.
    pub fn properties(&self) -> Properties {
        let promises = self.storage.nodes.promises(self.plain_properties());
        self.storage.recipe.properties(promises)
    }

    /// Those of the default formats.
    fn plain_properties(&self) -> Properties {
        if (self.memory, self.insertion, self.opacity) == ("unbounded", "always", "alpha") {
            return Properties::EXACT;
        }
        Properties {
            order_independent: self.is_order_independent(),
            unbiased: self.is_unbiased(),
            consistent: self.is_consistent(),
            exact_for_one: self.is_exact_for_one(),
            exact_for_one_color: self.is_exact_for_one_color(),
            exact_coverage: self.is_coverage_exact(),
        }
    }

    fn is_order_independent(&self) -> bool {
        let (stored, plain) = (self.accumulate == "stored", self.normalize == "none");
        let of_the_nearest =
            matches!(self.merge, "discard_furthest" | "discard_occupied" | "discard_occluded");
        match (self.memory, self.insertion) {
            ("none", _) => true,
            // who is among the nearest so far depends on who came, unless the list keeps nobody else
            (_, "nearest") => self.merge == "discard_furthest",
            ("samples", _) => true,
            // the nearest of which anything shows
            ("layers", "stochastic") if self.layers == 1 && self.merge == "discard_furthest" => true,
            // without limit chance admits everything
            (_, "stochastic") if self.opacity == "alpha" && self.bits > 0 => false,
            (memory, "stochastic") if self.opacity == "coverage" => {
                let one_bit = self.bits == 1 && self.merge != "over_nearest";
                (one_bit || memory == "unbounded") && (plain || (!stored && self.normalize == "global"))
            }
            ("unbounded" | "bins", _) => true,
            // the nearest of opaque layers hides all others, where it can come to lie in front of them
            (_, "threshold") => !matches!(self.merge, "over_nearest" | "over_arrival"),
            // one step at the nearest depth, to which everything contributes
            _ if !stored && self.layers == 1 && self.merge != "over_arrival" => true,
            // the k nearest depths, the last step down to what all fragments together let through
            _ if !stored && self.merge == "over_furthest" => self.insertion == "always",
            _ => of_the_nearest,
        }
    }

    fn is_unbiased(&self) -> bool {
        let all_samples = matches!(
            (self.memory, self.insertion),
            ("samples", "stochastic") | ("unbounded", "always" | "stochastic")
        );
        all_samples && self.opacity == "coverage" && self.normalize == "none"
    }

    fn is_consistent(&self) -> bool {
        match (self.memory, self.insertion) {
            ("layers", "always" | "nearest" | "stochastic") => self.merge != "over_arrival",
            ("unbounded", "always" | "stochastic") => true,
            ("samples", "stochastic") => self.normalize != "tail",
            ("bins", "always") => self.merge != "discard_occupied" && self.range_covers_scene,
            _ => false,
        }
    }

    /// Whether every fragment is let in as it is: then one alone is stored.
    fn keeps_the_first(&self) -> bool {
        self.opacity == "alpha" && matches!(self.insertion, "always" | "nearest")
    }

    fn is_exact_for_one(&self) -> bool {
        let all = self.accumulate == "all";
        match self.normalize {
            "global" if all => true,
            _ if self.memory == "none" || (all && self.memory == "samples") => true,
            _ => self.keeps_the_first() && self.merge != "sum",
        }
    }

    fn is_exact_for_one_color(&self) -> bool {
        match (self.accumulate, self.normalize) {
            ("all", "global") => true,
            ("stored", "tail" | "global") => self.keeps_the_first() || self.memory == "none",
            ("stored", _) => self.keeps_everything(),
            _ => false,
        }
    }

    fn is_coverage_exact(&self) -> bool {
        match (self.accumulate, self.normalize) {
            ("all", "global") => true,
            ("all", _) if self.memory == "samples" => true,
            (_, "global") => self.opacity == "alpha" || self.memory == "samples",
            (_, "tail") => self.keeps_the_first() || self.memory == "none",
            _ => self.keeps_everything() && self.merge != "sum",
        }
    }

    /// Whether what is stored covers as much as all fragments together.
    fn keeps_everything(&self) -> bool {
        let merges = matches!(
            self.merge,
            "over_furthest" | "over_nearest" | "over_closest" | "over_arrival" | "smallest_error" | "average"
        );
        self.opacity == "alpha" && self.insertion == "always" && merges
    }
}
