//! The k-buffer (Bavoil et al. 2007): a sliding window of k layers over a nearly sorted stream.

use super::mlab::MERGED;
use crate::continuum::insertion::Always;
use crate::continuum::layers::{StoredLayers, Stream};
use crate::continuum::merge::OverNearest;
use crate::continuum::nodes::{LAYERS, Nodes};
use crate::continuum::normalize::Unnormalized;
use crate::continuum::opacity::Alpha;
use crate::error::Result;
use crate::gpu::form::{Form, Path, Streaming, layers, only_default_formats};
use crate::params::{Kind, ParamSpec, Params, Value, View};
use crate::technique::{AnyTechnique, Axes, Cost, Info};
use crate::techniques::ANY_ORDER;

/// The registry entry.
pub static INFO: Info = Info {
    id: "k_buffer",
    aliases: &[],
    name: "k-buffer",
    citation: &["Bavoil2007"],
    doc: "Inserts each fragment into k layers sorted by depth; one too many, and the nearest is composited into \
          a front accumulator, in front of all that arrives later. Exact where every fragment of a \
          front-to-back stream is at most k places late, badly wrong back to front.",
    axes: Axes {
        memory: "k layers",
        insertion: "always",
        merge: "merge closest to camera",
        normalize: "no",
        opacity: "alpha",
    },
    params: &[ParamSpec::new(
        "layers",
        Kind::at_least(1),
        Value::Int(8),
        "layers kept per pixel besides the front accumulator",
    )],
    targets: &LAYERS,
    submission_orders: ANY_ORDER,
    random: false,
    geometry_passes: "1",
    bytes_per_pixel: "20 layers + 16 in f32, half of that in f16, 8 layers + 4 as rgba8 and an f32",
    build,
    gpu: Some(gpu),
};

fn build(params: &Params, view: &View) -> Result<Box<dyn AnyTechnique>> {
    let layers = params.size("layers");
    let nodes = Nodes::from_params(INFO.targets, params, view);
    let list = StoredLayers {
        stream: Stream { insertion: Always, merge: OverNearest, opacity: Alpha, layers },
        normalize: Unnormalized,
        // the accumulator has a colour, but no depth
        cost: Cost::list(layers, nodes.bytes, nodes.color_bytes),
        properties: MERGED,
    };
    Ok(list.stored(nodes))
}

/// Its form on a GPU, with f32 nodes.
fn gpu(params: &Params, _view: &View) -> Result<Form> {
    only_default_formats(params, INFO.targets)?;
    Ok(Form {
        weight: None,
        shader: include_str!("../../shaders/k_buffer.wgsl"),
        numbers: Vec::new(),
        path: Path::Streamed(Streaming::as_submitted(params).of_layers(layers(params)?)),
        shows_zero_fragments: false,
        colored_transmittance: false,
    })
}

#[cfg(test)]
mod tests {
    use crate::params::Input;
    use crate::techniques::testing::{
        F32_STATE, Random, assert_close, difference, fragment, over, random_pixel, resolve,
    };

    #[test]
    fn a_fragment_may_come_k_places_late() {
        let mut random = Random::new(3);
        for k in 1..6 {
            // blocks of k + 1 in any order: the last one is k late at most
            let mut pixel = random_pixel(30, 9);
            pixel.sort_by(|a, b| a.depth.total_cmp(&b.depth).then(a.primitive.cmp(&b.primitive)));
            pixel.chunks_mut(k + 1).for_each(|block| random.shuffle(block));
            let (color, transmittance) = over(&pixel);
            let layers = [("layers", Input::Int(i64::try_from(k).unwrap()))];
            assert_close(resolve("k_buffer", &layers, &pixel), color, transmittance, F32_STATE);
        }
    }

    #[test]
    fn one_place_too_late_is_wrong() {
        let layer = |z: f32, rgb, key| fragment(z, rgb, 0.5, key);
        let pixel = [layer(2.0, [1.0, 0.0, 0.0], 0), layer(3.0, [0.0; 3], 1), layer(1.0, [0.0, 1.0, 0.0], 2)];
        let (color, transmittance) = over(&pixel);
        let layers = |k| [("layers", Input::Int(k))];
        assert_close(resolve("k_buffer", &layers(2), &pixel), color, transmittance, F32_STATE);
        let got = resolve("k_buffer", &layers(1), &pixel);
        assert!((got.color.x - (0.5 + 0.125 * 0.25)).abs() < F32_STATE, "red lies on top: {got:?}");
    }

    #[test]
    fn back_to_front_is_badly_wrong() {
        let mut pixel = random_pixel(30, 12);
        pixel.iter_mut().for_each(|f| f.alpha = f.alpha.max(0.3));
        let inputs = [("layers", Input::Int(2)), ("submission_order", Input::Text("back_to_front".into()))];
        let (color, transmittance) = over(&pixel);
        assert!(difference(resolve("k_buffer", &inputs, &pixel), color, transmittance) > 0.1);
    }

    #[test]
    fn a_fragment_at_the_eye_is_not_in_front_of_what_was_flushed() {
        let pixel = [0, 1, 2, 3].map(|key| fragment(0.0, [0.2, 0.4, 0.8], 0.5, key));
        let (color, transmittance) = over(&pixel);
        assert_close(
            resolve("k_buffer", &[("layers", Input::Int(1))], &pixel),
            color,
            transmittance,
            F32_STATE,
        );
    }
}
