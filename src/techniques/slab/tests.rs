#![expect(clippy::cast_precision_loss, clippy::cast_possible_wrap, reason = "small counts")]

use super::*;
use crate::continuum::layers::{Node, Stored};
use crate::continuum::masks::Mask;
use crate::fragments::Fragment;
use crate::order::sort_key;
use crate::params::Input;
use crate::techniques::statistics::{SEEDS, SIGNIFICANT, Sampled, assert_mean, over_seeds};
use crate::techniques::testing::{
    BACKGROUND, F32_STATE, Scene, as_pixel, assert_close, build, fragment, over, random_pixel, resolve,
    resolve_all, three_layers,
};
use glam::{DVec3, Vec3};

type Inputs = Vec<(&'static str, Input)>;

fn sizes(layers: usize, bits: usize) -> Inputs {
    vec![("layers", Input::Int(layers as i64)), ("bits", Input::Int(bits as i64))]
}

fn with(mut inputs: Inputs, texts: &[(&'static str, &str)]) -> Inputs {
    inputs.extend(texts.iter().map(|(name, text)| (*name, Input::Text((*text).into()))));
    inputs
}

fn seeded(mut inputs: Inputs, seed: usize) -> Inputs {
    inputs.push(("seed", Input::Int(seed as i64)));
    inputs
}

fn background() -> DVec3 {
    Vec3::from(BACKGROUND).as_dvec3()
}

const STORED: &[(&str, &str)] = &[("accumulate", "stored")];
const UNCORRECTED: &[(&str, &str)] = &[("correction", "none")];
const TAIL: &[(&str, &str)] = &[("correction", "tail")];
const ALPHA: &[(&str, &str)] = &[("variant", "alpha")];

fn scene() -> Scene {
    let coincident = |i: u8| fragment(2.0, [0.9, 0.1 * f32::from(i), 0.2], 0.4, i.into());
    vec![three_layers(), random_pixel(5, 3), random_pixel(12, 4), (0..4).map(coincident).collect()]
}

#[test]
fn with_a_layer_for_every_bit_it_is_unbiased() {
    for probability in ["stratified", "random"] {
        for texts in [STORED, UNCORRECTED] {
            let inputs = with(with(sizes(5, 5), texts), &[("probability", probability)]);
            assert_mean("slab", &inputs, &scene(), over);
        }
    }
}

#[test]
fn with_fewer_layers_it_lets_too_much_through() {
    let pixel = vec![(0..6_u8).map(|i| fragment(f32::from(i), [1.0; 3], 0.3, i.into())).collect::<Vec<_>>()];
    let exact = over(&pixel[0]);
    for layers in [1, 2] {
        let sampled = over_seeds("slab", &with(sizes(layers, 8), STORED), &pixel, SEEDS)[0];
        assert!(sampled.mean.w - exact.1 > SIGNIFICANT * sampled.error.w, "{layers}: {sampled:?}");
    }
}

/// What three layers of alpha 1/2 let through on average: every way of inserting them, weighed.
fn expected_transmittance(bits: usize) -> f64 {
    let visibility = Visibility::new(bits, true);
    (0..8_u32)
        .map(|choice| {
            let (mut weight, mut transmittance) = (1.0, 1.0);
            for layer in 0..3 {
                let probability = visibility.of(|| 1.0 - transmittance, 0.5);
                let inserted = choice >> layer & 1 == 1;
                weight *= if inserted { probability } else { 1.0 - probability };
                transmittance *= if inserted { 0.5 } else { 1.0 };
            }
            weight * transmittance
        })
        .sum()
}

/// Sheet 2.6: alphas are biased at finite b, even with room for every layer.
#[test]
fn alphas_are_biased() {
    const COPIES: usize = 8;
    let layer = |i: u8| fragment(f32::from(i), [1.0; 3], 0.5, i.into());
    let scene = vec![(0..3).map(layer).collect::<Vec<_>>(); COPIES];
    for (bits, printed, digits) in [(4, 0.205, 3), (8, 0.153, 3), (16, 0.130, 3), (32, 0.1252, 4)] {
        let expected = expected_transmittance(bits);
        assert!((expected - printed).abs() < 0.5 * 0.1_f64.powi(digits), "{bits}: {expected}");
        let sampled = over_seeds("slab", &with(with(sizes(8, bits), STORED), ALPHA), &scene, SEEDS);
        let mean = sampled.iter().map(|s| s.mean.w).sum::<f64>() / COPIES as f64;
        let error = sampled[0].error.w / (COPIES as f64).sqrt();
        assert!((mean - expected).abs() < SIGNIFICANT * error, "{bits}: {mean} for {expected}");
        assert!(bits == 32 || mean - 0.125 > SIGNIFICANT * error, "{bits}: {mean} ± {error}");
    }
}

/// Sheet section 3, identity 6.
#[test]
fn with_as_many_layers_as_bits_it_is_stochastic_transparency_bit_for_bit() {
    let stochastic = |samples: usize, random: bool, correction, mode, seed| {
        let inputs = vec![("samples", Input::Int(samples as i64)), ("stratified", Input::Bool(!random))];
        let inputs = seeded(with(inputs, &[("correction", correction), ("mode", mode)]), seed);
        resolve_all("stochastic_transparency", &inputs, &scene())
    };
    for (seed, bits) in [1, 8, 33, 64, 65, 200].into_iter().enumerate() {
        for (random, probability) in [(false, "stratified"), (true, "random")] {
            let slab = |texts: &[(&'static str, &str)]| {
                let inputs = with(with(sizes(bits, bits), texts), &[("probability", probability)]);
                resolve_all("slab", &seeded(inputs, seed), &scene())
            };
            let color = stochastic(bits, random, "none", "color", seed);
            assert_eq!(slab(STORED), color);
            assert_eq!(slab(&[]), stochastic(bits, random, "alpha", "depth", seed));
            // the template composites the background with T̂(∞), stochastic transparency with R
            let depth = stochastic(bits, random, "none", "depth", seed);
            for ((slab, depth), color) in slab(UNCORRECTED).iter().zip(&depth).zip(&color) {
                let behind = color.transmittance - depth.transmittance;
                assert_eq!(slab.transmittance, color.transmittance);
                assert_close(*slab, depth.color + behind * background(), color.transmittance.x, 1e-15);
            }
        }
    }
}

#[test]
fn without_limit_every_fragment_enters() {
    let unlimited = |layers, texts| with(with(sizes(layers, 0), texts), ALPHA);
    for pixel in scene() {
        let (color, transmittance) = over(&pixel);
        for texts in [STORED, UNCORRECTED, TAIL, &[]] {
            assert_close(resolve("slab", &unlimited(64, texts), &pixel), color, transmittance, F32_STATE);
        }
        // the uncorrected second pass adds everything behind the layers at full weight
        let mut sorted = pixel.clone();
        sorted.sort_by_key(|f| sort_key(f.depth, f.primitive));
        let (near, left) = over(&sorted[..2]);
        let behind: DVec3 = sorted[2..].iter().map(|f| Vec3::from(f.color).as_dvec3()).sum();
        let got = resolve("slab", &unlimited(2, UNCORRECTED), &pixel);
        assert_close(got, near + left * behind, left, F32_STATE);
    }
}

/// Sheet section 3, identity 6: the second pass adds in the order of the list, so hybrid's is sorted too.
#[test]
fn without_limit_it_is_peeling_or_hybrid_transparency() {
    let scene: Scene = (1..=30).map(|n| random_pixel(2 * n, u64::from(n) + 60)).collect();
    for layers in [1, 2, 4, 8] {
        let slab = |texts| resolve_all("slab", &with(with(sizes(layers, 0), texts), ALPHA), &scene);
        let twin = |id, texts: &[(&'static str, &str)]| {
            let inputs = with(vec![("layers", Input::Int(layers as i64))], texts);
            resolve_all(id, &with(inputs, &[("submission_order", "sorted")]), &scene)
        };
        assert_eq!(slab(STORED), twin("multilayer_depth_peeling", &[]));
        assert_eq!(slab(TAIL), twin("hybrid_transparency", &[]));
        let global = twin("hybrid_transparency", &[("correction", "global")]);
        for (slab, hybrid) in slab(&[]).iter().zip(global) {
            assert_close(*slab, hybrid.color, hybrid.transmittance.x, F32_STATE);
        }
    }
}

#[test]
fn masks_have_bits() {
    let message = build("slab", &sizes(4, 0)).err().unwrap().to_string();
    assert!(message.contains("slab") && message.contains("variant=\"alpha\""), "{message}");
}

/// A primitive whose mask at seed 0 is the wanted one of 4 bits.
fn with_mask(depth: f32, bits: u32, unused: std::ops::Range<u32>) -> Fragment {
    let alpha = bits.count_ones() as f32 / 4.0;
    let masks = RandomMasks { bits: 4, stratified: true, seed: 0 };
    let has = |primitive: &u32| {
        let mut mask = Mask::<OneWord>::default();
        masks.draw(0, 0, *primitive, alpha, &mut mask);
        (0..4).all(|i| mask.has(i) == (bits >> i & 1 == 1))
    };
    let primitive = unused.into_iter().find(has).unwrap();
    fragment(depth, [1.0; 3], alpha, primitive)
}

/// The depths that two layers hold in the end.
fn stored_depths(stream: &[Fragment]) -> Vec<f32> {
    let masks = RandomMasks { bits: 4, stratified: true, seed: 0 };
    let layers = Stream {
        insertion: VisibleSamples,
        merge: DiscardFurthest,
        opacity: Coverage::<OneWord>::new(masks),
        layers: 2,
    };
    let mut stored = Stored::default();
    as_pixel(stream, |pixel| layers.store(pixel, &mut stored));
    stored.nodes.iter().map(Node::depth).collect()
}

/// Sheet R15: what two layers keep depends on when they get it.
#[test]
fn as_submitted_hidden_layers_keep_their_place() {
    let a = with_mask(3.0, 0b0010, 0..1000);
    let b = with_mask(2.0, 0b0001, 1000..2000);
    let c = with_mask(4.0, 0b0100, 2000..3000);
    let d = with_mask(1.0, 0b0011, 3000..4000);
    assert_eq!(stored_depths(&[a, b, c, d]), [1.0, 2.0]);
    assert_eq!(stored_depths(&[d, a, b, c]), [1.0, 4.0]);
    let image = |stream: &[Fragment], replay| {
        let inputs = with(with(sizes(2, 4), STORED), &[("replay", replay)]);
        resolve("slab", &inputs, stream).transmittance.x
    };
    // b is hidden by d, so one layer shows nothing and c's sample is lost
    assert_eq!([image(&[a, b, c, d], "as_is"), image(&[d, a, b, c], "as_is")], [0.5, 0.25]);
    assert_eq!([image(&[a, b, c, d], "sorted"), image(&[d, a, b, c], "sorted")], [0.25, 0.25]);
}

#[test]
fn nothing_enters_behind_an_opaque_layer() {
    let mut pixel = random_pixel(30, 5);
    pixel.push(fragment(0.5, [0.2, 0.4, 0.6], 1.0, 70_000));
    let exact = over(&pixel);
    for (variant, seed) in [("mask", 0), ("alpha", 0), ("mask", 1), ("alpha", 1)] {
        for texts in [STORED, UNCORRECTED, TAIL, &[]] {
            let inputs = seeded(with(with(sizes(4, 8), texts), &[("variant", variant)]), seed);
            assert_close(resolve("slab", &inputs, &pixel), exact.0, exact.1, F32_STATE);
        }
    }
    let chance = VisibleByChance { probability: Visibility::new(8, true), seed: 0 };
    let layers = Stream { insertion: chance, merge: DiscardFurthest, opacity: Alpha, layers: 8 };
    let mut stored = Stored::default();
    pixel.sort_by_key(|f| sort_key(f.depth, f.primitive));
    as_pixel(&pixel, |pixel| layers.store(pixel, &mut stored));
    assert_eq!((stored.nodes.len(), stored.lost.len()), (1, pixel.len() - 1));
}

/// W16 Figure 7, foliage of alpha .75 in eight layers: with bits, noise falls as 1 / sqrt(b) and the mean goes to
/// what hybrid transparency makes of the layers.
#[test]
fn more_bits_make_less_noise_and_leave_the_bias_of_the_layers() {
    let shades = [[0.9, 0.2, 0.1], [0.1, 0.8, 0.3], [0.2, 0.1, 0.7], [0.8, 0.7, 0.1], [0.1, 0.6, 0.6]];
    let leaf = |i: u8| fragment(f32::from(i), shades[usize::from(i) % 5], 0.75, i.into());
    let scene = vec![(0..12).map(leaf).collect::<Vec<_>>()];
    let hybrid = [("layers", Input::Int(8)), ("correction", Input::Text("global".into()))];
    let limit = resolve("hybrid_transparency", &hybrid, &scene[0]);
    let limit = (limit.color, limit.transmittance.x);
    let [coarse, medium, fine] =
        [8, 32, 128].map(|bits| over_seeds("slab", &sizes(8, bits), &scene, SEEDS / 4)[0]);
    let noise = |sampled: Sampled| sampled.variance.truncate().element_sum().sqrt();
    for (more, less) in [(coarse, medium), (medium, fine)] {
        assert!((noise(more) / noise(less) - 2.0).abs() < 0.2, "{more:?} {less:?}");
    }
    // a normalised mean is biased at eight bits, and at 128 by less than its noise
    assert!(coarse.score(limit) > 1.5 * fine.score(limit), "{coarse:?} {fine:?}");
    assert!(fine.score(limit) < SIGNIFICANT && noise(fine) < 0.02, "{fine:?}");
}

/// W16 Figure 8: b = 32, more layers.
#[test]
fn error_falls_with_layers() {
    let scene: Scene = (0..6).map(|seed| random_pixel(10, 40 + seed)).collect();
    let error = |layers| {
        let inputs = with(sizes(layers, 32), STORED);
        let mut sum = 0.0;
        for seed in 0..64 {
            for (got, pixel) in resolve_all("slab", &seeded(inputs.clone(), seed), &scene).iter().zip(&scene)
            {
                sum += (got.color - over(pixel).0).length_squared();
            }
        }
        (sum / (64.0 * 6.0)).sqrt()
    };
    let errors = [1, 2, 4, 8].map(error);
    assert!(errors.windows(2).all(|e| e[1] < e[0]), "{errors:?}");
}

#[test]
fn transmittance_is_that_of_the_layers() {
    let pixel = three_layers();
    for texts in [STORED, UNCORRECTED, TAIL, &[]] {
        let technique = build("slab", &with(with(sizes(2, 0), texts), ALPHA)).unwrap();
        let steps = as_pixel(&pixel, |pixel| technique.transmittance(pixel, &[2.0, 3.0, 5.0, 9.0])).unwrap();
        assert_eq!(steps, [1.0, 0.75, 0.375, 0.375]);
        // alphas of 1/4, 1/2 and 3/4 are whole numbers of 64 bits
        let technique = build("slab", &with(sizes(3, 64), texts)).unwrap();
        let steps = as_pixel(&pixel, |pixel| technique.transmittance(pixel, &[2.0, 3.0, 9.0])).unwrap();
        assert_eq!(steps[..2], [1.0, 0.75]);
        assert_eq!(steps[2], (steps[2] * 64.0).round() / 64.0);
    }
}

/// W16 section 4: four layers of 32 bits take as much as eight depth samples.
#[test]
fn costs_are_the_papers() {
    let complexity = DepthComplexity { mean: 3.0, max: 9 };
    let cost = |inputs: &Inputs| {
        let cost = build("slab", inputs).unwrap().cost(&complexity);
        (cost.geometry_passes, cost.bytes_per_pixel)
    };
    let half = [("accumulation_format", "f16"), ("revealage_format", "f16")];
    assert_eq!(cost(&sizes(4, 32)), (2.0, 8.0 * 4.0 + 20.0));
    assert_eq!(cost(&with(sizes(4, 96), &half)), (2.0, 16.0 * 4.0 + 10.0));
    assert_eq!(cost(&with(sizes(4, 32), ALPHA)), (2.0, 52.0));
    assert_eq!(cost(&with(with(sizes(4, 32), ALPHA), &[("format", "f16")])), (2.0, 26.0));
    let bytes = [("node_color_format", "unorm8")];
    let stored = with(sizes(4, 32), STORED);
    assert_eq!(
        [&[][..], &bytes].map(|formats| cost(&with(stored.clone(), formats))),
        [(1.0, 96.0), (1.0, 48.0)]
    );
    let alpha = with(stored, ALPHA);
    assert_eq!(
        [&[][..], &bytes].map(|formats| cost(&with(alpha.clone(), formats))),
        [(1.0, 80.0), (1.0, 32.0)]
    );
}
