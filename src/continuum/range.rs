//! The depth interval that bins and series divide (sheet 0.6).

use crate::fragments::List;
use crate::gpu::form::Number;
use crate::params::{Kind, ParamSpec, Params, Value, View};
use multiversion::multiversion;

/// Where a pixel's depth interval comes from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum DepthRange {
    /// The pixel's own fragments.
    Pixel,
    /// The same bounds everywhere; depths outside are clamped.
    Fixed(f64, f64),
}

impl DepthRange {
    /// The param `range` with the given default, `"pixel"` or `"scene"`.
    pub const fn param(default: &'static str) -> ParamSpec {
        ParamSpec::new(
            "range",
            Kind::DepthRange,
            Value::Text(default),
            "depths that are told apart: the pixel's own, the scene's transparent geometry's, or (z_lo, z_hi) \
             with depths outside clamped",
        )
    }

    /// What the param `range` asks for.
    pub fn from_params(params: &Params, view: &View) -> Self {
        match params.value("range") {
            Value::Text("pixel") => Self::Pixel,
            Value::Pair(lo, hi) => Self::Fixed(lo, hi),
            _ => Self::Fixed(view.depth_range.0, view.depth_range.1),
        }
    }

    /// The interval of a pixel with these fragments.
    pub fn interval(&self, list: List<'_>) -> Interval {
        let (lo, hi) = self.bounds(list);
        Interval { lo, hi }
    }

    /// The bounds for a pixel with these fragments.
    pub fn bounds(&self, list: List<'_>) -> (f64, f64) {
        match *self {
            Self::Pixel => list.depth_bounds().map_or((0.0, 0.0), |(lo, hi)| (lo.into(), hi.into())),
            Self::Fixed(lo, hi) => (lo, hi),
        }
    }

    /// The bounds as a shader has them, each a sum of two, and whether they are the pixel's.
    pub fn numbers(&self) -> [Number; 5] {
        let (lo, hi) = match *self {
            Self::Pixel => (0.0, 0.0),
            Self::Fixed(lo, hi) => (lo, hi),
        };
        // no depth is as far away, and shaders multiply what lies between
        let beyond = 2.0_f64.powi(100);
        let [[lo, more_lo], [hi, more_hi]] = [lo, hi].map(|x| Number::in_two(x.clamp(-beyond, beyond)));
        [lo, more_lo, hi, more_hi, Number::Whole((*self == Self::Pixel).into())]
    }

    /// Whether no fragment of the view is clamped.
    pub fn covers(&self, view: &View) -> bool {
        match *self {
            Self::Pixel => true,
            Self::Fixed(lo, hi) => lo <= view.depth_range.0 && view.depth_range.1 <= hi,
        }
    }
}

/// A depth interval that becomes [0, 1].
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Interval {
    /// The depth at 0.
    pub lo: f64,
    /// The depth at 1.
    pub hi: f64,
}

impl Interval {
    /// Where a depth lies, in [0, 1]; 0 in an interval of a single depth.
    pub fn position(&self, depth: f32) -> f64 {
        if self.hi <= self.lo {
            return 0.0;
        }
        ((f64::from(depth) - self.lo) / (self.hi - self.lo)).clamp(0.0, 1.0)
    }

    /// [`Interval::position`] of each depth.
    pub fn positions(&self, depth: &[f32], positions: &mut [f64]) {
        if self.hi <= self.lo {
            positions.fill(0.0);
        } else {
            positions_within(self.lo, self.hi, depth, positions);
        }
    }
}

#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"))]
fn positions_within(lo: f64, hi: f64, depth: &[f32], positions: &mut [f64]) {
    for (position, &depth) in positions.iter_mut().zip(depth) {
        *position = ((f64::from(depth) - lo) / (hi - lo)).clamp(0.0, 1.0);
    }
}

impl Interval {
    /// Where a depth lies on a logarithmic scale, in [0, 1]: half of MBOIT's warp plus one half. A depth of 0
    /// is far in front of everything.
    pub fn log_position(&self, depth: f32) -> f64 {
        let lo = self.lo.max(1e-6 * self.hi);
        if self.hi <= lo {
            return 0.0;
        }
        (f64::from(depth).clamp(lo, self.hi) / lo).ln() / (self.hi / lo).ln()
    }
}

/// Which of `count` equal cells of [0, 1] a position lies in, and how far inside it: 0 at the near edge, 1 at
/// the far edge of the last one, to which position 1 belongs.
#[expect(
    clippy::cast_precision_loss,
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "positions are not negative; cells beyond 2^53 are finer than any f32 depth"
)]
pub fn cell(position: f64, count: usize) -> (usize, f64) {
    let x = position * count as f64;
    let own = (x as usize).min(count - 1);
    (own, (x - own as f64).clamp(0.0, 1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    const VIEW: View = View { near: 0.1, far: 100.0, depth_range: (2.0, 8.0) };

    #[test]
    fn bounds_come_from_the_pixel_or_are_fixed() {
        let list = List { depth: &[4.0, 3.0, 5.0], ..List::default() };
        assert_eq!(DepthRange::Pixel.bounds(list), (3.0, 5.0));
        assert_eq!(DepthRange::Fixed(2.0, 8.0).bounds(list), (2.0, 8.0));
    }

    #[test]
    fn a_range_covers_the_scene_or_clamps() {
        let covers = [(2.0, 8.0), (1.0, 9.0), (2.1, 9.0), (1.0, 7.0)]
            .map(|(a, b)| DepthRange::Fixed(a, b).covers(&VIEW));
        assert_eq!(covers, [true, true, false, false]);
        assert!(DepthRange::Pixel.covers(&VIEW));
    }

    #[test]
    fn positions_are_clamped_and_those_of_a_single_layer_are_zero() {
        let interval = Interval { lo: 2.0, hi: 6.0 };
        assert_eq!([1.0, 2.0, 3.0, 6.0, 7.0].map(|z| interval.position(z)), [0.0, 0.0, 0.25, 1.0, 1.0]);
        assert_eq!([1.0, 2.0, 3.0].map(|z| Interval { lo: 2.0, hi: 2.0 }.position(z)), [0.0; 3]);
    }

    #[test]
    fn logarithmic_positions_too_even_from_the_eye_on() {
        let interval = Interval { lo: 2.0, hi: 8.0 };
        assert_eq!([1.0, 2.0, 4.0, 8.0, 9.0].map(|z| interval.log_position(z)), [0.0, 0.0, 0.5, 1.0, 1.0]);
        let eye = Interval { lo: 0.0, hi: 1.0 };
        let thousandth = eye.log_position(1e-3);
        assert!(eye.log_position(0.0) == 0.0 && (thousandth - 0.5).abs() < 1e-8, "{thousandth}");
        assert_eq!([0.0, 1.0].map(|z| Interval { lo: 0.0, hi: 0.0 }.log_position(z)), [0.0; 2]);
    }

    #[test]
    fn cells_are_closed_in_front_and_the_last_one_behind_too() {
        let cells = [0.0, 0.125, 0.25, 0.875, 1.0].map(|d| cell(d, 4));
        assert_eq!(cells, [(0, 0.0), (0, 0.5), (1, 0.0), (3, 0.5), (3, 1.0)]);
        assert_eq!(cell(0.7, 1), (0, 0.7));
        assert!((0.0..=1.0).contains(&cell(1.0, usize::MAX).1));
    }
}
