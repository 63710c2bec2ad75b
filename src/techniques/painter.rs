//! The painter's algorithm: alpha compositing of whole primitives, sorted by the depth of their centroid.

use super::alpha_compositing::{EXACT_COVERAGE, composite, gpu_composite};
use crate::error::Result;
use crate::format::{Formats, Target};
use crate::gpu::form::Form;
use crate::params::{Params, View};
use crate::technique::{AnyTechnique, Axes, Info, Properties};

/// The registry entry.
pub static INFO: Info = Info {
    id: "painter",
    aliases: &[],
    name: "Painter's algorithm",
    citation: &["Newell1972", "Porter1984"],
    doc: "Sorts whole primitives back to front by the view depth of their centroid and blends them in that \
          order: exact where none interpenetrate or overlap cyclically, for about the price of one sort.",
    axes: Axes {
        memory: "1 layer",
        insertion: "always",
        merge: "over operator",
        normalize: "no",
        opacity: "alpha",
    },
    params: &[],
    targets: &[Target::COLOR],
    submission_orders: &["centroid"],
    random: false,
    geometry_passes: "1",
    bytes_per_pixel: "a framebuffer: 16 in f32, 8 in f16, 4 in 8 bits (and a sort of the primitives)",
    build,
    gpu: Some(gpu),
};

#[expect(clippy::unnecessary_wraps, reason = "the signature of every technique's build")]
fn build(params: &Params, _view: &View) -> Result<Box<dyn AnyTechnique>> {
    let properties = Properties { order_independent: true, ..EXACT_COVERAGE };
    Ok(composite(properties, &Formats::from_params(INFO.targets, params)))
}

/// Its form on a GPU: whole primitives are sorted before they are drawn.
fn gpu(params: &Params, _view: &View) -> Result<Form> {
    gpu_composite(params, &Formats::from_params(INFO.targets, params))
}

#[cfg(test)]
mod tests {
    use crate::params::Input;
    use crate::techniques::testing::{
        F32_STATE, Scene, assert_close, fragment, over, resolve, resolve_all, three_layers,
    };

    #[test]
    fn equals_over_where_every_primitive_covers_one_pixel() {
        let (color, transmittance) = over(&three_layers());
        assert_close(resolve("painter", &[], &three_layers()), color, transmittance, F32_STATE);
    }

    /// Two quads that cross between two pixels: one of the pixels must come out wrong.
    fn crossing() -> Scene {
        let red = |z| fragment(z, [1.0, 0.0, 0.0], 0.5, 0);
        let blue = |z| fragment(z, [0.0, 0.0, 1.0], 0.5, 1);
        vec![vec![red(1.0), blue(3.0)], vec![red(4.0), blue(2.5)]]
    }

    #[test]
    fn equals_alpha_compositing_in_centroid_order() {
        let order = [("submission_order", Input::Text("centroid".into()))];
        let painted = resolve_all("painter", &[], &crossing());
        assert_eq!(painted, resolve_all("alpha_compositing", &order, &crossing()));
    }

    #[test]
    fn differs_from_over_where_quads_cross() {
        let painted = resolve_all("painter", &[], &crossing());
        let exact: Vec<_> = crossing().iter().map(|pixel| over(pixel)).collect();
        assert_close(painted[0], exact[0].0, exact[0].1, F32_STATE);
        assert!((painted[1].color - exact[1].0).abs().max_element() > 0.2);
        assert_eq!(painted[1].transmittance, glam::DVec3::splat(exact[1].1));
    }
}
