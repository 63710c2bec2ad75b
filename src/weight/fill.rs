//! Weights of many fragments at a time, in whole vectors.

use super::{MIN_DEPTH, WEIGHT_BOUNDS};

/// Weights that are computed together where there are many ...
const MANY: usize = 16;
/// ... and where there are few.
const LANES: usize = 8;

/// Writes the weights of all fragments, within their bounds, in whole vectors: the rest of a slice is computed
/// as one, too.
#[inline(always)]
#[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
pub(super) fn fill(at: &Fragments<'_, impl Alphas>, weights: &mut [f32], w: impl Fn(f32, f32) -> f32) {
    fill_within(at, weights, |z, a| bounded(w(at.seen.see(z), a)));
}

/// The same for weights that are no larger than [`WEIGHT_BOUNDS`] allow, and faster where depths are seen as they are.
#[inline(always)]
#[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
pub(super) fn fill_below_ceiling(
    at: &Fragments<'_, impl Alphas>,
    weights: &mut [f32],
    w: impl Fn(f32, f32) -> f32,
) {
    if at.seen.is_depth() {
        fill_within(at, weights, |z, a| not_less(w(not_less(z, MIN_DEPTH), a), WEIGHT_BOUNDS.0));
    } else {
        fill_within(at, weights, |z, a| not_less(w(at.seen.see(z), a), WEIGHT_BOUNDS.0));
    }
}

/// The same for weights that have their bounds, of depths as they are.
#[inline(always)]
#[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
fn fill_within(at: &Fragments<'_, impl Alphas>, weights: &mut [f32], w: impl Fn(f32, f32) -> f32) {
    let rest = fill_blocks::<MANY>(at, weights, &w);
    let (at, weights) = (at.from(rest), &mut weights[rest..]);
    let rest = fill_blocks::<LANES>(&at, weights, &w);
    let (at, weights) = (at.from(rest), &mut weights[rest..]);
    if !at.depth.is_empty() {
        let (mut z, mut a, mut all) = ([1.0; LANES], [1.0; LANES], [0.0; LANES]);
        z[..at.depth.len()].copy_from_slice(at.depth);
        at.alpha.write(&mut a[..at.depth.len()]);
        fill_lanes(&z, &a, &mut all, &w);
        weights.copy_from_slice(&all[..weights.len()]);
    }
}

/// Writes the weights of whole blocks; how many these are together.
#[inline(always)]
#[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
fn fill_blocks<const N: usize>(
    at: &Fragments<'_, impl Alphas>,
    weights: &mut [f32],
    w: &impl Fn(f32, f32) -> f32,
) -> usize {
    let depth = at.depth.as_chunks::<N>().0;
    for ((weights, z), a) in weights.as_chunks_mut::<N>().0.iter_mut().zip(depth).zip(at.alpha.chunks()) {
        fill_lanes(z, &a, weights, w);
    }
    N * depth.len()
}

#[inline(always)]
#[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
fn fill_lanes<const N: usize>(
    z: &[f32; N],
    a: &[f32; N],
    weights: &mut [f32; N],
    w: &impl Fn(f32, f32) -> f32,
) {
    let mut all = [0.0; N];
    for lane in 0..N {
        all[lane] = w(z[lane], a[lane]);
    }
    *weights = all;
}

/// What is to be weighed.
pub(super) struct Fragments<'a, A> {
    pub(super) seen: Seen,
    pub(super) depth: &'a [f32],
    pub(super) alpha: A,
}

impl<A: Alphas> Fragments<'_, A> {
    /// Those from the i-th on.
    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    fn from(&self, i: usize) -> Self {
        Self { depth: &self.depth[i..], alpha: self.alpha.after(i), ..*self }
    }
}

/// The alphas of fragments.
pub(super) trait Alphas: Copy {
    /// Those from the i-th on.
    fn after(self, i: usize) -> Self;
    /// So many at a time, as many times as there are whole chunks at least.
    fn chunks<const N: usize>(self) -> impl Iterator<Item = [f32; N]>;
    /// The first ones.
    fn write(self, to: &mut [f32]);
}

#[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
impl Alphas for &[f32] {
    #[inline(always)]
    fn after(self, i: usize) -> Self {
        &self[i..]
    }
    #[inline(always)]
    fn chunks<const N: usize>(self) -> impl Iterator<Item = [f32; N]> {
        self.as_chunks().0.iter().copied()
    }
    #[inline(always)]
    fn write(self, to: &mut [f32]) {
        to.copy_from_slice(self);
    }
}

/// All have the same.
#[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
impl Alphas for f32 {
    #[inline(always)]
    fn after(self, _: usize) -> Self {
        self
    }
    #[inline(always)]
    fn chunks<const N: usize>(self) -> impl Iterator<Item = [f32; N]> {
        std::iter::repeat([self; N])
    }
    #[inline(always)]
    fn write(self, to: &mut [f32]) {
        to.fill(self);
    }
}

#[inline(always)]
#[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
pub(super) fn bounded(w: f32) -> f32 {
    let (floor, ceiling) = WEIGHT_BOUNDS;
    let w = not_less(w, floor);
    if w < ceiling { w } else { ceiling }
}

/// The larger one; `least` where `x` is no number.
#[inline(always)]
#[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
fn not_less(x: f32, least: f32) -> f32 {
    if x > least { x } else { least }
}

/// The depth that weights see.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Seen {
    pub(super) scale: f32,
    pub(super) shift: f32,
}

impl Seen {
    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    pub(super) fn see(self, z: f32) -> f32 {
        not_less(self.scale * z + self.shift, MIN_DEPTH)
    }

    /// Whether it is the depth itself.
    fn is_depth(self) -> bool {
        self.scale == 1.0 && self.shift == 0.0
    }
}
