//! Moment-based OIT with trigonometric moments (Münstermann, Krumpen, Klein & Peters 2018, M18).

use crate::continuum::absorbance::S_MAX;
use crate::continuum::moments::oracle::{BIAS, OVERESTIMATION, regularization, technique};
use crate::continuum::moments::trigonometric::Harmonics;
use crate::continuum::oracle::Composite;
use crate::continuum::range::DepthRange;
use crate::error::Result;
use crate::params::{Kind, ParamSpec, Params, Value, View};
use crate::technique::{AnyTechnique, Axes, Info};
use crate::techniques::ANY_ORDER;
use std::f64::consts::PI;

/// The registry entry.
pub static INFO: Info = Info {
    id: "mboit_trig",
    aliases: &[],
    name: "Moment-based OIT, trigonometric moments",
    citation: &["Munstermann2018"],
    doc: "As mboit_power, with depth wound round the unit circle and the mean values of the first harmonics \
          for moments: two numbers each, better conditioned. A gap, the wrapping zone, keeps the far end from \
          the near one.",
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
            Kind::IntChoice(&[2, 3, 4]),
            Value::Int(3),
            "harmonics whose complex means are stored",
        ),
        BIAS.derived("4e-7 (2 moments), 8e-7 (3), 1.5e-6 (4)", |params, _| {
            Value::Float(Harmonics::default_bias(params.size("moments")))
        }),
        OVERESTIMATION,
        DepthRange::param("pixel"),
        S_MAX,
        Composite::param("normalize"),
        ParamSpec::new(
            "wrapping_zone",
            Kind::float(0.0, PI),
            Value::Float(0.1 * PI),
            "angle between the far end of the range and the near one; mass found there counts as in front",
        ),
    ],
    submission_orders: ANY_ORDER,
    random: false,
    geometry_passes: "2",
    bytes_per_pixel: "4 (2 moments + 1) + 10",
    build,
};

fn build(params: &Params, view: &View) -> Result<Box<dyn AnyTechnique>> {
    let zone = params.float("wrapping_zone");
    Ok(technique(Harmonics::new(params.size("moments"), zone, regularization(params)), params, view))
}
