//! Weighted blended OIT (`McGuire` & Bavoil 2013, eq. 6): a depth-weighted average at the exact coverage.

use super::blended_oit::BLENDED;
use crate::continuum::stored::Stored;
use crate::continuum::stored_sums::Recipe;
use crate::continuum::stored_sums::diagnose::{diagnose, faults};
use crate::continuum::sums::{Blended, Sums, SumsOf, finish_each};
use crate::diagnosis::{Diagnosis, Faults};
use crate::error::Result;
use crate::format::{FormatSet, Formats, SUMMATION, Summation, Target};
use crate::gpu::form::{Blend, BlendTarget, Blending, Form, Number, Path, SHARES, SUMS, only, target_format};
use crate::params::{Kind, ParamSpec, Params, Value, View};
use crate::technique::{
    AnyTechnique, Axes, Cost, DepthComplexity, FinishedPixels, Info, Pixel, Properties, Resolved, Streamed,
    Technique,
};
use crate::techniques::ANY_ORDER;
use crate::weight::{self, Weighting};
use glam::DVec3;

/// The registry entry.
pub static INFO: Info = Info {
    id: "wboit",
    aliases: &[],
    name: "Weighted blended OIT",
    citation: &["McGuire2013", "McGuire2016"],
    doc: "The average colour, weighted by a decreasing function of depth, covers the background exactly as \
          much as all fragments together do (MB13 eq. 6): nearer fragments dominate, none hides another.",
    axes: Axes {
        memory: "empirical func",
        insertion: "never",
        merge: "discard all",
        normalize: "α-weighted average",
        opacity: "alpha",
    },
    params: &[
        weight::WEIGHT,
        weight::WEIGHT_K,
        weight::WEIGHT_SCALE,
        weight::WEIGHT_SHIFT,
        weight::NEAR,
        weight::FAR,
        ParamSpec::new(
            "listing3_clamp",
            Kind::Bool,
            Value::Bool(false),
            "divide by the sum of weights clamped to [1e-4, 5e4], as MB13 Listing 3 is printed; darkens faint \
             fragments at the weights' floor",
        ),
        ParamSpec::new(
            "layout",
            Kind::Choice(&["listing3", "listing4", "monochrome"]),
            Value::Text("listing3"),
            "what is in which target: (w C, w a) and R (MB13 Listing 3); (w C, R) and w a, which need no blend function \
             per target (Listing 4); or (w C, w a, 0, R) in one target, with C the luminance (MB13 section 3.4)",
        ),
        SUMMATION,
    ],
    targets: &[
        Target::ACCUMULATION,
        Target::REVEALAGE.when(|params| params.text("layout") == "listing3"),
        WEIGHTS.when(|params| params.text("layout") == "listing4"),
    ],
    submission_orders: ANY_ORDER,
    random: false,
    geometry_passes: "1",
    bytes_per_pixel: "4 sums and R: 20 in f32, 10 in f16; monochrome: 16 and 8",
    build,
    gpu: Some(gpu),
};

fn build(params: &Params, _view: &View) -> Result<Box<dyn AnyTechnique>> {
    let weighting = Weighting::from_params(params)?;
    let wboit = Wboit { weighting, listing3_clamp: params.bool("listing3_clamp") };
    let formats = Formats::from_params(INFO.targets, params);
    let recipe = recipe(&formats, params);
    let layout = params.text("layout");
    if layout == "listing3" && formats.are_default() && recipe.summation == Summation::Plain {
        return Ok(Box::new(wboit));
    }
    let sums = formats.bytes_of("accumulation") + formats.bytes_of("weights");
    // integers for four sums, and R's logarithm beside them where R has no target of its own
    let fixed = recipe.summation == Summation::Fixed && params.text("layout") == "listing4";
    let logarithm = if fixed { 8.0 } else { 0.0 };
    Ok(Stored::boxed(wboit, recipe, recipe.bytes_per_pixel(&formats, sums) + logarithm))
}

/// Its form on a GPU, in any of the layouts.
fn gpu(params: &Params, _view: &View) -> Result<Form> {
    only(params, "summation", "plain")?;
    let formats = Formats::from_params(INFO.targets, params);
    let format = target_format(params, &formats, "accumulation", "accumulation_format", SUMS)?;
    let sums = BlendTarget::sums("accumulation_format", format, 4);
    let (draw, resolve, targets) = match params.text("layout") {
        "listing4" => {
            let weights = target_format(params, &formats, "weights", "weights_format", SUMS)?;
            let targets = vec![sums.with_share(), BlendTarget::sums("weights_format", weights, 1)];
            ("accumulate_listing4", "resolve_listing4", targets)
        }
        "monochrome" => ("accumulate_monochrome", "resolve_monochrome", vec![sums.with_share()]),
        _ => {
            let revealage = target_format(params, &formats, "revealage", "revealage_format", SHARES)?;
            let targets =
                vec![sums, BlendTarget::product("revealage_format", revealage, 1, Blend::Attenuate)];
            ("accumulate_listing3", "resolve_listing3", targets)
        }
    };
    let weighting = Weighting::from_params(params)?;
    let near_depths = weighting.is_gentle();
    let weight = weighting.shading(params)?;
    let largest_weights = formats.find("weights").map_or(f64::MAX, |format| format.max_finite(0));
    let more = [
        Number::float(format.max_finite(0)),
        Number::float(largest_weights),
        Number::Whole(params.bool("listing3_clamp").into()),
    ];
    Ok(Form {
        shader: include_str!("../../shaders/wboit.wgsl"),
        numbers: weight.numbers.into_iter().chain(more).collect(),
        weight: Some(weight.module),
        path: Path::Blended(Blending { near_depths, ..Blending::once(draw, resolve, targets) }),
        shows_zero_fragments: false,
        colored_transmittance: false,
    })
}

/// Σ w a, which Listing 4 keeps apart.
const WEIGHTS: Target = Target {
    name: "weights",
    param: "weights_format",
    doc: "format of the sum of weighted alphas where layout=\"listing4\" keeps it apart",
    formats: FormatSet::FLOATS,
    channels: 1,
    double: false,
    active: |_| true,
};

/// Which numbers are in which target's format.
fn recipe(formats: &Formats, params: &Params) -> Recipe {
    let recipe = Recipe::from_params(formats, params);
    let accumulation = recipe.rgb;
    match params.text("layout") {
        "listing4" => Recipe { alpha: formats.of("weights"), revealage: accumulation.of_alpha(), ..recipe },
        "monochrome" => Recipe { monochrome: true, revealage: accumulation.of_alpha(), ..recipe },
        _ => Recipe { revealage: formats.of("revealage"), ..recipe },
    }
}

/// A weighted average at the exact coverage.
pub(super) struct Wboit {
    /// The weights.
    pub weighting: Weighting,
    /// Whether the sum of weights is clamped as printed.
    pub listing3_clamp: bool,
}

impl Blended for Wboit {
    fn weighting(&self) -> Option<&Weighting> {
        Some(&self.weighting)
    }

    fn finish(&self, sums: &Sums, background: DVec3) -> Resolved {
        if self.listing3_clamp {
            return sums.cover(sums.color / sums.alpha.clamp(1e-4, 5e4), background);
        }
        sums.over(background)
    }

    fn finish_all(&self, pixels: &SumsOf<'_>, out: &mut FinishedPixels) {
        if self.listing3_clamp {
            return finish_each(self, pixels, out);
        }
        pixels.over(out);
    }
}

impl Technique for Wboit {
    type Scratch = Vec<f32>;

    fn resolve(&self, pixel: &Pixel<'_>, weights: &mut Vec<f32>) -> Resolved {
        self.blend_list(pixel.list, pixel.background, weights)
    }

    fn streamed(&self) -> Option<Streamed<'_>> {
        Some(Streamed::Sums(self))
    }

    fn cost(&self, _complexity: &DepthComplexity) -> Cost {
        Cost { geometry_passes: 1.0, bytes_per_pixel: 20.0 }
    }

    fn properties(&self) -> Properties {
        if !self.listing3_clamp {
            return BLENDED;
        }
        Properties { exact_for_one: false, exact_for_one_color: false, ..BLENDED }
    }

    fn faults(&self) -> Faults {
        faults(self, Recipe::SINGLE)
    }

    fn diagnose(&self, pixel: &Pixel<'_>, _weights: &mut Vec<f32>) -> Diagnosis {
        diagnose(self, Recipe::SINGLE, pixel.list)
    }
}

#[cfg(test)]
mod tests {
    use crate::fragments::Fragment;
    use crate::params::Input;
    use crate::technique::Resolved;
    use crate::techniques::testing::{
        BACKGROUND, F32_STATE, assert_close, build, fragment, over, random_pixel, resolve, three_layers,
    };
    use glam::{DVec3, Vec3};

    fn text(name: &'static str, value: &str) -> (&'static str, Input) {
        (name, Input::Text(value.into()))
    }

    fn wboit(params: &[(&str, Input)], pixel: &[Fragment]) -> Resolved {
        resolve("wboit", params, pixel)
    }

    #[test]
    fn three_layers_by_hand() {
        // inv_pow with k = 1 at depths 4, 2, 8: weights 1/4, 1/2, 1/8
        let premultiplied =
            [DVec3::new(0.05, 0.45, 0.1), DVec3::new(0.25, 0.075, 0.025), DVec3::new(0.15, 0.075, 0.75)];
        let color = 0.25 * premultiplied[0] + 0.5 * premultiplied[1] + 0.125 * premultiplied[2];
        let alpha = 0.25 * 0.5 + 0.5 * 0.25 + 0.125 * 0.75;
        let expected = 0.906_25 / alpha * color + 0.093_75 * Vec3::from(BACKGROUND).as_dvec3();
        let params = [text("weight", "inv_pow"), ("weight_k", Input::Int(1))];
        assert_close(wboit(&params, &three_layers()), expected, 0.093_75, F32_STATE);
    }

    #[test]
    fn constant_factors_cancel() {
        // z^-k at twice the depth is 2^-k of the weight, exactly
        let pixel = random_pixel(20, 3);
        let scaled = |g| wboit(&[text("weight", "inv_pow"), ("weight_scale", Input::Float(g))], &pixel);
        assert_close(scaled(2.0), scaled(1.0).color, scaled(1.0).transmittance.x, F32_STATE);
    }

    #[test]
    fn blended_colors_stay_in_the_hull() {
        for weight in ["mb7", "mb8", "mb9", "mb10", "inv_pow", "fig1", "smoke6", "fig10", "i3d16"] {
            let mut pixel = random_pixel(30, 5);
            for f in &mut pixel {
                f.color = [0.2 * f.alpha, 0.7 * f.alpha, f.color[2]];
            }
            let got = wboit(&[text("weight", weight)], &pixel);
            let covered = got.color - got.transmittance * Vec3::from(BACKGROUND).as_dvec3();
            let average = covered / (1.0 - got.transmittance);
            assert!((average.x - 0.2).abs() < F32_STATE && (average.y - 0.7).abs() < F32_STATE, "{weight}");
        }
    }

    #[test]
    fn underflow_of_every_weight_is_the_unweighted_average() {
        let mut pixel = random_pixel(6, 8);
        for f in &mut pixel {
            f.depth += 1e9;
        }
        let unweighted = resolve("blended_oit", &[], &pixel);
        let got = wboit(&[text("weight", "inv_pow")], &pixel);
        assert_close(got, unweighted.color, unweighted.transmittance.x, F32_STATE);
    }

    #[test]
    fn depth_of_the_scene_matters() {
        let mut pixel = three_layers();
        let here = wboit(&[], &pixel).color;
        for f in &mut pixel {
            f.depth += 20.0;
        }
        assert!((wboit(&[], &pixel).color - here).abs().max_element() > 0.01);
    }

    /// Sheet R12: at the weight floor the printed clamp darkens a lone fragment to `A_a` / 1e-4.
    #[test]
    fn the_printed_clamp_darkens_faint_fragments() {
        for (alpha, factor) in [(0.05, 0.25), (0.01, 0.01)] {
            let lone = [fragment(200.0, [1.0; 3], alpha, 0)];
            let mut got = wboit(&[("listing3_clamp", Input::Bool(true))], &lone);
            got.color -= got.transmittance * Vec3::from(BACKGROUND).as_dvec3();
            let kept = got.color.x / f64::from(alpha);
            assert!((kept - factor).abs() < 1e-5, "{alpha}: {kept}");
            let (color, transmittance) = over(&lone);
            assert_close(wboit(&[], &lone), color, transmittance, F32_STATE);
        }
    }

    #[test]
    fn the_printed_clamp_brightens_dense_stacks() {
        // sheet R12: 21.8 layers fill f16, 31 % beyond the clamp
        let pixel: Vec<_> = (0..22).map(|i| fragment(0.1, [1.0; 3], 1.0, i)).collect();
        let got = wboit(&[("listing3_clamp", Input::Bool(true))], &pixel);
        assert!((got.color.x - 22.0 * 3e3 / 5e4).abs() < 1e-5, "{got:?}");
    }

    #[test]
    fn near_must_be_less_than_far() {
        let params = [text("weight", "mb10"), ("near", Input::Float(5.0)), ("far", Input::Int(5))];
        let message = build("wboit", &params).err().unwrap().to_string();
        assert!(message.contains("wboit") && message.contains("near must be less than far"), "{message}");
    }

    #[test]
    fn window_depth_weights_use_the_cameras_planes_by_default() {
        let pixel = three_layers();
        let planes = [text("weight", "mb10"), ("near", Input::Float(0.1)), ("far", Input::Float(100.0))];
        assert_eq!(wboit(&planes, &pixel), wboit(&planes[..1], &pixel));
        let other = [text("weight", "mb10"), ("near", Input::Float(1.0)), ("far", Input::Float(100.0))];
        assert_ne!(wboit(&other, &pixel), wboit(&planes, &pixel));
    }

    #[test]
    fn bright_colors_are_exact() {
        let pixel = [fragment(1.0, [6e4, 1.0, 1e-3], 0.25, 0)];
        let (color, transmittance) = over(&pixel);
        for weight in ["one", "mb7", "mb8", "mb9", "mb10", "inv_pow", "fig1", "smoke6", "fig10", "i3d16"] {
            let got = wboit(&[text("weight", weight)], &pixel);
            assert!((got.color / color - 1.0).abs().max_element() < 3e-7, "{weight}: {got:?}");
            assert_eq!(got.transmittance.x, transmittance);
        }
    }
}
