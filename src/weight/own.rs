//! Weights of one's own, in WGSL or of arrays.

use super::{Fragments, Planes, WEIGHT_BOUNDS, bounded};
use crate::error::Result;
use crate::own::OwnFunction;
use crate::params::{Params, Reports, Setting};

/// A weight of somebody's own.
pub struct Own {
    function: OwnFunction,
    /// What window depth needs, where the function reads it.
    planes: Option<Planes>,
    reports: Reports,
}

/// Fragments whose depths are prepared together.
const CHUNK: usize = 128;

impl Own {
    /// The weight that the params ask for.
    ///
    /// # Errors
    /// `Error::Param` with what is wrong with its text.
    pub(super) fn new(setting: &Setting, planes: Planes, params: &Params) -> Result<Self> {
        let reads_depth = matches!(setting, Setting::Written(source) if source.reads("d"));
        Ok(Self {
            function: OwnFunction::from_params(setting, "weight", params)?,
            planes: reads_depth.then_some(planes),
            reports: params.reports().clone(),
        })
    }

    pub(super) fn is_same(&self, other: &Self) -> bool {
        self.planes == other.planes && self.function.is_same(&other.function)
    }

    pub(super) fn chunk(&self) -> usize {
        self.function.chunk()
    }

    pub(super) fn report(&self, invalid: u64) {
        self.reports.add_invalid(invalid);
    }

    /// Writes the weights of all fragments, within their bounds, and counts those that are none.
    pub(super) fn weigh(
        &self,
        at: &Fragments<'_, &[f32]>,
        weights: &mut [f32],
        times: impl Fn(usize) -> u64,
    ) -> u64 {
        let is_known = match &self.function {
            OwnFunction::Written(_) => self.weigh_written(at, weights),
            OwnFunction::Called(_) => {
                let seen: Vec<_> = at.depth.iter().map(|&z| at.seen.see(z)).collect();
                self.function.evaluate(&[&seen, at.alpha], weights)
            }
        };
        // what only stands in for a weight is counted when it comes
        let times = |i| if is_known { times(i) } else { 0 };
        repair(weights, times)
    }

    fn weigh_written(&self, at: &Fragments<'_, &[f32]>, weights: &mut [f32]) -> bool {
        let (mut z, mut d) = ([0.0; CHUNK], [0.0; CHUNK]);
        let chunks = at.depth.chunks(CHUNK).zip(at.alpha.chunks(CHUNK)).zip(weights.chunks_mut(CHUNK));
        for ((depth, alpha), weights) in chunks {
            let (z, d) = (&mut z[..depth.len()], &mut d[..depth.len()]);
            z.iter_mut().zip(depth).for_each(|(seen, &z)| *seen = at.seen.see(z));
            if let Some(planes) = self.planes {
                d.iter_mut().zip(&*z).for_each(|(d, &z)| *d = 1.0 - planes.one_minus_depth(z));
            }
            self.function.evaluate(&[z, alpha, d], weights);
        }
        true
    }
}

/// Keeps weights within their bounds, puts the least one in the place of what is none, and counts those.
fn repair(weights: &mut [f32], times: impl Fn(usize) -> u64) -> u64 {
    let mut invalid = 0;
    for (i, w) in weights.iter_mut().enumerate() {
        if *w > 0.0 && *w < f32::INFINITY {
            *w = bounded(*w);
        } else {
            invalid += times(i);
            *w = WEIGHT_BOUNDS.0;
        }
    }
    invalid
}
