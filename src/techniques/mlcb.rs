//! Multi-layer coverage blending (Wyman 2016, section 5): MLAB with coverage masks in place of alphas.

use crate::continuum::coverage::Coverage;
use crate::continuum::insertion::Always;
use crate::continuum::layers::{StoredLayers, Stream};
use crate::continuum::masks::{ManyWords, OneWord, RandomMasks, TwoWords, Words, rounded, words};
use crate::continuum::merge::OverFurthest;
use crate::continuum::nodes::{Nodes, SAMPLES};
use crate::continuum::normalize::{Core, Unnormalized};
use crate::continuum::opacity::{Alpha, Layer, Opacity};
use crate::continuum::samples::unmultiplied;
use crate::continuum::stored_layers::{Kept, StoredAlpha, StoredLayer};
use crate::diagnosis::Faults;
use crate::error::Result;
use crate::fragments::Fragment;
use crate::gpu::form::{Form, MASK_WORDS, Number, Path, Streaming, layers, only_default_formats, seed};
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
    targets: &SAMPLES,
    submission_orders: ANY_ORDER,
    random: true,
    geometry_passes: "1",
    bytes_per_pixel: "layers (node + bits / 8), a node 20 in f32, 10 in f16, 8 as rgb8 and an f32; hybrid: alpha_bits in place of bits",
    build,
    gpu: Some(gpu),
};

fn build(params: &Params, view: &View) -> Result<Box<dyn AnyTechnique>> {
    // opacity has bits of its own
    let nodes = Nodes::from_params(INFO.targets, params, view).without_shares();
    let seed = params.size("seed") as u64;
    if params.text("store") == "hybrid" {
        let bits = params.size("alpha_bits");
        let rounded = RoundedAlpha { levels: (1 << bits) - 1, seed };
        let list = Blend { layers: params.size("layers"), bits, nodes, properties: Properties::NONE };
        return Ok(list.with(rounded, StoredRounded { rounded, stored: nodes.alpha() }));
    }
    let bits = params.size("bits");
    let masks = RandomMasks { bits, stratified: true, seed };
    let promise = Properties { consistent: true, ..Properties::NONE };
    let list = Blend { layers: params.size("layers"), bits, nodes, properties: promise };
    Ok(match words(bits) {
        0 | 1 => list.with_masks::<OneWord>(masks),
        2 => list.with_masks::<TwoWords>(masks),
        _ => list.with_masks::<ManyWords>(masks),
    })
}

/// Its form on a GPU, with f32 nodes.
fn gpu(params: &Params, _view: &View) -> Result<Form> {
    only_default_formats(params, INFO.targets)?;
    let layers = layers(params)?;
    let is_hybrid = params.text("store") == "hybrid";
    let bits = if is_hybrid { 0 } else { mask_bits(params, layers)? };
    let levels = if is_hybrid { (1 << params.size("alpha_bits")) - 1 } else { 0 };
    let [low, high] = seed(params);
    let sizes = vec![(MASK_WORDS, bits.div_ceil(32).max(1)), ("KEEPS_ALPHAS", is_hybrid.into())];
    Ok(Form {
        weight: None,
        shader: include_str!("../../shaders/mlcb.wgsl"),
        numbers: vec![Number::Whole(bits), Number::Whole(1), low, high, Number::Whole(levels)],
        path: Path::Streamed(Streaming::as_submitted(params).of_layers(layers).of_sizes(sizes)),
        shows_zero_fragments: false,
        colored_transmittance: false,
    })
}

/// Words of masks that a pixel keeps on a GPU, at most: 4 layers have 2048 bits each, 32 layers 256.
const MOST_WORDS: u32 = 256;

/// The width of masks, if there is room for one per layer.
fn mask_bits(params: &Params, layers: u32) -> Result<u32> {
    let (bits, most) = (params.size("bits"), MOST_WORDS / layers * 32);
    u32::try_from(bits).ok().filter(|bits| *bits <= most).ok_or_else(|| {
        let problem = format!("bits={bits} has no form on the backend \"gpu\" with layers={layers}");
        params.error(problem, format!("there bits is at most {most}; fewer layers have room for more"))
    })
}

/// MLAB's choices on the other axes, with `bits` bits of opacity per layer.
struct Blend {
    layers: usize,
    bits: usize,
    nodes: Nodes,
    properties: Properties,
}

impl Blend {
    fn with_masks<W: Words>(self, masks: RandomMasks) -> Box<dyn AnyTechnique> {
        let stored = Kept { opacity: Coverage::<W>::new(masks), nodes: self.nodes };
        self.with(Coverage::<W>::new(masks), stored)
    }

    /// The technique with an opacity, or with its like in other formats.
    #[expect(clippy::cast_precision_loss, reason = "a cost estimate")]
    fn with<O: Opacity, S: Opacity>(self, opacity: O, stored: S) -> Box<dyn AnyTechnique> {
        let Self { layers, bits, nodes, properties } = self;
        let list = StoredLayers {
            stream: Stream { insertion: Always, merge: OverFurthest, opacity, layers },
            normalize: Unnormalized,
            cost: Cost::list(layers, nodes.bytes + bits as f64 / 8.0, 0.0),
            properties,
        };
        if nodes.are_default { Box::new(list) } else { list.with_opacity(stored).placed(nodes) }
    }
}

/// Alphas in steps of 1 / L, rounded at random as a fragment enters: every later step of MLAB is linear in each
/// of them, so that its mean is the unrounded one's.
#[derive(Debug, Clone, Copy)]
struct RoundedAlpha {
    /// L.
    levels: u32,
    seed: u64,
}

impl RoundedAlpha {
    /// Premultiplied colour and coverage of a fragment.
    fn round(self, pixel: &Pixel<'_>, fragment: &Fragment) -> Option<(DVec3, f64)> {
        if fragment.alpha == 0.0 {
            return None;
        }
        let draws = Draws::new(pixel.x, pixel.y, fragment.primitive, self.seed);
        let coverage = f64::from(rounded(fragment.alpha, self.levels, draws)) / f64::from(self.levels);
        Some((coverage * unmultiplied(fragment), coverage))
    }
}

impl Opacity for RoundedAlpha {
    type Paint = Layer;

    fn empty(&self) -> Layer {
        Layer::CLEAR
    }
    fn paint(&self, pixel: &Pixel<'_>, fragment: &Fragment) -> Option<Layer> {
        let (color, coverage) = self.round(pixel, fragment)?;
        let color = color.min(DVec3::splat(f32::MAX.into())).as_vec3();
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

/// [`RoundedAlpha`] with colours in nodes of other formats.
#[derive(Debug, Clone, Copy)]
struct StoredRounded {
    rounded: RoundedAlpha,
    stored: StoredAlpha,
}

impl Opacity for StoredRounded {
    type Paint = StoredLayer;

    fn empty(&self) -> StoredLayer {
        self.stored.empty()
    }
    fn paint(&self, pixel: &Pixel<'_>, fragment: &Fragment) -> Option<StoredLayer> {
        let (color, coverage) = self.rounded.round(pixel, fragment)?;
        Some(self.stored.store(color, coverage))
    }
    fn faults(&self) -> Faults {
        self.stored.faults()
    }
    /// What befalls the fragment's own colour, which rounding its alpha moves a little.
    fn written(&self, fragment: &Fragment) -> Faults {
        self.stored.written(fragment)
    }
    fn place(&self, depth: f32) -> f32 {
        self.stored.place(depth)
    }
    fn merge(&self, front: &mut StoredLayer, behind: &StoredLayer) {
        self.stored.merge(front, behind);
    }
    fn behind(&self, shown: f64, paint: &StoredLayer) -> f64 {
        self.stored.behind(shown, paint)
    }
    fn put_behind(&self, core: &mut Core, paint: &StoredLayer) {
        self.stored.put_behind(core, paint);
    }
}

#[cfg(test)]
mod tests;
