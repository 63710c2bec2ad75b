//! Its forms on a GPU: layered rendering, or lists that are binned in the resolve, where shaping is free (FEE21 §4).

use super::INFO;
use crate::continuum::range::DepthRange;
use crate::error::Result;
use crate::format::Formats;
use crate::gpu::form::blocks::{FUNCTIONS, INTERVAL, OUTPUTS};
use crate::gpu::form::{
    Blend, BlendTarget, Blending, Draw, Form, Number, Path, Registers, SHARES, SUMS, Streaming, WeightModule,
    only, only_default_formats, target_format,
};
use crate::own::{Call, callable, vectors};
use crate::params::{Params, Setting, Value, View};
use crate::weight::Weighting;

/// The form of either storage.
pub(super) fn gpu(params: &Params, view: &View) -> Result<Form> {
    if params.text("storage") == "lr" { layered(params, view) } else { listed(params, view) }
}

/// What both shaders know.
struct Common {
    numbers: Vec<Number>,
    weight: WeightModule,
    /// Whether a pass over the fragments has to find each pixel's bounds.
    finds_bounds: bool,
}

impl Common {
    fn from_params(params: &Params, view: &View, largest: f64) -> Result<Self> {
        let weight = Weighting::from_params(params)?.shading(params)?;
        let fading = Fading::from_params(params)?;
        let (smooth, shape) = (params.bool("smooth"), params.bool("shape"));
        let range = DepthRange::from_params(params, view);
        let by_absorbance = smooth && params.text("partition") == "absorbance";
        let numbers = [
            Number::size(params.size("bins")),
            Number::Whole(fading.number),
            Number::Whole(by_absorbance.into()),
            Number::float(if by_absorbance { params.float("s_max") } else { 0.0 }),
            Number::Whole(params.bool("normalize").into()),
            Number::Whole(shape.into()),
            Number::Float(if params.text("shape_anchor") == "edge" { 0.0 } else { 0.5 }),
            Number::float(largest),
        ];
        let unused = [Number::Whole(0); 3];
        let numbers = weight.numbers.into_iter().chain(range.numbers()).chain(numbers).chain(unused);
        Ok(Self {
            numbers: numbers.chain(fading.uniforms).collect(),
            weight: weight.module.with(&fading.text, fading.number == OWN),
            finds_bounds: shape || range == DepthRange::Pixel,
        })
    }
}

/// How fragments fade, as the shaders number it: a function of somebody's own, and those that are published.
const OWN: u32 = 3;
const NO_FADING: u32 = 0;
const BELL: u32 = 1;
const TENT: u32 = 2;

/// How fragments fade over bins.
struct Fading {
    number: u32,
    /// A function of somebody's own, or in its place one that is not called.
    text: String,
    uniforms: Vec<Number>,
}

impl Fading {
    fn from_params(params: &Params) -> Result<Self> {
        let published = |number| {
            let text = include_str!("../../../shaders/blocks/no_own_bins.wgsl").to_owned();
            Ok(Self { number, text, uniforms: vec![Number::Whole(0); 4] })
        };
        if !params.bool("smooth") {
            return published(NO_FADING);
        }
        match params.value("bin_function") {
            Value::Text("bell") => return published(BELL),
            Value::Text("tent") => return published(TENT),
            _ => {}
        }
        let Setting::Written(source) = params.setting("bin_function") else {
            let problem = "a callable has no form on the backend \"gpu\"";
            return Err(params.error(problem, "there bin_function is \"bell\", \"tent\", or written in WGSL"));
        };
        let call =
            Call { prefix: "bin_", entry: "bin", parameters: "x: f32", uniforms: "params.bin_uniforms" };
        let values = params.uniforms("bin_function");
        let mut uniforms: Vec<_> = values.iter().copied().map(Number::Float).collect();
        uniforms.resize(4 * vectors(values.len()), Number::Whole(0));
        Ok(Self { number: OWN, text: callable(source, call), uniforms })
    }
}

/// Of a fragment's place in bins, which both shaders have to know.
macro_rules! with_parts {
    ($($file:literal),*) => {
        concat!($(include_str!(concat!("../../../shaders/", $file)), "\n"),*)
    };
}

fn listed(params: &Params, view: &View) -> Result<Form> {
    only_default_formats(params, INFO.targets)?;
    let Common { numbers, weight, finds_bounds } = Common::from_params(params, view, f64::from(f32::MAX))?;
    Ok(Form {
        shader: with_parts!(
            "blocks/functions.wgsl",
            "blocks/interval.wgsl",
            "lwboit_parts.wgsl",
            "lwboit.wgsl"
        ),
        weight: Some(weight),
        numbers,
        path: Path::Streamed(match u32::try_from(params.size("capacity")) {
            Ok(capacity) if capacity > 0 => as_stream(finds_bounds).of_fragments(capacity, params),
            // there are never so many
            _ => as_stream(finds_bounds),
        }),
        shows_zero_fragments: false,
        colored_transmittance: false,
    })
}

fn as_stream(finds_bounds: bool) -> Streaming {
    let stream = Streaming::nearest_first().of_sizes(vec![("FINDS_BOUNDS", finds_bounds.into())]);
    stream.in_walks()
}

/// Channels of a texel, each of which holds what a bin leaves.
const CHANNELS: u32 = 4;

fn layered(params: &Params, view: &View) -> Result<Form> {
    only(params, "summation", "plain")?;
    let formats = Formats::from_params(INFO.targets, params);
    let sums = target_format(params, &formats, "accumulation", "accumulation_format", SUMS)?;
    let shares = target_format(params, &formats, "revealage", "revealage_format", SHARES)?;
    let Common { numbers, weight, finds_bounds } = Common::from_params(params, view, sums.max_finite(0))?;
    let bins = u32::try_from(params.size("bins")).unwrap_or_else(|_| unreachable!("at most 512"));
    let share = |channels| BlendTarget::product("revealage_format", shares, channels, Blend::Attenuate);
    let targets = vec![
        BlendTarget::bounds("range"),
        BlendTarget::sums("accumulation_format", sums, 4).array("bins", bins),
        share(CHANNELS).array("bins", bins.div_ceil(CHANNELS)),
        share(1),
    ];
    let draw = |shader, targets, in_parts| Draw { shader, targets, in_parts };
    let bounds = finds_bounds.then(|| draw("find_bounds", 0..1, false));
    Ok(Form {
        shader: with_parts!("lwboit_parts.wgsl"),
        weight: Some(weight),
        numbers,
        path: Path::Blended(Blending {
            targets,
            draws: bounds.into_iter().chain([draw("blend_into_bins", 1..4, true)]).collect(),
            resolve: "resolve",
            over_background: false,
            blocks: &[FUNCTIONS, INTERVAL, OUTPUTS],
            targets_block: include_str!("../../../shaders/lwboit_lr.wgsl"),
            by_depth: None,
            in_registers: Some(Registers {
                block: include_str!("../../../shaders/lwboit.wgsl"),
                stream: as_stream(finds_bounds),
            }),
            near_depths: false,
            words: 0,
        }),
        shows_zero_fragments: false,
        colored_transmittance: false,
    })
}
