//! Wavelet transparency (Aizenshtein, Smal & `McGuire` 2022): absorbance along the ray in the Haar basis.

use crate::continuum::absorbance::{
    S_MAX, SELF_CORRECT, absorbance, absorbances, transmittance, transmittances,
};
use crate::continuum::oracle::{CHUNK, Composite, Oracle, chunks, see_one};
use crate::continuum::range::{DepthRange, Interval, cell};
use crate::continuum::ringing::{RINGS, exp_minus, ringing};
use crate::continuum::stored_oracle::{COEFFICIENTS, StoredOracle, technique};
use crate::continuum::two_pass_form::{Own, two_pass_form};
use crate::diagnosis::{Diagnosis, Faults};
use crate::error::Result;
use crate::format::{Formats, SUMMATION, Target};
use crate::fragments::{Fragment, List};
use crate::gpu::form::blocks::{self, FUNCTIONS, INTERVAL, OUTPUTS, TWO_PASS};
use crate::gpu::form::{Form, Number};
use crate::params::{Kind, ParamSpec, Params, Value, View};
use crate::technique::{AnyTechnique, Axes, Cost, DepthComplexity, Info, Pixel, Properties};
use crate::techniques::ANY_ORDER;
use std::f64::consts::SQRT_2;

/// The most levels that a basis has: the largest rank and 1.
const MAX_LEVELS: usize = 11;

/// The registry entry.
pub static INFO: Info = Info {
    id: "wavelet",
    aliases: &[],
    name: "Wavelet Transparency",
    citation: &["Aizenshtein2022"],
    doc: "Sums the Haar coefficients of the absorbance in front of each depth, rank + 2 of them per fragment and \
          in any order; a second pass interpolates between the leaves and normalises.",
    axes: Axes {
        memory: "k Haar coefs",
        insertion: "always",
        merge: "sum in Haar basis",
        normalize: "α-weighted average",
        opacity: "alpha",
    },
    params: &[
        ParamSpec::new(
            "rank",
            Kind::Int { min: 0, max: 10 },
            Value::Int(3),
            "levels of the basis below the coarsest; 2^(rank + 1) coefficients",
        ),
        DepthRange::param("pixel"),
        SELF_CORRECT,
        S_MAX,
        Composite::param("normalize"),
        SUMMATION,
    ],
    targets: &[COEFFICIENTS, Target::ACCUMULATION, Target::REVEALAGE],
    submission_orders: ANY_ORDER,
    random: false,
    geometry_passes: "2, 1 more for range=\"pixel\"",
    bytes_per_pixel: "coefficients, 4 sums and R: 4 * 2^(rank + 1) + 20 in f32, 2 * 2^(rank + 1) + 10 in f16, 8 more for \
                      range=\"pixel\"",
    build,
    gpu: Some(gpu),
};

fn build(params: &Params, view: &View) -> Result<Box<dyn AnyTechnique>> {
    Ok(technique(Wavelet::from_params(params, view), INFO.targets, params))
}

/// Its form on a GPU.
fn gpu(params: &Params, view: &View) -> Result<Form> {
    let levels = params.size("rank") + 1;
    two_pass_form(
        params,
        view,
        &Own {
            shader: include_str!("../../shaders/wavelet.wgsl"),
            blocks: &[FUNCTIONS, INTERVAL, OUTPUTS, TWO_PASS, blocks::COEFFICIENTS],
            targets: INFO.targets,
            map: (COEFFICIENTS.name, "rank"),
            count: 1 << levels,
            numbers: &[Number::size(levels), Number::Whole(params.bool("self_correct").into())],
            ..Own::BARE
        },
    )
}

/// Haar coefficients of a depth range.
struct Wavelet {
    /// Levels.
    levels: usize,
    range: DepthRange,
    range_covers_scene: bool,
    self_correct: bool,
    s_max: f64,
}

/// One pixel's coefficients, in f64: leaves are small differences of them.
#[derive(Debug, Default)]
struct Map {
    interval: Interval,
    /// The scale at 0, node k of level p at 2^p + k.
    coefficients: Vec<f64>,
    /// What they say of each leaf.
    leaves: Vec<f64>,
}

impl Map {
    /// `V_j`: the mean of the absorbance over leaf j.
    fn leaf(&self, leaf: usize) -> f64 {
        self.leaves[leaf]
    }

    /// All leaves, level by level: a node is so much less than its parent on the left, so much more on the right.
    fn synthesize(&mut self) {
        let Self { coefficients, leaves, .. } = self;
        leaves.clear();
        leaves.resize(coefficients.len(), coefficients[0]);
        for (level, height) in HEIGHTS.iter().enumerate().take(coefficients.len().ilog2() as usize) {
            // from the right, so that no parent is overwritten before it is read
            for k in (0..1 << level).rev() {
                let (parent, half) = (leaves[k], height * coefficients[(1 << level) + k]);
                (leaves[2 * k], leaves[2 * k + 1]) = (parent - half, parent + half);
            }
        }
    }
}

/// 2^(p/2) for the nodes of level p.
const HEIGHTS: [f64; MAX_LEVELS] = {
    let mut heights = [SQRT_2; MAX_LEVELS];
    heights[0] = 1.0;
    let mut level = 2;
    while level < MAX_LEVELS {
        heights[level] = 2.0 * heights[level - 2];
        level += 1;
    }
    heights
};

impl Wavelet {
    fn from_params(params: &Params, view: &View) -> Self {
        let range = DepthRange::from_params(params, view);
        Self {
            levels: params.size("rank") + 1,
            range,
            range_covers_scene: range.covers(view),
            self_correct: params.bool("self_correct"),
            s_max: params.float("s_max"),
        }
    }

    /// N, the number of coefficients and of leaves.
    fn leaves(&self) -> usize {
        1 << self.levels
    }

    /// y = d (N − 1): the leaf, and how far inside; d = 1 lies at the near edge of the last.
    #[expect(clippy::cast_precision_loss, reason = "at most 2^11 leaves")]
    fn place(&self, position: f64) -> (usize, f64) {
        let last = (self.leaves() - 1) as f64;
        cell(position * last / (last + 1.0), self.leaves())
    }

    /// Adds a step of height `s` at this place, by `sum` of what is there and of what is added: to the scale and to the
    /// node of each level above the leaf.
    #[expect(clippy::cast_precision_loss, reason = "at most 2^11 leaves")]
    fn write(
        &self,
        coefficients: &mut [f64],
        (leaf, fraction): (usize, f64),
        s: f64,
        sum: impl Fn(f64, f64) -> f64,
    ) {
        let leaves = self.leaves();
        let x = (leaf as f64 + fraction) / leaves as f64;
        coefficients[0] = sum(coefficients[0], s * (1.0 - x));
        let (mut node, mut width) = ((leaves + leaf) >> 1, 2.0 / leaves as f64);
        for height in HEIGHTS[..self.levels].iter().rev() {
            let inside = x - (node as f64 * width - 1.0);
            coefficients[node] = sum(coefficients[node], s * height * inside.min(width - inside));
            (node, width) = (node / 2, 2.0 * width);
        }
    }

    /// A: the leaf in front and this one, interpolated.
    fn tau(map: &Map, (leaf, fraction): (usize, f64)) -> f64 {
        let before = if leaf == 0 { 0.0 } else { map.leaf(leaf - 1) };
        (1.0 - fraction) * before + fraction * map.leaf(leaf)
    }

    /// τ in front of each fragment, of the others alone if that is asked for; rings, also below zero.
    fn taus(&self, map: &Map, list: List<'_>, seen: &mut [f64]) {
        let mut own = [0.0; CHUNK];
        map.interval.positions(list.depth, seen);
        if self.self_correct {
            absorbances(list.alpha, self.s_max, &mut own);
        }
        for (seen, own) in seen.iter_mut().zip(own) {
            let place = self.place(*seen);
            // a step's own leaf is (1 − f) of it, of which the interpolation takes f
            *seen = Self::tau(map, place) - own * place.1 * (1.0 - place.1);
        }
    }
}

impl Oracle for Wavelet {
    type Map = Map;

    fn build(&self, pixel: &Pixel<'_>, map: &mut Map) {
        map.interval = self.range.interval(pixel.list);
        map.coefficients.clear();
        map.coefficients.resize(self.leaves(), 0.0);
        let (mut positions, mut s) = ([0.0; CHUNK], [0.0; CHUNK]);
        for part in chunks(pixel.list) {
            map.interval.positions(part.depth, &mut positions);
            absorbances(part.alpha, self.s_max, &mut s);
            for (&position, &s) in positions.iter().zip(&s).take(part.len()) {
                self.write(&mut map.coefficients, self.place(position), s, |sum, x| sum + x);
            }
        }
        map.synthesize();
    }

    fn in_front_of(&self, map: &Map, fragment: &Fragment) -> f64 {
        see_one(self, map, fragment)
    }

    fn see(&self, map: &Map, list: List<'_>, seen: &mut [f64]) {
        self.taus(map, list, seen);
        transmittances(seen);
    }

    fn at(&self, map: &Map, depth: f32) -> f64 {
        transmittance(Self::tau(map, self.place(map.interval.position(depth))))
    }

    fn total(&self, map: &Map) -> f64 {
        transmittance(map.leaf(self.leaves() - 1))
    }

    fn faults(&self) -> Faults {
        RINGS
    }

    fn diagnose(&self, map: &Map, list: List<'_>) -> Diagnosis {
        ringing(list, |part, seen| exp_minus(seen, |taus| self.taus(map, part, taus)), |z| self.at(map, z))
    }

    #[expect(clippy::cast_precision_loss, reason = "a cost estimate")]
    fn cost(&self, _complexity: &DepthComplexity) -> Cost {
        let range = f64::from(u8::from(self.range == DepthRange::Pixel));
        Cost {
            geometry_passes: 2.0 + range,
            bytes_per_pixel: 4.0 * self.leaves() as f64 + 8.0 * range + 20.0,
        }
    }

    fn properties(&self, composite: Composite) -> Properties {
        Properties {
            consistent: self.self_correct && self.range_covers_scene,
            ..composite.promises(self.self_correct || self.range == DepthRange::Pixel)
        }
    }
}

impl StoredOracle for Wavelet {
    fn build_stored(&self, pixel: &Pixel<'_>, formats: &Formats, map: &mut Map) {
        let format = formats.of(COEFFICIENTS.name);
        map.interval = self.range.interval(pixel.list);
        map.coefficients.clear();
        map.coefficients.resize(self.leaves(), 0.0);
        for f in pixel.list.iter() {
            let (place, s) = (self.place(map.interval.position(f.depth)), absorbance(f.alpha, self.s_max));
            self.write(&mut map.coefficients, place, s, |sum, x| format.accumulate(sum, x));
        }
        map.coefficients.iter_mut().for_each(|c| *c = format.read(*c));
        map.synthesize();
    }

    #[expect(clippy::cast_precision_loss, reason = "at most 2^11 leaves")]
    fn texels(&self, _complexity: &DepthComplexity) -> Vec<(&'static str, f64)> {
        vec![(COEFFICIENTS.name, self.leaves() as f64)]
    }
}

#[cfg(test)]
mod tests {
    use super::{Map, Wavelet};
    use crate::continuum::absorbance::absorbance;
    use crate::continuum::oracle::Oracle;
    use crate::continuum::range::DepthRange;
    use crate::fragments::Fragment;
    use crate::techniques::testing::{as_pixel, fragment, layered_pixels, mean_error, random_pixel};
    use std::f64::consts::LN_2;

    fn oracle(rank: usize, self_correct: bool) -> Wavelet {
        let range = DepthRange::Fixed(1.0, 9.0);
        Wavelet { levels: rank + 1, range, range_covers_scene: true, self_correct, s_max: 10.0 }
    }

    fn map(rank: usize, fragments: &[Fragment]) -> Map {
        let mut map = Map::default();
        as_pixel(fragments, |pixel| oracle(rank, true).build(pixel, &mut map));
        map
    }

    /// Mean over leaf j of N of the absorbance step function, position d lying at d (N − 1)/N.
    fn box_average(fragments: &[Fragment], leaf: u8, leaves: u8) -> f64 {
        let behind = |f: &Fragment| {
            let y = (f64::from(f.depth) - 1.0) / 8.0 * f64::from(leaves - 1);
            absorbance(f.alpha, 10.0) * (f64::from(leaf) + 1.0 - y).clamp(0.0, 1.0)
        };
        fragments.iter().map(behind).sum()
    }

    #[test]
    fn two_leaves_by_hand() {
        // depth 3 of 1..9 lies a quarter into the first of two leaves: three quarters of it are behind
        let layer = fragment(3.0, [1.0; 3], 0.5, 0);
        let map = map(0, &[layer]);
        assert!((map.leaf(0) / LN_2 - 0.75).abs() < 1e-14 && (map.leaf(1) / LN_2 - 1.0).abs() < 1e-14);
        let at = |z| -oracle(0, true).at(&map, z).log2();
        for (depth, expected) in [(1.0, 0.0), (3.0, 0.187_5), (5.0, 0.375), (9.0, 0.75)] {
            assert!((at(depth) - expected).abs() < 1e-14, "{depth}: {}", at(depth));
        }
        assert!((oracle(0, true).in_front_of(&map, &layer) - 1.0).abs() < 1e-14);
        assert!((oracle(0, true).total(&map) - 0.5).abs() < 1e-14);
    }

    #[test]
    fn leaves_are_means_of_the_step_function() {
        for n in 1..=40 {
            let pixel = random_pixel(n, u64::from(n) + 11);
            for rank in [0, 1, 3, 6] {
                let (map, leaves) = (map(rank, &pixel), 2_u8 << rank);
                for leaf in 0..leaves {
                    let mean = box_average(&pixel, leaf, leaves);
                    assert!((map.leaf(leaf.into()) - mean).abs() < 1e-11, "rank {rank}, leaf {leaf}");
                }
            }
        }
    }

    #[test]
    fn nothing_is_in_front_of_the_near_end_and_all_is_in_the_last_leaf() {
        for n in 1..=40 {
            let pixel = random_pixel(n, u64::from(n) + 12);
            let sum: f64 = pixel.iter().map(|f| absorbance(f.alpha, 10.0)).sum();
            let map = map(5, &pixel);
            assert_eq!(Wavelet::tau(&map, oracle(5, true).place(map.interval.position(1.0))), 0.0);
            assert!((map.leaf(63) - sum).abs() < 1e-11);
        }
    }

    /// Sheet 2.5, on other random pixels: 0.056 at rank 3 and 0.042 at rank 6; 0.035 and 0.0035 with
    /// self-correction.
    #[test]
    fn the_error_falls_with_the_rank_unless_fragments_hide_themselves() {
        let pixels = layered_pixels(1000, 6);
        let error = |rank, self_correct| mean_error(&oracle(rank, self_correct), &pixels);
        let sheet = [(3, false, 0.056), (3, true, 0.035), (6, false, 0.042), (6, true, 0.003_5)];
        for (rank, self_correct, expected) in sheet {
            let got = error(rank, self_correct);
            assert!(got < 1.4 * expected && expected < 1.4 * got, "{got} for {expected}");
        }
        assert!(error(10, true) < 5e-4 && error(10, false) > 0.03);
    }
}
