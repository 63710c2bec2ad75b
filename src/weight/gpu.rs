//! Weights as the shaders' `Weight` has them.

use super::{Formula, Function, Planes, Weighting};
use crate::gpu::form::Number;

impl Weighting {
    /// The members of `Weight` in `shaders/blocks/weight.wgsl`; none for a weight that is not one of the published ones.
    pub fn numbers(&self) -> Option<Vec<Number>> {
        let Function::Published(formula) = &self.function else { return None };
        let (index, k, planes) = match *formula {
            Formula::One => (0, 0.0, None),
            Formula::Mb7 => (1, 0.0, None),
            Formula::Mb8 => (2, 0.0, None),
            Formula::Mb9 => (3, 0.0, None),
            Formula::Mb10(planes) => (4, 0.0, Some(planes)),
            Formula::InvPow { k } => (5, k, None),
            Formula::Exp { k } => (6, k, None),
            Formula::Fig1 => (7, 0.0, None),
            Formula::Smoke6 => (8, 0.0, None),
            Formula::Fig10 { k } => (9, k, None),
            Formula::I3d16(planes) => (10, 0.0, Some(planes)),
        };
        let Planes { scale, inverse_far } = planes.unwrap_or(Planes { scale: 0.0, inverse_far: 0.0 });
        let floats = [k, self.seen.scale, self.seen.shift, scale, inverse_far].map(Number::Float);
        let unused = [Number::Whole(0); 2];
        Some([Number::Whole(index)].into_iter().chain(floats).chain(unused).collect())
    }
}
