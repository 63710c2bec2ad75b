//! Fourier opacity maps (Jansen & Bavoil 2010): absorbance along the ray as a Fourier series.

use crate::continuum::absorbance::{
    S_MAX, SELF_CORRECT, absorbance, absorbances, transmittance, transmittances,
};
use crate::continuum::oracle::{CHUNK, Composite, Oracle, chunks, see_one};
use crate::continuum::range::{DepthRange, Interval};
use crate::continuum::ringing::{RINGS, exp_minus, ringing};
use crate::continuum::series::{LANES, Lanes, Rotor, blocks, half_turns, harmonics, project, sum};
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
use multiversion::multiversion;
use std::f64::consts::PI;

/// The registry entry.
pub static INFO: Info = Info {
    id: "fourier_opacity_maps",
    aliases: &[],
    name: "Fourier Opacity Maps",
    citation: &["Jansen2010"],
    doc: "Sums the Fourier coefficients of absorption along the ray, which add up in any order; a second pass \
          sees each fragment through the integral of the series in front of it.",
    axes: Axes {
        memory: "k Fourier coefs",
        insertion: "always",
        merge: "sum in Fourier domain",
        normalize: "no",
        opacity: "alpha",
    },
    params: &[
        ParamSpec::new("frequencies", Kind::at_least(1), Value::Int(7), "frequencies of the series"),
        ParamSpec::new(
            "lanczos",
            Kind::Bool,
            Value::Bool(false),
            "damp high frequencies against ringing (Lanczos sigma factors)",
        ),
        ParamSpec::new(
            "margin",
            Kind::float(0.0, 0.25),
            Value::Float(0.05),
            "part of the period left free at either end: without it the nearest and the farthest depth are one",
        ),
        DepthRange::param("pixel"),
        SELF_CORRECT,
        S_MAX,
        Composite::param("none"),
        SUMMATION,
    ],
    targets: &[COEFFICIENTS, Target::ACCUMULATION, Target::REVEALAGE],
    submission_orders: ANY_ORDER,
    random: false,
    geometry_passes: "2",
    bytes_per_pixel: "coefficients, 4 sums and R: 4 (2 frequencies + 1) + 20 in f32, 2 (2 frequencies + 1) + 10 in f16",
    build,
    gpu: Some(gpu),
};

fn build(params: &Params, view: &View) -> Result<Box<dyn AnyTechnique>> {
    Ok(technique(FourierOpacityMaps::from_params(params, view), INFO.targets, params))
}

/// Its form on a GPU.
fn gpu(params: &Params, view: &View) -> Result<Form> {
    let (frequencies, margin) = (params.size("frequencies"), params.float("margin"));
    let flags = [params.bool("self_correct"), params.bool("lanczos"), false];
    let margins = [margin, 1.0 - 2.0 * margin].map(Number::in_two);
    let numbers =
        [margins.as_flattened(), &[Number::size(frequencies)], &flags.map(|flag| Number::Whole(flag.into()))];
    two_pass_form(
        params,
        view,
        &Own {
            shader: include_str!("../../shaders/fourier_opacity_maps.wgsl"),
            blocks: &[FUNCTIONS, INTERVAL, OUTPUTS, TWO_PASS, blocks::COEFFICIENTS],
            targets: INFO.targets,
            map: (COEFFICIENTS.name, "frequencies"),
            count: frequencies.saturating_mul(2).saturating_add(1),
            numbers: &numbers.concat(),
            ..Own::BARE
        },
    )
}

/// A Fourier series of absorption over a depth range.
struct FourierOpacityMaps {
    frequencies: usize,
    lanczos: bool,
    margin: f64,
    range: DepthRange,
    range_covers_scene: bool,
    self_correct: bool,
    s_max: f64,
}

/// One pixel's series. Coefficients are kept in f64: behind opaque fragments small differences of large ones
/// are what is seen.
#[derive(Debug, Default)]
struct Map {
    interval: Interval,
    /// Σ s.
    total: f64,
    /// Σ s cos(2πk d) and Σ s sin(2πk d), half the paper's `a_k` and `b_k`.
    harmonics: Vec<Harmonic>,
    /// The sums under construction, lane by lane.
    sums: Vec<(Lanes, Lanes)>,
}

/// A term of the series.
#[derive(Debug, Clone, Copy)]
struct Harmonic {
    a: f64,
    b: f64,
    /// `σ_k/(πk)`, what integration makes of it.
    weight: f64,
}

impl FourierOpacityMaps {
    fn from_params(params: &Params, view: &View) -> Self {
        let range = DepthRange::from_params(params, view);
        Self {
            frequencies: params.size("frequencies"),
            lanczos: params.bool("lanczos"),
            margin: params.float("margin"),
            range,
            range_covers_scene: range.covers(view),
            self_correct: params.bool("self_correct"),
            s_max: params.float("s_max"),
        }
    }

    /// Where in the period a position lies.
    fn phase(&self, position: f64) -> f64 {
        self.margin + (1.0 - 2.0 * self.margin) * position
    }

    /// The phase of each depth.
    fn phases(&self, map: &Map, depth: &[f32], phases: &mut [f64]) {
        map.interval.positions(depth, phases);
        phases.iter_mut().for_each(|phase| *phase = self.phase(*phase));
    }

    /// τ in front of each fragment, of the others alone if that is asked for; rings, also below zero.
    fn taus(&self, map: &Map, list: List<'_>, seen: &mut [f64]) {
        let (mut phases, mut s, mut taus) = ([0.0; CHUNK], [0.0; CHUNK], [[0.0; LANES]; CHUNK / LANES]);
        self.phases(map, list.depth, &mut phases);
        if self.self_correct {
            absorbances(list.alpha, self.s_max, &mut s);
        }
        let used = list.len().next_multiple_of(LANES);
        taus_of_others(map.total, &map.harmonics, blocks(&phases[..used]), blocks(&s), &mut taus);
        seen.copy_from_slice(&taus.as_flattened()[..list.len()]);
    }

    /// `σ_k` for k = 1..=K.
    #[expect(clippy::cast_precision_loss, reason = "frequencies are held in memory")]
    fn sigma(&self) -> impl Iterator<Item = f64> {
        let period = self.frequencies as f64 + 1.0;
        let sinc = move |pi_k: f64| (pi_k / period).sin() / (pi_k / period);
        let lanczos = self.lanczos;
        half_turns().take(self.frequencies).map(move |pi_k| if lanczos { sinc(pi_k) } else { 1.0 })
    }
}

impl FourierOpacityMaps {
    /// `σ_k/(πk)` for k = 1..=K.
    fn weights(&self) -> impl Iterator<Item = f64> {
        self.sigma().zip(half_turns()).map(|(sigma, pi_k)| sigma / pi_k)
    }
}

impl Map {
    /// τ(d): the series integrated up to d; rings, also below zero.
    fn tau(&self, d: f64) -> f64 {
        let terms = self.harmonics.iter().zip(harmonics(2.0 * PI * d));
        let ripple = terms.map(|(h, (cos, sin))| h.weight * (h.a * sin + h.b * (1.0 - cos)));
        self.total * d + ripple.sum::<f64>()
    }
}

/// τ at each phase, freed of a fragment's own share: of `s` what the series of a step has in front of it.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"))]
fn taus_of_others(total: f64, harmonics: &[Harmonic], phases: &[Lanes], s: &[Lanes], taus: &mut [Lanes]) {
    for ((phases, s), taus) in phases.iter().zip(s).zip(taus) {
        let mut rotor = Rotor::new(phases);
        let (mut ripple, mut own) = ([0.0; LANES], *phases);
        for h in harmonics {
            for lane in 0..LANES {
                let (cos, sin) = (rotor.cos[lane], rotor.sin[lane]);
                ripple[lane] += h.weight * (h.a * sin + h.b * (1.0 - cos));
                own[lane] += h.weight * sin;
            }
            rotor.turn();
        }
        for lane in 0..LANES {
            taus[lane] = (total * phases[lane] + ripple[lane]) - s[lane] * own[lane];
        }
    }
}

impl Oracle for FourierOpacityMaps {
    type Map = Map;

    fn build(&self, pixel: &Pixel<'_>, map: &mut Map) {
        map.interval = self.range.interval(pixel.list);
        map.total = 0.0;
        map.sums.clear();
        map.sums.resize(self.frequencies, ([0.0; LANES], [0.0; LANES]));
        for part in chunks(pixel.list) {
            let (mut phases, mut s) = ([0.0; CHUNK], [0.0; CHUNK]);
            self.phases(map, part.depth, &mut phases);
            absorbances(part.alpha, self.s_max, &mut s);
            map.total += s.iter().sum::<f64>();
            let used = part.len().next_multiple_of(LANES);
            project(blocks(&phases[..used]), blocks(&s[..used]), &mut map.sums);
        }
        let terms = map.sums.iter().zip(self.weights());
        map.harmonics.clear();
        map.harmonics.extend(terms.map(|((a, b), weight)| Harmonic { a: sum(a), b: sum(b), weight }));
    }

    fn in_front_of(&self, map: &Map, fragment: &Fragment) -> f64 {
        see_one(self, map, fragment)
    }

    fn see(&self, map: &Map, list: List<'_>, seen: &mut [f64]) {
        self.taus(map, list, seen);
        transmittances(seen);
    }

    fn at(&self, map: &Map, depth: f32) -> f64 {
        transmittance(map.tau(self.phase(map.interval.position(depth))))
    }

    fn total(&self, map: &Map) -> f64 {
        transmittance(map.total)
    }

    fn faults(&self) -> Faults {
        RINGS
    }

    fn diagnose(&self, map: &Map, list: List<'_>) -> Diagnosis {
        ringing(list, |part, seen| exp_minus(seen, |taus| self.taus(map, part, taus)), |z| self.at(map, z))
    }

    #[expect(clippy::cast_precision_loss, reason = "a cost estimate")]
    fn cost(&self, _complexity: &DepthComplexity) -> Cost {
        Cost { geometry_passes: 2.0, bytes_per_pixel: 8.0 * self.frequencies as f64 + 24.0 }
    }

    fn properties(&self, composite: Composite) -> Properties {
        Properties {
            consistent: self.self_correct && self.margin > 0.0 && self.range_covers_scene,
            ..composite.promises(self.self_correct)
        }
    }
}

impl StoredOracle for FourierOpacityMaps {
    fn build_stored(&self, pixel: &Pixel<'_>, formats: &Formats, map: &mut Map) {
        let format = formats.of(COEFFICIENTS.name);
        map.interval = self.range.interval(pixel.list);
        map.total = 0.0;
        map.harmonics.clear();
        map.harmonics.extend(self.weights().map(|weight| Harmonic { a: 0.0, b: 0.0, weight }));
        for f in pixel.list.iter() {
            let (s, turns) = (absorbance(f.alpha, self.s_max), self.phase(map.interval.position(f.depth)));
            map.total = format.accumulate(map.total, s);
            for (h, (cos, sin)) in map.harmonics.iter_mut().zip(harmonics(2.0 * PI * turns)) {
                h.a = format.accumulate(h.a, s * cos);
                h.b = format.accumulate(h.b, s * sin);
            }
        }
        map.total = format.read(map.total);
        map.harmonics.iter_mut().for_each(|h| (h.a, h.b) = (format.read(h.a), format.read(h.b)));
    }

    #[expect(clippy::cast_precision_loss, reason = "a cost estimate")]
    fn texels(&self, _complexity: &DepthComplexity) -> Vec<(&'static str, f64)> {
        vec![(COEFFICIENTS.name, 2.0 * self.frequencies as f64 + 1.0)]
    }
}

#[cfg(test)]
mod tests {
    use super::{FourierOpacityMaps, INFO, Map};
    use crate::continuum::absorbance::absorbance;
    use crate::continuum::oracle::Oracle;
    use crate::fragments::Fragment;
    use crate::params::Input;
    use crate::techniques::testing::{
        VIEW, as_pixel, exact_transmittance, fragment, given, layered_pixels, mean_error, random_pixel,
    };
    use std::f64::consts::{LN_2, PI};

    fn oracle(frequencies: i64, more: &[(&'static str, Input)]) -> FourierOpacityMaps {
        let mut inputs =
            vec![("frequencies", Input::Int(frequencies)), ("range", Input::Text("scene".into()))];
        inputs.extend_from_slice(more);
        FourierOpacityMaps::from_params(&given(&INFO, &inputs), &VIEW)
    }

    fn map(oracle: &FourierOpacityMaps, fragments: &[Fragment]) -> Map {
        let mut map = Map::default();
        as_pixel(fragments, |pixel| oracle.build(pixel, &mut map));
        map
    }

    const CHARGED: (&str, Input) = ("self_correct", Input::Bool(false));

    #[test]
    fn two_layers_and_one_frequency_by_hand() {
        // depths 3 and 7 of 1..9 are a quarter and three quarters of the period
        let layers = [fragment(3.0, [1.0; 3], 0.5, 0), fragment(7.0, [1.0; 3], 0.5, 1)];
        let oracle = oracle(1, &[("margin", Input::Float(0.0))]);
        let map = map(&oracle, &layers);
        // both cosines are 0, the sines 1 and -1: what is left is the ramp, half of it in the middle
        for (depth, share) in [(1.0, 0.0), (2.0, 0.125), (5.0, 0.5), (9.0, 1.0)] {
            assert!((oracle.at(&map, depth) - 0.25_f64.powf(share)).abs() < 1e-14);
        }
        // in front of the second lie three quarters of both, less 3/4 - 1/π that are its own; the first's own
        // 1/4 + 1/π are more than the quarters of both
        let second = 0.5_f64.powf(1.5 - (0.75 - 1.0 / PI));
        assert!((oracle.in_front_of(&map, &layers[1]) - second).abs() < 1e-14);
        assert_eq!(oracle.in_front_of(&map, &layers[0]), 1.0);
    }

    #[test]
    fn a_lone_fragments_series_is_the_closed_form() {
        for (lanczos, frequencies) in [(false, 1_u8), (false, 7), (true, 3), (true, 15)] {
            let oracle = oracle(frequencies.into(), &[("lanczos", Input::Bool(lanczos))]);
            let lone = fragment(4.2, [1.0; 3], 0.5, 0);
            let map = map(&oracle, &[lone]);
            let d = 0.05 + 0.9 * f64::from(4.2_f32 - 1.0) / 8.0;
            let terms = (1..=frequencies).map(|k| {
                let k = f64::from(k);
                let x = PI * k / (f64::from(frequencies) + 1.0);
                let sigma = if lanczos { x.sin() / x } else { 1.0 };
                sigma * (2.0 * PI * k * d).sin() / (PI * k)
            });
            let own = LN_2 * (d + terms.sum::<f64>());
            assert!((map.tau(d) - own).abs() < 1e-6, "{own}");
            assert!((oracle.in_front_of(&map, &lone) - 1.0).abs() < 1e-14);
        }
    }

    #[test]
    fn a_period_holds_all_that_there_is() {
        for n in 1..=40 {
            let pixel = random_pixel(n, u64::from(n) + 60);
            let sum: f64 = pixel.iter().map(|f| absorbance(f.alpha, 10.0)).sum();
            for frequencies in [1, 3, 40] {
                let oracle = oracle(frequencies, &[]);
                let map = map(&oracle, &pixel);
                assert!(map.tau(0.0).abs() < 1e-12);
                assert!((map.tau(1.0) - sum).abs() < 1e-10);
                assert!((oracle.total(&map) - (-sum).exp()).abs() < 1e-14);
            }
        }
    }

    /// Sheet 2.5: 0.030 at 7 frequencies.
    #[test]
    fn many_frequencies_are_over_unless_fragments_hide_themselves_or_the_ends_meet() {
        let pixels = layered_pixels(150, 6);
        let pixel_range = ("range", Input::Text("pixel".into()));
        let no_margin = ("margin", Input::Float(0.0));
        let seven = mean_error(&oracle(7, &[]), &pixels);
        assert!((seven / 0.030 - 1.0).abs() < 0.15, "{seven}");
        let many = |more: &[_]| mean_error(&oracle(1000, more), &pixels);
        assert!(many(&[]) < 1e-3);
        assert!(many(&[("lanczos", Input::Bool(true))]) < 2e-3);
        assert!(many(&[CHARGED]) > 0.05);
        let joined = [pixel_range, no_margin];
        assert!(many(&joined[..1]) < 1e-3 && many(&joined) > 0.02);
    }

    #[test]
    fn a_charged_fragment_hides_itself_by_half_its_absorbance() {
        let (layers, oracle) = (&layered_pixels(1, 6)[0], oracle(20_000, &[CHARGED]));
        let map = map(&oracle, layers);
        for (f, exact) in layers.iter().zip(exact_transmittance(layers)) {
            let expected = exact * (1.0 - f64::from(f.alpha)).sqrt();
            assert!((oracle.in_front_of(&map, f) - expected).abs() < 2e-3);
        }
    }

    /// Sheet 2.5: absorbance rings below zero in half of random pixels at 3 frequencies, in nine of ten at 7;
    /// transmittance stays at 1.
    #[test]
    fn ringing_brightens_nothing() {
        let pixels = layered_pixels(100, 6);
        let mut ringing = [3, 7].map(|frequencies| {
            let oracle = oracle(frequencies, &[]);
            let rings = |pixel: &&Vec<Fragment>| {
                let map = map(&oracle, pixel);
                assert!((0..80_u8).all(|i| oracle.at(&map, 1.0 + f32::from(i) / 10.0) <= 1.0));
                (1..200).any(|i| map.tau(f64::from(i) / 200.0) < 0.0)
            };
            pixels.iter().filter(rings).count()
        });
        ringing.sort_unstable();
        assert!(ringing[0] > 45 && ringing[1] > 85, "{ringing:?}");
    }
}
