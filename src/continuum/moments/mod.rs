//! Transmittance from moments of absorbance (Münstermann et al. 2018, M18).
//!
//! A pixel's absorbance, as a distribution over depth, is stored by a few of its moments, which add up over
//! fragments. Of all distributions with these moments and a point of mass at depth d, exactly one has no more
//! points than the moments can tell apart: the canonical one. Its mass in front of d bounds that of every
//! other from below, and with its mass at d from above.

#[cfg(doc)]
use crate::continuum::oracle::CHUNK;
use linear::{Ldl, Scalar};

pub mod linear;
pub mod oracle;
pub mod polynomial;
pub mod power;
pub mod quantized;
pub mod roots;
pub mod trigonometric;

/// The most numbers that a pixel stores beside its total absorbance.
pub const MAX_STORED: usize = 8;

/// A set of functions of depth whose mean values are a pixel's moments.
pub trait Basis: Send + Sync + 'static {
    /// A pixel's moments, ready to be asked.
    type Moments: Default;

    /// How many numbers a pixel stores beside its total absorbance.
    fn stored(&self) -> usize;

    /// The functions at `d` in [−1, 1]; those beyond [`Basis::stored`] are 0.
    fn functions(&self, d: f64) -> [f64; MAX_STORED];

    /// Makes moments, given the mean value of each function, ready to be asked.
    fn prepare(&self, means: &[f64; MAX_STORED]) -> Self::Moments;

    /// How often the bias had to be raised for a matrix that is positive definite beyond rounding.
    fn retries(moments: &Self::Moments) -> u32;

    /// Adds each function at `d`, weighted with it, of at most [`CHUNK`] fragments in single precision.
    fn add(&self, d: &[f64], s: &[f64], sums: &mut [f32; MAX_STORED]);

    /// The share of all absorbance that lies in front of each `d` in the canonical distribution that has it for
    /// a point; of the part at d itself, `overestimation` counts. There are at most [`CHUNK`].
    fn shares_in_front(&self, moments: &Self::Moments, d: &[f64], overestimation: f64, shares: &mut [f64]);

    /// [`Basis::shares_in_front`] for one.
    fn in_front(&self, moments: &Self::Moments, d: f64, overestimation: f64) -> f64 {
        let mut share = [0.0];
        self.shares_in_front(moments, &[d], overestimation, &mut share);
        share[0]
    }
}

/// How wide the numbers are that moments are stored in: M18 has a bias, and what to mix in, for each.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Width {
    /// 32 bits and more.
    Single,
    /// 16 bits.
    Half,
}

/// How moments are kept away from the border of what moments can be, where rounding decides.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Regularization {
    /// The share of the moments that is replaced by those of a fixed, spread out distribution.
    pub bias: f64,
    /// The relative precision that the moments were summed with.
    pub precision: f64,
}

/// A factored moment matrix, and what it took.
#[derive(Debug, Clone, Copy)]
pub struct Factored<S> {
    /// The factors.
    pub ldl: Ldl<S>,
    /// The bias that was needed.
    pub bias: f64,
    /// How often it had to be raised.
    pub retries: u32,
}

impl Regularization {
    /// Factors the matrix of the given size whose entries depend on the bias; where a pivot is as small as
    /// rounding errors (half a unit of precision, relative), ten times the bias is tried.
    pub fn factor<S: Scalar>(&self, size: usize, entry: impl Fn(f64, usize, usize) -> S) -> Factored<S> {
        let mut bias = self.bias.min(1.0);
        let mut retries = 0;
        loop {
            // nothing is left of the moments at bias 1, and what is mixed in is exact
            let guard = if bias < 1.0 { 0.5 * self.precision } else { 0.0 };
            if let Some(ldl) = Ldl::factor(size, |i, j| entry(bias, i, j), guard) {
                return Factored { ldl, bias, retries };
            }
            assert!(bias < 1.0, "the spread out distribution alone has a positive definite matrix");
            bias = (10.0 * bias).clamp(self.precision, 1.0);
            retries += 1;
        }
    }
}

#[cfg(test)]
mod tests;
