//! Primitives that wait for weights of somebody's own, which are best evaluated for thousands of fragments at once: the
//! cost of a call is shared by all of them. A pixel gets its fragments in the same order.

use super::Weight;
use super::kernels::{add_few, add_flat, add_weighted};
use crate::raster::{Cover, Premultiplied, Run, Where};
use crate::resolve::nanos_since;
use std::time::Instant;

/// What waits, primitive after primitive.
#[derive(Default)]
pub struct Deferred {
    /// Fragments that are evaluated together; none where no weight is somebody's own.
    chunk: Option<usize>,
    primitives: Vec<Primitive>,
    /// Where the fragments are: pixels of small primitives, runs of others.
    places: Vec<u32>,
    runs: Vec<Run>,
    depth: Vec<f32>,
    alpha: Vec<f32>,
    /// The fragments' colours where a primitive has several.
    colors: Vec<Premultiplied>,
}

/// How much of all that is a primitive's.
struct Primitive {
    /// Its first fragment.
    first: usize,
    /// Its colour, if it has but one.
    flat: Option<Premultiplied>,
    fragments: usize,
    places: usize,
    runs: usize,
}

/// Takes so much from the front of a slice.
fn take<'s, T>(slice: &mut &'s [T], len: usize) -> &'s [T] {
    let (now, later) = slice.split_at(len);
    *slice = later;
    now
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
        self.chunk.is_some_and(|chunk| self.depth.len() >= chunk)
    }

    /// Keeps a primitive of one colour.
    pub fn push_flat(&mut self, cover: &Cover<'_, '_>, color: Premultiplied) {
        self.push(cover, Some(color));
        self.alpha.resize(self.depth.len(), color[3]);
    }

    /// Keeps a primitive whose fragments have these colours.
    pub fn push_shaded(&mut self, cover: &Cover<'_, '_>, colors: &[Premultiplied]) {
        self.push(cover, None);
        self.alpha.extend(colors.iter().map(|color| color[3]));
        self.colors.extend_from_slice(colors);
    }

    fn push(&mut self, cover: &Cover<'_, '_>, flat: Option<Premultiplied>) {
        let (places, runs) = match cover.at {
            Where::Few(pixels) => (pixels.places(), &[][..]),
            Where::Many(runs) => (&[][..], runs),
        };
        self.primitives.push(Primitive {
            first: self.depth.len(),
            flat,
            fragments: cover.pixels,
            places: places.len(),
            runs: runs.len(),
        });
        self.places.extend_from_slice(places);
        self.runs.extend_from_slice(runs);
        match cover.constant_depth {
            Some(depth) => self.depth.resize(self.depth.len() + cover.pixels, depth),
            None => self.depth.extend_from_slice(&cover.depth[..cover.pixels]),
        }
    }

    /// Blends everything, in the order in which it came, into the sums of those weights that are somebody's own.
    pub fn blend(&mut self, weights: &mut [Weight<'_>], sums: &mut [Vec<[f32; 4]>], numbers: &mut Vec<f32>) {
        for (weight, sums) in weights.iter_mut().zip(sums).filter(|(weight, _)| weight.is_own()) {
            let Some(weighting) = weight.weighting else { continue };
            let start = Instant::now();
            let times = |i| u64::from(!self.is_nothing(i));
            weight.invalid += weighting.evaluate_counted(&self.depth, &self.alpha, numbers, times);
            self.add(numbers, sums);
            weight.stopwatch.add(nanos_since(start));
        }
        self.clear();
    }

    /// Adds all primitives to the sums of one weight.
    fn add(&self, mut weights: &[f32], sums: &mut [[f32; 4]]) {
        let (mut places, mut runs, mut colors) = (&self.places[..], &self.runs[..], &self.colors[..]);
        for primitive in &self.primitives {
            let weights = take(&mut weights, primitive.fragments);
            let places = take(&mut places, primitive.places);
            let runs = take(&mut runs, primitive.runs);
            match primitive.flat {
                Some(color) if runs.is_empty() => add_few(places, weights, color, sums),
                Some(color) => add_flat(runs, weights, color, sums),
                None => {
                    let colors = take(&mut colors, primitive.fragments);
                    let pixels = places.iter().map(|&place| place as usize);
                    let pixels = pixels.chain(runs.iter().flat_map(|run| run.pixels()));
                    for ((i, &weight), &color) in pixels.zip(weights).zip(colors) {
                        add_weighted(weight, color, &mut sums[i]);
                    }
                }
            }
        }
    }

    /// Whether a fragment neither covers nor emits: lists do without those.
    fn is_nothing(&self, fragment: usize) -> bool {
        let after = self.primitives.partition_point(|primitive| primitive.first <= fragment);
        let (before, now) = self.primitives[..after].split_at(after - 1);
        let color = now[0].flat.unwrap_or_else(|| {
            let shaded = before.iter().filter(|primitive| primitive.flat.is_none());
            let first = shaded.map(|primitive| primitive.fragments).sum::<usize>();
            self.colors[first + fragment - now[0].first]
        });
        color == [0.0; 4]
    }

    /// Forgets what waits.
    pub fn clear(&mut self) {
        self.primitives.clear();
        self.places.clear();
        self.runs.clear();
        self.depth.clear();
        self.alpha.clear();
        self.colors.clear();
    }
}
