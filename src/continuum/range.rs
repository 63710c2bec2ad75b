//! The depth interval that bins and series divide (sheet 0.6).

use crate::fragments::List;
use crate::params::{Kind, ParamSpec, Params, Value, View};

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

    /// The bounds for a pixel with these fragments.
    pub fn bounds(&self, list: List<'_>) -> (f64, f64) {
        match *self {
            Self::Pixel => list.depth_bounds().map_or((0.0, 0.0), |(lo, hi)| (lo.into(), hi.into())),
            Self::Fixed(lo, hi) => (lo, hi),
        }
    }

    /// Whether no fragment of the view is clamped.
    pub fn covers(&self, view: &View) -> bool {
        match *self {
            Self::Pixel => true,
            Self::Fixed(lo, hi) => lo <= view.depth_range.0 && view.depth_range.1 <= hi,
        }
    }
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
}
