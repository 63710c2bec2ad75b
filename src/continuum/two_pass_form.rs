//! The two-pass template on a GPU: the map's targets, to which fragments add in a first pass over the geometry, then those
//! of the second, which sees every fragment through the map (`shaders/blocks/two_pass.wgsl`).

use super::oracle::Composite;
use super::range::DepthRange;
use crate::error::Result;
use crate::format::{Formats, Target};
use crate::gpu::form::blocks::{TWO_PASS_STREAM, TWO_PASS_TARGETS};
use crate::gpu::form::{
    Blend, BlendTarget, Blending, Draw, Form, Number, Path, Registers, SHARES, SUMS, Streaming, only,
    target_format,
};
use crate::params::{Params, View};

/// What a technique has of its own.
pub struct Own<'a> {
    /// Its shader ...
    pub shader: &'static str,
    /// ... and the blocks that it wants.
    pub blocks: &'static [&'static str],
    /// What it stores.
    pub targets: &'static [Target],
    /// The target of coefficients, and the param on which their number depends.
    pub map: (&'static str, &'static str),
    /// How many coefficients there are.
    pub count: usize,
    /// A coefficient that has a target of its own.
    pub total: Option<&'static str>,
    /// Whether it wants each pixel's bounds, whatever the range.
    pub needs_bounds: bool,
    /// Words per pixel.
    pub words: u32,
    /// What follows in its `Params`.
    pub numbers: &'a [Number],
}

impl Own<'_> {
    /// One that has a map of so many coefficients, and nothing else.
    pub const BARE: Self = Self {
        shader: "",
        blocks: &[],
        targets: &[],
        map: ("", ""),
        count: 0,
        total: None,
        needs_bounds: false,
        words: 0,
        numbers: &[],
    };
}

/// The bindings of targets.
const BOUNDS: usize = 0;
const MAP: usize = 1;
const TOTAL: usize = 2;
const ACCUMULATION: usize = 3;
const ALL: usize = 5;

/// Coefficients per texel.
const LANES: usize = 4;

/// A technique's form.
///
/// # Errors
/// `Error::Param` for params that no device does.
pub fn two_pass_form(params: &Params, view: &View, own: &Own<'_>) -> Result<Form> {
    only(params, "summation", "plain")?;
    let formats = Formats::from_params(own.targets, params);
    let param_of = |name: &str| {
        let target = own.targets.iter().find(|target| target.name == name);
        target.unwrap_or_else(|| unreachable!("the technique has a target {name:?}")).param
    };
    let format = |name: &str, accepted| target_format(params, &formats, name, param_of(name), accepted);
    let (map, accumulation) = (format(own.map.0, SUMS)?, format("accumulation", SUMS)?);
    let revealage = format("revealage", SHARES)?;
    let total = own.total.map(|name| Ok((format(name, SUMS)?, param_of(name)))).transpose()?;
    let layers = u32::try_from(own.count.div_ceil(LANES)).unwrap_or(u32::MAX);
    let (total_format, total_param) = total.unwrap_or((map, param_of(own.map.0)));
    let targets = vec![
        BlendTarget::bounds("range"),
        BlendTarget::sums(param_of(own.map.0), map, 4).array(own.map.1, layers),
        BlendTarget::sums(total_param, total_format, 1),
        BlendTarget::sums("accumulation_format", accumulation, 4),
        BlendTarget::product("revealage_format", revealage, 1, Blend::Attenuate),
    ];
    let range = DepthRange::from_params(params, view);
    let finds_bounds = own.needs_bounds || range == DepthRange::Pixel;
    let draw = |shader, targets, in_parts| Draw { shader, targets, in_parts };
    let bounds = finds_bounds.then(|| draw("find_bounds", BOUNDS..MAP, false));
    let map_end = if total.is_some() { ACCUMULATION } else { TOTAL };
    let both = [draw("add_to_map", MAP..map_end, true), draw("look_through", ACCUMULATION..ALL, false)];
    let [s_max, largest] = [params.float("s_max"), accumulation.max_finite(0)];
    let shared = range.numbers().into_iter().chain([
        Number::float(s_max),
        Number::Whole(composite(params)),
        Number::float(largest),
        Number::float(map.max_finite(0)),
        Number::float(total_format.max_finite(0)),
        Number::Whole(0),
        Number::Whole(0),
    ]);
    Ok(Form {
        weight: None,
        shader: own.shader,
        numbers: shared.chain(own.numbers.iter().copied()).collect(),
        path: Path::Blended(Blending {
            targets,
            draws: bounds.into_iter().chain(both).collect(),
            resolve: "resolve",
            over_background: false,
            blocks: own.blocks,
            targets_block: TWO_PASS_TARGETS,
            by_depth: None,
            in_registers: Some(registers(own, finds_bounds, layers)),
            near_depths: false,
            words: own.words,
        }),
        shows_zero_fragments: false,
        colored_transmittance: false,
    })
}

/// Map and sums of a pixel in registers.
fn registers(own: &Own<'_>, finds_bounds: bool, layers: u32) -> Registers {
    let has_total = u32::from(own.total.is_some());
    let words = own.words.max(1);
    let sizes = vec![
        ("FINDS_BOUNDS", finds_bounds.into()),
        ("MAP_LAYERS", layers),
        ("HAS_TOTAL", has_total),
        ("MAP_WORDS", words),
    ];
    let all = layers.saturating_mul(4).saturating_add(has_total + words);
    Registers {
        block: TWO_PASS_STREAM,
        stream: Streaming::in_any_order().of_sizes(sizes).in_walks().of_words(all),
    }
}

/// How sums meet the background, as shaders number it.
pub fn composite(params: &Params) -> u32 {
    match Composite::from_params(params) {
        Composite::None => 0,
        Composite::ExactBackground => 1,
        Composite::Normalize => 2,
    }
}
