//! A composition on a GPU: its choices as the shader's params.

use super::setup::Setup;
use super::storage::TARGETS;
use crate::continuum::oracle::Composite;
use crate::continuum::range::DepthRange;
use crate::error::Result;
use crate::gpu::form::{
    Form, Listing, MASK_WORDS, Number, Path, Sorting, Streaming, at_most, layers, mask_size, masking,
    only_single_formats, submission,
};
use crate::params::{Params, View};
use crate::weight::{Formula, Function, Shading, Weighting};

/// The parts of the shader: what all compositions share, and what those of each kind of memory have.
const LAYERS: &str = concat!(
    include_str!("../../../shaders/continuum/axes.wgsl"),
    include_str!("../../../shaders/continuum/layers.wgsl")
);
const FUNCTIONS: &str = concat!(
    include_str!("../../../shaders/continuum/axes.wgsl"),
    include_str!("../../../shaders/continuum/functions.wgsl")
);
const LISTS: &str = concat!(
    include_str!("../../../shaders/continuum/axes.wgsl"),
    include_str!("../../../shaders/continuum/lists.wgsl"),
    include_str!("../../../shaders/continuum/bins.wgsl")
);

/// Words of the masks of all layers, at most: they are in registers, too, and compilers take minutes for more.
const MOST_WORDS: u32 = 256;

/// Refuses layers with masks that are too wide for so many.
fn check_masks(params: &Params, layers: u32, (_, words): (&'static str, u32)) -> Result<()> {
    if layers.saturating_mul(words) <= MOST_WORDS {
        return Ok(());
    }
    let problem = format!(
        "{layers} layers with masks of bits={} have no form on the backend \"gpu\"",
        params.size("bits")
    );
    Err(params.error(problem, format!("there layers times bits is at most {}", 32 * MOST_WORDS)))
}

/// So many bins, and samples of fixed thresholds, are told apart without rounding.
const MOST_BINS: u32 = 1 << 16;
const MOST_SAMPLES: u32 = 1 << 24;

/// The form of the composition that the params ask for.
///
/// # Errors
/// `Error::Param` with the reason if it has no meaning, or no form.
pub fn form(params: &Params, view: &View) -> Result<Form> {
    let setup = Setup::from_params(params, view)?;
    only_single_formats(params, &TARGETS)?;
    let weight = Weighting::from_params(params)?.shading(params)?;
    let (masking, mask_words) = masks(&setup, params)?;
    let (shader, resolve) = entry(&setup);
    // in which order fragments come is all the same to many, so that they may come sorted
    let order =
        if setup.properties().order_independent { (Sorting::Depth, false) } else { submission(params) };
    let keeps_keys = setup.memory == "layers" || setup.insertion == "nearest";
    let layers = if keeps_keys { layers(params)? } else { 1 };
    if setup.memory == "layers" {
        check_masks(params, layers, mask_words)?;
    }
    let sizes = sizes(&setup, params)?;
    let composition =
        Composition { masking, mask_words, weight, choices: axes(&setup), order, layers, sizes };
    Ok(composition.form(shader, resolve))
}

/// What a shader knows of a composition.
struct Composition {
    masking: [Number; 4],
    mask_words: (&'static str, u32),
    weight: Shading,
    choices: [Number; 6],
    order: (Sorting, bool),
    layers: u32,
    sizes: [Number; 7],
}

impl Composition {
    fn form(self, shader: &'static str, resolve: Option<&'static str>) -> Form {
        let (sorted, backwards) = self.order;
        let numbers = self
            .masking
            .into_iter()
            .chain(self.weight.numbers)
            .chain(self.choices)
            .chain([Number::Whole(backwards.into())]);
        let (layers, sizes) = (self.layers, vec![self.mask_words]);
        let path = if let Some(resolve) = resolve {
            Path::Listed(Listing { resolve, sorted, layers: Some(layers), sizes })
        } else {
            let stream = Streaming::in_order(sorted, backwards);
            Path::Streamed(stream.of_layers(layers).of_sizes(sizes).in_walks())
        };
        Form {
            weight: Some(self.weight.module),
            shader,
            numbers: numbers.chain(self.sizes).collect(),
            path,
            shows_zero_fragments: false,
            colored_transmittance: false,
        }
    }
}

/// The form of slab's list as fragments are submitted, which is that of a composition. What is not stored is `tail`, or else
/// all fragments are seen through the list if there is a `second_pass`.
///
/// # Errors
/// `Error::Param` for sizes and orders that have none.
pub fn slab_as_submitted(params: &Params, tail: bool, second_pass: Option<Composite>) -> Result<Form> {
    let keeps_masks = params.text("variant") == "mask";
    let mask_words = if keeps_masks { mask_size(params, "bits")? } else { (MASK_WORDS, 1) };
    let layers = layers(params)?;
    check_masks(params, layers, mask_words)?;
    let [stochastic, discard_furthest] = [3, 1];
    let composition = Composition {
        masking: masking(params, "bits", params.text("probability") == "stratified"),
        mask_words,
        weight: Weighting::new(Function::Published(Formula::One), 1.0, 0.0).shading(params)?,
        choices: [
            Number::Whole(stochastic),
            Number::Whole(discard_furthest),
            Number::Whole(tail.into()),
            Number::Whole(keeps_masks.into()),
            Number::Whole(second_pass.is_some().into()),
            second_pass.unwrap_or(Composite::None).number(),
        ],
        order: submission(params),
        layers,
        sizes: [Number::Whole(0); 7],
    };
    Ok(composition.form(LAYERS, None))
}

/// The shader, and its entry point if it looks at lists; others take fragments one by one.
fn entry(setup: &Setup) -> (&'static str, Option<&'static str>) {
    match (setup.memory, setup.merge) {
        ("none", _) => (FUNCTIONS, None),
        ("layers", _) => (LAYERS, None),
        ("bins", "sum" | "average") => (LISTS, Some("resolve_bins")),
        _ => (LISTS, Some("resolve_lists")),
    }
}

/// Random masks, those that decide by chance alone, or none; and the words of what is kept.
fn masks(setup: &Setup, params: &Params) -> Result<([Number; 4], (&'static str, u32))> {
    let random = setup.insertion == "stochastic";
    let stratified = params.text("probability") == "stratified";
    let kept = match (setup.memory, setup.opacity) {
        ("samples", _) if random => Some("samples"),
        ("samples", _) => None,
        (_, "coverage") => Some("bits"),
        _ => None,
    };
    if let Some(name) = kept {
        return Ok((masking(params, name, stratified), mask_size(params, name)?));
    }
    let mut chance = masking(params, "bits", stratified);
    if random {
        mask_size(params, "bits")?;
    } else {
        chance[0] = Number::Whole(0);
    }
    Ok((chance, (MASK_WORDS, 1)))
}

/// The choices.
fn axes(setup: &Setup) -> [Number; 6] {
    let insertion = match setup.insertion {
        "threshold" => 1,
        "nearest" => 2,
        "stochastic" => 3,
        _ => 0,
    };
    let merge = match setup.merge {
        "discard_furthest" => 1,
        "over_furthest" => 2,
        "over_nearest" => 3,
        "over_closest" => 4,
        "smallest_error" => 5,
        "over_arrival" => 6,
        "discard_occluded" => 7,
        "sum" => 8,
        "average" => 9,
        "discard_occupied" => 10,
        _ => 0,
    };
    let normalize = match setup.normalize {
        "tail" => 1,
        "global" => 2,
        _ => 0,
    };
    // a tail is what is not stored, and needs no second pass
    let second_pass = setup.accumulate == "all" && setup.normalize != "tail";
    let composite = match (setup.normalize, setup.memory) {
        ("global", _) => Composite::Normalize,
        (_, "samples") => Composite::ExactBackground,
        (_, _) => Composite::None,
    };
    let covers_samples = setup.opacity == "coverage";
    let choices = [insertion, merge, normalize, covers_samples.into(), second_pass.into()].map(Number::Whole);
    let [a, b, c, d, e] = choices;
    [a, b, c, d, e, composite.number()]
}

/// Samples, bins and what bounds numbers.
fn sizes(setup: &Setup, params: &Params) -> Result<[Number; 7]> {
    let samples = match setup.memory {
        "samples" => at_most(params, "samples", MOST_SAMPLES)?,
        _ if setup.opacity == "coverage" => at_most(params, "bits", MOST_SAMPLES)?,
        _ => 1,
    };
    let bins = if setup.memory == "bins" { at_most(params, "bins", MOST_BINS)? } else { 1 };
    let (of_pixel, nearest, farthest) = match setup.range {
        DepthRange::Pixel => (1, 0.0, 0.0),
        DepthRange::Fixed(lo, hi) => (0, lo, hi),
    };
    Ok([
        Number::Whole(samples),
        Number::Whole(bins),
        Number::Whole(of_pixel),
        Number::float(nearest),
        Number::float(farthest),
        Number::below(params.float("threshold")),
        Number::float(params.float("s_max")),
    ])
}
