//! The phenomenological model (`McGuire` & Mara 2016): weighted blended OIT whose fragments may transmit the
//! background in colour.

use super::blended_oit::BLENDED;
use crate::continuum::stored_sums::diagnose::diagnose_weighted;
use crate::continuum::stored_sums::{FixedLog, Recipe, StoredSums};
use crate::continuum::sums::{BlendSums, Sums};
use crate::diagnosis::{Diagnosis, Fault, Faults};
use crate::error::Result;
use crate::format::{Format, FormatSet, Formats, SUMMATION, Summation, Target};
use crate::fragments::List;
use crate::gpu::form::{Blend, BlendTarget, Blending, Form, Number, Path, SHARES, SUMS, only, target_format};
use crate::params::{Kind, ParamSpec, Params, Value, View};
use crate::technique::{
    AnyTechnique, Axes, Cost, DepthComplexity, Info, Pixel, Properties, Resolved, Technique,
};
use crate::techniques::ANY_ORDER;
use crate::weight::{FAR, Formula, Function, NEAR, Planes, Weighting};
use glam::DVec3;

/// The registry entry.
pub static INFO: Info = Info {
    id: "phenomenological",
    aliases: &[],
    name: "Phenomenological OIT",
    citation: &["McGuire2016"],
    doc: "Weighted blended OIT in which a fragment covers the background less where it transmits light, per \
          channel. All fragments share one transmission; diffusion and refraction, which need neighbouring \
          pixels, are left out.",
    axes: Axes {
        memory: "empirical func",
        insertion: "never",
        merge: "discard all",
        normalize: "α-weighted average",
        opacity: "alpha",
    },
    params: &[
        NEAR.when(|_| true),
        FAR.when(|_| true),
        ParamSpec::new(
            "transmission",
            Kind::FloatOrRgb { min: 0.0, max: 1.0 },
            Value::Rgb([0.0; 3]),
            "share of the background that passes through the covered part of a fragment, per channel",
        ),
        ParamSpec::new(
            "divisor_floor",
            Kind::NON_NEGATIVE,
            Value::Float(0.0),
            "least sum of weights to divide by; 1e-5 is the authors' shaders', which darkens faint fragments",
        ),
        SUMMATION,
    ],
    targets: &[Target::ACCUMULATION, MODULATION],
    submission_orders: ANY_ORDER,
    random: false,
    geometry_passes: "1",
    bytes_per_pixel: "4 sums and the background's share per channel: 32 in f32, 16 in f16, 4 less with the share in unorm8",
    build,
    gpu: Some(gpu),
};

/// B, the background's share per channel; the authors' is RGBA8.
const MODULATION: Target = Target {
    name: "modulation",
    param: "modulation_format",
    doc: "format of the background's share per channel; format=\"f32\" keeps it in f64, the authors' shaders in unorm8",
    formats: FormatSet::SHARES,
    channels: 3,
    double: true,
    active: |_| true,
};

fn build(params: &Params, _view: &View) -> Result<Box<dyn AnyTechnique>> {
    let Value::Rgb(transmission) = params.value("transmission") else {
        unreachable!("a value of this kind is three numbers")
    };
    let formats = Formats::from_params(INFO.targets, params);
    let recipe = Recipe::from_params(&formats, params);
    // the fixed-point logarithms of the shares
    let fixed = recipe.summation == Summation::Fixed;
    let logarithms = if fixed { 24.0 - formats.bytes_of("modulation") } else { 0.0 };
    let default = formats.are_default() && recipe.summation == Summation::Plain;
    Ok(Box::new(Phenomenological {
        weighting: weighting(params)?,
        transmission: DVec3::from(transmission),
        divisor_floor: params.float("divisor_floor"),
        stored: (!default).then_some((recipe, formats.of("modulation"))),
        bytes: recipe.bytes_per_pixel(&formats, formats.bytes_of("accumulation")) + logarithms,
    }))
}

/// Its form on a GPU: the blend unit multiplies the background's share by each fragment's, channel by channel.
fn gpu(params: &Params, _view: &View) -> Result<Form> {
    only(params, "summation", "plain")?;
    let Value::Rgb(transmission) = params.value("transmission") else {
        unreachable!("a value of this kind is three numbers")
    };
    let formats = Formats::from_params(INFO.targets, params);
    let format = target_format(params, &formats, "accumulation", "accumulation_format", SUMS)?;
    let modulation = target_format(params, &formats, "modulation", "modulation_format", SHARES)?;
    let targets = vec![
        BlendTarget::sums("accumulation_format", format, 4),
        BlendTarget::product("modulation_format", modulation, 4, Blend::Multiply),
    ];
    let weight = weighting(params)?.shading(params)?;
    let more = [format.max_finite(0), params.float("divisor_floor")];
    Ok(Form {
        weight: Some(weight.module),
        shader: include_str!("../../shaders/phenomenological.wgsl"),
        numbers: weight
            .numbers
            .into_iter()
            .chain(transmission.into_iter().chain(more).map(Number::float))
            .collect(),
        path: Path::Blended(Blending::once("accumulate", "resolve", targets)),
        shows_zero_fragments: false,
        colored_transmittance: true,
    })
}

/// The authors' weight.
fn weighting(params: &Params) -> Result<Weighting> {
    let formula = Formula::I3d16(Planes::from_params(params)?);
    Ok(Weighting::new(Function::Published(formula), 1.0, 0.0))
}

struct Phenomenological {
    weighting: Weighting,
    /// τ.
    transmission: DVec3,
    divisor_floor: f64,
    /// How the sums are stored and what the background's share is stored in, if not by default.
    stored: Option<(Recipe, Format)>,
    bytes: f64,
}

/// Working memory: a' and w of each fragment.
#[derive(Debug, Default)]
struct Scratch {
    alpha: Vec<f32>,
    weights: Vec<f32>,
    stored_weights: Vec<f64>,
}

/// How much of the background all fragments cover, and what that leaves, B; each is kept for itself, as
/// [`BlendSums`] does.
#[derive(Debug, Clone, Copy)]
struct Modulation {
    coverage: DVec3,
    transmittance: DVec3,
}

impl Modulation {
    /// Π (1 − a (1 − τ)).
    fn by(alphas: &[f32], transmission: DVec3) -> Self {
        let mut net = Self { coverage: DVec3::ZERO, transmittance: DVec3::ONE };
        for &alpha in alphas {
            let coverage = f64::from(alpha) * (1.0 - transmission);
            net.transmittance *= 1.0 - coverage;
            net.coverage += (1.0 - net.coverage) * coverage;
        }
        net
    }

    /// The same in integers, whose sum does not depend on the order.
    fn fixed(alphas: &[f32], transmission: DVec3) -> Self {
        let (mut coverage, mut transmittance) = ([0.0; 3], [1.0; 3]);
        for channel in 0..3 {
            let mut log = FixedLog::default();
            let kept = 1.0 - transmission[channel];
            alphas.iter().for_each(|&alpha| log.attenuate(f64::from(alpha) * kept));
            (transmittance[channel], coverage[channel]) = log.shares();
        }
        Self { coverage: coverage.into(), transmittance: transmittance.into() }
    }

    /// The same in a target of a format.
    #[expect(clippy::cast_possible_truncation, reason = "blend factors are f32")]
    fn stored(alphas: &[f32], transmission: DVec3, format: Format) -> Self {
        if format == Format::F64 {
            return Self::by(alphas, transmission);
        }
        let mut shares = [1.0; 3];
        for &alpha in alphas {
            let factors = 1.0 - f64::from(alpha) * (1.0 - transmission);
            for (share, factor) in shares.iter_mut().zip(factors.to_array()) {
                *share = format.blend(*share, f64::from(factor as f32), 0.0);
            }
            format.round_texel(&mut shares);
        }
        let transmittance = DVec3::from(shares);
        Self { coverage: 1.0 - transmittance, transmittance }
    }

    /// `(1 − B) color / alpha + B background`; the background's share alone where there is no alpha.
    fn cover(&self, color: DVec3, alpha: f64, background: DVec3) -> Resolved {
        let share = if alpha > 0.0 { self.coverage / alpha } else { DVec3::ZERO };
        let blended = share * color + self.transmittance * background;
        Resolved {
            color: blended.min(DVec3::splat(f32::MAX.into())),
            transmittance: self.transmittance,
            dropped: 0,
        }
    }
}

impl Phenomenological {
    /// a' = a (1 − mean τ).
    fn thin(&self, list: List<'_>, alpha: &mut Vec<f32>) {
        #[expect(clippy::cast_possible_truncation, reason = "the sums are f32 targets")]
        let kept = (1.0 - self.transmission.element_sum() / 3.0) as f32;
        alpha.clear();
        alpha.extend(list.alpha.iter().map(|a| a * kept));
    }

    /// Σ w (C, a') as `recipe` stores it.
    fn store(&self, recipe: Recipe, list: List<'_>, scratch: &mut Scratch) -> StoredSums {
        let Scratch { alpha, stored_weights, .. } = scratch;
        self.thin(list, alpha);
        recipe.blend_list(Some(&self.weighting), List { alpha, ..list }, stored_weights)
    }

    /// Σ w (C, a').
    fn accumulate(&self, pixel: &Pixel<'_>, scratch: &mut Scratch) -> BlendSums {
        let Scratch { alpha, weights, .. } = scratch;
        self.thin(pixel.list, alpha);
        self.weighting.evaluate(pixel.list.depth, alpha, weights);
        let mut sums = BlendSums::CLEAR;
        for ((&weight, &color), &alpha) in weights.iter().zip(pixel.list.color).zip(alpha.iter()) {
            sums.add(weight, color, alpha);
        }
        sums
    }

    /// How the sums are stored, with the format of the background's share for that of R.
    fn recipe_with_share(&self) -> Recipe {
        let stored = self.stored.map(|(recipe, format)| Recipe { revealage: format, ..recipe });
        stored.unwrap_or(Recipe::SINGLE)
    }

    /// What the sum of colours is divided by.
    fn divisor(&self, sums: &Sums) -> f64 {
        if sums.alpha > 0.0 { sums.alpha.max(self.divisor_floor) } else { 0.0 }
    }
}

/// What went wrong with one channel of the background's share.
fn diagnose_share(recipe: Recipe, alphas: &[f32], transmission: f64, found: &mut Diagnosis) {
    let mut share = StoredSums::CLEAR;
    for &alpha in alphas {
        let coverage = f64::from(alpha) * (1.0 - transmission);
        // of no colour and alpha: but for R there is nothing to go wrong
        share.add_watched(recipe, recipe.one(), [0.0; 3], 0.0, coverage, 1.0 - coverage, found);
    }
    let (covers, format) = (alphas.iter().any(|alpha| *alpha > 0.0), recipe.revealage);
    if covers && transmission < 1.0 && recipe.faults().has(Fault::Cancellation) {
        found.cancel(1.0, share.read(recipe).transmittance, format);
    }
}

impl Technique for Phenomenological {
    type Scratch = Scratch;
    const COLORED_TRANSMITTANCE: bool = true;

    fn resolve(&self, pixel: &Pixel<'_>, scratch: &mut Scratch) -> Resolved {
        if let Some((recipe, format)) = self.stored {
            let stored = self.store(recipe, pixel.list, scratch);
            let shares = match recipe.summation {
                Summation::Fixed => Modulation::fixed(pixel.list.alpha, self.transmission),
                _ => Modulation::stored(pixel.list.alpha, self.transmission, format),
            };
            let sums = stored.read(recipe);
            let resolved = shares.cover(sums.color, self.divisor(&sums), pixel.background);
            return Resolved { dropped: stored.saturated.into(), ..resolved };
        }
        let sums = self.accumulate(pixel, scratch).read(pixel.list.len());
        let modulation = Modulation::by(pixel.list.alpha, self.transmission);
        modulation.cover(sums.color, self.divisor(&sums), pixel.background)
    }

    fn faults(&self) -> Faults {
        self.recipe_with_share().faults()
    }

    fn diagnose(&self, pixel: &Pixel<'_>, scratch: &mut Scratch) -> Diagnosis {
        let recipe = self.recipe_with_share();
        let Scratch { alpha, stored_weights, .. } = scratch;
        self.thin(pixel.list, alpha);
        recipe.weigh(Some(&self.weighting), pixel.list.depth, alpha, stored_weights);
        // R beside the sums is nobody's target here
        let sums = Recipe { revealage: Format::F64, ..recipe };
        let (mut found, _) = diagnose_weighted(sums, stored_weights, List { alpha, ..pixel.list });
        for transmission in self.transmission.to_array() {
            diagnose_share(recipe, pixel.list.alpha, transmission, &mut found);
        }
        found
    }

    fn cost(&self, _complexity: &DepthComplexity) -> Cost {
        Cost { geometry_passes: 1.0, bytes_per_pixel: self.bytes }
    }

    fn properties(&self) -> Properties {
        let blocks = self.transmission == DVec3::ZERO;
        let exact = blocks && self.divisor_floor == 0.0;
        let promises = Properties {
            exact_for_one: exact,
            exact_for_one_color: exact,
            exact_coverage: blocks,
            ..BLENDED
        };
        match self.stored {
            None => promises,
            Some((recipe, format)) => Recipe { revealage: format, ..recipe }.properties(promises),
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::params::Input;
    use crate::techniques::testing::{
        BACKGROUND, F32_STATE, assert_close, build, fragment, over, random_pixel, resolve, three_layers,
    };
    use glam::{DVec3, Vec3};

    const ID: &str = "phenomenological";

    fn transmission(rgb: [f64; 3]) -> (&'static str, Input) {
        ("transmission", Input::Floats(rgb.to_vec()))
    }

    /// All three depths are beyond the far plane, where the weights are 1000 a' 0.01³, at least 1e-2.
    #[test]
    fn three_layers_by_hand() {
        let planes = [("near", Input::Float(0.5)), ("far", Input::Float(1.0))];
        let tinted = [transmission([1.0, 0.5, 0.0]), planes[0].clone(), planes[1].clone()];
        let got = resolve(ID, &tinted, &three_layers());
        let transmittance = DVec3::new(1.0, 0.75 * 0.875 * 0.625, 0.5 * 0.75 * 0.25);
        let average = DVec3::new(0.45, 0.6, 0.875) / (0.5 * 1.5);
        let expected = (1.0 - transmittance) * average + transmittance * DVec3::from(Vec3::from(BACKGROUND));
        assert!((got.transmittance - transmittance).abs().max_element() < 1e-15, "{got:?}");
        assert!((got.color - expected).abs().max_element() < F32_STATE, "{got:?} {expected}");
    }

    /// Sheet 3, identity 5.
    #[test]
    fn without_transmission_it_is_wboit_with_its_weight() {
        for seed in 0..20 {
            let pixel = random_pixel(3 * seed, seed.into());
            let weight = ("weight", Input::Text("i3d16".into()));
            assert_eq!(resolve(ID, &[], &pixel), resolve("wboit", &[weight], &pixel));
        }
    }

    #[test]
    fn gray_transmission_thins_what_covers_the_background() {
        for (tau, n) in [(0.25, 5), (0.5, 17), (1.0, 8)] {
            let pixel = random_pixel(n, 3);
            let got = resolve(ID, &[("transmission", Input::Float(tau))], &pixel);
            let expected: f64 = pixel.iter().map(|f| 1.0 - f64::from(f.alpha) * (1.0 - tau)).product();
            assert!((got.transmittance - expected).abs().max_element() < 1e-14, "{got:?}");
        }
    }

    #[test]
    fn a_lone_fragment_keeps_its_light_and_covers_less() {
        let glass = fragment(3.0, [0.8, 0.4, 0.2], 0.5, 0);
        let got = resolve(ID, &[("transmission", Input::Float(0.5))], &[glass]);
        let expected = 0.5 * DVec3::new(0.8, 0.4, 0.2) + 0.75 * DVec3::from(Vec3::from(BACKGROUND));
        assert_close(got, expected, 0.75, F32_STATE);
        let clear = resolve(ID, &[("transmission", Input::Float(1.0))], &[glass]);
        assert_close(clear, DVec3::from(Vec3::from(BACKGROUND)), 1.0, 0.0);
    }

    /// Sheet 2.4: the authors' shaders divide by 1e-5 at least.
    #[test]
    fn the_printed_floor_darkens_faint_fragments() {
        let faint = [fragment(90.0, [1.0; 3], 1e-4, 0)];
        let (color, transmittance) = over(&faint);
        assert_close(resolve(ID, &[], &faint), color, transmittance, F32_STATE);
        let floored = resolve(ID, &[("divisor_floor", Input::Float(1e-5))], &faint);
        // its weight is 1e-2, so the sum is 1e-6
        let darkened = color - 0.9 * 1e-4;
        assert_close(floored, darkened, transmittance, F32_STATE);
    }

    fn word(name: &'static str, value: &str) -> (&'static str, Input) {
        (name, Input::Text(value.into()))
    }

    /// The authors' targets: halves and 8 bits of the background's share, which do not see what is faint.
    #[test]
    fn the_authors_targets_lose_faint_fragments() {
        let faint: Vec<_> = (0..300).map(|i| fragment(1.0, [0.5; 3], 1.0 / 520.0, i)).collect();
        let targets = [word("format", "f16"), word("modulation_format", "unorm8")];
        assert_eq!(resolve(ID, &targets, &faint).transmittance, DVec3::ONE);
        let pixel = random_pixel(20, 4);
        let (got, exact) = (resolve(ID, &targets, &pixel), resolve(ID, &[], &pixel));
        assert!((got.color - exact.color).abs().max_element() < 0.02, "{got:?} {exact:?}");
    }

    #[test]
    fn every_summation_is_the_same_within_its_precision() {
        let pixel = random_pixel(40, 6);
        for tau in [[0.0; 3], [0.9, 0.5, 0.0]] {
            let exact = resolve(ID, &[word("format", "f64"), transmission(tau)], &pixel);
            for summation in ["plain", "compensated", "fixed", "scaled", "scaled_double"] {
                let got = resolve(ID, &[word("summation", summation), transmission(tau)], &pixel);
                let far = (got.color - exact.color).abs().max_element();
                assert!(far < 1e-5, "{summation}: {far:e}");
            }
        }
    }

    #[test]
    fn near_must_be_less_than_far() {
        let message = build(ID, &[("near", Input::Int(200))]).err().unwrap().to_string();
        assert!(message.contains(ID) && message.contains("near must be less than far"), "{message}");
    }
}
