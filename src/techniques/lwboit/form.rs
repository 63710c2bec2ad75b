//! Its forms on a GPU: layered rendering, or lists that are binned in the resolve, where shaping is free (FEE21 §4).

use super::INFO;
use crate::continuum::range::DepthRange;
use crate::error::Result;
use crate::format::Formats;
use crate::gpu::form::blocks::{FUNCTIONS, INTERVAL, OUTPUTS};
use crate::gpu::form::{
    Blend, BlendTarget, Blending, Draw, Form, Listing, Number, Path, SHARES, SUMS, Sorting, only,
    only_default_formats, target_format,
};
use crate::params::{Params, Value, View};
use crate::weight::{Shading, Weighting};

/// The form of either storage.
pub(super) fn gpu(params: &Params, view: &View) -> Result<Form> {
    if params.text("storage") == "lr" { layered(params, view) } else { listed(params, view) }
}

/// What both shaders know.
struct Common {
    weight: Shading,
    bins: u32,
    fading: u32,
    anchor: f32,
    range: DepthRange,
}

impl Common {
    fn from_params(params: &Params, view: &View) -> Result<Self> {
        let weight = Weighting::from_params(params)?.shading(params)?;
        let fading = match (params.bool("smooth"), params.value("bin_function")) {
            (false, _) => 0,
            (true, Value::Text("bell")) => 1,
            (true, Value::Text("tent")) => 2,
            _ => {
                let problem = "bin functions of one's own have no form on the backend \"gpu\"";
                return Err(params.error(problem, "there bin_function is \"bell\" or \"tent\""));
            }
        };
        Ok(Self {
            weight,
            bins: u32::try_from(params.size("bins")).unwrap_or_else(|_| unreachable!("at most 512")),
            fading,
            anchor: if params.text("shape_anchor") == "edge" { 0.0 } else { 0.5 },
            range: DepthRange::from_params(params, view),
        })
    }
}

fn listed(params: &Params, view: &View) -> Result<Form> {
    if params.bool("smooth") {
        only(params, "partition", "none")?;
    }
    if params.size("capacity") > 0 {
        let problem = "a capacity has no form on the backend \"gpu\", which keeps every fragment";
        return Err(params.error(problem, "there capacity is 0"));
    }
    only_default_formats(params, INFO.targets)?;
    let Common { weight, bins, fading, anchor, range } = Common::from_params(params, view)?;
    let (nearest, farthest) = match range {
        DepthRange::Pixel => (0.0, 0.0),
        DepthRange::Fixed(lo, hi) => (lo, hi),
    };
    let more = [
        Number::Whole(bins),
        Number::Whole(fading),
        Number::Whole(params.bool("normalize").into()),
        Number::Whole(params.bool("shape").into()),
        Number::Float(anchor),
        Number::Whole((range == DepthRange::Pixel).into()),
        Number::float(nearest),
        Number::float(farthest),
    ];
    Ok(Form {
        shader: include_str!("../../../shaders/lwboit.wgsl"),
        weight: Some(weight.module),
        numbers: weight.numbers.into_iter().chain(more).collect(),
        path: Path::Listed(Listing {
            resolve: "resolve",
            sorted: Sorting::Depth,
            layers: None,
            sizes: vec![],
        }),
        shows_zero_fragments: false,
        colored_transmittance: false,
    })
}

/// Channels of a texel, each of which holds what a bin leaves.
const CHANNELS: u32 = 4;

fn layered(params: &Params, view: &View) -> Result<Form> {
    only(params, "summation", "plain")?;
    let formats = Formats::from_params(INFO.targets, params);
    let sums = target_format(params, &formats, "accumulation", "accumulation_format", SUMS)?;
    let shares = target_format(params, &formats, "revealage", "revealage_format", SHARES)?;
    let Common { weight, bins, fading, anchor, range } = Common::from_params(params, view)?;
    let (smooth, shape) = (params.bool("smooth"), params.bool("shape"));
    let share = |channels| BlendTarget::product("revealage_format", shares, channels, Blend::Attenuate);
    let targets = vec![
        BlendTarget::bounds("range"),
        BlendTarget::sums("accumulation_format", sums, 4).array("bins", bins),
        share(CHANNELS).array("bins", bins.div_ceil(CHANNELS)),
        share(1),
    ];
    let draw = |shader, targets, in_parts| Draw { shader, targets, in_parts };
    let bounds = (shape || range == DepthRange::Pixel).then(|| draw("find_bounds", 0..1, false));
    let by_absorbance = smooth && params.text("partition") == "absorbance";
    let more = [
        Number::Whole(bins),
        Number::Whole(fading),
        Number::Whole(by_absorbance.into()),
        Number::float(if by_absorbance { params.float("s_max") } else { 0.0 }),
        Number::Whole(params.bool("normalize").into()),
        Number::Whole(shape.into()),
        Number::Float(anchor),
        Number::float(sums.max_finite(0)),
    ];
    Ok(Form {
        shader: include_str!("../../../shaders/lwboit_lr.wgsl"),
        weight: Some(weight.module),
        numbers: weight.numbers.into_iter().chain(range.numbers()).chain(more).collect(),
        path: Path::Blended(Blending {
            targets,
            draws: bounds.into_iter().chain([draw("blend_into_bins", 1..4, true)]).collect(),
            resolve: "resolve",
            over_background: false,
            blocks: &[FUNCTIONS, INTERVAL, OUTPUTS],
            targets_block: "",
            in_registers: None,
            words: 0,
        }),
        shows_zero_fragments: false,
        colored_transmittance: false,
    })
}
