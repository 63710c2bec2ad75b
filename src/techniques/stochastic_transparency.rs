//! Stochastic transparency (Enderton et al. 2010): every fragment covers a random share alpha of a pixel's
//! samples, and each sample shows its nearest fragment; stratified as Laine & Karras (2011) do.

use crate::continuum::masks::{ManyWords, OneWord, RandomMasks, TwoWords, Words, words};
use crate::continuum::oracle::{Composite, Oracle, TwoPass};
use crate::continuum::samples::{DepthTest, Shown, uncovered, unmultiplied};
use crate::continuum::steps::Steps;
use crate::continuum::sums::BlendSums;
use crate::error::Result;
use crate::fragments::Fragment;
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
    targets: &[],
    submission_orders: ANY_ORDER,
    random: true,
    geometry_passes: "color: 1, 1 more for correction=\"alpha\"; depth: 2",
    bytes_per_pixel: "color: 8 samples, 2 more for correction=\"alpha\"; depth: 4 samples + 10 (sums and R)",
    build,
};

fn build(params: &Params, _view: &View) -> Result<Box<dyn AnyTechnique>> {
    Ok(match words(params.size("samples")) {
        0 | 1 => build_with::<OneWord>(params),
        2 => build_with::<TwoWords>(params),
        _ => build_with::<ManyWords>(params),
    })
}

fn build_with<W: Words>(params: &Params) -> Box<dyn AnyTechnique> {
    let masks = RandomMasks {
        bits: params.size("samples"),
        stratified: params.bool("stratified"),
        seed: params.size("seed") as u64,
    };
    let corrected = params.text("correction") == "alpha";
    if params.text("mode") == "color" {
        return Box::new(StochasticColor::<W> { masks, corrected, width: PhantomData });
    }
    let composite = if corrected { Composite::Normalize } else { Composite::ExactBackground };
    Box::new(TwoPass { oracle: StochasticDepth::<W> { masks, width: PhantomData }, composite })
}

/// What holds of every mode: masks do not know when a fragment arrives, and noise falls with samples.
const STOCHASTIC: Properties = Properties { order_independent: true, consistent: true, ..Properties::NONE };

/// Samples that keep colours.
struct StochasticColor<W> {
    masks: RandomMasks,
    corrected: bool,
    width: PhantomData<W>,
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

impl<W: Words> Technique for StochasticColor<W> {
    type Scratch = Samples<W>;
    const NEEDS_SORTED: bool = true;

    fn resolve(&self, pixel: &Pixel<'_>, samples: &mut Samples<W>) -> Resolved {
        let mut shown = Shown::BACKGROUND;
        samples.test.run(&self.masks, pixel, |f, visible| shown.add(visible, unmultiplied(f)));
        if !self.corrected {
            return shown.over(self.masks.bits, pixel.background);
        }
        let mut net = BlendSums::CLEAR;
        for (&color, &alpha) in pixel.sorted.color.iter().zip(pixel.sorted.alpha) {
            net.add(1.0, color, alpha);
        }
        // no sample covered: the layers' share stays black
        net.read(0).cover(shown.average(self.masks.bits).unwrap_or(DVec3::ZERO), pixel.background)
    }

    fn transmittance(&self, pixel: &Pixel<'_>, depths: &[f32], samples: &mut Samples<W>) -> Option<Vec<f64>> {
        samples.measure(&self.masks, pixel);
        Some(depths.iter().map(|&depth| samples.steps.at(depth)).collect())
    }

    #[expect(clippy::cast_precision_loss, reason = "a cost estimate")]
    fn cost(&self, _complexity: &DepthComplexity) -> Cost {
        let net = f64::from(u8::from(self.corrected));
        Cost { geometry_passes: 1.0 + net, bytes_per_pixel: 8.0 * self.masks.bits as f64 + 2.0 * net }
    }

    fn properties(&self) -> Properties {
        Properties { unbiased: !self.corrected, exact_coverage: self.corrected, ..STOCHASTIC }
    }
}

/// Samples that keep depths: a transmittance function with steps of 1 / S.
struct StochasticDepth<W> {
    masks: RandomMasks,
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

    #[expect(clippy::cast_precision_loss, reason = "a cost estimate")]
    fn cost(&self, _complexity: &DepthComplexity) -> Cost {
        Cost { geometry_passes: 2.0, bytes_per_pixel: 4.0 * self.masks.bits as f64 + 10.0 }
    }

    /// The nearest fragment has T̂ = 1, so that something always shows.
    fn properties(&self, composite: Composite) -> Properties {
        let corrected = composite == Composite::Normalize;
        Properties {
            unbiased: !corrected,
            exact_for_one: true,
            exact_for_one_color: corrected,
            exact_coverage: true,
            ..STOCHASTIC
        }
    }
}

#[cfg(test)]
mod tests;
