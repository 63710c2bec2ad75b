//! Techniques that take a pixel's fragments one by one, and the orders in which they come.

use super::{BlendTarget, ONE_WALK, WALKS, blocks_of_fragments};
use crate::params::Params;

/// What a technique that takes fragments one by one wants of them, besides that there be any. Lists hand them over where
/// there are lists.
#[derive(Debug, Clone, PartialEq)]
pub struct Streaming {
    /// How many layers a pixel keeps, for shaders that keep `LAYERS`.
    pub layers: Option<u32>,
    /// Other sizes of what a pixel keeps, which the shader has as constants of these names.
    pub sizes: Vec<(&'static str, u32)>,
    /// How lists are sorted, ...
    pub sorted: Sorting,
    /// ... and whether they are read from their end.
    pub backwards: bool,
    /// Whether a pixel may want all of its fragments once more, which the shader's `again` says.
    pub walks_again: bool,
    /// How many fragments of a pixel there may be, if there is a limit.
    pub capacity: Option<Capacity>,
    /// Words that a pixel takes in registers, where it may be many.
    pub words: u32,
    /// The same by sample masks, where there is such a form.
    pub by_samples: Option<Sampling>,
}

impl Streaming {
    /// One that takes fragments as lists are sorted, or from their end.
    pub fn in_order(sorted: Sorting, backwards: bool) -> Self {
        Self {
            layers: None,
            sizes: Vec::new(),
            sorted,
            backwards,
            walks_again: false,
            capacity: None,
            words: 0,
            by_samples: None,
        }
    }

    /// One that takes fragments in whatever order.
    pub fn in_any_order() -> Self {
        Self::in_order(Sorting::Submission, false)
    }

    /// One that takes the nearest fragment first.
    pub fn nearest_first() -> Self {
        Self::in_order(Sorting::Depth, false)
    }

    /// One that takes fragments as the param `submission_order` has them.
    pub fn as_submitted(params: &Params) -> Self {
        let (sorted, backwards) = submission(params);
        Self::in_order(sorted, backwards)
    }

    /// The same with so many layers.
    pub fn of_layers(self, layers: u32) -> Self {
        Self { layers: Some(layers), ..self }
    }

    /// The same with sizes of other things.
    pub fn of_sizes(self, sizes: Vec<(&'static str, u32)>) -> Self {
        Self { sizes, ..self }
    }

    /// The same with so many fragments of a pixel, the first that are submitted.
    pub fn of_fragments(self, fragments: u32, params: &Params) -> Self {
        let (sorted, backwards) = submission(params);
        Self { capacity: Some(Capacity { fragments, sorted, backwards }), ..self }
    }

    /// The same, of which a pixel keeps so many words.
    pub fn of_words(self, words: u32) -> Self {
        Self { words, ..self }
    }

    /// The same with a form by sample masks.
    pub fn or_by_samples(self, sampling: Sampling) -> Self {
        Self { by_samples: Some(sampling), ..self }
    }

    /// The same where a pixel may want all of its fragments once more.
    pub fn in_walks(self) -> Self {
        Self { walks_again: true, ..self }
    }
}

/// An order of lists.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sorting {
    /// By (depth, primitive), nearest first.
    Depth,
    /// As the fragments were submitted.
    Submission,
    /// As whole primitives come in the order that is asked for.
    Rank,
}

/// How a compute shader reads lists.
#[derive(Debug, Clone, PartialEq)]
pub struct ListReader {
    /// Its entry point.
    pub point: &'static str,
    /// How lists are sorted for it.
    pub sorted: Sorting,
    /// Constants of its pipeline.
    pub constants: Vec<(&'static str, f64)>,
}

/// So many fragments of a pixel are kept, the first ones in this order; others are dropped, and counted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Capacity {
    /// How many.
    pub fragments: u32,
    /// How lists are sorted for it ...
    pub sorted: Sorting,
    /// ... and whether those at their end are the first.
    pub backwards: bool,
}

/// The order in which a technique is handed a pixel's fragments: how lists are sorted for it, and whether they are read from
/// their end.
pub fn submission(params: &Params) -> (Sorting, bool) {
    match params.text("submission_order") {
        "as_is" => (Sorting::Submission, false),
        "reversed" => (Sorting::Submission, true),
        "sorted" => (Sorting::Depth, false),
        "back_to_front" => (Sorting::Depth, true),
        _ => (Sorting::Rank, false),
    }
}

/// Two passes over the geometry for as many of a pixel's samples as a device has at a time: fragments cover samples, which keep
/// the nearest; then all fragments add what of them is shown.
#[derive(Debug, Clone, PartialEq)]
pub struct Sampling {
    /// Its shader, which reads the same `Params`, ...
    pub shader: &'static str,
    /// ... with constants of these names.
    pub sizes: Vec<(&'static str, u32)>,
    /// The fragment shader that gives depth, mask and primitive.
    pub cover: &'static str,
    /// The one that looks at the samples.
    pub look: &'static str,
    /// The one that makes the image.
    pub resolve: &'static str,
    /// What the second one adds to.
    pub sums: Vec<BlendTarget>,
    /// Samples of a pixel.
    pub samples: u32,
}

impl Streaming {
    /// The blocks that its shader may use.
    pub(super) fn blocks(&self) -> Vec<&'static str> {
        let mut blocks = vec![WALKS];
        blocks.extend(blocks_of_fragments(self.layers, &self.sizes));
        if !self.walks_again {
            blocks.push(ONE_WALK);
        }
        blocks
    }
}
