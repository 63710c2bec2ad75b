//! Moments as a transmittance function: what the techniques of both bases share.

use super::{Basis, MAX_STORED, Regularization};
use crate::continuum::absorbance::{absorbance, transmittance};
use crate::continuum::oracle::{Composite, Oracle, TwoPass};
use crate::continuum::range::DepthRange;
use crate::fragments::{Fragment, List};
use crate::params::{Kind, ParamSpec, Params, Value, View};
use crate::technique::{AnyTechnique, Cost, DepthComplexity, Pixel, Properties};

/// The param `bias`; its default is the technique's own.
pub const BIAS: ParamSpec = ParamSpec::new(
    "bias",
    Kind::NON_NEGATIVE,
    Value::None,
    "share of the moments that is replaced by those of spread out mass, against rounding; 1 and more replace \
     all",
);

/// The param `overestimation`.
pub const OVERESTIMATION: ParamSpec = ParamSpec::new(
    "overestimation",
    Kind::float(0.0, 1.0),
    Value::Float(0.25),
    "where between its lower bound (0) and its upper (1) the absorbance in front of a depth is taken",
);

/// Pixels of less absorbance count as empty (M18's code): their moments are made of rounding.
const EMPTY: f32 = 1.0005e-3;

/// What the param `bias` asks for; moments are summed in single precision.
pub fn regularization(params: &Params) -> Regularization {
    Regularization { bias: params.float("bias"), precision: f32::EPSILON.into() }
}

/// The technique of these params over a basis.
pub fn technique<B: Basis>(basis: B, params: &Params, view: &View) -> Box<dyn AnyTechnique> {
    let oracle = MomentOracle {
        basis,
        overestimation: params.float("overestimation"),
        range: DepthRange::from_params(params, view),
        s_max: params.float("s_max"),
    };
    Box::new(TwoPass { oracle, composite: Composite::from_params(params) })
}

/// A transmittance function by its moments.
pub struct MomentOracle<B> {
    basis: B,
    overestimation: f64,
    range: DepthRange,
    s_max: f64,
}

/// Depth on a logarithmic scale from −1 to 1.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Warp {
    low: f64,
    high: f64,
    log_low: f64,
    scale: f64,
}

impl Warp {
    /// The scale on which `low` is −1 and `high` is 1; a depth of 0 is moved in front of the rest.
    pub fn new((low, high): (f64, f64)) -> Self {
        let low = low.max(1e-6 * high);
        if high <= low {
            return Self::default();
        }
        let log_low = low.ln();
        Self { low, high, log_low, scale: 2.0 / (high.ln() - log_low) }
    }

    /// Where a depth is on the scale; 0 where there is but one depth.
    pub fn position(&self, depth: f32) -> f64 {
        if self.scale == 0.0 {
            return 0.0;
        }
        let log = f64::from(depth).clamp(self.low, self.high).ln() - self.log_low;
        (self.scale * log - 1.0).clamp(-1.0, 1.0)
    }
}

/// One pixel's transmittance function.
#[derive(Debug, Default)]
pub struct Map<M> {
    warp: Warp,
    total: f32,
    /// None where the pixel counts as empty.
    moments: Option<M>,
}

impl<B: Basis> MomentOracle<B> {
    /// Total absorbance, and the sum of each basis function weighted with it, as blended in single precision.
    #[expect(clippy::cast_possible_truncation, reason = "the sums are f32 targets")]
    fn sum(&self, warp: &Warp, list: List<'_>) -> (f32, [f32; MAX_STORED]) {
        let (mut total, mut sums) = (0.0, [0.0; MAX_STORED]);
        for (&depth, &alpha) in list.depth.iter().zip(list.alpha) {
            let s = absorbance(alpha, self.s_max);
            total += s as f32;
            for (sum, f) in sums.iter_mut().zip(self.basis.functions(warp.position(depth))) {
                *sum += (s * f) as f32;
            }
        }
        (total, sums)
    }
}

impl<B: Basis> Oracle for MomentOracle<B> {
    type Map = Map<B::Moments>;

    fn build(&self, pixel: &Pixel<'_>, map: &mut Self::Map) {
        map.warp = Warp::new(self.range.bounds(pixel.list));
        let (total, sums) = self.sum(&map.warp, pixel.list);
        map.total = total;
        map.moments =
            (total >= EMPTY).then(|| self.basis.prepare(&sums.map(|sum| f64::from(sum) / f64::from(total))));
    }

    fn in_front_of(&self, map: &Self::Map, fragment: &Fragment) -> f64 {
        self.at(map, fragment.depth)
    }

    fn at(&self, map: &Self::Map, depth: f32) -> f64 {
        let Some(moments) = &map.moments else { return 1.0 };
        let share = self.basis.in_front(moments, map.warp.position(depth), self.overestimation);
        transmittance(f64::from(map.total) * share)
    }

    fn total(&self, map: &Self::Map) -> f64 {
        if map.moments.is_some() { transmittance(map.total.into()) } else { 1.0 }
    }

    #[expect(clippy::cast_precision_loss, reason = "a handful of targets")]
    fn cost(&self, _complexity: &DepthComplexity) -> Cost {
        Cost { geometry_passes: 2.0, bytes_per_pixel: 4.0 * (self.basis.stored() + 1) as f64 + 10.0 }
    }

    /// Eight moments are the most there are, so no size makes the error vanish.
    fn properties(&self, composite: Composite) -> Properties {
        composite.promises(false)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn depth_is_warped_logarithmically() {
        let warp = Warp::new((1.0, 100.0));
        assert_eq!([0.5, 1.0, 100.0, 200.0].map(|z| warp.position(z)), [-1.0, -1.0, 1.0, 1.0]);
        assert!(warp.position(10.0).abs() < 1e-15);
    }

    #[test]
    fn the_eye_and_a_single_depth_have_places_too() {
        let from_eye = Warp::new((0.0, 2.0));
        assert_eq!([0.0, 1e-9, 2.0].map(|z| from_eye.position(z)), [-1.0, -1.0, 1.0]);
        for depth in [0.0, 3.0] {
            assert_eq!(Warp::new((depth, depth)).position(3.0), 0.0);
        }
    }
}
