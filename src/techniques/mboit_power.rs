//! Moment-based OIT with power moments (Münstermann, Krumpen, Klein & Peters 2018, M18).

use crate::continuum::absorbance::S_MAX;
use crate::continuum::moments::oracle::{BIAS, OVERESTIMATION, regularization, technique};
use crate::continuum::moments::power::Powers;
use crate::continuum::oracle::Composite;
use crate::continuum::range::DepthRange;
use crate::error::Result;
use crate::params::{Kind, ParamSpec, Params, Value, View};
use crate::technique::{AnyTechnique, Axes, Info};
use crate::techniques::ANY_ORDER;

/// The registry entry.
pub static INFO: Info = Info {
    id: "mboit_power",
    aliases: &[],
    name: "Moment-based OIT, power moments",
    citation: &["Munstermann2018"],
    doc: "The absorbance in front of a depth is read off the first powers' mean values over the pixel's \
          absorbance, with depth on a logarithmic scale: bounds on it follow from the one distribution of \
          these moments that has the fewest points, one of them at that depth.",
    axes: Axes {
        memory: "k moments",
        insertion: "always",
        merge: "sum in moment space",
        normalize: "α-weighted average",
        opacity: "alpha",
    },
    params: &[
        ParamSpec::new(
            "moments",
            Kind::IntChoice(&[4, 6, 8]),
            Value::Int(4),
            "powers of depth whose means are stored",
        ),
        BIAS.derived("5e-7 (4 moments), 5e-6 (6), 5e-5 (8)", |params, _| {
            Value::Float(Powers::default_bias(params.size("moments")))
        }),
        OVERESTIMATION,
        DepthRange::param("pixel"),
        S_MAX,
        Composite::param("normalize"),
    ],
    submission_orders: ANY_ORDER,
    random: false,
    geometry_passes: "2",
    bytes_per_pixel: "4 (moments + 1) + 10",
    build,
};

fn build(params: &Params, view: &View) -> Result<Box<dyn AnyTechnique>> {
    Ok(technique(Powers::new(params.size("moments"), regularization(params)), params, view))
}
