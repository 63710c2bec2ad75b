//! Moments as a transmittance function: what the techniques of both bases share.

use super::quantized::{self, Quantized};
use super::{Basis, MAX_STORED, Regularization, Width};
use crate::continuum::absorbance::{absorbance, absorbances, transmittance, transmittances};
use crate::continuum::functions::ln;
use crate::continuum::oracle::{CHUNK, Composite, Oracle, chunks, see_one};
use crate::continuum::range::DepthRange;
use crate::continuum::ringing::{RINGS, exp_minus, ringing};
use crate::continuum::stored_oracle::{self, StoredOracle};
use crate::diagnosis::{Diagnosis, Fault, Faults};
use crate::format::{Format, FormatSet, Formats, Target};
use crate::fragments::{Fragment, List};
use crate::gpu::form::Number;
use crate::params::{Kind, ParamSpec, Params, Value, View};
use crate::technique::{AnyTechnique, Cost, DepthComplexity, Pixel, Properties};
use multiversion::multiversion;

/// The param `bias`; its default is the technique's own.
pub const BIAS: ParamSpec = ParamSpec::new(
    "bias",
    Kind::NON_NEGATIVE,
    Value::None,
    "share of the moments that is replaced by those of spread out mass, against rounding; 1 and more replace \
     all",
)
.after_formats();

/// The param `overestimation`.
pub const OVERESTIMATION: ParamSpec = ParamSpec::new(
    "overestimation",
    Kind::float(0.0, 1.0),
    Value::Float(0.25),
    "where between its lower bound (0) and its upper (1) the absorbance in front of a depth is taken",
);

/// The sums of moments.
pub const MOMENTS: Target = Target {
    name: "moments",
    param: "moments_format",
    doc: "format of the sums of moments; f16 and bf16 sum them as they are, which is not safe below a bias of 1e-2",
    formats: FormatSet::FLOATS,
    channels: 1,
    double: false,
    active: |_| true,
};

/// Total absorbance.
pub const ABSORBANCE: Target = Target {
    name: "absorbance",
    param: "absorbance_format",
    doc: "format of the total absorbance",
    ..MOMENTS
};

/// Pixels of less absorbance count as empty (M18's code): their moments are made of rounding.
const EMPTY: f32 = 1.0005e-3;

/// The formats of absorbance and of moments.
fn formats(params: &Params) -> [Format; 2] {
    let of = |target: Target| {
        let name = params.text(target.param);
        Format::from_name(name).unwrap_or_else(|| unreachable!("{name:?} was checked"))
    };
    [of(ABSORBANCE), of(MOMENTS)]
}

/// How wide what is stored is.
pub fn width(params: &Params) -> Width {
    let wide = |format| matches!(format, Format::F64 | Format::F32);
    if formats(params).into_iter().all(wide) { Width::Single } else { Width::Half }
}

/// What the param `bias` asks for, and the precision of the coarser format.
pub fn regularization(params: &Params) -> Regularization {
    let precision = |format: Format| 2.0 * format.unit_roundoff();
    let [absorbance, moments] = formats(params).map(precision);
    // mean values are not divided by it
    let absorbance = if formats(params)[1].is_normalized() { 0.0 } else { absorbance };
    Regularization { bias: params.float("bias"), precision: moments.max(absorbance) }
}

/// What shaders know of both params, and half of the precision.
pub fn regularization_numbers(params: &Params) -> [Number; 3] {
    let Regularization { bias, precision } = regularization(params);
    [params.float("overestimation"), bias, 0.5 * precision].map(Number::float)
}

/// The technique of these params over a basis.
pub fn technique<B: Basis>(
    basis: B,
    targets: &'static [Target],
    params: &Params,
    view: &View,
) -> Box<dyn AnyTechnique> {
    stored_oracle::technique(MomentOracle::new(basis, params, view), targets, params)
}

/// A transmittance function by its moments.
pub struct MomentOracle<B> {
    basis: B,
    overestimation: f64,
    range: DepthRange,
    s_max: f64,
}

/// Depth on a logarithmic scale from −1 to 1.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Warp {
    low: f64,
    high: f64,
    log_low: f64,
    log_range: f64,
}

impl Warp {
    /// The scale on which `low` is −1 and `high` is 1; a depth of 0 is moved in front of the rest.
    pub fn new((low, high): (f64, f64)) -> Self {
        let low = low.max(1e-6 * high);
        if high <= low {
            return Self::default();
        }
        let log_low = ln(low);
        Self { low, high, log_low, log_range: ln(high) - log_low }
    }

    /// Where each depth is on the scale; 0 where there is but one depth.
    pub fn positions(&self, depth: &[f32], positions: &mut [f64]) {
        if self.log_range == 0.0 {
            positions.fill(0.0);
        } else {
            positions_on(*self, depth, positions);
        }
    }

    /// Where a depth is.
    pub fn position(&self, depth: f32) -> f64 {
        let mut position = [0.0];
        self.positions(&[depth], &mut position);
        position[0]
    }
}

#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"))]
fn positions_on(warp: Warp, depth: &[f32], positions: &mut [f64]) {
    for (position, &depth) in positions.iter_mut().zip(depth) {
        // as clamp does, which has a branch for bounds out of order
        let inside = f64::from(depth).max(warp.low).min(warp.high);
        *position = (2.0 * (ln(inside) - warp.log_low) / warp.log_range - 1.0).clamp(-1.0, 1.0);
    }
}

/// One pixel's transmittance function.
#[derive(Debug, Default)]
pub struct Map<M> {
    warp: Warp,
    total: f64,
    /// None where the pixel counts as empty.
    moments: Option<M>,
}

impl<B: Basis> MomentOracle<B> {
    /// The oracle of these params over a basis.
    pub fn new(basis: B, params: &Params, view: &View) -> Self {
        Self {
            basis,
            overestimation: params.float("overestimation"),
            range: DepthRange::from_params(params, view),
            s_max: params.float("s_max"),
        }
    }

    /// τ in front of each fragment, as the moments have it; none where the pixel counts as empty.
    fn taus(&self, map: &Map<B::Moments>, list: List<'_>, taus: &mut [f64]) {
        let Some(moments) = &map.moments else { return taus.fill(0.0) };
        let mut d = [0.0; CHUNK];
        let d = &mut d[..list.len()];
        map.warp.positions(list.depth, d);
        self.basis.shares_in_front(moments, d, self.overestimation, taus);
        taus.iter_mut().for_each(|share| *share *= map.total);
    }

    /// Total absorbance, and the sum of each basis function weighted with it, as blended in single precision.
    #[expect(clippy::cast_possible_truncation, reason = "the sums are f32 targets")]
    fn sum(&self, warp: &Warp, list: List<'_>) -> (f32, [f32; MAX_STORED]) {
        let (mut total, mut sums) = (0.0, [0.0; MAX_STORED]);
        let (mut d, mut s) = ([0.0; CHUNK], [0.0; CHUNK]);
        for part in chunks(list) {
            let (d, s) = (&mut d[..part.len()], &mut s[..part.len()]);
            warp.positions(part.depth, d);
            absorbances(part.alpha, self.s_max, s);
            s.iter().for_each(|s| total += *s as f32);
            self.basis.add(d, s, &mut sums);
        }
        (total, sums)
    }

    /// Makes the map ready to be asked, given total absorbance and the mean values that follow.
    fn prepare(&self, map: &mut Map<B::Moments>, total: f64, means: impl FnOnce(f64) -> [f64; MAX_STORED]) {
        map.total = total;
        map.moments = (total >= EMPTY.into()).then(|| self.basis.prepare(&means(total)));
    }

    /// Hands over each fragment's absorbance and basis functions.
    fn add_each(&self, warp: Warp, list: List<'_>, mut add: impl FnMut(f64, [f64; MAX_STORED])) {
        for f in list.iter() {
            add(absorbance(f.alpha, self.s_max), self.basis.functions(warp.position(f.depth)));
        }
    }
}

impl<B: Basis> Oracle for MomentOracle<B> {
    type Map = Map<B::Moments>;

    fn build(&self, pixel: &Pixel<'_>, map: &mut Self::Map) {
        map.warp = Warp::new(self.range.bounds(pixel.list));
        let (total, sums) = self.sum(&map.warp, pixel.list);
        self.prepare(map, total.into(), |total| sums.map(|sum| f64::from(sum) / total));
    }

    fn in_front_of(&self, map: &Self::Map, fragment: &Fragment) -> f64 {
        see_one(self, map, fragment)
    }

    fn see(&self, map: &Self::Map, list: List<'_>, seen: &mut [f64]) {
        self.taus(map, list, seen);
        transmittances(seen);
    }

    fn at(&self, map: &Self::Map, depth: f32) -> f64 {
        let Some(moments) = &map.moments else { return 1.0 };
        let share = self.basis.in_front(moments, map.warp.position(depth), self.overestimation);
        transmittance(map.total * share)
    }

    fn total(&self, map: &Self::Map) -> f64 {
        if map.moments.is_some() { transmittance(map.total) } else { 1.0 }
    }

    fn faults(&self) -> Faults {
        RINGS.and(&[Fault::HankelFailures, Fault::BiasRetries])
    }

    fn diagnose(&self, map: &Self::Map, list: List<'_>) -> Diagnosis {
        let unclamped = |part: List<'_>, seen: &mut [f64]| exp_minus(seen, |taus| self.taus(map, part, taus));
        let mut found = ringing(list, unclamped, |depth| self.at(map, depth));
        let retries = map.moments.as_ref().map_or(0, B::retries);
        if retries > 0 {
            found.count(Fault::HankelFailures);
        }
        (0..retries).for_each(|_| found.count(Fault::BiasRetries));
        found
    }

    #[expect(clippy::cast_precision_loss, reason = "a handful of targets")]
    fn cost(&self, _complexity: &DepthComplexity) -> Cost {
        Cost { geometry_passes: 2.0, bytes_per_pixel: 4.0 * (self.basis.stored() + 1) as f64 + 20.0 }
    }

    /// Eight moments are the most there are, so no size makes the error vanish.
    fn properties(&self, composite: Composite) -> Properties {
        composite.promises(false)
    }
}

impl<B: Basis> StoredOracle for MomentOracle<B> {
    /// Sums, or the mean values of [`Quantized`].
    fn build_stored(&self, pixel: &Pixel<'_>, formats: &Formats, map: &mut Self::Map) {
        let [absorbance, moments] = [ABSORBANCE, MOMENTS].map(|target| formats.of(target.name));
        map.warp = Warp::new(self.range.bounds(pixel.list));
        if moments.is_normalized() {
            let mut stored = Quantized::new(absorbance);
            self.add_each(map.warp, pixel.list, |s, functions| {
                stored.add(s, std::array::from_fn(|k| functions[k]));
            });
            return self.prepare(map, stored.total(), |_| {
                let mut means = [0.0; MAX_STORED];
                means[..quantized::COUNT].copy_from_slice(&stored.means());
                means
            });
        }
        let (mut total, mut sums) = (0.0, [0.0; MAX_STORED]);
        self.add_each(map.warp, pixel.list, |s, functions| {
            total = absorbance.accumulate(total, s);
            for (sum, function) in sums.iter_mut().zip(functions).take(self.basis.stored()) {
                *sum = moments.accumulate(*sum, s * function);
            }
        });
        self.prepare(map, absorbance.read(total), |total| sums.map(|sum| moments.read(sum) / total));
    }

    #[expect(clippy::cast_precision_loss, reason = "a handful of targets")]
    fn texels(&self, _complexity: &DepthComplexity) -> Vec<(&'static str, f64)> {
        vec![(ABSORBANCE.name, 1.0), (MOMENTS.name, self.basis.stored() as f64)]
    }
}

#[cfg(test)]
mod stored;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::continuum::moments::power::Powers;
    use crate::continuum::moments::trigonometric::Harmonics;
    use crate::params::Input;
    use crate::techniques::testing::{
        VIEW, as_pixel, assert_close, build, clear_pixels, exact_transmittance, fragment, given, mean_error,
        random_pixel, resolve,
    };
    use crate::techniques::{find, mboit_power, mboit_trig};

    const IDS: [&str; 2] = ["mboit_power", "mboit_trig"];

    fn powers(count: usize, inputs: &[(&str, Input)]) -> MomentOracle<Powers> {
        let moments = ("moments", Input::Int(i64::try_from(count).unwrap()));
        let params = given(&mboit_power::INFO, &[inputs, &[moments]].concat());
        MomentOracle::new(Powers::new(count, regularization(&params)), &params, &VIEW)
    }

    fn harmonics(count: usize, inputs: &[(&str, Input)]) -> MomentOracle<Harmonics> {
        let moments = ("moments", Input::Int(i64::try_from(count).unwrap()));
        let params = given(&mboit_trig::INFO, &[inputs, &[moments]].concat());
        let basis = Harmonics::new(count, params.float("wrapping_zone"), regularization(&params));
        MomentOracle::new(basis, &params, &VIEW)
    }

    #[test]
    fn depth_is_warped_logarithmically() {
        let warp = Warp::new((1.0, 100.0));
        assert_eq!([0.5, 1.0, 100.0, 200.0].map(|z| warp.position(z)), [-1.0, -1.0, 1.0, 1.0]);
        assert!(warp.position(10.0).abs() < 1e-15);
    }

    #[test]
    fn the_eye_and_a_single_depth_have_places_too() {
        let from_eye = Warp::new((0.0, 2.0));
        assert_eq!([0.0, 1e-9, 2.0].map(|z| from_eye.position(z)), [-1.0, -1.0, 1.0]);
        for depth in [0.0, 3.0] {
            assert_eq!(Warp::new((depth, depth)).position(3.0), 0.0);
        }
    }

    /// What the bias of single precision does to the mean transmittance in front of a pixel's layers.
    const FEW_LAYERS: f64 = 5e-5;

    /// Sheet 3, identity 8.
    #[test]
    fn few_layers_are_exact_without_overestimation() {
        let inputs = [("overestimation", Input::Int(0))];
        for n in 1..=5_u16 {
            // of different absorbance and at logarithmically even depths
            let layer =
                |i: u16| fragment(1.5_f32.powi(i.into()), [1.0; 3], 0.3 + 0.1 * f32::from(i), i.into());
            let pixel: Vec<_> = (0..n).map(layer).collect();
            for count in [4, 6, 8].into_iter().filter(|m| usize::from(n) <= m / 2 + 1) {
                let error = mean_error(&powers(count, &inputs), std::slice::from_ref(&pixel));
                assert!(error < FEW_LAYERS, "{count} powers, {n} layers: {error}");
            }
            for count in [2, 3, 4].into_iter().filter(|m| usize::from(n) <= m + 1) {
                let error = mean_error(&harmonics(count, &inputs), std::slice::from_ref(&pixel));
                assert!(error < FEW_LAYERS, "{count} harmonics, {n} layers: {error}");
            }
        }
    }

    #[test]
    fn more_moments_see_better() {
        let pixels = clear_pixels(60);
        let power = [4, 6, 8].map(|m| mean_error(&powers(m, &[]), &pixels));
        let trig = [2, 3, 4].map(|m| mean_error(&harmonics(m, &[]), &pixels));
        for errors in [power, trig] {
            assert!(errors.is_sorted_by(|a, b| a > b) && errors[0] < 0.12, "{errors:?}");
        }
    }

    /// What rounding of the sums moves the bounds by, as between implementations.
    const ROUNDING: f64 = 2e-3;

    #[test]
    fn overestimation_goes_from_bound_to_bound() {
        let bounds = [0, 1].map(|beta| powers(6, &[("overestimation", Input::Int(beta))]));
        for pixel in clear_pixels(30) {
            let mut map = Map::default();
            as_pixel(&pixel, |pixel| bounds[0].build(pixel, &mut map));
            for (f, exact) in pixel.iter().zip(exact_transmittance(&pixel)) {
                let [high, low] = [0, 1].map(|i| bounds[i].in_front_of(&map, f));
                assert!(low - ROUNDING <= exact && exact <= high + ROUNDING, "{low} {exact} {high}");
            }
        }
    }

    /// Sheet 2.5: single precision fails the pivots' guard in a thousandth of random pixels.
    #[test]
    fn the_bias_of_the_papers_is_hardly_ever_raised() {
        let mut raised = [0; 6];
        for seed in 0..300_u32 {
            let pixel = random_pixel(1 + seed % 20, seed.into());
            as_pixel(&pixel, |pixel| {
                for (i, count) in [4, 6, 8].into_iter().enumerate() {
                    let mut map = Map::default();
                    powers(count, &[]).build(pixel, &mut map);
                    raised[i] += map.moments.map_or(0, |m| m.retries);
                    let mut map = Map::default();
                    harmonics(count / 2, &[]).build(pixel, &mut map);
                    raised[3 + i] += map.moments.map_or(0, |m| m.retries);
                }
            });
        }
        assert!(raised.iter().all(|n| *n <= 3), "{raised:?}");
    }

    /// One layer has a singular matrix, which no bias lets pass; ten times a bias is the next.
    #[test]
    fn diagnoses_say_how_often_the_bias_was_raised() {
        let layer = [fragment(2.0, [1.0; 3], 0.5, 0), fragment(6.0, [1.0; 3], 0.5, 1)];
        for id in IDS {
            let found = |bias| {
                let technique = build(id, &[("bias", Input::Float(bias))]).unwrap();
                let found = as_pixel(&layer, |pixel| technique.diagnose(pixel));
                [Fault::HankelFailures, Fault::BiasRetries].map(|fault| found.amount(fault))
            };
            assert_eq!(found(1e-3), [0.0, 0.0], "{id}");
            let [failures, retries] = found(0.0);
            assert!(failures == 1.0 && retries >= 1.0, "{id}: {retries}");
        }
    }

    /// Opaque fragments, coincident and clustered depths, and no bias but what the guard asks for.
    #[test]
    fn whatever_the_pixel_transmittance_is_a_share() {
        let depths = [0.0, 0.5, 1.0, 4.999, 5.0, 5.000_001, 9.0, 1e30];
        for bias in [None, Some(("bias", Input::Int(0)))] {
            let inputs: Vec<_> = bias.into_iter().chain([("s_max", Input::Int(60))]).collect();
            for seed in 0..150_u32 {
                let mut pixel = random_pixel(seed % 70, seed.into());
                for f in pixel.iter_mut().filter(|_| seed % 3 == 0) {
                    f.depth = 5.0 + (f.depth - 5.0) * 1e-6;
                }
                as_pixel(&pixel, |pixel| {
                    let seen =
                        |technique: Box<dyn AnyTechnique>| technique.transmittance(pixel, &depths).unwrap();
                    for (id, moments) in IDS.iter().flat_map(|id| [2, 3, 4].map(|m| (*id, m))) {
                        let count =
                            ("moments", Input::Int(if id == "mboit_power" { 2 * moments } else { moments }));
                        let seen = seen(build(id, &[&inputs[..], &[count]].concat()).unwrap());
                        let share = |t: &f64| (0.0..=1.0).contains(t);
                        assert!(seen.iter().all(share), "{id} {moments} {seed}: {seen:?}");
                    }
                });
            }
        }
    }

    #[test]
    fn faint_pixels_count_as_empty_and_are_averaged() {
        let mut pixel = random_pixel(9, 1);
        pixel.iter_mut().for_each(|f| *f = fragment(f.depth, f.color, 1e-4, f.primitive));
        for id in IDS {
            assert_eq!(resolve(id, &[], &pixel), resolve("blended_oit", &[], &pixel));
            let technique = find(id).unwrap().with_defaults();
            let seen = as_pixel(&pixel, |pixel| technique.transmittance(pixel, &[0.0, 5.0, 50.0]));
            assert_eq!(seen.unwrap(), [1.0; 3]);
        }
    }

    /// Sheet 0.3: where every T̂ underflows the average is that of blended OIT.
    #[test]
    fn dense_stacks_fall_back_to_the_average() {
        let stack: Vec<_> = (0..2000_u16)
            .map(|i| {
                let depth = f32::from(i % 4);
                fragment(1.0 + depth, [0.25 * depth, 0.5, 1.0], 1.0, i.into())
            })
            .collect();
        for id in IDS {
            let blended = resolve("blended_oit", &[], &stack);
            assert_close(resolve(id, &[], &stack), blended.color, 0.0, 2000.0 * f64::from(f32::EPSILON));
        }
    }

    #[test]
    fn a_nearer_layer_dominates() {
        let red_in_front = [fragment(2.0, [1.0, 0.0, 0.0], 0.9, 0), fragment(6.0, [0.0, 1.0, 0.0], 0.9, 1)];
        for id in IDS {
            let got = resolve(id, &[], &red_in_front).color;
            assert!(got.x > 5.0 * got.y, "{id}: {got}");
        }
    }
}
