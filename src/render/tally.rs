//! Counts and times of a run, summed over tiles.

use crate::lanes::{Group, LANES};
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
    pub occluded: Occluded,
    pub variants: Vec<VariantTally>,
}

impl Tally {
    pub fn new(variants: usize) -> Self {
        Self { variants: vec![VariantTally::default(); variants], ..Self::default() }
    }

    /// Counts pixels by their numbers of fragments.
    pub fn count(&mut self, fragments: impl Iterator<Item = u32> + Clone) {
        self.fragments += fragments.clone().map(u64::from).sum::<u64>();
        self.deepest = self.deepest.max(fragments.clone().max().unwrap_or(0).into());
        self.empty_pixels += fragments.map(|n| u64::from(n == 0)).sum::<u64>();
    }

    /// Counts pixels by their numbers of fragments, of which there are none in those beyond the last.
    pub fn count_groups(&mut self, groups: &[Group<u32>], pixels: usize) {
        let (fragments, deepest, empty) = count_groups(groups);
        self.fragments += fragments;
        self.deepest = self.deepest.max(deepest.into());
        self.empty_pixels += empty - (groups.len() * LANES - pixels) as u64;
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
        self.occluded.add(other.occluded);
        for (mine, theirs) in self.variants.iter_mut().zip(&other.variants) {
            mine.nanos += theirs.nanos;
            mine.dropped += theirs.dropped;
            mine.single_fragment_pixels += theirs.single_fragment_pixels;
            mine.hidden_fragments += theirs.hidden_fragments;
        }
        self
    }
}

/// The sum, the largest, and how many are zero.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"))]
fn count_groups(groups: &[Group<u32>]) -> (u64, u32, u64) {
    let (mut sums, mut deepest, mut empty) = ([0_u64; LANES], [0; LANES], [0_u64; LANES]);
    for group in groups {
        for lane in 0..LANES {
            let n = group.0[lane];
            sums[lane] += u64::from(n);
            deepest[lane] = if n > deepest[lane] { n } else { deepest[lane] };
            empty[lane] += u64::from(n == 0);
        }
    }
    (sums.iter().sum(), deepest.into_iter().max().unwrap_or(0), empty.iter().sum())
}
