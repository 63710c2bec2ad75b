//! Sort-independent alpha blending (Meshkin 2007): the terms of `over` that do not depend on order.

use crate::continuum::stored::Stored;
use crate::continuum::stored_sums::Recipe;
use crate::continuum::stored_sums::diagnose::{diagnose, faults};
use crate::continuum::sums::{Blended, Sums};
use crate::diagnosis::{Diagnosis, Faults};
use crate::error::Result;
use crate::format::{FormatSet, Formats, SUMMATION, Summation, Target};
use crate::gpu::form::{BlendTarget, Blending, Form, Number, Path, SHARES, only, target_format};
use crate::params::{Params, View};
use crate::technique::{
    AnyTechnique, Axes, Cost, DepthComplexity, Info, Pixel, Properties, Resolved, Streamed, Technique,
};
use crate::techniques::ANY_ORDER;
use glam::DVec3;

/// The registry entry.
pub static INFO: Info = Info {
    id: "weighted_sum",
    aliases: &[],
    name: "Weighted sum (sort-independent alpha blending)",
    citation: &["Meshkin2007", "McGuire2013"],
    doc: "Adds up premultiplied colours and subtracts their coverage from the background (MB13 eq. 3): right \
          to first order in alpha, and out of the colours' hull once coverages sum to more than 1.",
    axes: Axes {
        memory: "1 layer",
        insertion: "always",
        merge: "weighted sum",
        normalize: "no",
        opacity: "alpha",
    },
    params: &[SUMMATION],
    targets: &[Target::ACCUMULATION.of(FormatSet::SMALL_SUMS)],
    submission_orders: ANY_ORDER,
    random: false,
    geometry_passes: "1",
    bytes_per_pixel: "4 numbers of the format: 16 in f32, 8 in f16",
    build,
    gpu: Some(gpu),
};

#[expect(clippy::unnecessary_wraps, reason = "the signature of every technique's build")]
fn build(params: &Params, _view: &View) -> Result<Box<dyn AnyTechnique>> {
    let formats = Formats::from_params(INFO.targets, params);
    let recipe = Recipe::from_params(&formats, params);
    if formats.are_default() && recipe.summation == Summation::Plain {
        return Ok(Box::new(WeightedSum));
    }
    Ok(Stored::boxed(WeightedSum, recipe, recipe.bytes_per_pixel(&formats, formats.bytes_of("accumulation"))))
}

/// Its form on a GPU.
fn gpu(params: &Params, _view: &View) -> Result<Form> {
    only(params, "summation", "plain")?;
    let formats = Formats::from_params(INFO.targets, params);
    let format = target_format(params, &formats, "accumulation", "accumulation_format", SHARES)?;
    let targets = vec![BlendTarget::sums("accumulation_format", format, 4)];
    Ok(Form {
        weight: None,
        shader: include_str!("../../shaders/weighted_sum.wgsl"),
        numbers: vec![Number::float(format.max_finite(0))],
        path: Path::Blended(Blending::once("accumulate", "resolve", targets)),
        shows_zero_fragments: false,
        colored_transmittance: false,
    })
}

/// Premultiplied colours added up.
pub(super) struct WeightedSum;

impl Blended for WeightedSum {
    fn subtracts_alpha(&self) -> bool {
        true
    }

    /// MB13 eq. 3, Listing 1.
    fn finish(&self, sums: &Sums, background: DVec3) -> Resolved {
        let transmittance = 1.0 - sums.alpha;
        Resolved::new(sums.color + transmittance * background, transmittance)
    }
}

impl Technique for WeightedSum {
    type Scratch = Vec<f32>;

    fn resolve(&self, pixel: &Pixel<'_>, weights: &mut Vec<f32>) -> Resolved {
        self.blend_list(pixel.list, pixel.background, weights)
    }

    fn streamed(&self) -> Option<Streamed<'_>> {
        Some(Streamed::Sums(self))
    }

    fn cost(&self, _complexity: &DepthComplexity) -> Cost {
        Cost { geometry_passes: 1.0, bytes_per_pixel: 16.0 }
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
        BACKGROUND, F32_STATE, assert_close, over, random_pixel, resolve, three_layers,
    };
    use glam::{DVec3, Vec3};

    #[test]
    fn layers_by_hand() {
        let background = Vec3::from(BACKGROUND).as_dvec3();
        let two = DVec3::new(0.3, 0.525, 0.125) + 0.25 * background;
        assert_close(resolve("weighted_sum", &[], &three_layers()[..2]), two, 0.25, F32_STATE);
        let three = DVec3::new(0.45, 0.6, 0.875) - 0.5 * background; // coverages sum to 1.5
        assert_close(resolve("weighted_sum", &[], &three_layers()), three, -0.5, F32_STATE);
    }

    #[test]
    fn the_error_is_of_second_order_in_alpha() {
        let pixel = random_pixel(8, 1);
        let error = |scale: f32| {
            let mut faint = pixel.clone();
            for f in &mut faint {
                f.alpha *= scale;
                f.color = f.color.map(|c| c * scale);
            }
            let difference = resolve("weighted_sum", &[], &faint).color - over(&faint).0;
            difference.abs().max_element() / f64::from(scale).powi(2)
        };
        let limit = error(1e-2);
        assert!(limit > 0.0);
        assert!((error(1e-3) / limit - 1.0).abs() < 0.1, "{} {limit}", error(1e-3));
    }
}
