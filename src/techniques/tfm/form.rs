//! Its forms on a GPU: extinction adds up in render targets; transmittance takes sorted lists.

use super::{INFO, is_extinction};
use crate::continuum::range::DepthRange;
use crate::continuum::stored_oracle::COEFFICIENTS;
use crate::continuum::two_pass_form::{Own, composite, two_pass_form};
use crate::error::Result;
use crate::format::{Format, Formats};
use crate::gpu::form::blocks::{self, FUNCTIONS, INTERVAL, OUTPUTS, TWO_PASS};
use crate::gpu::form::{Form, Listing, Number, Path, Sorting, only, target_format};
use crate::params::{Params, View};

/// The form of either projection.
pub(super) fn gpu(params: &Params, view: &View) -> Result<Form> {
    if is_extinction(params) { extinction(params, view) } else { curve(params, view) }
}

fn extinction(params: &Params, view: &View) -> Result<Form> {
    let frequencies = params.size("frequencies");
    let own = Own {
        shader: include_str!("../../../shaders/tfm.wgsl"),
        blocks: &[FUNCTIONS, INTERVAL, OUTPUTS, TWO_PASS, blocks::COEFFICIENTS],
        targets: INFO.targets,
        map: (COEFFICIENTS.name, "frequencies"),
        count: frequencies.saturating_add(1),
        numbers: &[Number::size(frequencies), Number::Whole(params.bool("self_correct").into())],
        ..Own::BARE
    };
    two_pass_form(params, view, &own)
}

/// Frequencies of a series that one thread sums over a pixel's whole list.
const MOST_FREQUENCIES: usize = 4096;

fn curve(params: &Params, view: &View) -> Result<Form> {
    only(params, "summation", "plain")?;
    let formats = Formats::from_params(INFO.targets, params);
    for target in INFO.targets {
        // nothing is stored but fragments
        target_format(params, &formats, target.name, target.param, &[Format::F32])?;
    }
    let frequencies = params.size("frequencies");
    if frequencies > MOST_FREQUENCIES {
        let problem = format!(
            "frequencies={frequencies} has no form on the backend \"gpu\" for project=\"transmittance\""
        );
        return Err(params.error(problem, format!("there frequencies is at most {MOST_FREQUENCIES}")));
    }
    let own = [Number::Whole(composite(params)), Number::size(frequencies), Number::Whole(0)];
    Ok(Form {
        weight: None,
        shader: concat!(
            include_str!("../../../shaders/blocks/functions.wgsl"),
            include_str!("../../../shaders/blocks/interval.wgsl"),
            include_str!("../../../shaders/tfm_curve.wgsl")
        ),
        numbers: DepthRange::from_params(params, view).numbers().into_iter().chain(own).collect(),
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
