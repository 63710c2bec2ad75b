//! What storage does to blended sums, and what ways of summation do about it.

use super::*;
use crate::continuum::sums::BlendSums;
use crate::fragments::Fragment;
use crate::params::Input;
use crate::technique::{AnyTechnique, DepthComplexity, Resolved};
use crate::techniques::testing::{
    BACKGROUND, Random, build, difference, fragment, over, random_pixel, resolve,
};
use glam::Vec3;

const PLAIN: Recipe = Recipe {
    rgb: Format::F16,
    alpha: Format::F16,
    revealage: Format::F16,
    count: Format::F16,
    summation: Summation::Plain,
    monochrome: false,
};

fn text(name: &'static str, value: &str) -> (&'static str, Input) {
    (name, Input::Text(value.into()))
}

fn halves(summation: &str) -> [(&'static str, Input); 2] {
    [text("format", "f16"), text("summation", summation)]
}

fn sums(recipe: Recipe, weights: &[f64], fragments: &[Fragment]) -> StoredSums {
    let mut sums = StoredSums::CLEAR;
    weights.iter().zip(fragments).for_each(|(w, f)| sums.add(recipe, *w, f.color, f.alpha));
    sums
}

#[test]
fn stored_in_f32_and_f64_they_are_the_streamed_sums() {
    let recipe =
        Recipe { rgb: Format::F32, alpha: Format::F32, revealage: Format::F64, count: Format::F64, ..PLAIN };
    for seed in 0..20 {
        let pixel = random_pixel(40, seed);
        let (mut streamed, mut random) = (BlendSums::CLEAR, Random::new(seed));
        let weights: Vec<_> = pixel.iter().map(|_| 1e3 * random.unit()).collect();
        pixel.iter().zip(&weights).for_each(|(f, w)| streamed.add(*w, f.color, f.alpha));
        let weights: Vec<_> = weights.into_iter().map(f64::from).collect();
        assert_eq!(sums(recipe, &weights, &pixel).read(recipe), streamed.read(pixel.len()));
    }
}

/// The colour of a pixel blended in f64 by the formula alone.
fn by_formula(pixel: &[Fragment], weight: impl Fn(f64, f64) -> f64) -> (DVec3, f64) {
    let (mut color, mut alpha, mut transmittance) = (DVec3::ZERO, 0.0, 1.0);
    for f in pixel {
        let (z, a) = (f64::from(f.depth), f64::from(f.alpha));
        color += weight(z, a) * DVec3::from(f.color.map(f64::from));
        alpha += weight(z, a) * a;
        transmittance *= 1.0 - a;
    }
    (color / alpha * (1.0 - transmittance) + transmittance * background(), transmittance)
}

fn background() -> DVec3 {
    Vec3::from(BACKGROUND).as_dvec3()
}

#[test]
fn in_f64_nothing_is_lost() {
    for seed in 0..10 {
        let pixel = random_pixel(60, seed);
        let params = [text("format", "f64"), text("weight", "inv_pow")];
        let (color, transmittance) = by_formula(&pixel, |z, _| z.powi(-4));
        assert!(difference(resolve("wboit", &params, &pixel), color, transmittance) < 1e-13);
        let exp = [text("weight", "exp"), ("weight_k", Input::Float(0.5))];
        let (color, transmittance) = by_formula(&pixel, |z, _| (-0.5 * z).exp());
        for summation in ["plain", "compensated", "scaled", "scaled_double"] {
            let storage = [text("format", "f64"), text("summation", summation)];
            let got = resolve("wboit", &[&exp[..], &storage].concat(), &pixel);
            assert!(difference(got, color, transmittance) < 1e-13, "{summation}");
        }
    }
}

/// MB13 §3.2: 16-bit sums saturate after about 20 layers at the upper clamp; sheet R12: 21.8.
#[test]
fn halves_overflow_after_20_layers_at_the_upper_clamp() {
    let layers = [fragment(0.1, [1.0; 3], 1.0, 0); 22];
    let alpha = |n: usize| sums(PLAIN, &[3e3; 22], &layers[..n]).sums[3];
    assert!((alpha(21) / 63e3 - 1.0).abs() < 0.01, "{}", alpha(21));
    assert_eq!(alpha(22), f64::INFINITY);
    // what is infinite reads as the largest number, and all colours are white then
    let mut dark = layers;
    dark.iter_mut().for_each(|f| f.color = [0.9, 0.99, 1.0]);
    dark[0].color = [1.0; 3];
    let got = resolve("wboit", &[text("format", "f16")], &[dark, dark, dark].concat());
    assert_eq!(got.color, DVec3::ONE);
    let scaled = resolve("wboit", &halves("scaled_double"), &[dark, dark, dark].concat());
    assert!((scaled.color.x - 0.9045).abs() < 1e-3, "{scaled:?}");
}

/// Sheet 4: in 8 bits an alpha below 1/510 is a no-op, in 16 one below 2.4e-4.
#[test]
fn revealage_ignores_what_is_fainter_than_half_a_step() {
    let share = |format, alpha| {
        let layers: Vec<_> = (0..200).map(|i| fragment(1.0, [1.0; 3], alpha, i)).collect();
        resolve("wboit", &[text("revealage_format", format)], &layers).transmittance.x
    };
    assert_eq!(share("unorm8", 1.0 / 511.0), 1.0);
    assert!(share("unorm8", 1.0 / 509.0) < 1.0);
    assert_eq!(share("f16", 2.4e-4), 1.0);
    assert!(share("f16", 2.5e-4) < 1.0);
    assert!((share("f32", 2.4e-4) - 0.999_76_f64.powi(200)).abs() < 1e-5);
}

/// MB13 §3.2: without range clamping underflow leaves areas too dark where alpha is small and z large.
#[test]
fn underflow_darkens_what_is_faint_and_far() {
    // z^-4 a is a quantum or two, a tenth of it is nothing
    let lone = [fragment(60.0, [0.1, 0.5, 0.1], 0.9, 0)];
    let exact = over(&lone).0;
    let color = |params: &[(&str, Input)]| resolve("wboit", params, &lone).color;
    let unclamped = color(&[text("format", "f16"), text("weight", "inv_pow")]);
    assert!(exact.x - unclamped.x > 0.08, "{unclamped} {exact}");
    let clamped = color(&[text("format", "f16")]);
    assert!((clamped - exact).abs().max_element() < 3e-3, "{clamped} {exact}");
    let scaled = color(&[text("format", "f16"), text("weight", "inv_pow"), text("summation", "scaled")]);
    assert!((scaled - exact).abs().max_element() < 1e-3, "{scaled} {exact}");
}

#[test]
fn compensation_keeps_what_rounding_cuts_off() {
    let layers = vec![fragment(1.0, [0.5; 3], 1.0, 0); 5000];
    let read = |summation| {
        let recipe = Recipe { summation, ..PLAIN };
        let one = if summation.is_scaled() { 0.0 } else { 1.0 };
        sums(recipe, &vec![one; 5000], &layers).read(recipe)
    };
    // beside 2048 the next half is 2050
    assert_eq!(read(Summation::Plain).alpha, 2048.0);
    // what is cut off is summed in halves, too
    assert_eq!(read(Summation::Compensated).alpha, 4096.0);
    assert_eq!(read(Summation::Compensated).color.x, 2048.0);
    assert_eq!(read(Summation::ScaledDouble).alpha, 5000.0);
    assert_eq!(read(Summation::Fixed).alpha, 5000.0);
}

fn shuffled(pixel: &[Fragment], seed: u64) -> Vec<Fragment> {
    let mut pixel = pixel.to_vec();
    Random::new(seed).shuffle(&mut pixel);
    pixel
}

#[test]
fn fixed_point_has_the_same_bits_in_any_order() {
    for format in ["f64", "f32", "f16", "bf16", "rgb9e5"] {
        let params = [text("accumulation_format", format), text("summation", "fixed")];
        for seed in 0..20 {
            let pixel = random_pixel(64, seed);
            let first = resolve("wboit", &params, &pixel);
            assert_eq!(resolve("wboit", &params, &shuffled(&pixel, seed)), first, "{format}");
            let float = resolve("wboit", &[], &pixel);
            let close = if format == "f64" || format == "f32" { 1e-5 } else { 0.05 };
            assert!(
                difference(first, float.color, float.transmittance.x) < close,
                "{format}: {first:?} {float:?}"
            );
        }
    }
}

#[test]
fn fixed_point_saturates_and_counts() {
    let pixel = |n| (0..n).map(|i| fragment(0.1, [1.0; 3], 1.0, i)).collect::<Vec<_>>();
    // 32 bits for twice a half: up to 2^15
    let dropped = |n| resolve("wboit", &halves("fixed"), &pixel(n)).dropped;
    assert_eq!([dropped(10), dropped(11), dropped(30)], [0, 1, 1]);
    let got = resolve("wboit", &halves("fixed"), &pixel(30));
    assert_eq!(got.color, DVec3::ONE);
    let wide = resolve("wboit", &[text("summation", "fixed")], &pixel(1000));
    assert_eq!((wide.dropped, wide.color), (0, DVec3::ONE));
}

/// 10,000 layers of random colours at depths from 1e-3 to 1e6, evenly over their logarithm.
fn deep_pixel(seed: u64) -> Vec<Fragment> {
    let mut random = Random::new(seed);
    let mut layer = |i| {
        let (z, alpha) = (10.0_f32.powf(9.0 * random.unit() - 3.0), 0.05 + 0.9 * random.unit());
        fragment(z, [random.unit(), 0.5 * random.unit(), 0.1 + 0.9 * random.unit()], alpha, i)
    };
    (0..10_000).map(&mut layer).collect()
}

fn weights() -> Vec<Vec<(&'static str, Input)>> {
    let named = ["one", "mb7", "mb8", "mb9", "mb10"].map(|name| vec![text("weight", name)]);
    let steep = |name, k| vec![text("weight", name), ("weight_k", Input::Float(k))];
    let steep = [steep("inv_pow", 6.0), steep("exp", 1.0), steep("exp", 0.1), steep("exp", 1e-3)];
    named.into_iter().chain(steep).collect()
}

fn in_format(
    weight: &[(&'static str, Input)],
    format: &str,
    summation: &str,
    pixel: &[Fragment],
) -> Resolved {
    let storage = [text("format", format), text("summation", summation)];
    resolve("wboit", &[weight, &storage].concat(), pixel)
}

/// Two scaled halves are as good as doubles to the eye; halves by themselves are not for any of these weights.
#[test]
fn scaled_double_halves_keep_every_weight_over_ten_thousand_layers() {
    const VISIBLE: f64 = 1e-2;
    let pixel = deep_pixel(1);
    for weight in weights() {
        let exact = in_format(&weight, "f64", "scaled", &pixel);
        let error = |summation| {
            let got = in_format(&weight, "f16", summation, &pixel);
            (got.color - exact.color).abs().max_element()
        };
        let double = error("scaled_double");
        assert!(double < VISIBLE, "{weight:?}: {double:e}");
        assert!(error("plain") > VISIBLE, "{weight:?}: {:e}", error("plain"));
    }
}

/// However steep a weight is, scaled sums are neither infinite nor nothing, and the nearest layers are what is seen.
#[test]
fn scaled_sums_neither_overflow_nor_underflow() {
    for (k, name) in [(1e5, "exp"), (1e9, "exp"), (100.0, "inv_pow"), (1e4, "inv_pow")] {
        for format in ["f64", "f32", "f16", "bf16", "r11g11b10f", "rgb9e5"] {
            for summation in ["scaled", "scaled_double"] {
                let storage = [text("accumulation_format", format), text("summation", summation)];
                let weight = [text("weight", name), ("weight_k", Input::Float(k))];
                let mut pixel = deep_pixel(2);
                pixel[5000] = fragment(1e-4, [0.75, 0.25, 0.5], 0.5, 5000);
                let got = resolve("wboit", &[&weight[..], &storage].concat(), &pixel);
                let nearest = DVec3::new(0.75, 0.25, 0.5);
                let far = (got.color - nearest).abs().max_element();
                // the packed mantissas have 5 bits at least
                assert!(far < 0.02, "{name} {k} {format} {summation}: {got:?}");
            }
        }
    }
}

#[test]
fn scaled_sums_follow_weights_that_grow_and_that_fall() {
    let recipe = Recipe { summation: Summation::Scaled, ..PLAIN };
    let layers = [fragment(1.0, [0.5, 0.25, 0.125], 1.0, 0); 5];
    let read = |logs: [f64; 5]| sums(recipe, &logs, &layers).read(recipe);
    for logs in
        [[0.0, 40.0, 80.0, 120.0, 160.0], [160.0, 120.0, 80.0, 40.0, 0.0], [1e9, -1e9, 1e12, 0.0, 0.0]]
    {
        let got = read(logs);
        assert_eq!(got.color / got.alpha, DVec3::new(0.5, 0.25, 0.125), "{logs:?}");
        assert!(got.alpha > 0.0 && got.alpha.is_finite());
    }
    let nothing = read([f64::NEG_INFINITY; 5]);
    assert_eq!((nothing.alpha, nothing.count), (0.0, 5.0));
    // in the range of f64 they are not only in proportion
    assert_eq!(read([0.0; 5]).alpha, 5.0);
}

/// MB13 Listings 3 and 4, and the packing for monochrome surfaces of its section 3.4.
#[test]
fn layouts_differ_in_room_not_in_what_they_hold() {
    let layout = |name| [text("format", "f16"), text("layout", name)];
    let cost = |name| {
        let technique: Box<dyn AnyTechnique> = build("wboit", &layout(name)).unwrap();
        technique.cost(&DepthComplexity { mean: 1.0, max: 1 }).bytes_per_pixel
    };
    assert_eq!(["listing3", "listing4", "monochrome"].map(cost), [10.0, 10.0, 8.0]);
    for seed in 0..10 {
        let mut pixel = random_pixel(30, seed);
        let one = |name, pixel: &[Fragment]| resolve("wboit", &layout(name), pixel);
        assert_eq!(one("listing4", &pixel), one("listing3", &pixel));
        pixel.iter_mut().for_each(|f| f.color = [f.color[1]; 3]);
        let (gray, colored) = (one("monochrome", &pixel), one("listing3", &pixel));
        assert!(difference(gray, colored.color, colored.transmittance.x) < 1e-2, "{gray:?} {colored:?}");
    }
}

#[test]
fn counts_in_halves_end_at_2048() {
    let layers: Vec<_> = (0..4096).map(|i| fragment(1.0, [0.25; 3], 1e-4, i)).collect();
    let share = |format| {
        let params = [text("count_format", format), text("accumulation_format", "f64")];
        resolve("weighted_average", &params, &layers).transmittance.x
    };
    let (alpha, mean) = (4096.0 * f64::from(1e-4_f32), f64::from(1e-4_f32));
    assert!((share("f64") - (1.0 - mean).powi(4096)).abs() < 1e-9);
    assert!((share("f16") - (1.0 - alpha / 2048.0).powi(2048)).abs() < 1e-9);
}

#[test]
fn formats_that_say_nothing_new_take_the_fast_path() {
    let streams = |id: &str, params: &[(&str, Input)]| build(id, params).unwrap().streamed().is_some();
    for id in ["wboit", "blended_oit", "weighted_sum", "weighted_average", "alpha_compositing", "painter"] {
        assert!(streams(id, &[text("format", "f32")]), "{id}");
        assert!(!streams(id, &[text("format", "f16")]), "{id}");
        assert!(!streams(id, &[text("format", "f64")]), "{id}");
    }
    assert!(streams("wboit", &[text("accumulation_format", "f32"), text("revealage_format", "f64")]));
    assert!(!streams("wboit", &[text("revealage_format", "f32")]));
    assert!(!streams("wboit", &[text("summation", "compensated")]));
}

#[test]
fn bytes_follow_formats_and_summation() {
    let cost = |id: &str, params: &[(&str, Input)]| {
        build(id, params).unwrap().cost(&DepthComplexity { mean: 1.0, max: 1 }).bytes_per_pixel
    };
    for (id, single) in
        [("wboit", 20.0), ("weighted_sum", 16.0), ("alpha_compositing", 16.0), ("gs_wsr", 16.0)]
    {
        assert_eq!(cost(id, &[]), single, "{id}");
        assert_eq!(cost(id, &[text("format", "f16")]), 0.5 * single, "{id}");
        assert_eq!(cost(id, &[text("format", "f64")]), 2.0 * single, "{id}");
    }
    let summed = |name| cost("wboit", &halves(name));
    let all = ["plain", "compensated", "fixed", "scaled", "scaled_double"].map(summed);
    assert_eq!(all, [10.0, 18.0, 24.0, 14.0, 22.0]);
    assert_eq!(cost("painter", &[text("format", "srgb8")]), 4.0);
    let authors = [text("format", "f16"), text("modulation_format", "unorm8")];
    assert_eq!(cost("phenomenological", &authors), 12.0);
}

/// Corrections may be negative, and formats without a sign would keep the positive ones alone.
#[test]
fn what_is_left_of_unsigned_sums_has_a_sign() {
    let layer = |i: u8| fragment(f32::from(i), [0.3, 0.2, 0.1], 0.5, i.into());
    let pixel: Vec<_> = (0..100).map(layer).collect();
    for format in ["r11g11b10f", "rgb9e5"] {
        let off = |summation: &str| {
            let stored = [
                text("accumulation_format", format),
                text("revealage_format", "f64"),
                text("summation", summation),
            ];
            let exact = resolve("blended_oit", &[text("format", "f64")], &pixel);
            difference(resolve("blended_oit", &stored, &pixel), exact.color, exact.transmittance.x)
        };
        assert!(off("scaled_double") < 2e-3, "{format}: {:e}", off("scaled_double"));
        assert!(off("scaled_double") < off("plain"), "{format}");
        assert!(off("compensated") < off("plain"), "{format}");
    }
}

/// An opaque layer whose weight is beyond halves has no colour left, but covers.
#[test]
fn what_has_lost_its_color_still_covers() {
    let lost = [text("format", "f16"), text("weight", "inv_pow")];
    let got = resolve("wboit", &lost, &[fragment(100.0, [0.1, 0.5, 0.1], 1.0, 0)]);
    assert_eq!((got.color, got.transmittance), (DVec3::ZERO, DVec3::ZERO));
}
