//! Moment-based OIT with power moments (Münstermann, Krumpen, Klein & Peters 2018, M18).

use crate::continuum::absorbance::S_MAX;
use crate::continuum::moments::oracle::{
    ABSORBANCE, BIAS, MOMENTS, OVERESTIMATION, regularization, regularization_numbers, technique, width,
};
use crate::continuum::moments::power::Powers;
use crate::continuum::oracle::Composite;
use crate::continuum::range::DepthRange;
use crate::continuum::two_pass_form::{Own, two_pass_form};
use crate::error::Result;
use crate::format::{Format, SUMMATION, Target};
use crate::gpu::form::blocks::{self, FUNCTIONS, INTERVAL, OUTPUTS, TWO_PASS};
use crate::gpu::form::{Form, Number};
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
        BIAS.derived("5e-7 (4 moments), 5e-6 (6), 5e-5 (8); in 16 bits 6e-5, 6e-4, 2.5e-3", |params, _| {
            Value::Float(Powers::default_bias(params.size("moments"), width(params)))
        }),
        OVERESTIMATION,
        DepthRange::param("pixel"),
        S_MAX,
        Composite::param("normalize"),
        SUMMATION,
    ],
    targets: &TARGETS,
    submission_orders: ANY_ORDER,
    random: false,
    geometry_passes: "2",
    bytes_per_pixel: "absorbance, moments, 4 sums and R: 4 (moments + 1) + 20 in f32, 2 (moments + 1) + 10 in f16",
    build,
    gpu: Some(gpu),
};

static TARGETS: [Target; 4] = [
    ABSORBANCE,
    Target {
        doc: "format of the moments: sums in floats, and in unorm16, for 4 moments, transformed mean values, which need \
              ordered access; sums of 4 or 6 in f16 take a bias of 1e-2 and more to be safe",
        formats: MOMENTS.formats.and(&[Format::Unorm16]),
        ..MOMENTS
    },
    Target::ACCUMULATION,
    Target::REVEALAGE,
];

fn build(params: &Params, view: &View) -> Result<Box<dyn AnyTechnique>> {
    let count = params.size("moments");
    if params.text(MOMENTS.param) == Format::Unorm16.name() && count != 4 {
        let problem = format!("parameter \"moments_format\" is \"unorm16\" with {count} moments");
        return Err(params.error(problem, "allowed is unorm16 for 4 moments, whose transform is known"));
    }
    let powers = Powers::new(count, regularization(params)).of_width(width(params));
    Ok(technique(powers, &TARGETS, params, view))
}

/// Its form on a GPU: sums of moments, as single precision has them.
fn gpu(params: &Params, view: &View) -> Result<Form> {
    let count = params.size("moments");
    let spread = Powers::new(count, regularization(params)).of_width(width(params)).spread();
    let points = [Number::size(count / 2)];
    let numbers = [&points[..], &regularization_numbers(params), &spread.map(Number::float)].concat();
    two_pass_form(
        params,
        view,
        &Own {
            shader: include_str!("../../shaders/mboit_power.wgsl"),
            blocks: &[FUNCTIONS, INTERVAL, OUTPUTS, TWO_PASS, blocks::MOMENTS],
            targets: &TARGETS,
            map: (MOMENTS.name, "moments"),
            count,
            total: Some(ABSORBANCE.name),
            numbers: &numbers,
            ..Own::BARE
        },
    )
}

#[cfg(test)]
mod tests {
    use crate::params::{Input, Value};
    use crate::techniques::testing::{
        Random, assert_close, build, fragment, given, over, resolve, three_layers,
    };

    /// What the bias of single precision does to the layers' weights.
    const BIASED: f64 = 5e-5;

    fn beta(x: f64) -> (&'static str, Input) {
        ("overestimation", Input::Float(x))
    }

    /// Sheet 2.5: without overestimation m / 2 + 1 layers are told apart.
    #[test]
    fn three_layers_are_exact_without_overestimation() {
        let (color, transmittance) = over(&three_layers());
        for moments in [4, 6, 8] {
            let got = resolve("mboit_power", &[("moments", Input::Int(moments)), beta(0.0)], &three_layers());
            assert_close(got, color, transmittance, BIASED);
        }
    }

    /// Charged with all of themselves, the layers weigh 1 - alpha times as much.
    #[test]
    fn three_layers_with_full_overestimation_by_hand() {
        // alphas 1/4, 1/2, 3/4 front to back: weights 3/4, 3/8, 3/32
        let [middle, near, far] = [0, 1, 2].map(|i| glam::Vec3::from(three_layers()[i].color).as_dvec3());
        let sum = 0.75 * near + 0.375 * middle + 0.093_75 * far;
        let weight = 0.75 * 0.25 + 0.375 * 0.5 + 0.093_75 * 0.75;
        let background = glam::Vec3::from(crate::techniques::testing::BACKGROUND).as_dvec3();
        let expected = 0.906_25 * sum / weight + 0.093_75 * background;
        assert_close(resolve("mboit_power", &[beta(1.0)], &three_layers()), expected, 0.093_75, BIASED);
    }

    #[test]
    fn bias_and_memory_follow_the_moments() {
        let complexity = crate::technique::DepthComplexity { mean: 3.0, max: 9 };
        for (moments, bias, bytes) in [(4, 5e-7, 40.0), (6, 5e-6, 48.0), (8, 5e-5, 56.0)] {
            let inputs = [("moments", Input::Int(moments))];
            assert_eq!(given(&super::INFO, &inputs).value("bias"), Value::Float(bias));
            let cost = build("mboit_power", &inputs).unwrap().cost(&complexity);
            assert_eq!((cost.geometry_passes, cost.bytes_per_pixel), (2.0, bytes));
        }
    }

    /// The sums are order-independent up to their rounding in f32, which near-coincident depths amplify; 0.16
    /// is the largest difference that a search for bad pixels found.
    #[test]
    fn near_coincident_depths_amplify_the_rounding_of_sums() {
        let mut worst = 0.0_f64;
        for seed in 0..200 {
            let mut random = Random::new(seed);
            let mut pixel: Vec<_> = (0..5)
                .map(|i| {
                    let near = 4.0 + f32::from(u8::from(i == 4));
                    let rgb = [random.unit(), random.unit(), random.unit()];
                    fragment(near + 6e-4 * random.unit(), rgb, 0.5 + 0.45 * random.unit(), i)
                })
                .collect();
            let forward = resolve("mboit_power", &[("moments", Input::Int(6))], &pixel);
            pixel.reverse();
            let backward = resolve("mboit_power", &[("moments", Input::Int(6))], &pixel);
            worst = worst.max((forward.color - backward.color).abs().max_element());
        }
        assert!(worst > 1e-5, "{worst:e} is no amplification: the claim can be sharpened");
        assert!(worst < 0.25, "{worst}");
    }
}
