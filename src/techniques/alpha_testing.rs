//! Alpha testing: a z-buffer of the fragments that are opaque enough.

use crate::continuum::insertion::Threshold;
use crate::continuum::layers::{StoredLayers, Stream};
use crate::continuum::merge::DiscardFurthest;
use crate::continuum::nodes::{LAYERS, Nodes};
use crate::continuum::normalize::Unnormalized;
use crate::continuum::opacity::Alpha;
use crate::error::Result;
use crate::gpu::form::{Form, Number, Path, Streaming, only_single_formats};
use crate::params::{Kind, ParamSpec, Params, Value, View};
use crate::technique::{AnyTechnique, Axes, Cost, Info, Properties};
use crate::techniques::ANY_ORDER;

/// The param that tells opaque from absent.
pub(super) const THRESHOLD: ParamSpec = ParamSpec::new(
    "threshold",
    Kind::Float { min: 0.0, max: 1.0, min_open: false, max_open: true },
    Value::Float(0.5),
    "fragments of a larger alpha become opaque, the others are refused",
);

/// The registry entry.
pub static INFO: Info = Info {
    id: "alpha_testing",
    aliases: &[],
    name: "Alpha testing",
    citation: &["Wyman2016"],
    doc: "Shows the nearest fragment whose alpha exceeds a threshold as if it were opaque, and nothing else: \
          what an engine does with foliage when it cannot afford transparency.",
    axes: Axes {
        memory: "1 layer",
        insertion: "if alpha > thresh",
        merge: "discard furthest",
        normalize: "no",
        opacity: "alpha",
    },
    params: &[THRESHOLD],
    targets: &LAYERS,
    submission_orders: ANY_ORDER,
    random: false,
    geometry_passes: "1",
    bytes_per_pixel: "colour and depth: 20 in f32, 10 in f16, 8 as rgba8 and an f32",
    build,
    gpu: Some(gpu),
};

fn build(params: &Params, view: &View) -> Result<Box<dyn AnyTechnique>> {
    let insertion = Threshold(params.float("threshold"));
    let nodes = Nodes::from_params(INFO.targets, params, view);
    let list = StoredLayers {
        stream: Stream { insertion, merge: DiscardFurthest, opacity: Alpha, layers: 1 },
        normalize: Unnormalized,
        cost: Cost::list(1, nodes.bytes, 0.0),
        properties: Properties { order_independent: true, ..Properties::NONE },
    };
    Ok(list.stored(nodes))
}

/// Its form on a GPU: one node in f32.
fn gpu(params: &Params, _view: &View) -> Result<Form> {
    only_single_formats(params, INFO.targets)?;
    Ok(Form {
        weight: None,
        shader: include_str!("../../shaders/alpha_testing.wgsl"),
        // an f32 is larger than a number if it is larger than the next f32 below
        numbers: vec![Number::below(params.float("threshold"))],
        path: Path::Streamed(Streaming::in_any_order()),
        shows_zero_fragments: false,
        colored_transmittance: false,
    })
}

#[cfg(test)]
mod tests {
    use crate::params::Input;
    use crate::technique::Resolved;
    use crate::techniques::testing::{
        BACKGROUND, F32_STATE, assert_close, fragment, over, random_pixel, resolve, three_layers,
    };
    use glam::{DVec3, Vec3};

    #[test]
    fn the_nearest_fragment_above_the_threshold_is_opaque() {
        // depths 4, 2, 8 with alpha 1/2, 1/4, 3/4
        let at =
            |threshold| resolve("alpha_testing", &[("threshold", Input::Float(threshold))], &three_layers());
        assert_close(at(0.2), DVec3::new(1.0, 0.3, 0.1), 0.0, F32_STATE);
        assert_close(at(0.25), DVec3::new(0.1, 0.9, 0.2), 0.0, F32_STATE);
        assert_close(at(0.5), DVec3::new(0.2, 0.1, 1.0), 0.0, F32_STATE);
        assert_eq!(at(0.75), Resolved::background(Vec3::from(BACKGROUND).as_dvec3()));
    }

    #[test]
    fn opaque_fragments_are_exact() {
        for n in 1..20 {
            let mut pixel = random_pixel(n, n.into());
            for f in &mut pixel {
                *f = fragment(f.depth, f.color, 1.0, f.primitive);
            }
            let (color, transmittance) = over(&pixel);
            assert_close(resolve("alpha_testing", &[], &pixel), color, transmittance, 0.0);
        }
    }
}
