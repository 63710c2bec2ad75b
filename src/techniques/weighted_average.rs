//! Weighted average (Bavoil & Myers 2008): every fragment becomes the mean fragment.

use crate::continuum::stored::Stored;
use crate::continuum::stored_sums::Recipe;
use crate::continuum::stored_sums::diagnose::{diagnose, faults};
use crate::continuum::sums::{Blended, Sums};
use crate::diagnosis::{Diagnosis, Faults};
use crate::error::Result;
use crate::format::{FormatSet, Formats, SUMMATION, Summation, Target};
use crate::gpu::form::{BlendTarget, Blending, Form, Number, Path, SHARES, SUMS, only, target_format};
use crate::params::{Params, View};
use crate::technique::{
    AnyTechnique, Axes, Cost, DepthComplexity, Info, Pixel, Properties, Resolved, Streamed, Technique,
};
use crate::techniques::ANY_ORDER;
use glam::DVec3;

/// The registry entry.
pub static INFO: Info = Info {
    id: "weighted_average",
    aliases: &[],
    name: "Weighted average",
    citation: &["Bavoil2008", "McGuire2013"],
    doc: "Composites as many copies of the alpha-weighted mean fragment as there are fragments (MB13 eq. 4). \
          The background shows too much unless all alphas are equal, and fragments that neither cover nor \
          emit change the image.",
    axes: Axes {
        memory: "1 layer",
        insertion: "always",
        merge: "α-weighted average",
        normalize: "no",
        opacity: "alpha",
    },
    params: &[SUMMATION],
    targets: &[Target::ACCUMULATION.of(FormatSet::SMALL_SUMS), Target::COUNT],
    submission_orders: ANY_ORDER,
    random: false,
    geometry_passes: "1",
    bytes_per_pixel: "4 sums and a count: 20 in f32, 10 in f16",
    build,
    gpu: Some(gpu),
};

#[expect(clippy::unnecessary_wraps, reason = "the signature of every technique's build")]
fn build(params: &Params, _view: &View) -> Result<Box<dyn AnyTechnique>> {
    let formats = Formats::from_params(INFO.targets, params);
    let recipe = Recipe { count: formats.of("count"), ..Recipe::from_params(&formats, params) };
    if formats.are_default() && recipe.summation == Summation::Plain {
        return Ok(Box::new(WeightedAverage));
    }
    let bytes = recipe.bytes_per_pixel(&formats, formats.bytes_of("accumulation"));
    Ok(Stored::boxed(WeightedAverage, recipe, bytes))
}

/// Its form on a GPU.
fn gpu(params: &Params, _view: &View) -> Result<Form> {
    only(params, "summation", "plain")?;
    let formats = Formats::from_params(INFO.targets, params);
    let format = target_format(params, &formats, "accumulation", "accumulation_format", SHARES)?;
    let count = target_format(params, &formats, "count", "count_format", SUMS)?;
    let targets = vec![
        BlendTarget::sums("accumulation_format", format, 4),
        BlendTarget::sums("count_format", count, 1),
    ];
    Ok(Form {
        weight: None,
        shader: include_str!("../../shaders/weighted_average.wgsl"),
        numbers: vec![Number::float(format.max_finite(0))],
        path: Path::Blended(Blending::once("accumulate", "resolve", targets)),
        shows_zero_fragments: true,
        colored_transmittance: false,
    })
}

struct WeightedAverage;

impl Blended for WeightedAverage {
    /// MB13 eq. 4, Listing 2.
    fn finish(&self, sums: &Sums, background: DVec3) -> Resolved {
        sums.over_as_mean(background)
    }
}

impl Technique for WeightedAverage {
    type Scratch = Vec<f32>;
    const SEES_ZERO_FRAGMENTS: bool = true;

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
        Properties { order_independent: true, exact_for_one: true, ..Properties::NONE }
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
    use crate::techniques::testing::{
        BACKGROUND, F32_STATE, assert_close, fragment, over, random_pixel, resolve, three_layers,
    };
    use glam::{DVec3, Vec3};

    #[test]
    fn three_layers_by_hand() {
        // mean alpha 1/2, so 1/8 of the background
        let expected = 0.875 / 1.5 * DVec3::new(0.45, 0.6, 0.875) + 0.125 * Vec3::from(BACKGROUND).as_dvec3();
        assert_close(resolve("weighted_average", &[], &three_layers()), expected, 0.125, F32_STATE);
    }

    #[test]
    fn the_background_never_shows_too_little_and_right_for_equal_alphas() {
        for n in 1..=16 {
            let mut pixel = random_pixel(n, 7);
            let exact = over(&pixel).1;
            let got = resolve("weighted_average", &[], &pixel).transmittance.x;
            assert!(got >= exact - F32_STATE, "{got} < {exact}");
            for f in &mut pixel {
                f.alpha = 0.3;
            }
            let got = resolve("weighted_average", &[], &pixel).transmittance.x;
            assert!((got - over(&pixel).1).abs() < F32_STATE);
        }
    }

    #[test]
    fn zero_fragments_change_the_image() {
        let mut pixel = vec![fragment(1.0, [1.0; 3], 1.0, 0)];
        assert_eq!(resolve("weighted_average", &[], &pixel).transmittance.x, 0.0);
        pixel.push(fragment(2.0, [0.0; 3], 0.0, 1));
        assert!((resolve("weighted_average", &[], &pixel).transmittance.x - 0.25).abs() < 1e-15);
    }

    #[test]
    fn faint_fragments_do_not_cancel() {
        // bright ones, so that the background does not drown them
        let pixel = vec![fragment(1.0, [1e6; 3], 1e-12, 0); 4];
        let got = resolve("weighted_average", &[], &pixel);
        let covered = got.color - got.transmittance * Vec3::from(BACKGROUND).as_dvec3();
        assert!((covered.x / 4e-6 - 1.0).abs() < F32_STATE, "{covered}");
    }
}
