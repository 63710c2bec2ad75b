//! Primitives that wait for weights of somebody's own, which are best evaluated for thousands of fragments at once: the
//! cost of a call is shared by all of them. A pixel gets its fragments in the same order.

use super::Weight;
use super::aligned::Aligned;
use super::kernels::{add_few, add_flat, add_weighted};
use crate::raster::{Arrivals, Cover, Premultiplied};
use crate::resolve::nanos_since;
use std::time::Instant;

/// What waits, primitive after primitive.
#[derive(Default)]
pub struct Deferred {
    /// Fragments that are evaluated together; none where no weight is somebody's own.
    chunk: Option<usize>,
    /// Where the fragments are, and their depths.
    arrivals: Arrivals,
    primitives: Vec<Primitive>,
    alpha: Vec<f32>,
    /// The fragments' colours where a primitive has several.
    colors: Vec<Premultiplied>,
}

/// The colours of a primitive that waits.
struct Primitive {
    /// Its first fragment.
    first: usize,
    /// Its colour, if it has but one.
    flat: Option<Premultiplied>,
    /// The first of its colours otherwise.
    first_color: usize,
}

impl Deferred {
    /// For weights that are evaluated for so many fragments at once.
    pub fn of(chunk: Option<usize>) -> Self {
        Self { chunk, ..Self::default() }
    }

    /// Whether there are such weights.
    pub fn is_wanted(&self) -> bool {
        self.chunk.is_some()
    }

    /// Whether nothing waits.
    pub fn is_empty(&self) -> bool {
        self.primitives.is_empty()
    }

    /// Whether enough waits to be evaluated.
    pub fn is_full(&self) -> bool {
        self.chunk.is_some_and(|chunk| self.arrivals.fragments() >= chunk)
    }

    /// Keeps a primitive of one colour.
    pub fn push_flat(&mut self, cover: &Cover<'_, '_>, color: Premultiplied) {
        self.push(cover, Some(color));
        self.alpha.resize(self.arrivals.fragments(), color[3]);
    }

    /// Keeps a primitive whose fragments have these colours.
    pub fn push_shaded(&mut self, cover: &Cover<'_, '_>, colors: &[Premultiplied]) {
        self.push(cover, None);
        self.alpha.extend(colors.iter().map(|color| color[3]));
        self.colors.extend_from_slice(colors);
    }

    fn push(&mut self, cover: &Cover<'_, '_>, flat: Option<Premultiplied>) {
        let (first, first_color) = (self.arrivals.fragments(), self.colors.len());
        self.primitives.push(Primitive { first, flat, first_color });
        self.arrivals.push(cover);
    }

    /// Blends everything, in the order in which it came, into the sums of those weights that are somebody's own.
    pub fn blend(
        &mut self,
        weights: &mut [Weight<'_>],
        sums: &mut [Aligned<[f32; 4]>],
        numbers: &mut Vec<f32>,
    ) {
        for (weight, sums) in weights.iter_mut().zip(sums).filter(|(weight, _)| weight.is_own()) {
            let Some(weighting) = weight.weighting else { continue };
            let start = Instant::now();
            let times = |i| u64::from(!self.is_nothing(i));
            weight.invalid += weighting.evaluate_counted(self.arrivals.depth(), &self.alpha, numbers, times);
            self.add(numbers, sums);
            weight.stopwatch.add(nanos_since(start));
        }
        self.clear();
    }

    /// Adds all primitives to the sums of one weight.
    fn add(&self, mut weights: &[f32], sums: &mut [[f32; 4]]) {
        for (primitive, arrived) in self.primitives.iter().zip(self.arrivals.iter()) {
            let (now, later) = weights.split_at(arrived.depth.len());
            weights = later;
            match primitive.flat {
                Some(color) if arrived.runs.is_empty() => add_few(arrived.pixels, now, color, sums),
                Some(color) => add_flat(arrived.runs, now, color, sums),
                None => {
                    let colors = &self.colors[primitive.first_color..];
                    for ((i, &weight), &color) in arrived.places().zip(now).zip(colors) {
                        add_weighted(weight, color, &mut sums[i]);
                    }
                }
            }
        }
    }

    /// Whether a fragment neither covers nor emits: lists do without those.
    fn is_nothing(&self, fragment: usize) -> bool {
        let after = self.primitives.partition_point(|primitive| primitive.first <= fragment);
        let Primitive { first, flat, first_color } = self.primitives[after - 1];
        flat.unwrap_or_else(|| self.colors[first_color + fragment - first]) == [0.0; 4]
    }

    /// Forgets what waits.
    pub fn clear(&mut self) {
        self.arrivals.clear();
        self.primitives.clear();
        self.alpha.clear();
        self.colors.clear();
    }
}
