//! Weighted sum rendering of Gaussian splats (Hou et al. 2025): a weighted average in which the background
//! takes part like a fragment.

use crate::continuum::stored_sums::{Recipe, StoredSums};
use crate::continuum::sums::{BlendSums, Sums, blend};
use crate::diagnosis::{Diagnosis, Faults};
use crate::error::Result;
use crate::format::{Format, FormatSet, Formats, SUMMATION, Summation, Target};
use crate::fragments::List;
use crate::gpu::form::{
    BlendTarget, Blending, Form, Number, Path, SUMS, Streaming, only, only_single_formats, target_format,
};
use crate::params::{Kind, ParamSpec, Params, Value, View};
use crate::technique::{
    AnyTechnique, Axes, Cost, DepthComplexity, Info, Pixel, Properties, Resolved, Technique,
};
use crate::techniques::ANY_ORDER;
use std::f64::consts::LOG2_E;

/// The registry entry.
pub static INFO: Info = Info {
    id: "gs_wsr",
    aliases: &[],
    name: "Weighted sum rendering (Gaussian splatting)",
    citation: &["Hou2025"],
    doc: "The average of all fragments and of the background, weighted by depth. The background has a constant \
          weight instead of being covered, so not even one fragment is exact, and an opaque one lets it shine \
          through.",
    axes: Axes {
        memory: "empirical func",
        insertion: "never",
        merge: "discard all",
        normalize: "weighted average incl. background",
        opacity: "alpha",
    },
    params: &[
        ParamSpec::new(
            "variant",
            Kind::Choice(&["direct", "exp", "linear"]),
            Value::Text("direct"),
            "weight of a fragment: 1, exp(-sigma z^gamma), or max(0, 1 - z / sigma) gain",
        ),
        ParamSpec::new(
            "background_weight",
            Kind::NON_NEGATIVE,
            Value::Float(1.0),
            "weight of the background",
        ),
        ParamSpec::new(
            "sigma",
            Kind::POSITIVE,
            Value::None,
            "how fast exp falls, or the depth where linear ends",
        )
        .derived("1 (exp), automatic (linear: twice the mean depth of a pixel)", |params, _| {
            if params.text("variant") == "exp" { Value::Float(1.0) } else { Value::None }
        })
        .when(|params| params.text("variant") != "direct"),
        ParamSpec::new("gamma", Kind::POSITIVE, Value::Float(1.0), "power of depth in exp")
            .when(|params| params.text("variant") == "exp"),
        ParamSpec::new("gain", Kind::POSITIVE, Value::Float(1.0), "factor of linear")
            .when(|params| params.text("variant") == "linear"),
        SUMMATION,
    ],
    targets: &[Target::ACCUMULATION, DEPTH],
    submission_orders: ANY_ORDER,
    random: false,
    geometry_passes: "1, 1 more for linear's automatic sigma",
    bytes_per_pixel: "4 sums: 16 in f32, 8 in f16; linear's automatic sigma takes 2 more",
    build,
    gpu: Some(gpu),
};

fn build(params: &Params, _view: &View) -> Result<Box<dyn AnyTechnique>> {
    let weight = match (params.text("variant"), params.value("sigma")) {
        ("exp", _) => Weight::Exponential { sigma: params.float("sigma"), gamma: params.float("gamma") },
        ("linear", Value::Float(sigma)) => Weight::Linear { sigma: Some(sigma), gain: params.float("gain") },
        ("linear", _) => Weight::Linear { sigma: None, gain: params.float("gain") },
        _ => Weight::Direct,
    };
    let formats = Formats::from_params(INFO.targets, params);
    let recipe = Recipe::from_params(&formats, params);
    let bytes = recipe.bytes_per_pixel(&formats, formats.bytes_of("accumulation"));
    let default = formats.are_default() && recipe.summation == Summation::Plain;
    let automatic = matches!(weight, Weight::Linear { sigma: None, .. });
    let depth = if automatic { formats.of("depth") } else { Format::F64 };
    let background_weight = params.float("background_weight");
    let stored = (!default).then_some((recipe, depth));
    Ok(Box::new(WeightedSumRendering { weight, background_weight, stored, bytes }))
}

const BLENDED: &str = concat!(
    include_str!("../../shaders/gs_wsr/average.wgsl"),
    include_str!("../../shaders/gs_wsr/blended.wgsl")
);
const LISTED: &str = concat!(
    include_str!("../../shaders/gs_wsr/average.wgsl"),
    include_str!("../../shaders/gs_wsr/listed.wgsl")
);

/// Its form on a GPU: the blend unit adds up; fragments are walked over twice where sigma is a pixel's own.
fn gpu(params: &Params, _view: &View) -> Result<Form> {
    only(params, "summation", "plain")?;
    let formats = Formats::from_params(INFO.targets, params);
    let (variant, sigma) = match (params.text("variant"), params.value("sigma")) {
        ("exp", Value::Float(sigma)) => (1, Some(sigma)),
        ("linear", Value::Float(sigma)) => (2, Some(sigma)),
        ("linear", _) => (2, None),
        _ => (0, Some(0.0)),
    };
    let (format, path) = if sigma.is_some() {
        let format = target_format(params, &formats, "accumulation", "accumulation_format", SUMS)?;
        let targets = vec![BlendTarget::sums("accumulation_format", format, 4)];
        let (draw, resolve) = ("accumulate", "resolve");
        (format, Path::Blended(Blending::once(draw, resolve, targets)))
    } else {
        only_single_formats(params, INFO.targets)?;
        (Format::F32, Path::Streamed(Streaming::in_any_order().in_walks()))
    };
    // what is positive stays so
    let positive = |x: f64| Number::float(x.max(f32::MIN_POSITIVE.into()));
    let numbers = vec![
        Number::Whole(variant),
        positive(sigma.unwrap_or(0.0)),
        positive(params.float("gamma")),
        positive(params.float("gain")),
        Number::float(params.float("background_weight")),
        Number::float(format.max_finite(0)),
    ];
    Ok(Form {
        weight: None,
        shader: if sigma.is_some() { BLENDED } else { LISTED },
        numbers,
        path,
        shows_zero_fragments: false,
        colored_transmittance: false,
    })
}

/// What the automatic sigma is made of.
const DEPTH: Target = Target {
    name: "depth",
    param: "depth_format",
    doc: "format of the sum of depths and of their number, from which linear's automatic sigma follows",
    formats: FormatSet::FLOATS,
    channels: 2,
    double: true,
    active: |params| params.text("variant") == "linear" && params.value("sigma") == Value::None,
};

/// A fragment's weight by its depth.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Weight {
    Direct,
    Exponential {
        sigma: f64,
        gamma: f64,
    },
    Linear {
        /// None: twice the mean depth of the pixel.
        sigma: Option<f64>,
        gain: f64,
    },
}

impl Weight {
    /// The weight for a pixel with these fragments, whose depths are summed up in `depth`.
    fn for_pixel(self, list: List<'_>, depth: Format) -> Self {
        match self {
            Self::Linear { sigma: None, gain } => {
                Self::Linear { sigma: Some(2.0 * mean_depth(list, depth)), gain }
            }
            weight => weight,
        }
    }

    #[expect(clippy::cast_possible_truncation, reason = "the sums are f32 targets")]
    fn at(self, depth: f32) -> f32 {
        self.at_f64(depth) as f32
    }

    fn at_f64(self, depth: f32) -> f64 {
        let z = f64::from(depth);
        let weight = match self {
            Self::Direct => 1.0,
            Self::Exponential { sigma, gamma } => (-sigma * z.powf(gamma)).exp(),
            // where every depth is 0, so is their mean
            Self::Linear { sigma: None | Some(0.0), gain } => gain,
            Self::Linear { sigma: Some(sigma), gain } => (1.0 - z / sigma).max(0.0) * gain,
        };
        weight.min(LARGEST)
    }

    /// As the sums want it.
    fn stored_at(self, recipe: Recipe, depth: f32) -> f64 {
        match (recipe.summation.is_scaled(), recipe.rgb) {
            (true, _) => self.log2_at(depth),
            (false, Format::F64) => self.at_f64(depth),
            (false, _) => f64::from(self.at(depth)),
        }
    }

    /// log2 w: where the exponential underflows, too.
    fn log2_at(self, depth: f32) -> f64 {
        match self {
            Self::Exponential { sigma, gamma } => -sigma * f64::from(depth).powf(gamma) * LOG2_E,
            _ => self.at_f64(depth).log2(),
        }
    }
}

/// Sums of ten thousand such weights stay finite in f32.
const LARGEST: f64 = 1e30;

#[expect(clippy::cast_precision_loss, reason = "a pixel's list is far shorter than 2^52")]
fn mean_depth(list: List<'_>, format: Format) -> f64 {
    if format == Format::F64 {
        return list.depth.iter().map(|&z| f64::from(z)).sum::<f64>() / list.len() as f64;
    }
    let add = |sum, x| format.round(format.blend(sum, 1.0, x));
    let sums = list.depth.iter().fold((0.0, 0.0), |(sum, n), &z| (add(sum, z.into()), add(n, 1.0)));
    format.read(sums.0) / sums.1
}

struct WeightedSumRendering {
    weight: Weight,
    background_weight: f64,
    /// How the sums are stored and what depths are summed in, if not by default.
    stored: Option<(Recipe, Format)>,
    bytes: f64,
}

impl WeightedSumRendering {
    fn sums(&self, list: List<'_>) -> Sums {
        let weight = self.weight.for_pixel(list, Format::F64);
        let mut sums = BlendSums::CLEAR;
        for fragment in list.iter() {
            sums.add(weight.at(fragment.depth), fragment.color, fragment.alpha);
        }
        sums.read(list.len())
    }

    fn stored_sums(&self, recipe: Recipe, depth: Format, list: List<'_>) -> StoredSums {
        let weight = self.weight.for_pixel(list, depth);
        let mut sums = StoredSums::CLEAR;
        for fragment in list.iter() {
            sums.add(recipe, weight.stored_at(recipe, fragment.depth), fragment.color, fragment.alpha);
        }
        sums
    }
}

impl Technique for WeightedSumRendering {
    type Scratch = ();

    fn resolve(&self, pixel: &Pixel<'_>, (): &mut ()) -> Resolved {
        let (sums, saturated) = match self.stored {
            None => (self.sums(pixel.list), false),
            Some((recipe, depth)) => {
                let sums = self.stored_sums(recipe, depth, pixel.list);
                (sums.read(recipe), sums.saturated)
            }
        };
        let total = self.background_weight + sums.alpha;
        if total == 0.0 {
            return Resolved::background(pixel.background);
        }
        let blended = blend(sums.color / total, 1.0, self.background_weight / total, pixel.background);
        Resolved { dropped: saturated.into(), ..blended }
    }

    fn faults(&self) -> Faults {
        self.stored.map_or(Recipe::SINGLE, |(recipe, _)| recipe).faults()
    }

    fn diagnose(&self, pixel: &Pixel<'_>, (): &mut ()) -> Diagnosis {
        let (recipe, depth) = self.stored.unwrap_or((Recipe::SINGLE, Format::F64));
        let weight = self.weight.for_pixel(pixel.list, depth);
        let (mut sums, mut found) = (StoredSums::CLEAR, Diagnosis::CLEAR);
        // where linear ends, 0 is what the formula says
        let counts = |z| !matches!(weight, Weight::Linear { .. }) || weight.at_f64(z) > 0.0;
        for f in pixel.list.iter().filter(|f| counts(f.depth)) {
            // the share R is nobody's target here
            sums.add_watched(
                recipe,
                weight.stored_at(recipe, f.depth),
                f.color,
                f.alpha,
                0.0,
                1.0,
                &mut found,
            );
        }
        sums.read_watched(recipe, &mut found);
        found
    }

    fn cost(&self, _complexity: &DepthComplexity) -> Cost {
        let automatic = matches!(self.weight, Weight::Linear { sigma: None, .. });
        Cost { geometry_passes: if automatic { 2.0 } else { 1.0 }, bytes_per_pixel: self.bytes }
    }

    fn properties(&self) -> Properties {
        Properties { order_independent: true, ..Properties::NONE }
    }
}

#[cfg(test)]
mod tests {
    use crate::params::{Input, Value};
    use crate::technique::DepthComplexity;
    use crate::techniques::testing::{
        BACKGROUND, F32_STATE, assert_close, build, fragment, given, random_pixel, resolve, three_layers,
    };
    use glam::{DVec3, Vec3};

    fn variant(name: &str) -> (&'static str, Input) {
        ("variant", Input::Text(name.into()))
    }

    /// Premultiplied colours of the three layers, at depths 4, 2, 8 and alphas 1/2, 1/4, 3/4.
    const LAYERS: [DVec3; 3] =
        [DVec3::new(0.05, 0.45, 0.1), DVec3::new(0.25, 0.075, 0.025), DVec3::new(0.15, 0.075, 0.75)];

    #[test]
    fn three_layers_by_hand() {
        let e = |z: f64| (-0.5 * z * z).exp();
        let square = [variant("exp"), ("sigma", Input::Float(0.5)), ("gamma", Input::Int(2))];
        let gain = [variant("linear"), ("sigma", Input::Int(6)), ("gain", Input::Int(3))];
        // the mean depth is 14/3
        let linear = |z: f64| 1.0 - z * 3.0 / 28.0;
        let cases = [
            (&[][..], [1.0; 3]),
            (&square, [e(4.0), e(2.0), e(8.0)]),
            (&gain, [1.0, 2.0, 0.0]),
            (&[variant("linear")], [linear(4.0), linear(2.0), linear(8.0)]),
        ];
        for (inputs, w) in cases {
            let background = ("background_weight", Input::Float(0.25));
            let got = resolve("gs_wsr", &[inputs, &[background]].concat(), &three_layers());
            let total = 0.25 + 0.5 * w[0] + 0.25 * w[1] + 0.75 * w[2];
            let sum = w[0] * LAYERS[0] + w[1] * LAYERS[1] + w[2] * LAYERS[2];
            let color = (0.25 * DVec3::from(Vec3::from(BACKGROUND)) + sum) / total;
            assert_close(got, color, 0.25 / total, F32_STATE);
        }
    }

    /// Sheet 2.7: then it is the colour term of weighted blended OIT alone.
    #[test]
    fn without_background_it_is_the_average_color() {
        for seed in 0..10 {
            let pixel = random_pixel(8 + seed, seed.into());
            let blended = resolve("blended_oit", &[], &pixel);
            let covered = blended.color - blended.transmittance * DVec3::from(Vec3::from(BACKGROUND));
            let average = covered / (1.0 - blended.transmittance);
            let got = resolve("gs_wsr", &[("background_weight", Input::Int(0))], &pixel);
            assert_close(got, average, 0.0, F32_STATE);
            let almost = resolve("gs_wsr", &[("background_weight", Input::Float(1e-9))], &pixel);
            assert_close(almost, average, 0.0, F32_STATE);
        }
    }

    #[test]
    fn a_lone_fragment_is_exact_for_one_background_weight_only() {
        let lone = [fragment(2.0, [1.0, 0.5, 0.0], 0.75, 0)];
        let (color, transmittance) = crate::techniques::testing::over(&lone);
        let at = |weight| resolve("gs_wsr", &[("background_weight", Input::Float(weight))], &lone);
        assert_close(at(0.25), color, transmittance, F32_STATE);
        assert!((at(1.0).color - color).abs().max_element() > 0.01);
    }

    #[test]
    fn nothing_with_a_weight_leaves_the_background() {
        let beyond = [fragment(5.0, [1.0; 3], 0.5, 0)];
        let inputs = [variant("linear"), ("sigma", Input::Int(5)), ("background_weight", Input::Int(0))];
        assert_close(resolve("gs_wsr", &inputs, &beyond), DVec3::from(Vec3::from(BACKGROUND)), 1.0, 0.0);
        let at_the_eye = [fragment(0.0, [1.0; 3], 0.5, 0)];
        assert!(resolve("gs_wsr", &[variant("linear")], &at_the_eye).color.is_finite());
    }

    /// exp(-z²) of depths whose weights halves do not have.
    #[test]
    fn scaled_halves_keep_weights_that_halves_lose() {
        let far = [fragment(6.0, [1.0, 0.5, 0.0], 0.5, 0), fragment(6.1, [0.0, 0.5, 1.0], 0.5, 1)];
        let at = |format: &str, summation: &str| {
            let storage = [("format", format), ("summation", summation), ("variant", "exp")];
            let storage = storage.map(|(name, value)| (name, Input::Text(value.into())));
            let rest = [("gamma", Input::Int(2)), ("background_weight", Input::Int(0))];
            resolve("gs_wsr", &[&storage[..], &rest].concat(), &far)
        };
        let exact = at("f64", "plain");
        assert_close(at("f16", "scaled"), exact.color, 0.0, 1e-3);
        assert_close(at("f32", "plain"), exact.color, 0.0, F32_STATE);
        assert_eq!(at("f16", "plain").transmittance.x, 1.0);
    }

    #[test]
    fn sums_of_depths_are_stored_too() {
        let pixel: Vec<_> = (0..5000).map(|i| fragment(1.0, [1.0, 0.5, 0.0], 0.5, i)).collect();
        let at = |format: &str| {
            let depth = ("depth_format", Input::Text(format.into()));
            resolve("gs_wsr", &[variant("linear"), depth], &pixel).transmittance.x
        };
        // sum and count both stop at 2048: their quotient is right
        assert_eq!(at("f16"), at("f32"));
        assert!((at("f64") - at("f32")).abs() < 1e-9);
    }

    #[test]
    fn sigma_is_automatic_where_it_depends_on_the_pixel() {
        let sigma = |name| given(&super::INFO, &[variant(name)]).value("sigma");
        assert_eq!(["direct", "exp", "linear"].map(sigma), [Value::None, Value::Float(1.0), Value::None]);
        let complexity = DepthComplexity { mean: 1.0, max: 1 };
        let passes = |inputs: &[_]| build("gs_wsr", inputs).unwrap().cost(&complexity).geometry_passes;
        assert_eq!(passes(&[variant("linear")]), 2.0);
        assert_eq!(passes(&[variant("linear"), ("sigma", Input::Int(3))]), 1.0);
    }
}
