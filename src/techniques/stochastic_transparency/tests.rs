#![expect(clippy::cast_precision_loss, clippy::cast_possible_wrap, reason = "small counts")]

use super::*;
use crate::continuum::masks::Mask;
use crate::params::Input;
use crate::techniques::statistics::{SEEDS, SIGNIFICANT, assert_mean, over_seeds};
use crate::techniques::testing::{
    BACKGROUND, F32_STATE, Random, Scene, as_pixel, assert_close, build, fragment, over, random_pixel,
    resolve, resolve_all, three_layers,
};
use glam::{DVec3, Vec3};

type Inputs = Vec<(&'static str, Input)>;

fn variant(samples: usize, stratified: bool, correction: &str, mode: &str) -> Inputs {
    vec![
        ("samples", Input::Int(samples as i64)),
        ("stratified", Input::Bool(stratified)),
        ("correction", Input::Text(correction.into())),
        ("mode", Input::Text(mode.into())),
    ]
}

fn seeded(mut inputs: Inputs, seed: usize) -> Inputs {
    inputs.push(("seed", Input::Int(seed as i64)));
    inputs
}

fn background() -> DVec3 {
    Vec3::from(BACKGROUND).as_dvec3()
}

/// A few pixels, equal depths and opaque fragments among them.
fn scene() -> Scene {
    let coincident = |i: u8| fragment(2.0, [0.9, 0.1 * f32::from(i), 0.2], 0.4, i.into());
    vec![three_layers(), random_pixel(5, 3), random_pixel(12, 4), (0..4).map(coincident).collect()]
}

#[test]
fn the_mean_over_seeds_is_over() {
    for (stratified, mode) in [(true, "color"), (false, "color"), (true, "depth"), (false, "depth")] {
        assert_mean("stochastic_transparency", &variant(5, stratified, "none", mode), &scene(), over);
    }
}

#[test]
fn the_mean_keeps_emission_in_depth_mode() {
    let mut pixel = random_pixel(4, 7);
    pixel.push(Fragment { depth: 8.5, color: [0.5, 1.0, 2.0], alpha: 0.0, primitive: 70_000 });
    assert_mean("stochastic_transparency", &variant(6, true, "none", "depth"), &vec![pixel], over);
}

/// Each sample on its own, in arrival order, as the depth test of hardware would have it.
fn sample_by_sample(pixel: &[Fragment], masks: &RandomMasks) -> (DVec3, f64) {
    let mut samples = vec![((f32::INFINITY, u32::MAX), background()); masks.bits];
    for f in pixel {
        let mut mask = Mask::<ManyWords>::default();
        masks.draw(0, 0, f.primitive, f.alpha, &mut mask);
        for (s, sample) in samples.iter_mut().enumerate() {
            if mask.has(s) && (f.depth, f.primitive) < sample.0 {
                *sample = ((f.depth, f.primitive), unmultiplied(f));
            }
        }
    }
    let open = samples.iter().filter(|s| s.0.0 == f32::INFINITY).count();
    let mean = samples.iter().map(|s| s.1).sum::<DVec3>() / masks.bits as f64;
    (mean, open as f64 / masks.bits as f64)
}

#[test]
fn samples_met_front_to_back_are_those_of_a_depth_test() {
    for n in [1, 2, 5, 13, 40] {
        for samples in [1, 8, 64, 100, 300] {
            let stratified = n % 2 == 0;
            let masks = RandomMasks { bits: samples, stratified, seed: 5 };
            let pixel = random_pixel(n, 900 + u64::from(n));
            let inputs = seeded(variant(samples, stratified, "none", "color"), 5);
            let (color, transmittance) = sample_by_sample(&pixel, &masks);
            let got = resolve("stochastic_transparency", &inputs, &pixel);
            assert_close(got, color, transmittance, 1e-13);
        }
    }
}

#[test]
fn a_stratified_layer_of_whole_samples_has_no_noise() {
    let pixel = vec![fragment(2.0, [0.9, 0.2, 0.5], 0.375, 0)];
    let (color, transmittance) = over(&pixel);
    for (seed, mode) in (0..50).flat_map(|s| [(s, "color"), (s, "depth")]) {
        let got = resolve("stochastic_transparency", &seeded(variant(8, true, "none", mode), seed), &pixel);
        assert_close(got, color, transmittance, F32_STATE);
    }
}

#[test]
fn opaque_fragments_are_exact() {
    let mut pixel = random_pixel(20, 3);
    for f in &mut pixel {
        *f = fragment(f.depth, f.color, 1.0, f.primitive);
    }
    let (color, transmittance) = over(&pixel);
    for (correction, mode) in [("none", "color"), ("none", "depth"), ("alpha", "color"), ("alpha", "depth")] {
        for stratified in [false, true] {
            let got = resolve("stochastic_transparency", &variant(8, stratified, correction, mode), &pixel);
            assert_close(got, color, transmittance, F32_STATE);
        }
    }
}

#[test]
fn permutations_leave_the_image_of_each_seed_as_it_is() {
    let mut random = Random::new(1);
    let mut pixel = random_pixel(30, 6);
    for seed in 0..40 {
        for (correction, mode) in [("none", "color"), ("none", "depth"), ("alpha", "depth")] {
            let inputs = seeded(variant(16, seed % 2 == 0, correction, mode), seed);
            let before = resolve("stochastic_transparency", &inputs, &pixel);
            random.shuffle(&mut pixel);
            assert_eq!(resolve("stochastic_transparency", &inputs, &pixel), before);
        }
    }
}

/// Sheet 2.6: Var T̂ = T (1 − T) / S for independent samples, so four times as many halve the noise.
#[test]
fn noise_falls_with_the_root_of_samples() {
    let pixel = vec![random_pixel(6, 21)];
    let transmittance = over(&pixel[0]).1;
    for samples in [4, 16, 64] {
        let inputs = variant(samples, false, "none", "color");
        let variance = over_seeds("stochastic_transparency", &inputs, &pixel, SEEDS)[0].variance.w;
        let law = transmittance * (1.0 - transmittance) / samples as f64;
        // the standard error of a variance is sqrt((kurtosis − 1) / n) of it; kurtosis is at most 3 + 1 / (4 law)
        let error = ((2.0 + 0.25 / (law * (samples as f64).powi(2))) / SEEDS as f64).sqrt();
        assert!((variance / law - 1.0).abs() < SIGNIFICANT * error, "{samples}: {variance} for {law}");
    }
}

/// Stratified samples of one layer: only the rounding of a S is random.
#[test]
fn stratification_takes_noise_away() {
    let pixel = vec![vec![fragment(2.0, [1.0; 3], 0.3, 0)]];
    let inputs = variant(8, true, "none", "color");
    let variance = over_seeds("stochastic_transparency", &inputs, &pixel, SEEDS)[0].variance.w;
    let law = 0.4 * 0.6 / 64.0;
    assert!((variance / law - 1.0).abs() < 0.05, "{variance} for {law}");
}

/// Weights of layers of alpha .3, .6, .5, .8, .4, over many seeds in that many pixels.
fn weights(inputs: &Inputs, pixels: usize) -> [f64; 5] {
    let mut weights = [0.0; 5];
    for (first, take) in [(0_u8, 3), (3, 2)] {
        let layer = |(i, alpha): (u8, f32)| {
            let rgb = [0, 1, 2].map(|channel| f32::from(u8::from(i == first + channel)));
            fragment(f32::from(i), rgb, alpha, i.into())
        };
        let scene = vec![(0..).zip([0.3, 0.6, 0.5, 0.8, 0.4]).map(layer).collect::<Vec<_>>(); pixels];
        for seed in 0..SEEDS / 8 {
            for got in resolve_all("stochastic_transparency", &seeded(inputs.clone(), seed), &scene) {
                let own = got.color - got.transmittance * background();
                (0..take)
                    .for_each(|i| weights[usize::from(first) + i] += own[i] / (SEEDS / 8 * pixels) as f64);
            }
        }
    }
    weights
}

/// Sheet 2.6: the corrected weights of five layers at S = 8, against the exact ones.
#[test]
fn correction_is_biased_at_few_samples_and_consistent() {
    // three digits are printed; the mean of 32768 draws is known to about 0.001
    let tolerance = 0.003;
    let exact = [0.3, 0.42, 0.14, 0.112, 0.0112];
    let corrected = weights(&variant(8, true, "alpha", "depth"), 64);
    for (got, printed) in corrected.iter().zip([0.305, 0.425, 0.138, 0.105, 0.010]) {
        assert!((got - printed).abs() < tolerance, "{corrected:?}");
    }
    assert!(exact[3] - corrected[3] > 0.004, "{corrected:?}");
    let fine = weights(&variant(512, true, "alpha", "depth"), 4);
    assert!(fine.iter().zip(exact).all(|(got, exact)| (got - exact).abs() < 0.001), "{fine:?}");
}

#[test]
fn a_correction_without_a_covered_sample_leaves_the_background_its_share() {
    // seed 0 rounds 0.001 of 8 samples down
    let pixel = vec![fragment(2.0, [1.0; 3], 0.001, 0)];
    let got = resolve("stochastic_transparency", &variant(8, true, "alpha", "color"), &pixel);
    let left = over(&pixel).1;
    assert_close(got, left * background(), left, 1e-15);
}

#[test]
fn transmittance_counts_samples_and_the_nearest_fragment_is_unoccluded() {
    let pixel = random_pixel(9, 31);
    let nearest = pixel.iter().map(|f| f.depth).fold(f32::INFINITY, f32::min);
    for mode in ["color", "depth"] {
        let technique = build("stochastic_transparency", &variant(8, true, "none", mode)).unwrap();
        let depths: Vec<_> = std::iter::once(nearest).chain((0..40).map(|i| i as f32 * 0.25)).collect();
        let steps = as_pixel(&pixel, |pixel| technique.transmittance(pixel, &depths)).unwrap();
        assert_eq!(steps[0], 1.0);
        assert!(steps[1..].windows(2).all(|w| w[0] >= w[1]), "{steps:?}");
        assert!(steps.iter().all(|t| (t * 8.0).fract() == 0.0), "{steps:?}");
        let end = resolve("stochastic_transparency", &variant(8, true, "none", "color"), &pixel);
        assert_eq!(steps[40], end.transmittance.x);
    }
}

/// W16 Figures 1 and 2: 16 samples, four fragments of alpha .5 in the order red, blue, green, yellow.
#[test]
fn the_worked_pixel_of_wyman() {
    let layer = |z, key| fragment(z, [1.0; 3], 0.5, key);
    let pixel = [layer(0.5, 0), layer(0.7, 1), layer(0.3, 2), layer(0.9, 3)];
    let (mut held, mut hidden) = ([0_usize; 4], 0_usize);
    let mut test = DepthTest::<OneWord>::default();
    for seed in 0..SEEDS as u64 {
        let masks = RandomMasks { bits: 16, stratified: true, seed };
        let mut yellow = false;
        as_pixel(&pixel, |pixel| {
            test.run(&masks, pixel, |f, visible| {
                held[f.primitive as usize] += visible;
                yellow |= f.primitive == 3;
            });
        });
        hidden += usize::from(!yellow);
    }
    // red, blue, green hold 4, 2, 8 samples; 2 stay open, of which yellow takes 1
    for (held, expected) in held.iter().zip([4.0, 2.0, 8.0, 1.0]) {
        let mean = *held as f64 / SEEDS as f64;
        // no count varies by more than 1.5 samples
        assert!((mean - expected).abs() < SIGNIFICANT * 1.5 / (SEEDS as f64).sqrt(), "{mean} for {expected}");
    }
    let share = hidden as f64 / SEEDS as f64;
    let error = (0.3 * 0.7 / SEEDS as f64).sqrt();
    assert!((share - 0.30).abs() < SIGNIFICANT * error, "{share}");
}

#[test]
fn costs_count_samples() {
    let complexity = DepthComplexity { mean: 3.0, max: 9 };
    let cost = |correction, mode| {
        let technique = build("stochastic_transparency", &variant(8, true, correction, mode)).unwrap();
        let cost = technique.cost(&complexity);
        (cost.geometry_passes, cost.bytes_per_pixel)
    };
    assert_eq!([cost("none", "color"), cost("alpha", "color")], [(1.0, 160.0), (2.0, 164.0)]);
    assert_eq!([cost("none", "depth"), cost("alpha", "depth")], [(2.0, 52.0); 2]);
}

#[test]
fn a_million_samples() {
    let (color, transmittance) = over(&three_layers());
    let got = resolve("stochastic_transparency", &variant(1 << 20, true, "none", "color"), &three_layers());
    // stratified noise is below that of independent samples, 0.5 / sqrt(S)
    assert_close(got, color, transmittance, SIGNIFICANT * 0.5 / 1024.0);
}
