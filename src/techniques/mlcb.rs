//! Multi-layer coverage blending (Wyman 2016, section 5): MLAB with coverage masks in place of alphas.

use crate::continuum::coverage::Coverage;
use crate::continuum::insertion::Always;
use crate::continuum::layers::{StoredLayers, Stream};
use crate::continuum::masks::{ManyWords, OneWord, RandomMasks, TwoWords, rounded, words};
use crate::continuum::merge::OverFurthest;
use crate::continuum::normalize::{Core, Unnormalized};
use crate::continuum::opacity::{Alpha, Layer, Opacity};
use crate::continuum::samples::unmultiplied;
use crate::error::Result;
use crate::fragments::Fragment;
use crate::params::{Kind, ParamSpec, Params, Value, View};
use crate::random::Draws;
use crate::technique::{AnyTechnique, Axes, Cost, Info, Pixel, Properties};
use crate::techniques::ANY_ORDER;
use glam::DVec3;

/// The registry entry.
pub static INFO: Info = Info {
    id: "mlcb",
    aliases: &[],
    name: "Multi-layer coverage blending",
    citation: &["Wyman2016"],
    doc: "Multi-layer alpha blending whose layers cover samples at random, each sample the nearest layer's; \
          merged colours weigh as much as the samples they show in. On average it is MLAB of as many layers, \
          for any number of bits. store=\"hybrid\" keeps coverage for geometry, of which a pixel has one \
          sample here, and an alpha of few bits, rounded at random. Fragments of alpha 0 are lost.",
    axes: Axes {
        memory: "k layers",
        insertion: "always",
        merge: "merge furthest",
        normalize: "no",
        opacity: "coverage",
    },
    params: &[
        ParamSpec::new("layers", Kind::at_least(1), Value::Int(4), "layers kept per pixel"),
        ParamSpec::new(
            "store",
            Kind::Choice(&["mask", "hybrid"]),
            Value::Text("mask"),
            "what opacity is kept as: a mask of samples, or an alpha of few bits (W16 section 5.4)",
        ),
        ParamSpec::new(
            "bits",
            Kind::at_least(1),
            Value::Int(32),
            "bits of a layer's mask; noise falls with them",
        )
        .when(|p| p.text("store") == "mask"),
        ParamSpec::new(
            "alpha_bits",
            Kind::Int { min: 1, max: 16 },
            Value::Int(4),
            "bits of a layer's alpha in the hybrid store",
        )
        .when(|p| p.text("store") == "hybrid"),
    ],
    targets: &[],
    submission_orders: ANY_ORDER,
    random: true,
    geometry_passes: "1",
    bytes_per_pixel: "layers (8 + bits / 8); hybrid: layers (8 + alpha_bits / 8)",
    build,
};

fn build(params: &Params, _view: &View) -> Result<Box<dyn AnyTechnique>> {
    let layers = params.size("layers");
    let seed = params.size("seed") as u64;
    if params.text("store") == "hybrid" {
        let bits = params.size("alpha_bits");
        return Ok(blend(layers, bits, RoundedAlpha { levels: (1 << bits) - 1, seed }, Properties::NONE));
    }
    let bits = params.size("bits");
    let masks = RandomMasks { bits, stratified: true, seed };
    let promise = Properties { consistent: true, ..Properties::NONE };
    Ok(match words(bits) {
        0 | 1 => blend(layers, bits, Coverage::<OneWord>::new(masks), promise),
        2 => blend(layers, bits, Coverage::<TwoWords>::new(masks), promise),
        _ => blend(layers, bits, Coverage::<ManyWords>::new(masks), promise),
    })
}

/// MLAB's choices on the other axes, with `bits` bits of opacity per layer.
#[expect(clippy::cast_precision_loss, reason = "a cost estimate")]
fn blend<O: Opacity>(
    layers: usize,
    bits: usize,
    opacity: O,
    properties: Properties,
) -> Box<dyn AnyTechnique> {
    let stream = Stream { insertion: Always, merge: OverFurthest, opacity, layers };
    let cost = Cost::list(layers, layers as f64 * bits as f64 / 8.0);
    Box::new(StoredLayers { stream, normalize: Unnormalized, cost, properties })
}

/// Alphas in steps of 1 / L, rounded at random as a fragment enters: every later step of MLAB is linear in each
/// of them, so that its mean is the unrounded one's.
#[derive(Debug, Clone, Copy)]
struct RoundedAlpha {
    /// L.
    levels: u32,
    seed: u64,
}

impl Opacity for RoundedAlpha {
    type Paint = Layer;

    fn empty(&self) -> Layer {
        Layer::CLEAR
    }
    fn paint(&self, pixel: &Pixel<'_>, fragment: &Fragment) -> Option<Layer> {
        if fragment.alpha == 0.0 {
            return None;
        }
        let draws = Draws::new(pixel.x, pixel.y, fragment.primitive, self.seed);
        let coverage = f64::from(rounded(fragment.alpha, self.levels, draws)) / f64::from(self.levels);
        let color = (coverage * unmultiplied(fragment)).min(DVec3::splat(f32::MAX.into())).as_vec3();
        Some(Layer { color, coverage, transmittance: 1.0 - coverage })
    }
    fn merge(&self, front: &mut Layer, behind: &Layer) {
        Alpha.merge(front, behind);
    }
    fn behind(&self, shown: f64, paint: &Layer) -> f64 {
        Alpha.behind(shown, paint)
    }
    fn put_behind(&self, core: &mut Core, paint: &Layer) {
        Alpha.put_behind(core, paint);
    }
}

#[cfg(test)]
mod tests;
