//! Z³ (Jouppi & Chang 1999): k layers, the closest two of which merge.

use super::mlab::MERGED;
use crate::continuum::insertion::Always;
use crate::continuum::layers::{StoredLayers, Stream};
use crate::continuum::merge::OverClosest;
use crate::continuum::nodes::{LAYERS, Nodes};
use crate::continuum::normalize::Unnormalized;
use crate::continuum::opacity::Alpha;
use crate::error::Result;
use crate::gpu::form::{Form, Number, Path, Streaming, layers, only_default_formats};
use crate::params::{Kind, ParamSpec, Params, Value, View};
use crate::technique::{AnyTechnique, Axes, Cost, Info};
use crate::techniques::ANY_ORDER;

/// The registry entry.
pub static INFO: Info = Info {
    id: "z3",
    aliases: &[],
    name: "Z³",
    citation: &["Jouppi1999"],
    doc: "Inserts each fragment into k layers sorted by depth; one too many, and the two adjacent ones with the \
          smallest gap between them merge. The published hardware also keeps depth slopes and coverage masks \
          to resolve intersections within a pixel, which one sample per pixel does not have.",
    axes: Axes {
        memory: "k layers",
        insertion: "always",
        merge: "merge w/closest depths",
        normalize: "no",
        opacity: "alpha",
    },
    params: &[
        ParamSpec::new("layers", Kind::at_least(1), Value::Int(4), "layers kept per pixel"),
        ParamSpec::new(
            "merge_depth",
            Kind::Choice(&["front", "mean"]),
            Value::Text("front"),
            "where a merged layer lies: at the nearer of its two depths, or at their mean",
        ),
    ],
    targets: &LAYERS,
    submission_orders: ANY_ORDER,
    random: false,
    geometry_passes: "1",
    bytes_per_pixel: "20 layers in f32, 10 in f16, 8 as rgba8 and an f32",
    build,
    gpu: Some(gpu),
};

fn build(params: &Params, view: &View) -> Result<Box<dyn AnyTechnique>> {
    let layers = params.size("layers");
    let merge = OverClosest { mean_depth: params.text("merge_depth") == "mean" };
    let nodes = Nodes::from_params(INFO.targets, params, view);
    let list = StoredLayers {
        stream: Stream { insertion: Always, merge, opacity: Alpha, layers },
        normalize: Unnormalized,
        cost: Cost::list(layers, nodes.bytes, 0.0),
        properties: MERGED,
    };
    Ok(list.stored(nodes))
}

/// Its form on a GPU, with f32 nodes.
fn gpu(params: &Params, _view: &View) -> Result<Form> {
    only_default_formats(params, INFO.targets)?;
    let at_mean = Number::Whole((params.text("merge_depth") == "mean").into());
    Ok(Form {
        weight: None,
        shader: include_str!("../../shaders/z3.wgsl"),
        numbers: vec![at_mean],
        path: Path::Streamed(Streaming::as_submitted(params).of_layers(layers(params)?)),
        shows_zero_fragments: false,
        colored_transmittance: false,
    })
}

#[cfg(test)]
mod tests {
    use crate::fragments::Fragment;
    use crate::params::Input;
    use crate::techniques::testing::{as_pixel, build, fragment};

    fn depths_where_transmittance_falls(merge_depth: &str, pixel: &[Fragment]) -> Vec<f32> {
        let inputs = [("layers", Input::Int(2)), ("merge_depth", Input::Text(merge_depth.into()))];
        let z3 = build("z3", &inputs).unwrap();
        let depths: Vec<f32> = (0..40_u8).map(|i| f32::from(i) * 0.25 + 0.1).collect();
        let steps = as_pixel(pixel, |pixel| z3.transmittance(pixel, &depths)).unwrap();
        let falls = steps.windows(2).zip(&depths).filter(|(t, _)| t[1] < t[0]);
        falls.map(|(_, z)| (z + 0.125).round()).collect()
    }

    #[test]
    fn the_closest_two_merge_the_nearer_pair_on_ties() {
        let at = |depths: [f32; 3]| depths.map(|z| fragment(z, [1.0; 3], 0.5, 0));
        assert_eq!(depths_where_transmittance_falls("front", &at([1.0, 7.0, 5.0])), [1.0, 5.0]);
        assert_eq!(depths_where_transmittance_falls("mean", &at([1.0, 7.0, 5.0])), [1.0, 6.0]);
        assert_eq!(depths_where_transmittance_falls("front", &at([9.0, 5.0, 1.0])), [1.0, 9.0]);
        assert_eq!(depths_where_transmittance_falls("mean", &at([9.0, 5.0, 1.0])), [3.0, 9.0]);
    }
}
