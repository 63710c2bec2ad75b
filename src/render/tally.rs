//! Counts and times of a run, summed over tiles.

use crate::raster::Occluded;
use crate::resolve::VariantTally;
use multiversion::multiversion;

#[derive(Debug, Clone, Default)]
pub(super) struct Tally {
    pub raster_nanos: u64,
    /// The part of `raster_nanos` that was the techniques' own, by samples.
    pub streaming_nanos: u64,
    pub fragments: u64,
    pub deepest: u64,
    pub empty_tiles: u64,
    pub empty_pixels: u64,
    /// Tiles whose layers `over` got in any order, since they have one colour ...
    pub one_color_tiles: u64,
    /// ... and those where they came front to back.
    pub layered_tiles: u64,
    /// Pixels of sums that have those of a neighbour.
    pub repeated_pixels: u64,
    pub occluded: Occluded,
    pub variants: Vec<VariantTally>,
}

impl Tally {
    pub fn new(variants: usize) -> Self {
        Self { variants: vec![VariantTally::default(); variants], ..Self::default() }
    }

    /// Counts pixels by their numbers of fragments.
    pub fn count(&mut self, counts: &[u32]) {
        let (fragments, deepest, empty) = summarize(counts);
        self.fragments += fragments;
        self.deepest = self.deepest.max(deepest.into());
        self.empty_pixels += empty;
    }

    /// The same for cells, each of so many pixels.
    pub fn count_cells(&mut self, counts: &[u32], pixels: impl Iterator<Item = usize>) {
        for (&n, pixels) in counts.iter().zip(pixels) {
            self.fragments += u64::from(n) * pixels as u64;
            self.deepest = self.deepest.max(n.into());
            self.empty_pixels += if n == 0 { pixels as u64 } else { 0 };
        }
    }

    /// Adds what a variant did while rasterising.
    pub fn streamed(&mut self, variant: usize, nanos: u64) {
        self.streaming_nanos += nanos;
        self.variants[variant].nanos += nanos;
    }

    pub fn merge(mut self, other: &Self) -> Self {
        self.raster_nanos += other.raster_nanos;
        self.streaming_nanos += other.streaming_nanos;
        self.fragments += other.fragments;
        self.deepest = self.deepest.max(other.deepest);
        self.empty_tiles += other.empty_tiles;
        self.empty_pixels += other.empty_pixels;
        self.one_color_tiles += other.one_color_tiles;
        self.layered_tiles += other.layered_tiles;
        self.repeated_pixels += other.repeated_pixels;
        self.occluded.add(other.occluded);
        for (mine, theirs) in self.variants.iter_mut().zip(&other.variants) {
            mine.nanos += theirs.nanos;
            mine.dropped += theirs.dropped;
            mine.invalid_weights += theirs.invalid_weights;
            mine.single_fragment_pixels += theirs.single_fragment_pixels;
            mine.hidden_fragments += theirs.hidden_fragments;
        }
        self
    }
}

/// The sum, the largest, and how many are zero.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"))]
fn summarize(counts: &[u32]) -> (u64, u32, u64) {
    let (mut sum, mut largest, mut zeros) = (0, 0, 0);
    for &n in counts {
        sum += u64::from(n);
        largest = if n > largest { n } else { largest };
        zeros += u64::from(n == 0);
    }
    (sum, largest, zeros)
}
