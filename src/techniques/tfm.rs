//! Transmittance function maps (Delalandre et al. 2011) and extinction transmittance maps (Gautron et al. 2011):
//! a cosine series of transmittance, or of extinction, which adds up in any order.

mod form;

use self::form::gpu;
use crate::continuum::absorbance::{
    S_MAX, SELF_CORRECT, absorbance, absorbances, transmittance, transmittances,
};
use crate::continuum::oracle::{CHUNK, Composite, Oracle, chunks, see_one};
use crate::continuum::range::{DepthRange, Interval};
use crate::continuum::ringing::{RINGS, exp_minus, ringing};
use crate::continuum::series::{LANES, Lanes, Rotor, blocks, half_turns, harmonics, project, sum};
use crate::continuum::stored_oracle::{COEFFICIENTS, StoredOracle, technique};
use crate::diagnosis::{Diagnosis, Faults};
use crate::error::Result;
use crate::format::{Format, Formats, SUMMATION, Target};
use crate::fragments::{Fragment, List};
use crate::params::{Kind, ParamSpec, Params, Value, View};
use crate::technique::{AnyTechnique, Axes, Cost, DepthComplexity, Info, Pixel, Properties};
use crate::techniques::ANY_ORDER;
use multiversion::multiversion;
use std::f64::consts::PI;

/// The registry entry.
pub static INFO: Info = Info {
    id: "tfm",
    aliases: &[],
    name: "Transmittance Function Maps",
    citation: &["Delalandre2011", "Gautron2011"],
    doc: "Projects a pixel's extinction, fragment by fragment in any order, or its sorted transmittance curve to a \
          cosine series; a second pass sees each fragment through it.",
    axes: Axes {
        memory: "k DCT coefs",
        insertion: "always",
        merge: "sum in DCT basis",
        normalize: "no",
        opacity: "alpha",
    },
    params: &[
        ParamSpec::new("frequencies", Kind::at_least(1), Value::Int(8), "frequencies of the series"),
        ParamSpec::new(
            "project",
            Kind::Choice(&["extinction", "transmittance"]),
            Value::Text("extinction"),
            "what the series is of: extinction, which is additive, or transmittance, which needs sorted fragments \
             and tends to the middle of each step",
        ),
        DepthRange::param("pixel"),
        SELF_CORRECT.when(is_extinction),
        S_MAX.when(is_extinction),
        Composite::param("none"),
        SUMMATION,
    ],
    targets: &[COEFFICIENTS, Target::ACCUMULATION, Target::REVEALAGE],
    submission_orders: ANY_ORDER,
    random: false,
    geometry_passes: "2",
    bytes_per_pixel: "coefficients, 4 sums and R: 4 (frequencies + 1) + 20 in f32, 2 (frequencies + 1) + 10 in f16",
    build,
    gpu: Some(gpu),
};

fn is_extinction(params: &Params) -> bool {
    params.text("project") == "extinction"
}

fn build(params: &Params, view: &View) -> Result<Box<dyn AnyTechnique>> {
    Ok(if is_extinction(params) {
        technique(Extinction::from_params(params, view), INFO.targets, params)
    } else {
        technique(Curve::from_params(params, view), INFO.targets, params)
    })
}

/// The cosine coefficients of a pixel, in f64: they cancel where it is dark.
#[derive(Debug, Default)]
struct Map {
    interval: Interval,
    /// `c_0`.
    mean: f64,
    /// `c_k / 2` for k = 1..=K.
    cosines: Vec<f64>,
    /// The sums under construction, lane by lane.
    sums: Vec<(Lanes, Lanes)>,
}

impl Map {
    fn clear(&mut self, interval: Interval, mean: f64, frequencies: usize) {
        (self.interval, self.mean) = (interval, mean);
        self.sums.clear();
        self.sums.resize(frequencies, ([0.0; LANES], [0.0; LANES]));
    }

    /// Half a turn from end to end: the even extension of the range has a period of twice its length.
    fn phases(&self, depth: &[f32], phases: &mut [f64]) {
        self.interval.positions(depth, phases);
        phases.iter_mut().for_each(|phase| *phase *= 0.5);
    }

    /// Adds `s cos(πk d)` and `s sin(πk d)` of each fragment to the sums; lanes without one have s = 0.
    fn add(&mut self, depth: &[f32], s: &[f64; CHUNK]) {
        let mut phases = [0.0; CHUNK];
        self.phases(depth, &mut phases);
        project(blocks(&phases[..depth.len().next_multiple_of(LANES)]), blocks(s), &mut self.sums);
    }

    /// Replaces every coefficient.
    fn each(&mut self, replace: impl Fn(f64) -> f64) {
        self.mean = replace(self.mean);
        self.cosines.iter_mut().for_each(|c| *c = replace(*c));
    }

    /// `c_0 + Σ c_k cos(πk d)`.
    fn value(&self, d: f64) -> f64 {
        let terms = self.cosines.iter().zip(harmonics(PI * d));
        self.mean + 2.0 * terms.map(|(c, (cos, _))| c * cos).sum::<f64>()
    }

    /// Its integral up to d.
    fn integral(&self, d: f64) -> f64 {
        let terms = self.cosines.iter().zip(harmonics(PI * d)).zip(half_turns());
        self.mean * d + 2.0 * terms.map(|((c, (_, sin)), pi_k)| c * sin / pi_k).sum::<f64>()
    }
}

/// τ at each phase, freed of a fragment's own share: of `s` what the series of a step has in front of it, whose
/// terms are `sin(2πk d)/(πk)`.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"))]
fn taus_of_others(mean: f64, cosines: &[f64], phases: &[Lanes], s: &[Lanes], taus: &mut [Lanes]) {
    for ((phases, s), taus) in phases.iter().zip(s).zip(taus) {
        let mut rotor = Rotor::new(phases);
        let (mut ripple, mut own) = ([0.0; LANES], [0.0; LANES]);
        for (&c, pi_k) in cosines.iter().zip(half_turns()) {
            let weight = 2.0 / pi_k;
            let integral = weight * c;
            for lane in 0..LANES {
                ripple[lane] += integral * rotor.sin[lane];
                own[lane] += weight * rotor.sin[lane] * rotor.cos[lane];
            }
            rotor.turn();
        }
        for lane in 0..LANES {
            let d = 2.0 * phases[lane];
            taus[lane] = (mean * d + ripple[lane]) - s[lane] * (d + own[lane]);
        }
    }
}

/// The series at each phase, within [0, 1].
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"))]
fn series_values(mean: f64, cosines: &[f64], phases: &[Lanes], values: &mut [Lanes]) {
    for (phases, values) in phases.iter().zip(values) {
        let mut rotor = Rotor::new(phases);
        let mut terms = [0.0; LANES];
        for c in cosines {
            for (term, cos) in terms.iter_mut().zip(&rotor.cos) {
                *term += c * cos;
            }
            rotor.turn();
        }
        for lane in 0..LANES {
            values[lane] = (mean + 2.0 * terms[lane]).clamp(0.0, 1.0);
        }
    }
}

#[expect(clippy::cast_precision_loss, reason = "a cost estimate")]
fn texels(frequencies: usize) -> Vec<(&'static str, f64)> {
    vec![(COEFFICIENTS.name, frequencies as f64 + 1.0)]
}

#[expect(clippy::cast_precision_loss, reason = "a cost estimate")]
fn cost(frequencies: usize) -> Cost {
    Cost { geometry_passes: 2.0, bytes_per_pixel: 4.0 * (frequencies as f64 + 1.0) + 20.0 }
}

/// A cosine series of extinction.
struct Extinction {
    frequencies: usize,
    range: DepthRange,
    range_covers_scene: bool,
    self_correct: bool,
    s_max: f64,
}

impl Extinction {
    fn from_params(params: &Params, view: &View) -> Self {
        let range = DepthRange::from_params(params, view);
        Self {
            frequencies: params.size("frequencies"),
            range,
            range_covers_scene: range.covers(view),
            self_correct: params.bool("self_correct"),
            s_max: params.float("s_max"),
        }
    }

    /// τ in front of each fragment, of the others alone if that is asked for; rings, also below zero.
    fn taus(&self, map: &Map, list: List<'_>, seen: &mut [f64]) {
        let (mut phases, mut s, mut taus) = ([0.0; CHUNK], [0.0; CHUNK], [[0.0; LANES]; CHUNK / LANES]);
        map.phases(list.depth, &mut phases);
        if self.self_correct {
            absorbances(list.alpha, self.s_max, &mut s);
        }
        let used = list.len().next_multiple_of(LANES);
        taus_of_others(map.mean, &map.cosines, blocks(&phases[..used]), blocks(&s), &mut taus);
        seen.copy_from_slice(&taus.as_flattened()[..list.len()]);
    }
}

impl Oracle for Extinction {
    type Map = Map;

    fn build(&self, pixel: &Pixel<'_>, map: &mut Map) {
        map.clear(self.range.interval(pixel.list), 0.0, self.frequencies);
        for part in chunks(pixel.list) {
            let mut s = [0.0; CHUNK];
            absorbances(part.alpha, self.s_max, &mut s);
            map.mean += s.iter().sum::<f64>();
            map.add(part.depth, &s);
        }
        map.cosines.clear();
        map.cosines.extend(map.sums.iter().map(|(cosines, _)| sum(cosines)));
    }

    fn in_front_of(&self, map: &Map, fragment: &Fragment) -> f64 {
        see_one(self, map, fragment)
    }

    fn see(&self, map: &Map, list: List<'_>, seen: &mut [f64]) {
        self.taus(map, list, seen);
        transmittances(seen);
    }

    fn at(&self, map: &Map, depth: f32) -> f64 {
        transmittance(map.integral(map.interval.position(depth)))
    }

    fn total(&self, map: &Map) -> f64 {
        transmittance(map.mean)
    }

    fn faults(&self) -> Faults {
        RINGS
    }

    fn diagnose(&self, map: &Map, list: List<'_>) -> Diagnosis {
        ringing(list, |part, seen| exp_minus(seen, |taus| self.taus(map, part, taus)), |z| self.at(map, z))
    }

    fn cost(&self, _complexity: &DepthComplexity) -> Cost {
        cost(self.frequencies)
    }

    fn properties(&self, composite: Composite) -> Properties {
        Properties {
            consistent: self.self_correct && self.range_covers_scene,
            ..composite.promises(self.self_correct || self.range == DepthRange::Pixel)
        }
    }
}

impl StoredOracle for Extinction {
    fn build_stored(&self, pixel: &Pixel<'_>, formats: &Formats, map: &mut Map) {
        let format = formats.of(COEFFICIENTS.name);
        (map.interval, map.mean) = (self.range.interval(pixel.list), 0.0);
        map.cosines.clear();
        map.cosines.resize(self.frequencies, 0.0);
        for f in pixel.list.iter() {
            let (s, d) = (absorbance(f.alpha, self.s_max), map.interval.position(f.depth));
            map.mean = format.accumulate(map.mean, s);
            for (c, (cos, _)) in map.cosines.iter_mut().zip(harmonics(PI * d)) {
                *c = format.accumulate(*c, s * cos);
            }
        }
        map.each(|c| format.read(c));
    }

    fn texels(&self, _complexity: &DepthComplexity) -> Vec<(&'static str, f64)> {
        texels(self.frequencies)
    }
}

/// A cosine series of transmittance.
struct Curve {
    frequencies: usize,
    range: DepthRange,
}

impl Curve {
    fn from_params(params: &Params, view: &View) -> Self {
        Self { frequencies: params.size("frequencies"), range: DepthRange::from_params(params, view) }
    }
}

impl Oracle for Curve {
    type Map = Map;
    const NEEDS_SORTED: bool = true;

    /// Each fragment takes `T_i a_i` from all that is behind it: `1 − d` of that from `c_0`, and from `c_k` twice
    /// the integral of `cos(πk x)` from d to 1, which is `−2 sin(πk d)/(πk)`.
    fn build(&self, pixel: &Pixel<'_>, map: &mut Map) {
        map.clear(self.range.interval(pixel.list), 1.0, self.frequencies);
        let mut reaches = 1.0;
        for part in chunks(pixel.sorted) {
            let mut taken = [0.0; CHUNK];
            for ((taken, &depth), &alpha) in taken.iter_mut().zip(part.depth).zip(part.alpha) {
                *taken = reaches * f64::from(alpha);
                reaches *= 1.0 - f64::from(alpha);
                map.mean -= *taken * (1.0 - map.interval.position(depth));
            }
            map.add(part.depth, &taken);
        }
        map.cosines.clear();
        map.cosines.extend(map.sums.iter().zip(half_turns()).map(|((_, sines), pi_k)| sum(sines) / pi_k));
    }

    fn in_front_of(&self, map: &Map, fragment: &Fragment) -> f64 {
        see_one(self, map, fragment)
    }

    fn see(&self, map: &Map, list: List<'_>, seen: &mut [f64]) {
        let (mut phases, mut values) = ([0.0; CHUNK], [[0.0; LANES]; CHUNK / LANES]);
        map.phases(list.depth, &mut phases);
        series_values(
            map.mean,
            &map.cosines,
            blocks(&phases[..list.len().next_multiple_of(LANES)]),
            &mut values,
        );
        seen.copy_from_slice(&values.as_flattened()[..list.len()]);
    }

    fn at(&self, map: &Map, depth: f32) -> f64 {
        map.value(map.interval.position(depth)).clamp(0.0, 1.0)
    }

    fn total(&self, map: &Map) -> f64 {
        map.value(1.0).clamp(0.0, 1.0)
    }

    fn faults(&self) -> Faults {
        RINGS
    }

    fn diagnose(&self, map: &Map, list: List<'_>) -> Diagnosis {
        let value = |depth: f32| map.value(map.interval.position(depth));
        let values = |part: List<'_>, seen: &mut [f64]| {
            seen.iter_mut().zip(part.depth).for_each(|(seen, &depth)| *seen = value(depth));
        };
        ringing(list, values, |z| self.at(map, z))
    }

    fn cost(&self, _complexity: &DepthComplexity) -> Cost {
        cost(self.frequencies)
    }

    fn properties(&self, composite: Composite) -> Properties {
        composite.promises(false)
    }
}

impl StoredOracle for Curve {
    /// Who has sorted a pixel's fragments projects them all, and writes each coefficient once.
    fn build_stored(&self, pixel: &Pixel<'_>, formats: &Formats, map: &mut Map) {
        let format: Format = formats.of(COEFFICIENTS.name);
        self.build(pixel, map);
        map.each(|c| format.read(format.round(c)));
    }

    fn texels(&self, _complexity: &DepthComplexity) -> Vec<(&'static str, f64)> {
        texels(self.frequencies)
    }
}

#[cfg(test)]
mod tests {
    use super::{Curve, Extinction, INFO, Map};
    use crate::continuum::absorbance::absorbance;
    use crate::continuum::oracle::Oracle;
    use crate::continuum::range::DepthRange;
    use crate::fragments::Fragment;
    use crate::params::Input;
    use crate::techniques::testing::{
        VIEW, as_pixel, exact_transmittance, fragment, given, layered_pixels, mean_error, random_pixel,
    };
    use std::f64::consts::PI;

    const RANGE: DepthRange = DepthRange::Fixed(1.0, 9.0);

    fn extinction(frequencies: usize, self_correct: bool) -> Extinction {
        Extinction { frequencies, range: RANGE, range_covers_scene: true, self_correct, s_max: 10.0 }
    }

    fn map<O: Oracle<Map = Map>>(oracle: &O, fragments: &[Fragment]) -> Map {
        let mut map = Map::default();
        as_pixel(fragments, |pixel| oracle.build(pixel, &mut map));
        map
    }

    #[test]
    fn two_layers_and_one_frequency_by_hand() {
        // depths 3 and 7 of 1..9 are 1/4 and 3/4; their cosines cancel, so that extinction is even
        let layers = [fragment(3.0, [1.0; 3], 0.5, 0), fragment(7.0, [1.0; 3], 0.5, 1)];
        let even = map(&extinction(1, true), &layers);
        for (depth, share) in [(1.0, 0.0), (3.0, 0.25), (5.0, 0.5), (9.0, 1.0)] {
            assert!((extinction(1, true).at(&even, depth) - 0.25_f64.powf(share)).abs() < 1e-14);
        }
        // transmittance 1, 1/2, 1/4: mean 1/4 + 1/4 + 1/16, cosine 2 (1/2 + 1/4) sin(π/4)/π
        let curve = Curve { frequencies: 1, range: RANGE };
        let steps = map(&curve, &layers);
        let cosine = 1.5 * (PI / 4.0).sin() / PI;
        for (depth, cos) in [(1.0, 1.0), (5.0, 0.0), (9.0, -1.0)] {
            assert!((curve.at(&steps, depth) - (0.562_5 + cosine * cos)).abs() < 1e-14);
        }
        assert_eq!(curve.total(&steps), curve.at(&steps, 9.0));
    }

    #[test]
    fn extinction_adds_up_from_nothing_to_all() {
        for n in 1..=40 {
            let pixel = random_pixel(n, u64::from(n) + 30);
            let sum: f64 = pixel.iter().map(|f| absorbance(f.alpha, 10.0)).sum();
            for frequencies in [1, 8, 50] {
                let map = map(&extinction(frequencies, true), &pixel);
                assert!(map.integral(0.0) == 0.0 && (map.integral(1.0) - sum).abs() < 1e-10);
            }
        }
    }

    #[test]
    fn a_lone_fragments_series_is_the_closed_form() {
        let lone = fragment(4.2, [1.0; 3], 0.7, 0);
        for frequencies in [1, 2, 8, 33] {
            let oracle = extinction(frequencies, true);
            assert!((oracle.in_front_of(&map(&oracle, &[lone]), &lone) - 1.0).abs() < 1e-14);
        }
    }

    /// Sheet 2.5: 0.043 at 7 frequencies, where the Fourier series has 0.030, but slightly less than it at 15
    /// scalars each.
    #[test]
    fn extinction_tends_to_over_unless_fragments_hide_themselves() {
        let pixels = layered_pixels(150, 6);
        let error = |frequencies, self_correct| mean_error(&extinction(frequencies, self_correct), &pixels);
        let (seven, fourteen) = (error(7, true), error(14, true));
        assert!((seven / 0.043 - 1.0).abs() < 0.15 && fourteen < 0.030, "{seven} {fourteen}");
        assert!(error(1000, true) < 2e-3 && error(1000, false) > 0.05);
    }

    #[test]
    fn transmittance_tends_to_the_middle_of_each_step() {
        let layers = &layered_pixels(1, 6)[0];
        let curve = Curve { frequencies: 20_000, range: RANGE };
        let map = map(&curve, layers);
        for (f, exact) in layers.iter().zip(exact_transmittance(layers)) {
            let middle = exact * (1.0 - 0.5 * f64::from(f.alpha));
            assert!((curve.in_front_of(&map, f) - middle).abs() < 1e-3);
        }
    }

    #[test]
    fn params_of_extinction_do_not_tell_curves_apart() {
        let identity = |inputs: &[(&str, Input)]| given(&INFO, inputs).identity();
        let curve = ("project", Input::Text("transmittance".into()));
        let charged = ("self_correct", Input::Bool(false));
        assert_eq!(identity(&[curve.clone(), charged.clone()]), identity(&[curve]));
        assert_ne!(identity(&[charged]), identity(&[]));
        assert_eq!(DepthRange::from_params(&given(&INFO, &[]), &VIEW), DepthRange::Pixel);
    }
}
