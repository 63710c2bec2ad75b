//! The weights of a primitive's fragments, as its sums want them.

use crate::raster::{Cover, LANES, Premultiplied};
use crate::weight::Weighting;

/// What a primitive of one colour and one weight adds to the sums: the weight at its depth times the colour.
#[inline(always)]
#[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
pub fn constant_term(weighting: Option<&Weighting>, depth: Option<f32>, color: Premultiplied) -> [f32; 4] {
    let (Some(weighting), Some(depth)) = (weighting, depth) else { return color };
    let mut weight = [0.0];
    weighting.evaluate_here(&[depth], color[3], &mut weight);
    color.map(|channel| weight[0] * channel)
}

/// The weights of all pixels of a primitive of one colour, and a few more: whole vectors are faster than exact
/// ends, and there are depths enough.
#[inline(always)]
#[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
pub fn weigh_flat(weighting: &Weighting, cover: &Cover<'_, '_>, alpha: f32, weights: &mut Roomy) {
    let len = cover.pixels.next_multiple_of(LANES);
    weighting.evaluate_here(&cover.depth[..len], alpha, weights.resized(len));
}

/// Numbers with room for [`LANES`] more before the first and behind the last, whatever is in it.
#[derive(Default)]
pub struct Roomy(Vec<f32>);

impl Roomy {
    /// So many of whatever value, to be written.
    #[inline]
    fn resized(&mut self, len: usize) -> &mut [f32] {
        let Self(numbers) = self;
        if numbers.len() < len + 2 * LANES {
            numbers.resize(len + 2 * LANES, 0.0);
        }
        &mut numbers[LANES..LANES + len]
    }

    /// From the first number on.
    #[inline]
    pub fn numbers(&self) -> &[f32] {
        &self.0[LANES..]
    }

    /// With the room before the first.
    #[inline]
    pub fn with_room(&self) -> &[f32] {
        &self.0
    }
}

/// The weights of all pixels of a primitive whose colour varies.
pub fn weigh_shaded(
    weighting: Option<&Weighting>,
    cover: &Cover<'_, '_>,
    alphas: &[f32],
    constant: &mut Vec<f32>,
    weights: &mut Vec<f32>,
) {
    let Some(weighting) = weighting else { return refill(weights, cover.pixels, 1.0) };
    match cover.constant_depth {
        Some(depth) => {
            refill(constant, cover.pixels, depth);
            weighting.evaluate(constant, alphas, weights);
        }
        None => weighting.evaluate(&cover.depth[..cover.pixels], alphas, weights),
    }
}

fn refill(numbers: &mut Vec<f32>, len: usize, number: f32) {
    numbers.clear();
    numbers.resize(len, number);
}
