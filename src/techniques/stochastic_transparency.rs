//! Stochastic transparency (Enderton et al. 2010): every fragment covers a random share alpha of a pixel's
//! samples, and each sample shows its nearest fragment; stratified as Laine & Karras (2011) do.

use crate::continuum::masks::{ManyWords, OneWord, RandomMasks, TwoWords, Words, words};
use crate::continuum::nodes::{AsTheyAre, Keep, Nodes, bytes_of_sums, sums};
use crate::continuum::normalize::sums_of_all;
use crate::continuum::oracle::{Composite, Oracle, TwoPass};
use crate::continuum::placed::Placed;
use crate::continuum::samples::{DepthTest, Shown, uncovered, unmultiplied};
use crate::continuum::steps::Steps;
use crate::continuum::stored_pass::StoredPass;
use crate::continuum::stored_sums::Recipe;
use crate::continuum::stored_tail::stored_sums_of_all;
use crate::continuum::sums::Sums;
use crate::diagnosis::{Diagnosis, Faults};
use crate::error::Result;
use crate::format::{Format, Formats, Target};
use crate::fragments::{Fragment, List};
use crate::gpu::form::{
    Blend, BlendTarget, Form, Number, Path, Sampling, Streaming, at_most, mask_size, masking,
    only_single_formats, window_exponent,
};
use crate::order::sort_key;
use crate::params::{Kind, ParamSpec, Params, Value, View};
use crate::technique::{
    AnyTechnique, Axes, Cost, DepthComplexity, Info, Pixel, Properties, Resolved, Technique,
};
use crate::techniques::ANY_ORDER;
use glam::DVec3;
use std::marker::PhantomData;

/// The registry entry.
pub static INFO: Info = Info {
    id: "stochastic_transparency",
    aliases: &[],
    name: "Stochastic transparency",
    citation: &["Enderton2010", "Enderton2011", "Laine2011"],
    doc: "Each fragment covers a random share alpha of a pixel's samples, and z-tests do the rest: the mean of \
          the samples is noisy, and right on average. In depth mode the samples only measure transmittance, \
          through which a second pass accumulates the fragments' own colours; correction=\"alpha\" scales to \
          the exact coverage, for less noise and some bias.",
    axes: Axes {
        memory: "k samples",
        insertion: "stochastic",
        merge: "z-test, discard occluded",
        normalize: "α-weighted average",
        opacity: "coverage",
    },
    params: &[
        ParamSpec::new("samples", Kind::at_least(1), Value::Int(8), "samples per pixel"),
        ParamSpec::new(
            "stratified",
            Kind::Bool,
            Value::Bool(true),
            "a fragment covers alpha samples many, up to rounding, rather than each with probability alpha",
        ),
        ParamSpec::new(
            "correction",
            Kind::Choice(&["none", "alpha"]),
            Value::Text("none"),
            "none is unbiased; alpha scales what shows to the exact coverage of all fragments",
        ),
        ParamSpec::new(
            "mode",
            Kind::Choice(&["color", "depth"]),
            Value::Text("color"),
            "samples keep colours and are averaged, or keep depths alone, for a second pass to look through",
        ),
    ],
    targets: &TARGETS,
    submission_orders: ANY_ORDER,
    random: true,
    geometry_passes: "color: 1, 1 more for correction=\"alpha\"; depth: 2",
    bytes_per_pixel: "color: 20 samples, 4 more for correction=\"alpha\"; depth: 4 samples + 20 (sums and R); half of that in f16",
    build,
    gpu: Some(gpu),
};

static TARGETS: [Target; 4] = [
    Target::SAMPLE_COLOR.when(|p| p.text("mode") == "color"),
    Target::NODE_DEPTH,
    Target::ACCUMULATION.when(|p| p.text("mode") == "depth"),
    Target::REVEALAGE.when(|p| p.text("mode") == "depth" || p.text("correction") == "alpha"),
];

fn build(params: &Params, view: &View) -> Result<Box<dyn AnyTechnique>> {
    let formats = Formats::from_params(INFO.targets, params);
    Ok(match words(params.size("samples")) {
        0 | 1 => build_with::<OneWord>(params, &formats, view),
        2 => build_with::<TwoWords>(params, &formats, view),
        _ => build_with::<ManyWords>(params, &formats, view),
    })
}

/// Its form on a GPU, with nodes in f32 and the CPU's masks.
fn gpu(params: &Params, view: &View) -> Result<Form> {
    only_single_formats(params, INFO.targets)?;
    let sizes = vec![mask_size(params, "samples")?];
    let sampling = Sampling {
        shader: include_str!("../../shaders/stochastic_samples.wgsl"),
        sizes: sizes.clone(),
        cover: "cover_samples",
        look: "add_showing",
        resolve: "resolve",
        sums: vec![
            BlendTarget::sums("format", Format::F32, 4),
            BlendTarget::product("format", Format::F32, 1, Blend::Attenuate),
        ],
        samples: at_most(params, "samples", u32::MAX)?,
    };
    let masking = masking(params, "samples", params.bool("stratified"));
    let corrected = Number::Whole((params.text("correction") == "alpha").into());
    let keeps_depths = Number::Whole((params.text("mode") == "depth").into());
    Ok(Form {
        weight: None,
        shader: include_str!("../../shaders/stochastic_transparency.wgsl"),
        numbers: masking.into_iter().chain([corrected, keeps_depths, window_exponent(view)]).collect(),
        path: Path::Streamed(Streaming::nearest_first().of_sizes(sizes).or_by_samples(sampling)),
        shows_zero_fragments: false,
        colored_transmittance: false,
    })
}

fn build_with<W: Words>(params: &Params, formats: &Formats, view: &View) -> Box<dyn AnyTechnique> {
    let nodes = Nodes::new(formats, view);
    let (recipe, depths) = (sums(formats), nodes.depths);
    let masks = RandomMasks {
        bits: params.size("samples"),
        stratified: params.bool("stratified"),
        seed: params.size("seed") as u64,
    };
    let corrected = params.text("correction") == "alpha";
    let bytes = Cost::list(masks.bits, nodes.bytes, bytes_of_sums(formats)).bytes_per_pixel;
    if params.text("mode") == "color" {
        let promises = nodes.promises(Properties {
            unbiased: !corrected,
            exact_coverage: corrected && recipe.revealage == Format::F64,
            ..STOCHASTIC
        });
        let samples = StochasticColor::<W, _> {
            masks,
            corrected,
            bytes,
            promises,
            colors: AsTheyAre,
            width: PhantomData,
        };
        if nodes.are_default {
            return Box::new(samples);
        }
        return Box::new(Placed::new(samples.keeping((nodes, recipe)), depths));
    }
    let composite = if corrected { Composite::Normalize } else { Composite::ExactBackground };
    let oracle = StochasticDepth::<W> { masks, nodes, bytes, width: PhantomData };
    if nodes.are_default {
        return Box::new(TwoPass { oracle, composite });
    }
    Box::new(Placed::new(StoredPass { oracle, composite, recipe }, depths))
}

/// What holds of every mode: masks do not know when a fragment arrives, and noise falls with samples.
const STOCHASTIC: Properties = Properties { order_independent: true, consistent: true, ..Properties::NONE };

/// Samples that keep colours.
struct StochasticColor<W, K> {
    masks: RandomMasks,
    corrected: bool,
    bytes: f64,
    promises: Properties,
    colors: K,
    width: PhantomData<W>,
}

impl<W, K> StochasticColor<W, K> {
    fn keeping<L>(self, colors: L) -> StochasticColor<W, L> {
        let Self { masks, corrected, bytes, promises, width, .. } = self;
        StochasticColor { masks, corrected, bytes, promises, colors, width }
    }
}

/// How samples keep colours, and a pixel the share of all its fragments.
trait Store: Keep {
    fn net(&self, list: List<'_>) -> Sums;
}

impl Store for AsTheyAre {
    fn net(&self, list: List<'_>) -> Sums {
        sums_of_all(list).read(0)
    }
}

impl Keep for (Nodes, Recipe) {
    fn keep(&self, color: DVec3) -> DVec3 {
        self.0.keep(color)
    }
    fn faults(&self) -> Faults {
        self.0.faults()
    }
    fn written(&self, color: DVec3) -> Faults {
        self.0.written(color)
    }
}

impl Store for (Nodes, Recipe) {
    fn net(&self, list: List<'_>) -> Sums {
        stored_sums_of_all(self.1, list)
    }
}

/// One pixel's working memory.
#[derive(Debug)]
struct Samples<W> {
    test: DepthTest<W>,
    steps: Steps,
}

impl<W: Words> Default for Samples<W> {
    fn default() -> Self {
        Self { test: DepthTest::default(), steps: Steps::default() }
    }
}

impl<W: Words> Samples<W> {
    /// T̂: the share of samples whose depth is not nearer.
    fn measure(&mut self, masks: &RandomMasks, pixel: &Pixel<'_>) {
        let Self { test, steps } = self;
        steps.clear();
        let mut covered = 0;
        test.run(masks, pixel, |fragment, visible| {
            covered += visible;
            steps.push(sort_key(fragment.depth, fragment.primitive), uncovered(covered, masks.bits));
        });
    }
}

impl<W: Words, K: Store> Technique for StochasticColor<W, K> {
    type Scratch = Samples<W>;
    const NEEDS_SORTED: bool = true;

    fn resolve(&self, pixel: &Pixel<'_>, samples: &mut Samples<W>) -> Resolved {
        let mut shown = Shown::BACKGROUND;
        samples.test.run(&self.masks, pixel, |f, visible| {
            shown.add(visible, self.colors.keep(unmultiplied(f)));
        });
        if !self.corrected {
            return shown.over(self.masks.bits, pixel.background);
        }
        // no sample covered: the layers' share stays black
        let net = self.colors.net(pixel.sorted);
        net.cover(shown.average(self.masks.bits).unwrap_or(DVec3::ZERO), pixel.background)
    }

    fn transmittance(&self, pixel: &Pixel<'_>, depths: &[f32], samples: &mut Samples<W>) -> Option<Vec<f64>> {
        samples.measure(&self.masks, pixel);
        Some(depths.iter().map(|&depth| samples.steps.at(depth)).collect())
    }

    fn faults(&self) -> Faults {
        self.colors.faults()
    }

    /// Of the fragments that some sample shows in the end.
    fn diagnose(&self, pixel: &Pixel<'_>, samples: &mut Samples<W>) -> Diagnosis {
        let mut found = Diagnosis::CLEAR;
        samples.test.run(&self.masks, pixel, |f, _| found.count_all(self.colors.written(unmultiplied(f))));
        found
    }

    fn cost(&self, _complexity: &DepthComplexity) -> Cost {
        let net = f64::from(u8::from(self.corrected));
        Cost { geometry_passes: 1.0 + net, bytes_per_pixel: self.bytes }
    }

    fn properties(&self) -> Properties {
        self.promises
    }
}

/// Samples that keep depths: a transmittance function with steps of 1 / S.
struct StochasticDepth<W> {
    masks: RandomMasks,
    nodes: Nodes,
    bytes: f64,
    width: PhantomData<W>,
}

impl<W: Words> Oracle for StochasticDepth<W> {
    type Map = Samples<W>;
    const NEEDS_SORTED: bool = true;

    fn build(&self, pixel: &Pixel<'_>, map: &mut Samples<W>) {
        map.measure(&self.masks, pixel);
    }
    fn in_front_of(&self, map: &Samples<W>, fragment: &Fragment) -> f64 {
        map.steps.in_front_of(sort_key(fragment.depth, fragment.primitive))
    }
    fn at(&self, map: &Samples<W>, depth: f32) -> f64 {
        map.steps.at(depth)
    }
    fn total(&self, map: &Samples<W>) -> f64 {
        map.steps.total()
    }

    fn cost(&self, _complexity: &DepthComplexity) -> Cost {
        Cost { geometry_passes: 2.0, bytes_per_pixel: self.bytes }
    }

    /// The nearest fragment has T̂ = 1, so that something always shows.
    fn properties(&self, composite: Composite) -> Properties {
        let corrected = composite == Composite::Normalize;
        self.nodes.promises(Properties {
            unbiased: !corrected,
            exact_for_one: true,
            exact_for_one_color: corrected,
            exact_coverage: true,
            ..STOCHASTIC
        })
    }
}

#[cfg(test)]
mod tests;
