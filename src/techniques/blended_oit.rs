//! Blended OIT (`McGuire` & Bavoil 2013, eq. 5): the average colour at the exact coverage.

use crate::continuum::stored::Stored;
use crate::continuum::stored_sums::Recipe;
use crate::continuum::stored_sums::diagnose::{diagnose, faults};
use crate::continuum::sums::{Blended, Sums, SumsOf};
use crate::diagnosis::{Diagnosis, Faults};
use crate::error::Result;
use crate::format::{FormatSet, Formats, SUMMATION, Summation, Target};
use crate::gpu::form::{Blend, BlendTarget, Blending, Form, Number, Path, SHARES, only, target_format};
use crate::params::{Params, View};
use crate::technique::{
    AnyTechnique, Axes, Cost, DepthComplexity, FinishedPixels, Info, Pixel, Properties, Resolved, Streamed,
    Technique,
};
use crate::techniques::ANY_ORDER;
use glam::DVec3;

/// The registry entry.
pub static INFO: Info = Info {
    id: "blended_oit",
    aliases: &[],
    name: "Blended OIT",
    citation: &["McGuire2013"],
    doc: "The alpha-weighted average colour covers the background exactly as much as all fragments together \
          do (MB13 eq. 5); which of them is in front makes no difference.",
    axes: Axes {
        memory: "constant func",
        insertion: "never",
        merge: "discard all",
        normalize: "α-weighted average",
        opacity: "alpha",
    },
    params: &[SUMMATION],
    targets: &[Target::ACCUMULATION.of(FormatSet::SMALL_SUMS), Target::REVEALAGE],
    submission_orders: ANY_ORDER,
    random: false,
    geometry_passes: "1",
    bytes_per_pixel: "4 sums and R: 20 in f32, 10 in f16",
    build,
    gpu: Some(gpu),
};

#[expect(clippy::unnecessary_wraps, reason = "the signature of every technique's build")]
fn build(params: &Params, _view: &View) -> Result<Box<dyn AnyTechnique>> {
    let formats = Formats::from_params(INFO.targets, params);
    let recipe = Recipe { revealage: formats.of("revealage"), ..Recipe::from_params(&formats, params) };
    if formats.are_default() && recipe.summation == Summation::Plain {
        return Ok(Box::new(BlendedOit));
    }
    Ok(Stored::boxed(BlendedOit, recipe, recipe.bytes_per_pixel(&formats, formats.bytes_of("accumulation"))))
}

/// Its form on a GPU.
fn gpu(params: &Params, _view: &View) -> Result<Form> {
    only(params, "summation", "plain")?;
    let formats = Formats::from_params(INFO.targets, params);
    let format = target_format(params, &formats, "accumulation", "accumulation_format", SHARES)?;
    let revealage = target_format(params, &formats, "revealage", "revealage_format", SHARES)?;
    let targets = vec![
        BlendTarget::sums("accumulation_format", format, 4),
        BlendTarget::product("revealage_format", revealage, 1, Blend::Attenuate),
    ];
    Ok(Form {
        weight: None,
        shader: include_str!("../../shaders/blended_oit.wgsl"),
        numbers: vec![Number::float(format.max_finite(0))],
        path: Path::Blended(Blending::once("accumulate", "resolve", targets)),
        shows_zero_fragments: false,
        colored_transmittance: false,
    })
}

struct BlendedOit;

impl Blended for BlendedOit {
    fn finish(&self, sums: &Sums, background: DVec3) -> Resolved {
        sums.over(background)
    }

    fn finish_all(&self, pixels: &SumsOf<'_>, out: &mut FinishedPixels) {
        pixels.over(out);
    }
}

impl Technique for BlendedOit {
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
        BLENDED
    }

    fn faults(&self) -> Faults {
        faults(self, Recipe::SINGLE)
    }

    fn diagnose(&self, pixel: &Pixel<'_>, _weights: &mut Vec<f32>) -> Diagnosis {
        diagnose(self, Recipe::SINGLE, pixel.list)
    }
}

/// What every average at exact coverage promises.
pub(super) const BLENDED: Properties = Properties {
    order_independent: true,
    exact_for_one: true,
    exact_for_one_color: true,
    exact_coverage: true,
    ..Properties::NONE
};

#[cfg(test)]
mod tests {
    use crate::techniques::testing::{
        BACKGROUND, F32_STATE, assert_close, fragment, over, resolve, three_layers,
    };
    use glam::{DVec3, Vec3};

    #[test]
    fn layers_by_hand() {
        let background = Vec3::from(BACKGROUND).as_dvec3();
        let two = 0.625 / 0.75 * DVec3::new(0.3, 0.525, 0.125) + 0.375 * background;
        assert_close(resolve("blended_oit", &[], &three_layers()[..2]), two, 0.375, F32_STATE);
        let three = 0.906_25 / 1.5 * DVec3::new(0.45, 0.6, 0.875) + 0.093_75 * background;
        assert_close(resolve("blended_oit", &[], &three_layers()), three, 0.093_75, F32_STATE);
    }

    #[test]
    fn a_faint_fragment_keeps_its_color() {
        let lone = [fragment(1.0, [6e4, 1.0, 0.0], 1e-30, 0)];
        let (color, transmittance) = over(&lone);
        assert_close(resolve("blended_oit", &[], &lone), color, transmittance, 1e-15);
    }

    #[test]
    fn emission_without_coverage_is_lost() {
        let mut lone = fragment(1.0, [1.0; 3], 0.0, 0);
        lone.color = [1.0; 3];
        let background = Vec3::from(BACKGROUND).as_dvec3();
        assert_close(resolve("blended_oit", &[], &[lone]), background, 1.0, 0.0);
    }
}
