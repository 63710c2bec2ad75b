//! Buckets by hand, and where they are exact.

use crate::fragments::Fragment;
use crate::params::Input;
use crate::technique::Resolved;
use crate::techniques::testing::{
    F32_STATE, Random, as_pixel, assert_close, build, fragment, over, random_pixel, resolve,
};
use glam::DVec3;

type Inputs<'a> = Vec<(&'a str, Input)>;

fn text<'a>(name: &'a str, value: &str) -> (&'a str, Input) {
    (name, Input::Text(value.into()))
}

/// Layers and mode, and for `min_depth` the thresholds that keep every fragment.
fn whole(layers: i64, mode: &str) -> Inputs<'_> {
    let mut inputs = vec![("layers", Input::Int(layers)), text("mode", mode)];
    if mode == "min_depth" {
        inputs.push(("front_threshold", Input::Float(-1.0)));
        inputs.push(("opaque_threshold", Input::Float(2.0)));
    }
    inputs
}

const MODES: [&str; 3] = ["min_depth", "depth", "transmittance"];

fn mlab_buckets(inputs: &[(&str, Input)], pixel: &[Fragment]) -> Resolved {
    resolve("mlab_buckets", inputs, pixel)
}

/// Transmittance just behind each whole depth from 0 to 9, as the stored layers have it.
fn steps(inputs: &[(&str, Input)], pixel: &[Fragment]) -> Vec<f64> {
    let depths: Vec<f32> = (0..10_u8).map(|z| f32::from(z) + 0.5).collect();
    let technique = build("mlab_buckets", inputs).unwrap();
    as_pixel(pixel, |pixel| technique.transmittance(pixel, &depths)).unwrap()
}

#[test]
fn one_depth_bucket_is_mlab() {
    for n in 1..=40 {
        let pixel = random_pixel(n, u64::from(n) + 40);
        for layers in [1, 2, 5] {
            let mut inputs = whole(layers, "depth");
            inputs.push(("buckets", Input::Int(1)));
            let mlab = resolve("mlab", &[("layers", Input::Int(layers))], &pixel);
            assert_eq!(mlab_buckets(&inputs, &pixel), mlab);
        }
    }
}

#[test]
fn without_overflow_it_is_over() {
    for n in [1, 2, 5, 12, 40] {
        let pixel = random_pixel(n, u64::from(n) + 60);
        let (color, transmittance) = over(&pixel);
        for mode in MODES {
            let got = mlab_buckets(&whole(i64::from(n) + 1, mode), &pixel);
            assert_close(got, color, transmittance, F32_STATE);
        }
    }
}

#[test]
fn ordered_streams_are_exact_in_every_mode() {
    for n in [3, 8, 30] {
        let mut pixel = random_pixel(n, u64::from(n) + 80);
        pixel.iter_mut().for_each(|f| f.alpha = f.alpha.min(0.9));
        let (color, transmittance) = over(&pixel);
        for (mode, order) in MODES.iter().flat_map(|m| ["sorted", "back_to_front"].map(|o| (*m, o))) {
            for layers in [1, 2, 4] {
                let mut inputs = vec![
                    ("layers", Input::Int(layers)),
                    text("mode", mode),
                    text("submission_order", order),
                    ("opaque_threshold", Input::Float(2.0)),
                ];
                for buckets in [1, 3] {
                    inputs.push(("buckets", Input::Int(buckets)));
                    let got = mlab_buckets(&inputs, &pixel);
                    assert_close(got, color, transmittance, F32_STATE);
                }
            }
        }
    }
}

#[test]
fn what_is_in_front_of_the_first_surface_shares_a_layer() {
    let at = |z: f32, alpha| fragment(z, [1.0; 3], alpha, 0);
    let pixel = [at(7.0, 0.5), at(2.0, 0.125), at(5.0, 0.5), at(1.0, 0.125), at(6.0, 0.5), at(3.0, 0.125)];
    let front = 0.875_f64.powi(3);
    let inputs = [("layers", Input::Int(3))];
    let expected =
        [1.0, front, front, front, front, front / 2.0, front / 8.0, front / 8.0, front / 8.0, front / 8.0];
    assert_eq!(steps(&inputs, &pixel), expected);
    // without a surface there is only that layer
    let faint = steps(&[("front_threshold", Input::Float(0.75))], &pixel);
    assert_eq!(faint[1..], [front / 8.0; 9]);
}

#[test]
fn what_is_behind_the_opaque_is_dropped_and_hardly_missed() {
    for (seed, threshold) in (0..20).zip([0.5, 0.8, 0.9, 0.98].into_iter().cycle()) {
        let pixel = random_pixel(20, seed);
        let room = |opaque| {
            let inputs = [
                ("layers", Input::Int(30)),
                ("front_threshold", Input::Float(-1.0)),
                ("opaque_threshold", Input::Float(opaque)),
            ];
            mlab_buckets(&inputs, &pixel)
        };
        let (all, some) = (room(2.0), room(threshold));
        let moved = (all.color - some.color).abs().max_element();
        assert!(moved <= 1.0 - threshold, "{threshold}: {moved}");
    }
}

#[test]
fn depth_buckets_keep_to_themselves() {
    // a logarithmic scale from 1 to 9 has its middle at 3
    let at = |z: f32| fragment(z, [1.0; 3], 0.5, 0);
    let pixel = [9.0, 1.0, 2.0, 2.5, 4.0].map(at);
    let inputs = [("layers", Input::Int(1)), text("mode", "depth"), ("buckets", Input::Int(2))];
    assert_eq!(steps(&inputs, &pixel)[..5], [1.0, 0.125, 0.125, 0.125, 0.03125]);
}

#[test]
fn a_dark_list_splits_before_the_newcomer() {
    let at = |z: f32| fragment(z, [1.0; 3], 0.75, 0);
    let inputs = |buckets, threshold| {
        vec![
            ("layers", Input::Int(2)),
            text("mode", "transmittance"),
            ("buckets", Input::Int(buckets)),
            ("transmittance_threshold", Input::Float(threshold)),
        ]
    };
    let t = 0.25_f64;
    // 5 splits {1, 5, 8} into {1} and {5, 8}, and 2 finds room behind 1
    let pixel = [1.0, 8.0, 5.0, 2.0].map(at);
    let all =
        [1.0, t, t.powi(2), t.powi(2), t.powi(2), t.powi(3), t.powi(3), t.powi(3), t.powi(4), t.powi(4)];
    assert_eq!(steps(&inputs(2, 0.1), &pixel), all);
    // one list, or one that is not dark enough, merges 5 and 8, then 2 with both
    let merged = [1.0, t, t.powi(4), t.powi(4)];
    assert_eq!(steps(&inputs(1, 0.1), &pixel)[..4], merged);
    assert_eq!(steps(&inputs(2, 0.001), &pixel)[..4], merged);
}

#[test]
fn buckets_save_layers_for_the_first_surfaces() {
    let mut random = Random::new(5);
    let mut errors = [DVec3::ZERO; 2];
    for seed in 0..40 {
        // many faint layers in front arrive after the surfaces
        let mut pixel = random_pixel(24, 500 + seed);
        for (i, f) in pixel.iter_mut().enumerate() {
            let (z, alpha) = if i < 6 { (6.0, 0.7) } else { (1.0, 0.05) };
            *f = fragment(z + 2.0 * random.unit(), f.color, alpha, f.primitive);
        }
        let exact = over(&pixel).0;
        let plain = resolve("mlab", &[], &pixel).color;
        for (error, got) in errors.iter_mut().zip([plain, mlab_buckets(&[], &pixel).color]) {
            *error += (got - exact).powf(2.0);
        }
    }
    assert!(errors[1].element_sum() < errors[0].element_sum(), "{errors:?}");
}
