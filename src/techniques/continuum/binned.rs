//! Memory in bins: fragments that pass a gate are summed or blended per bin.

use super::super::lwboit::{self, LayeredWboit};
use super::super::opacity_shadow_maps::{Interpolation, Map, OpacityShadowMaps};
use super::finish::Finish;
use crate::continuum::insertion::{Always, Nearest, Threshold};
use crate::continuum::normalize::Normalize;
use crate::continuum::oracle::{Composite, Oracle};
use crate::continuum::range::{DepthRange, Interval, cell};
use crate::continuum::stochastic::VisibleByChance;
use crate::fragments::{Fragment, List, Lists};
use crate::order::sort_key;
use crate::technique::{Cost, DepthComplexity, Pixel, Properties, Resolved, Technique};

/// The axis *insertion* where what is stored is not a list.
pub trait Gate: Send + Sync + 'static {
    /// The fragment as it is stored; `None` refuses it. `occlusion` is what the bins in front of it cover,
    /// `nearest` the keys of the nearest fragments so far.
    fn pass(
        &self,
        pixel: &Pixel<'_>,
        fragment: Fragment,
        occlusion: impl FnOnce() -> f64,
        nearest: &mut Vec<u64>,
    ) -> Option<Fragment>;
}

impl Gate for Always {
    fn pass(
        &self,
        _pixel: &Pixel<'_>,
        fragment: Fragment,
        _occlusion: impl FnOnce() -> f64,
        _nearest: &mut Vec<u64>,
    ) -> Option<Fragment> {
        Some(fragment)
    }
}

impl Gate for Threshold {
    fn pass(
        &self,
        _pixel: &Pixel<'_>,
        fragment: Fragment,
        _occlusion: impl FnOnce() -> f64,
        _nearest: &mut Vec<u64>,
    ) -> Option<Fragment> {
        Threshold::pass(*self, &fragment)
    }
}

impl Gate for Nearest {
    fn pass(
        &self,
        _pixel: &Pixel<'_>,
        fragment: Fragment,
        _occlusion: impl FnOnce() -> f64,
        nearest: &mut Vec<u64>,
    ) -> Option<Fragment> {
        Nearest::pass(*self, sort_key(fragment.depth, fragment.primitive), nearest).then_some(fragment)
    }
}

impl Gate for VisibleByChance {
    fn pass(
        &self,
        pixel: &Pixel<'_>,
        fragment: Fragment,
        occlusion: impl FnOnce() -> f64,
        _nearest: &mut Vec<u64>,
    ) -> Option<Fragment> {
        self.shows(pixel, &fragment, occlusion).then_some(fragment)
    }
}

/// Bins and what may enter them.
pub struct Binning<G> {
    /// Which fragments.
    pub gate: G,
    /// B.
    pub bins: usize,
    /// What the bins divide.
    pub range: DepthRange,
}

/// The fragments of a pixel that passed.
#[derive(Debug, Default)]
pub struct Passed {
    interval: Interval,
    fragments: Lists,
    lost: Vec<u32>,
    nearest: Vec<u64>,
    /// The product of 1 − a in each bin that holds something, nearest first.
    bins: Vec<(usize, f64)>,
}

impl Passed {
    fn list(&self) -> List<'_> {
        self.fragments.as_ref().row(0)
    }
    /// The transmittance of the bins in front of `bin`.
    fn in_front_of(&self, bin: usize) -> f64 {
        self.bins.iter().take_while(|(other, _)| *other < bin).map(|(_, t)| t).product()
    }
    /// The transmittance of each bin becomes that of all bins up to it.
    fn accumulate(&mut self) {
        let mut behind = 1.0;
        for (_, transmittance) in &mut self.bins {
            behind *= *transmittance;
            *transmittance = behind;
        }
    }
    fn attenuate(&mut self, bin: usize, transmittance: f64) {
        match self.bins.binary_search_by_key(&bin, |(bin, _)| *bin) {
            Ok(i) => self.bins[i].1 *= transmittance,
            Err(i) => self.bins.insert(i, (bin, transmittance)),
        }
    }
}

impl<G: Gate> Binning<G> {
    fn bin(&self, interval: &Interval, depth: f32) -> usize {
        cell(interval.position(depth), self.bins).0
    }

    /// The transmittance in front of a depth's bin, of accumulated ones.
    fn accumulated(&self, passed: &Passed, depth: f32) -> f64 {
        let own = self.bin(&passed.interval, depth);
        let in_front = passed.bins.partition_point(|(bin, _)| *bin < own);
        in_front.checked_sub(1).map_or(1.0, |last| passed.bins[last].1)
    }

    /// Sends the pixel's fragments through the gate, in submission order.
    fn admit(&self, pixel: &Pixel<'_>, passed: &mut Passed) {
        passed.interval = self.range.interval(pixel.list);
        passed.fragments.clear();
        passed.lost.clear();
        passed.bins.clear();
        let mut nearest = std::mem::take(&mut passed.nearest);
        nearest.clear();
        for (source, fragment) in (0..).zip(pixel.list.iter()) {
            let bin = self.bin(&passed.interval, fragment.depth);
            let occlusion = || 1.0 - passed.in_front_of(bin);
            match self.gate.pass(pixel, fragment, occlusion, &mut nearest) {
                Some(fragment) => {
                    passed.attenuate(bin, 1.0 - f64::from(fragment.alpha));
                    passed.fragments.push(fragment);
                }
                None => passed.lost.push(source),
            }
        }
        passed.fragments.end_row();
        passed.nearest = nearest;
    }
}

/// Bins that blend what passes (`merge="average"`), composited front to back.
pub struct AveragedBins<G> {
    /// Bins and gate.
    pub binning: Binning<G>,
    /// How a bin blends.
    pub blend: LayeredWboit,
    /// What becomes of the others.
    pub finish: Finish,
}

/// One pixel's working memory.
#[derive(Debug, Default)]
pub struct Scratch {
    passed: Passed,
    bins: lwboit::Scratch,
    weights: Vec<f32>,
}

impl<G: Gate> Technique for AveragedBins<G> {
    type Scratch = Scratch;

    fn resolve(&self, pixel: &Pixel<'_>, scratch: &mut Scratch) -> Resolved {
        let Scratch { passed, bins, weights } = scratch;
        self.binning.admit(pixel, passed);
        let core = self.blend.blend_bins(pixel.list, passed.list(), bins);
        self.finish.resolve(pixel, &core, &passed.lost, weights)
    }
    fn transmittance(&self, pixel: &Pixel<'_>, depths: &[f32], scratch: &mut Scratch) -> Option<Vec<f64>> {
        let passed = &mut scratch.passed;
        self.binning.admit(pixel, passed);
        passed.accumulate();
        Some(depths.iter().map(|&depth| self.binning.accumulated(passed, depth)).collect())
    }
    fn cost(&self, _complexity: &DepthComplexity) -> Cost {
        super::COST
    }
    fn properties(&self) -> Properties {
        Properties::NONE
    }
}

/// What blended bins let through, for a second pass.
pub struct AveragedSteps<G>(pub Binning<G>);

impl<G: Gate> Oracle for AveragedSteps<G> {
    type Map = Passed;

    fn build(&self, pixel: &Pixel<'_>, map: &mut Passed) {
        self.0.admit(pixel, map);
        map.accumulate();
    }
    fn in_front_of(&self, map: &Passed, fragment: &Fragment) -> f64 {
        self.at(map, fragment.depth)
    }
    fn at(&self, map: &Passed, depth: f32) -> f64 {
        self.0.accumulated(map, depth)
    }
    fn total(&self, map: &Passed) -> f64 {
        map.bins.last().map_or(1.0, |(_, behind)| *behind)
    }
    fn cost(&self, _complexity: &DepthComplexity) -> Cost {
        super::COST
    }
    fn properties(&self, _composite: Composite) -> Properties {
        Properties::NONE
    }
}

/// Bins that sum the absorbance of what passes (`merge="sum"`): opacity shadow maps.
pub struct SummedBins<G> {
    /// Bins and gate.
    pub binning: Binning<G>,
    /// Largest absorbance of a fragment.
    pub s_max: f64,
}

impl<G: Gate> SummedBins<G> {
    fn maps(&self, range: DepthRange) -> OpacityShadowMaps {
        OpacityShadowMaps {
            bins: self.binning.bins,
            interpolation: Interpolation::Floor,
            range,
            range_covers_scene: false,
            s_max: self.s_max,
        }
    }
}

impl<G: Gate> Oracle for SummedBins<G> {
    type Map = (Passed, Map);

    /// Bins divide the range of all fragments, also of those that do not pass.
    fn build(&self, pixel: &Pixel<'_>, (passed, map): &mut Self::Map) {
        self.binning.admit(pixel, passed);
        let Interval { lo, hi } = passed.interval;
        self.maps(DepthRange::Fixed(lo, hi)).build(&Pixel { list: passed.list(), ..*pixel }, map);
    }
    fn in_front_of(&self, (_, map): &Self::Map, fragment: &Fragment) -> f64 {
        self.maps(self.binning.range).in_front_of(map, fragment)
    }
    fn see(&self, (_, map): &Self::Map, list: List<'_>, seen: &mut [f64]) {
        self.maps(self.binning.range).see(map, list, seen);
    }
    fn at(&self, (_, map): &Self::Map, depth: f32) -> f64 {
        self.maps(self.binning.range).at(map, depth)
    }
    fn total(&self, (_, map): &Self::Map) -> f64 {
        self.maps(self.binning.range).total(map)
    }
    fn cost(&self, _complexity: &DepthComplexity) -> Cost {
        super::COST
    }
    fn properties(&self, _composite: Composite) -> Properties {
        Properties::NONE
    }
}
