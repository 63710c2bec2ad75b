//! Multi-layer alpha blending (Salvi & Vaidyanathan 2014): k layers, the furthest two of which merge.

use crate::continuum::insertion::Always;
use crate::continuum::layers::{StoredLayers, Stream};
use crate::continuum::merge::OverFurthest;
use crate::continuum::nodes::{LAYERS, Nodes};
use crate::continuum::normalize::Unnormalized;
use crate::continuum::opacity::Alpha;
use crate::error::Result;
use crate::gpu::form::{Form, Path, Streaming, layers, only_default_formats};
use crate::params::{Kind, ParamSpec, Params, Value, View};
use crate::technique::{AnyTechnique, Axes, Cost, Info, Properties};
use crate::techniques::ANY_ORDER;

/// The registry entry.
pub static INFO: Info = Info {
    id: "mlab",
    aliases: &[],
    name: "Multi-layer alpha blending",
    citation: &["Salvi2014"],
    doc: "Inserts each fragment into k layers sorted by depth; one too many, and the two furthest merge into \
          one at the nearer's depth. Exact with as many layers as fragments, and for any k where fragments \
          arrive front to back or back to front; otherwise a fragment may come too late to lie between two \
          that have merged.",
    axes: Axes {
        memory: "k layers",
        insertion: "always",
        merge: "merge furthest",
        normalize: "no",
        opacity: "alpha",
    },
    params: &[ParamSpec::new(
        "layers",
        Kind::at_least(1),
        Value::Int(4),
        "layers kept per pixel; the error vanishes with as many as there are fragments",
    )],
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
    let nodes = Nodes::from_params(INFO.targets, params, view);
    let list = StoredLayers {
        stream: Stream { insertion: Always, merge: OverFurthest, opacity: Alpha, layers },
        normalize: Unnormalized,
        cost: Cost::list(layers, nodes.bytes, 0.0),
        properties: MERGED,
    };
    Ok(list.stored(nodes))
}

/// Its form on a GPU, with f32 nodes.
fn gpu(params: &Params, _view: &View) -> Result<Form> {
    only_default_formats(params, INFO.targets)?;
    Ok(Form {
        weight: None,
        shader: include_str!("../../shaders/mlab.wgsl"),
        numbers: Vec::new(),
        path: Path::Streamed(Streaming::as_submitted(params).of_layers(layers(params)?)),
        shows_zero_fragments: false,
        colored_transmittance: false,
    })
}

/// Lists whose overflow merges adjacent layers lose nothing, only order: what commutes stays exact.
pub(super) const MERGED: Properties = Properties {
    consistent: true,
    exact_for_one: true,
    exact_for_one_color: true,
    exact_coverage: true,
    ..Properties::NONE
};

#[cfg(test)]
mod tests {
    use crate::fragments::Fragment;
    use crate::params::Input;
    use crate::technique::Resolved;
    use crate::techniques::testing::{
        BACKGROUND, F32_STATE, assert_close, fragment, over, random_pixel, resolve, three_layers,
    };
    use glam::{DVec3, Vec3};

    fn mlab(layers: i64, pixel: &[Fragment]) -> Resolved {
        resolve("mlab", &[("layers", Input::Int(layers))], pixel)
    }

    #[test]
    fn three_layers_by_hand() {
        // at depths 4, 2, 8; one layer holds what came so far, and 2 goes over it, 8 under it
        let (color, transmittance) = over(&three_layers());
        assert_close(mlab(1, &three_layers()), color, transmittance, F32_STATE);
        // submitted 8, 2, 4: 2 over 8 merged, then 4 behind both
        let [middle, near, far] = three_layers().try_into().unwrap();
        let wrong = DVec3::new(0.25, 0.075, 0.025)
            + 0.75 * DVec3::new(0.15, 0.075, 0.75)
            + 0.75 * 0.25 * DVec3::new(0.05, 0.45, 0.1)
            + transmittance * Vec3::from(BACKGROUND).as_dvec3();
        assert_close(mlab(1, &[far, near, middle]), wrong, transmittance, F32_STATE);
        assert_close(mlab(2, &[far, near, middle]), color, transmittance, F32_STATE);
    }

    #[test]
    fn a_late_fragment_between_merged_ones_is_out_of_place() {
        let mut pixel = random_pixel(24, 5);
        pixel.iter_mut().for_each(|f| f.alpha = f.alpha.min(0.5));
        let before = mlab(4, &pixel);
        pixel.rotate_left(7);
        let after = mlab(4, &pixel);
        assert!((after.color - before.color).abs().max_element() > 1e-3);
        assert!((after.transmittance - before.transmittance).abs().max_element() < 1e-15);
    }

    #[test]
    fn what_overflows_can_still_be_hidden() {
        let bright = |z| Fragment { alpha: 0.0, ..fragment(z, [f32::MAX; 3], 1.0, 0) };
        let pixel = [bright(3.0), bright(4.0), bright(5.0), fragment(1.0, [0.5; 3], 1.0, 1)];
        assert_close(mlab(1, &pixel), DVec3::splat(0.5), 0.0, 0.0);
    }
}
