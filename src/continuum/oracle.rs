//! The two-pass template of transmittance techniques: build T̂, then accumulate every fragment through it
//! (sheet 0.3). They differ in the basis that T̂ is written in, and in nothing else.

use super::sums::{BlendSums, blend};
use crate::diagnosis::{Diagnosis, Faults};
use crate::fragments::{Fragment, List};
use crate::gpu::form::Number;
use crate::params::{Kind, ParamSpec, Params, Value};
use crate::technique::{Cost, DepthComplexity, Pixel, Properties, Resolved, Technique};

/// How the accumulated fragments meet the background.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Composite {
    /// `N + T̂(∞) C_0`: everything as the map has it.
    None,
    /// `N + R C_0`: the background's share is the exact product.
    ExactBackground,
    /// `N (1 − R) / D + R C_0`: a weighted average with T̂ for a weight.
    Normalize,
}

impl Composite {
    /// The param `composite` with the given default.
    pub const fn param(default: &'static str) -> ParamSpec {
        ParamSpec::new(
            "composite",
            Kind::Choice(&["none", "exact_bg", "normalize"]),
            Value::Text(default),
            "how the sums meet the background: as the map has it, with the background's exact share, or \
             normalised to the exact coverage",
        )
    }

    /// What the param `composite` asks for.
    pub fn from_params(params: &Params) -> Self {
        match params.text("composite") {
            "exact_bg" => Self::ExactBackground,
            "normalize" => Self::Normalize,
            _ => Self::None,
        }
    }

    /// As `composite_sums` in `shaders/blocks/sums.wgsl` has it.
    pub fn number(self) -> Number {
        Number::Whole(match self {
            Self::None => 0,
            Self::ExactBackground => 1,
            Self::Normalize => 2,
        })
    }
}

impl Composite {
    /// What holds of an additive map of absorbance that is composited so: such a map does not depend on order,
    /// and its own background share is not exact behind opaque fragments, whose absorbance is bounded.
    /// `lone_is_free` says whether nothing is in front of a lone fragment.
    pub fn promises(self, lone_is_free: bool) -> Properties {
        let normalize = self == Self::Normalize;
        Properties {
            order_independent: true,
            unbiased: false,
            consistent: false,
            exact_for_one: normalize || (self == Self::ExactBackground && lone_is_free),
            exact_for_one_color: normalize,
            exact_coverage: self != Self::None,
        }
    }
}

/// Transmittances below this one are raised to it when they are weights: a dense stack whose every T̂
/// underflows then falls back to MB13 eq. 5 instead of showing the background.
pub const FLOOR: f64 = 1e-30;

/// So many fragments are looked at together, in loops that vectorise.
pub const CHUNK: usize = 64;

/// A list in parts of at most [`CHUNK`] fragments.
pub fn chunks(list: List<'_>) -> impl Iterator<Item = List<'_>> {
    let parts = list.depth.chunks(CHUNK).zip(list.color.chunks(CHUNK));
    let parts = parts.zip(list.alpha.chunks(CHUNK).zip(list.primitive.chunks(CHUNK)));
    parts.map(|((depth, color), (alpha, primitive))| List { depth, color, alpha, primitive })
}

/// [`Oracle::in_front_of`] by means of [`Oracle::see`].
pub fn see_one<O: Oracle>(oracle: &O, map: &O::Map, fragment: &Fragment) -> f64 {
    let mut seen = [0.0];
    let Fragment { depth, color, alpha, primitive } = *fragment;
    let list = List { depth: &[depth], color: &[color], alpha: &[alpha], primitive: &[primitive] };
    oracle.see(map, list, &mut seen);
    seen[0]
}

/// A basis for a pixel's transmittance function, with its params bound.
pub trait Oracle: Send + Sync + 'static {
    /// The function of one pixel, and what building it needs; reused from pixel to pixel.
    type Map: Default;
    /// Whether [`Oracle::build`] looks at `pixel.sorted`.
    const NEEDS_SORTED: bool = false;

    /// Pass A: the pixel's transmittance function.
    fn build(&self, pixel: &Pixel<'_>, map: &mut Self::Map);

    /// T̂ strictly in front of one of the pixel's fragments, at its (depth, primitive), freed of the
    /// fragment's own absorbance where the technique does so.
    fn in_front_of(&self, map: &Self::Map, fragment: &Fragment) -> f64;

    /// [`Oracle::in_front_of`] for each of at most [`CHUNK`] of the pixel's fragments.
    fn see(&self, map: &Self::Map, list: List<'_>, seen: &mut [f64]) {
        for (seen, fragment) in seen.iter_mut().zip(list.iter()) {
            *seen = self.in_front_of(map, &fragment);
        }
    }

    /// T̂ strictly in front of any depth.
    fn at(&self, map: &Self::Map, depth: f32) -> f64;

    /// T̂(∞).
    fn total(&self, map: &Self::Map) -> f64;

    /// What can go wrong with the map's numbers, as far as it is looked for.
    fn faults(&self) -> Faults {
        Faults::NONE
    }

    /// What went wrong with a pixel's map, once it is built.
    fn diagnose(&self, _map: &Self::Map, _list: List<'_>) -> Diagnosis {
        Diagnosis::CLEAR
    }

    /// The modelled cost, both passes together.
    fn cost(&self, complexity: &DepthComplexity) -> Cost;

    /// The promises when composited so.
    fn properties(&self, composite: Composite) -> Properties;
}

/// A technique that looks through an oracle.
pub struct TwoPass<O> {
    /// The transmittance function.
    pub oracle: O,
    /// The resolve.
    pub composite: Composite,
}

impl<O: Oracle> TwoPass<O> {
    /// Pass B: every fragment through the map. Sorted fragments, where there are any, make the sums the same
    /// to the last bit whatever the order of submission.
    fn accumulate(&self, map: &O::Map, pixel: &Pixel<'_>) -> BlendSums {
        let list = if O::NEEDS_SORTED { pixel.sorted } else { pixel.list };
        let floor = if self.composite == Composite::Normalize { FLOOR } else { 0.0 };
        let mut sums = BlendSums::CLEAR;
        let mut seen = [0.0; CHUNK];
        for part in chunks(list) {
            self.oracle.see(map, part, &mut seen[..part.len()]);
            for ((t, &color), &alpha) in seen.iter().zip(part.color).zip(part.alpha) {
                #[expect(clippy::cast_possible_truncation, reason = "the sums are f32 targets")]
                let weight = t.max(floor) as f32;
                sums.add(weight, color, alpha);
            }
        }
        sums
    }
}

impl<O: Oracle> Technique for TwoPass<O> {
    type Scratch = O::Map;
    const NEEDS_SORTED: bool = O::NEEDS_SORTED;

    fn resolve(&self, pixel: &Pixel<'_>, map: &mut O::Map) -> Resolved {
        self.oracle.build(pixel, map);
        let sums = self.accumulate(map, pixel);
        match self.composite {
            Composite::None => blend(sums.color(), 1.0, self.oracle.total(map), pixel.background),
            Composite::ExactBackground => blend(sums.color(), 1.0, sums.transmittance(), pixel.background),
            Composite::Normalize => sums.over(pixel.background),
        }
    }

    fn transmittance(&self, pixel: &Pixel<'_>, depths: &[f32], map: &mut O::Map) -> Option<Vec<f64>> {
        self.oracle.build(pixel, map);
        Some(depths.iter().map(|&depth| self.oracle.at(map, depth)).collect())
    }

    fn faults(&self) -> Faults {
        self.oracle.faults()
    }

    fn diagnose(&self, pixel: &Pixel<'_>, map: &mut O::Map) -> Diagnosis {
        self.oracle.build(pixel, map);
        self.oracle.diagnose(map, pixel.list)
    }

    fn cost(&self, complexity: &DepthComplexity) -> Cost {
        self.oracle.cost(complexity)
    }

    fn properties(&self) -> Properties {
        self.oracle.properties(self.composite)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fragments::Lists;
    use crate::technique::Batch;
    use crate::techniques::testing::{BACKGROUND, assert_close, over, three_layers};

    /// The exact step function, from the sorted list.
    struct Exact;

    impl Oracle for Exact {
        type Map = Vec<(f32, f64)>;
        const NEEDS_SORTED: bool = true;

        fn build(&self, pixel: &Pixel<'_>, map: &mut Self::Map) {
            map.clear();
            let mut transmittance = 1.0;
            for f in pixel.sorted.iter() {
                transmittance *= 1.0 - f64::from(f.alpha);
                map.push((f.depth, transmittance));
            }
        }
        fn in_front_of(&self, map: &Self::Map, fragment: &Fragment) -> f64 {
            self.at(map, fragment.depth)
        }
        fn at(&self, map: &Self::Map, depth: f32) -> f64 {
            map.iter().take_while(|(z, _)| *z < depth).last().map_or(1.0, |(_, t)| *t)
        }
        fn total(&self, map: &Self::Map) -> f64 {
            map.last().map_or(1.0, |(_, t)| *t)
        }
        fn cost(&self, _complexity: &DepthComplexity) -> Cost {
            Cost { geometry_passes: 2.0, bytes_per_pixel: 10.0 }
        }
        fn properties(&self, _composite: Composite) -> Properties {
            Properties::EXACT
        }
    }

    /// f32 sums of three layers.
    const SUMS: f64 = 1e-6;

    #[test]
    fn an_exact_map_makes_every_composite_exact() {
        let fragments = three_layers();
        let (mut lists, mut sorted) = (Lists::new(), Lists::new());
        fragments.iter().for_each(|f| lists.push(*f));
        lists.end_row();
        let mut by_depth = fragments.clone();
        by_depth.sort_by(|a, b| a.depth.total_cmp(&b.depth));
        by_depth.iter().for_each(|f| sorted.push(*f));
        sorted.end_row();
        let batch = Batch {
            x: 0,
            y: 0,
            width: 1,
            first: 0,
            lists: lists.as_ref(),
            sorted: Some(sorted.as_ref()),
            background: &[BACKGROUND],
        };
        let (color, transmittance) = over(&fragments);
        for composite in [Composite::None, Composite::ExactBackground, Composite::Normalize] {
            let technique = TwoPass { oracle: Exact, composite };
            let got = technique.resolve(&batch.pixel(0), &mut Vec::new());
            assert_close(got, color, transmittance, SUMS);
            let steps = technique.transmittance(&batch.pixel(0), &[2.0, 3.0, 5.0, 9.0], &mut Vec::new());
            assert_eq!(steps.unwrap(), [1.0, 0.75, 0.375, 0.093_75]);
        }
    }
}
