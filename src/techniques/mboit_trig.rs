//! Moment-based OIT with trigonometric moments (Münstermann, Krumpen, Klein & Peters 2018, M18).

use crate::continuum::absorbance::S_MAX;
use crate::continuum::moments::oracle::{
    ABSORBANCE, BIAS, MOMENTS, OVERESTIMATION, regularization, regularization_numbers, technique, width,
};
use crate::continuum::moments::trigonometric::Harmonics;
use crate::continuum::oracle::Composite;
use crate::continuum::range::DepthRange;
use crate::continuum::two_pass_form::{Own, two_pass_form};
use crate::error::Result;
use crate::format::{SUMMATION, Target};
use crate::gpu::form::blocks::{self, FUNCTIONS, INTERVAL, OUTPUTS, TWO_PASS};
use crate::gpu::form::{Form, Number};
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
        BIAS.derived(
            "4e-7 (2 moments), 8e-7 (3), 1.5e-6 (4); in 16 bits 4e-4, 6.5e-4, 8.5e-4",
            |params, _| Value::Float(Harmonics::default_bias(params.size("moments"), width(params))),
        ),
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
        SUMMATION,
    ],
    targets: &TARGETS,
    submission_orders: ANY_ORDER,
    random: false,
    geometry_passes: "2",
    bytes_per_pixel: "absorbance, moments, 4 sums and R: 4 (2 moments + 1) + 20 in f32, 2 (2 moments + 1) + 10 in f16",
    build,
    gpu: Some(gpu),
};

fn build(params: &Params, view: &View) -> Result<Box<dyn AnyTechnique>> {
    let zone = params.float("wrapping_zone");
    let harmonics = Harmonics::new(params.size("moments"), zone, regularization(params));
    Ok(technique(harmonics, &TARGETS, params, view))
}

/// Its form on a GPU: sums of moments, as single precision has them.
fn gpu(params: &Params, view: &View) -> Result<Form> {
    let count = params.size("moments");
    let zone = params.float("wrapping_zone") / (2.0 * PI);
    let [half_range, more] = Number::in_two(0.5 - 0.5 * zone);
    let circle = [half_range, more, Number::float(zone), Number::Whole(0)];
    let numbers = [&[Number::size(count)][..], &regularization_numbers(params), &circle].concat();
    two_pass_form(
        params,
        view,
        &Own {
            shader: include_str!("../../shaders/mboit_trig.wgsl"),
            blocks: &[FUNCTIONS, INTERVAL, OUTPUTS, TWO_PASS, blocks::MOMENTS],
            targets: &TARGETS,
            map: (MOMENTS.name, "moments"),
            count: 2 * count,
            total: Some(ABSORBANCE.name),
            numbers: &numbers,
            ..Own::BARE
        },
    )
}

static TARGETS: [Target; 4] = [ABSORBANCE, MOMENTS, Target::ACCUMULATION, Target::REVEALAGE];

#[cfg(test)]
mod tests {
    use crate::params::{Input, Value};
    use crate::techniques::testing::{as_pixel, assert_close, build, given, over, resolve, three_layers};

    /// What the bias of single precision does to the layers' weights.
    const BIASED: f64 = 1e-4;

    /// Sheet 2.5: without overestimation m + 1 layers are told apart.
    #[test]
    fn three_layers_are_exact_without_overestimation() {
        let (color, transmittance) = over(&three_layers());
        for moments in [2, 3, 4] {
            let inputs = [("moments", Input::Int(moments)), ("overestimation", Input::Int(0))];
            assert_close(resolve("mboit_trig", &inputs, &three_layers()), color, transmittance, BIASED);
        }
    }

    /// With no gap the far end of the range is the near one, and what is there hides what is in front of it.
    #[test]
    fn the_wrapping_zone_keeps_the_ends_apart() {
        let in_front = |zone: f64| {
            let technique = build("mboit_trig", &[("wrapping_zone", Input::Float(zone))]).unwrap();
            let ends = [three_layers()[1], three_layers()[2]];
            let depths = [ends[0].depth];
            as_pixel(&ends, |pixel| technique.transmittance(pixel, &depths).unwrap()[0])
        };
        // of the near layer's quarter of alpha, a quarter counts; with no gap also of the far layer's
        assert!((in_front(0.3) - 0.75_f64.powf(0.25)).abs() < BIASED, "{}", in_front(0.3));
        assert!((in_front(0.0) - (0.75_f64 * 0.25).powf(0.25)).abs() < BIASED, "{}", in_front(0.0));
    }

    #[test]
    fn bias_and_memory_follow_the_moments() {
        let complexity = crate::technique::DepthComplexity { mean: 3.0, max: 9 };
        for (moments, bias, bytes) in [(2, 4e-7, 40.0), (3, 8e-7, 48.0), (4, 1.5e-6, 56.0)] {
            let inputs = [("moments", Input::Int(moments))];
            assert_eq!(given(&super::INFO, &inputs).value("bias"), Value::Float(bias));
            let cost = build("mboit_trig", &inputs).unwrap().cost(&complexity);
            assert_eq!((cost.geometry_passes, cost.bytes_per_pixel), (2.0, bytes));
        }
    }
}
