//! Large primitives that are the same everywhere, kept until there are many and then blended into one band of the tile
//! after the other: the sums of a band stay in the nearest cache, those of the whole tile do not. A pixel gets its
//! fragments in the same order.

use super::kernels::{add_constant, cover_faintly};
use super::{Sums, Weight};
use crate::continuum::sums::FAINT;
use crate::raster::{Cover, Premultiplied, Run};
use multiversion::multiversion;

/// Pixels whose sums fit the nearest cache, at 28 bytes each: so many rows of a tile that are no more.
const BAND: usize = 1024;
/// Runs that are worth keeping, at 16 bytes each.
const RUNS: usize = 1 << 13;

/// What waits to be blended.
#[derive(Default)]
pub struct Pending {
    layers: Vec<Layer>,
    runs: Vec<Run>,
    /// The layers' colours, coverages and depths.
    colors: Vec<Premultiplied>,
    alpha: Vec<f32>,
    depth: Vec<f32>,
    /// What each layer adds to the sums, weight by weight.
    added: Vec<Vec<[f32; 4]>>,
}

/// One primitive.
struct Layer {
    alpha: f64,
    /// Its runs in the band at hand, and the end of all.
    now: std::ops::Range<usize>,
    end: usize,
}

impl Layer {
    /// Goes on to the runs that begin before pixel `limit`.
    fn advance(&mut self, runs: &[Run], limit: usize) {
        let first = self.now.end;
        let now = runs[first..self.end].iter().take_while(|run| (run.first as usize) < limit).count();
        self.now = first..first + now;
    }
}

impl Pending {
    /// For so many weights.
    pub fn with_weights(weights: usize) -> Self {
        Self { added: vec![Vec::new(); weights], ..Self::default() }
    }

    /// Whether nothing waits.
    pub fn is_empty(&self) -> bool {
        self.layers.is_empty()
    }

    /// Whether enough waits to be blended.
    pub fn is_full(&self) -> bool {
        self.runs.len() >= RUNS
    }

    /// Keeps a primitive of one colour, and one depth where weights look at it.
    pub fn push(&mut self, cover: &Cover<'_, '_>, color: Premultiplied) {
        let first = self.runs.len();
        self.runs.extend_from_slice(cover.runs);
        self.layers.push(Layer { alpha: color[3].into(), now: first..first, end: self.runs.len() });
        self.colors.push(color);
        self.alpha.push(color[3]);
        self.depth.push(cover.constant_depth.unwrap_or(1.0));
    }

    /// What each layer adds to the sums of each weight: the weight at its depth times its colour.
    fn weigh(&mut self, weights: &mut [Weight<'_>], numbers: &mut Vec<f32>) {
        let Self { layers, runs, colors, alpha, depth, added } = self;
        let pixels = |layer: usize| {
            let first = if layer == 0 { 0 } else { layers[layer - 1].end };
            runs[first..layers[layer].end].iter().map(|run| u64::from(run.len)).sum::<u64>()
        };
        for (weight, added) in weights.iter_mut().zip(added) {
            let Some(weighting) = weight.weighting else {
                added.extend_from_slice(colors);
                continue;
            };
            let times = |layer: usize| if colors[layer] == [0.0; 4] { 0 } else { pixels(layer) };
            weight.invalid += weighting.evaluate_counted(depth, alpha, numbers, times);
            added.extend(colors.iter().zip(&*numbers).map(|(color, w)| color.map(|channel| w * channel)));
        }
    }

    /// Blends everything, in the order in which it came, into a tile of so many columns.
    pub fn blend(
        &mut self,
        columns: usize,
        weights: &mut [Weight<'_>],
        sums: &mut Sums,
        numbers: &mut Vec<f32>,
    ) {
        self.weigh(weights, numbers);
        let Self { layers, runs, added, .. } = self;
        let Sums { weighted, transmittance, coverage, counts, faint } = sums;
        let Some((first, others)) = weighted.split_first_mut() else { return };
        // whole rows: a run that reached into the next band would come before earlier ones there
        let band = columns * (BAND / columns).max(1);
        for limit in (band..transmittance.len() + band).step_by(band) {
            layers.iter_mut().for_each(|layer| layer.advance(runs, limit));
            blend_band(layers, runs, &added[0], transmittance, counts, first);
            for (sums, added) in others.iter_mut().zip(&added[1..]) {
                add_band(layers, runs, added, sums);
            }
            for layer in layers.iter().filter(|layer| layer.alpha <= FAINT) {
                *faint = true;
                cover_faintly(&runs[layer.now.clone()], layer.alpha, coverage);
            }
        }
        self.clear();
    }

    /// Forgets what waits.
    pub fn clear(&mut self) {
        self.layers.clear();
        self.runs.clear();
        self.colors.clear();
        self.alpha.clear();
        self.depth.clear();
        self.added.iter_mut().for_each(Vec::clear);
    }
}

/// Attenuates the background, counts the fragments and adds to the sums.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"))]
fn blend_band(
    layers: &[Layer],
    runs: &[Run],
    added: &[[f32; 4]],
    transmittance: &mut [f64],
    counts: &mut [u32],
    sums: &mut [[f32; 4]],
) {
    for (layer, added) in layers.iter().zip(added) {
        let left = 1.0 - layer.alpha;
        for run in &runs[layer.now.clone()] {
            transmittance[run.pixels()].iter_mut().for_each(|t| *t *= left);
            counts[run.pixels()].iter_mut().for_each(|n| *n += 1);
            for sum in &mut sums[run.pixels()] {
                for channel in 0..4 {
                    sum[channel] += added[channel];
                }
            }
        }
    }
}

/// Adds to the sums of another weight.
fn add_band(layers: &[Layer], runs: &[Run], added: &[[f32; 4]], sums: &mut [[f32; 4]]) {
    for (layer, added) in layers.iter().zip(added) {
        add_constant(&runs[layer.now.clone()], *added, sums);
    }
}
