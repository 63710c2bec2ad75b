//! What layered weighted blending does to pixels worked out by hand, and to random ones.

use crate::fragments::Fragment;
use crate::params::Input;
use crate::technique::{DepthComplexity, Resolved};
use crate::techniques::testing::{
    BACKGROUND, F32_STATE, Random, assert_close, build, difference, fragment, over, random_pixel, resolve,
    resolve_all, three_layers,
};
use glam::{DVec3, Vec3};

/// Params under construction.
pub(super) type Inputs = Vec<(&'static str, Input)>;

pub(super) trait With: Sized {
    fn with(self, name: &'static str, value: Input) -> Self;
    fn switch(self, name: &'static str, on: bool) -> Self {
        self.with(name, Input::Bool(on))
    }
    fn word(self, name: &'static str, value: &str) -> Self {
        self.with(name, Input::Text(value.into()))
    }
}

impl With for Inputs {
    fn with(mut self, name: &'static str, value: Input) -> Self {
        self.push((name, value));
        self
    }
}

pub(super) fn smooth(bins: i64) -> Inputs {
    vec![("bins", Input::Int(bins))]
}

pub(super) fn naive(bins: i64) -> Inputs {
    smooth(bins).switch("smooth", false)
}

fn absorbance(bins: i64) -> Inputs {
    smooth(bins).word("partition", "absorbance")
}

fn lwboit(inputs: &Inputs, pixel: &[Fragment]) -> Resolved {
    resolve("lwboit", inputs, pixel)
}

#[track_caller]
fn assert_over(inputs: &Inputs, pixel: &[Fragment], tolerance: f64) {
    let (color, transmittance) = over(pixel);
    assert_close(lwboit(inputs, pixel), color, transmittance, tolerance);
}

fn background() -> DVec3 {
    Vec3::from(BACKGROUND).as_dvec3()
}

/// What an opaque fragment of absorbance at most 10 lets through.
fn leak() -> f64 {
    (-10.0_f64).exp()
}

/// Pixels of six fragments at least 0.2 apart within the test view's range of 8.
fn separated_pixels(count: u64, alpha: impl Fn(&mut Random) -> f32) -> Vec<Vec<Fragment>> {
    let one = |seed| {
        let mut random = Random::new(seed);
        let mut depths: Vec<f32> = Vec::new();
        while depths.len() < 6 {
            let z = 1.0 + 8.0 * random.unit();
            if depths.iter().all(|d| (d - z).abs() >= 0.201) {
                depths.push(z);
            }
        }
        let mut layer = |(primitive, z)| {
            let rgb = [random.unit(), random.unit(), random.unit()];
            fragment(z, rgb, alpha(&mut random), primitive)
        };
        (0..).zip(depths).map(&mut layer).collect()
    };
    (0..count).map(one).collect()
}

fn clear(random: &mut Random) -> f32 {
    0.05 + 0.9 * random.unit()
}

fn often_opaque(random: &mut Random) -> f32 {
    if random.unit() < 0.4 { 1.0 } else { clear(random) }
}

#[expect(clippy::cast_precision_loss, reason = "some hundred pixels")]
fn rmse(inputs: &Inputs, pixels: &[Vec<Fragment>]) -> f64 {
    let images = resolve_all("lwboit", inputs, pixels);
    let errors = images.iter().zip(pixels).map(|(got, pixel)| (got.color - over(pixel).0).length_squared());
    (errors.sum::<f64>() / (3.0 * pixels.len() as f64)).sqrt()
}

#[test]
fn one_layer_is_exact_under_every_switch_but_plain_smoothing() {
    for (partition, smooth_, normalize, shape) in (0..16)
        .map(|i| (if i & 8 == 0 { "none" } else { "absorbance" }, i & 4 == 0, i & 2 == 0, i & 1 == 0))
        .filter(|&(partition, smooth, normalize, _)| !smooth || normalize || partition == "absorbance")
    {
        for bins in [1, 2, 7, 32, 33, 512] {
            for z in [1.0, 1.1, 4.9, 5.0, 9.0] {
                let inputs = smooth(bins)
                    .switch("smooth", smooth_)
                    .switch("normalize", normalize)
                    .switch("shape", shape)
                    .word("partition", partition);
                assert_over(&inputs, &[fragment(z, [0.8, 0.3, 0.1], 0.6, 0)], F32_STATE);
                let leaks = if normalize || !smooth_ { F32_STATE } else { leak() + F32_STATE };
                assert_over(&inputs, &[fragment(z, [0.8, 0.3, 0.1], 1.0, 0)], leaks);
            }
        }
    }
}

#[test]
fn two_layers_by_hand() {
    // bins [1, 5) and [5, 9]; weight 1/z
    let inverse = |inputs: Inputs| inputs.word("weight", "inv_pow").with("weight_k", Input::Int(1));
    let (a, b) = (fragment(4.0, [1.0, 0.0, 0.0], 0.5, 0), fragment(2.0, [0.0, 1.0, 0.0], 0.25, 1));
    let shared = inverse(naive(2).switch("shape", false));
    let color = 0.625 * DVec3::new(0.125, 0.125, 0.0) / 0.25;
    assert_close(lwboit(&shared, &[a, b]), color + 0.375 * background(), 0.375, F32_STATE);
    let apart = [a, Fragment { depth: 5.0, ..b }];
    let color = DVec3::new(0.5, 0.125, 0.0);
    assert_close(lwboit(&shared, &apart), color + 0.375 * background(), 0.375, F32_STATE);
}

#[test]
fn three_layers_by_hand() {
    // bins [1, 5) and [5, 9]: depths 4 and 2 share the first, 8 lies in the second; no weights
    let inputs = naive(2).switch("shape", false).word("weight", "one");
    let near = 0.625 * DVec3::new(0.3, 0.525, 0.125) / 0.75;
    let color = near + 0.375 * DVec3::new(0.15, 0.075, 0.75);
    let got = lwboit(&inputs, &three_layers());
    assert_close(got, color + 0.093_75 * background(), 0.093_75, F32_STATE);
}

/// Sheet 2.4 and R3: what smoothing leaves of a lone fragment before normalisation.
#[test]
fn plain_smoothing_changes_coverage() {
    let covered = |position: f32, alpha, anchor: Option<&str>| {
        let inputs = smooth(8).switch("normalize", false).switch("shape", anchor.is_some());
        let inputs = inputs.word("shape_anchor", anchor.unwrap_or("center"));
        1.0 - lwboit(&inputs, &[fragment(1.0 + position, [1.0; 3], alpha, 0)]).transmittance.x
    };
    let cases = [
        (covered(3.5, 1.0, None), 1.0),
        (covered(4.0, 1.0, None), 0.751),
        (covered(3.5, 0.5, None), 0.531),
        (covered(4.0, 0.5, None), 0.439),
        (covered(3.3, 1.0, Some("center")), 1.0),
        (covered(3.3, 1.0, Some("edge")), 0.501),
    ];
    for (got, expected) in cases {
        assert!((got - expected).abs() < 6e-4, "{got} for {expected}");
    }
}

#[test]
fn one_smooth_bin_is_wboit_with_the_bells_weight() {
    for function in ["bell", "tent"] {
        let pixel = random_pixel(12, 21);
        let (mut color, mut alpha) = (DVec3::ZERO, 0.0);
        for f in &pixel {
            let x = (f64::from(f.depth) - 1.0) / 8.0 - 0.5;
            let b = if function == "bell" { (-4.0 * x * x).exp2() } else { 1.0 - x.abs() };
            let w = b * f64::from(f.depth).powi(-4);
            color += w * Vec3::from(f.color).as_dvec3();
            alpha += w * f64::from(f.alpha);
        }
        let transmittance = over(&pixel).1;
        let expected = (1.0 - transmittance) / alpha * color + transmittance * background();
        let inputs =
            smooth(1).switch("shape", false).word("bin_function", function).word("weight", "inv_pow");
        assert_close(lwboit(&inputs, &pixel), expected, transmittance, F32_STATE);
    }
}

/// Sheet 2.4 word for word, in f64 and over all bins: unshaped, weight 1/z.
fn by_definition(pixel: &[Fragment], bins: u16, tent: bool, split: bool, normalize: bool) -> DVec3 {
    let width = 8.0 / f64::from(bins);
    let function = |f: &Fragment, k: u16| {
        let x = (f64::from(f.depth) - 1.0) / width - (f64::from(k) + 0.5);
        let own = ((f64::from(f.depth) - 1.0) / width).floor().min(f64::from(bins - 1));
        match (tent, split && (f64::from(k) - own).abs() > 2.0) {
            (true, _) => (1.0 - x.abs()).max(0.0),
            (_, true) => 0.0,
            _ => (-4.0 * x * x).exp2(),
        }
    };
    let (mut color, mut transmittance) = (DVec3::ZERO, 1.0);
    for k in 0..bins {
        let (mut sum, mut alphas, mut left) = (DVec3::ZERO, 0.0, 1.0);
        for f in pixel {
            let (a, b) = (f64::from(f.alpha), function(f, k));
            let beta = b / (0..bins).map(|j| function(f, j)).sum::<f64>();
            let s = (-(1.0 - a).ln()).min(10.0);
            let part = match (split, a > 0.0) {
                (true, true) => (1.0 - (-beta * s).exp()) / a,
                (true, false) => beta,
                _ => b,
            };
            sum += part / f64::from(f.depth) * Vec3::from(f.color).as_dvec3();
            alphas += part / f64::from(f.depth) * a;
            left *= if split { (-beta * s).exp() } else { 1.0 - a * b };
        }
        if alphas > 0.0 {
            color += transmittance * (1.0 - left) * sum / alphas;
        }
        transmittance *= left;
    }
    if normalize {
        let exact = over(pixel).1;
        return color / (1.0 - transmittance) * (1.0 - exact) + exact * background();
    }
    color + transmittance * background()
}

#[test]
fn smooth_bins_are_what_the_definition_says() {
    for n in 1..12 {
        let mut pixel = random_pixel(n, u64::from(n) + 50);
        pixel.push(fragment(4.3, [0.9, 0.1, 0.4], 0.05, 77_000));
        pixel.push(Fragment { alpha: 0.0, ..fragment(4.4, [0.1, 0.1, 0.2], 1.0, 77_001) });
        for (bins, tent, split, normalize) in
            (0..24).map(|i| ([1, 4, 13][i / 8], i & 1 == 0, i & 2 == 0, i & 4 == 0))
        {
            let inputs = smooth(bins.into()).switch("shape", false).switch("normalize", normalize);
            let inputs = inputs.word("bin_function", if tent { "tent" } else { "bell" });
            let inputs = inputs.word("partition", if split { "absorbance" } else { "none" });
            let inputs = inputs.word("weight", "inv_pow").with("weight_k", Input::Int(1));
            let (got, expected) =
                (lwboit(&inputs, &pixel), by_definition(&pixel, bins, tent, split, normalize));
            assert_close(got, expected, got.transmittance.x, F32_STATE);
        }
    }
}

#[test]
fn bins_narrower_than_the_gaps_are_over() {
    let shaped = |inputs: Inputs, shape| inputs.switch("shape", shape);
    for pixel in separated_pixels(100, clear) {
        // naive: width < gap, 1.5 widths with the centre anchor, whose last bin is that wide
        assert_over(&shaped(naive(41), false), &pixel, F32_STATE);
        assert_over(&naive(41).word("shape_anchor", "edge"), &pixel, F32_STATE);
        assert_over(&shaped(naive(61), true), &pixel, F32_STATE);
        // absorbance: 5 widths (bell) or 2 (tent), one more with the centre anchor
        let tent = |inputs: Inputs| inputs.word("bin_function", "tent");
        for normalize in [true, false] {
            let switched = |inputs: Inputs| inputs.switch("normalize", normalize);
            assert_over(&switched(shaped(absorbance(201), false)), &pixel, F32_STATE);
            assert_over(&switched(shaped(absorbance(241), true)), &pixel, F32_STATE);
            assert_over(&switched(shaped(tent(absorbance(81)), false)), &pixel, F32_STATE);
            assert_over(&switched(shaped(tent(absorbance(121)), true)), &pixel, F32_STATE);
        }
    }
}

#[test]
fn opaque_layers_leak_what_s_max_says() {
    for pixel in separated_pixels(100, often_opaque) {
        let unshaped = absorbance(256).switch("shape", false);
        assert_over(&unshaped, &pixel, 6.0 * leak());
        assert_over(&unshaped.with("s_max", Input::Int(25)), &pixel, F32_STATE);
    }
}

/// The table of sheet 2.4, on other random pixels: six fragments, gaps of 0.2 in a range of 8, unshaped.
#[test]
fn errors_are_those_of_the_sheet() {
    const BINS: [i64; 5] = [8, 16, 32, 64, 128];
    let table = |inputs: fn(i64) -> Inputs, alpha: fn(&mut Random) -> f32| {
        let pixels = separated_pixels(400, alpha);
        BINS.map(|bins| rmse(&inputs(bins).switch("shape", false), &pixels))
    };
    let assert_near = |got: [f64; 5], expected: [f64; 5], factor: f64| {
        for (got, expected) in got.into_iter().zip(expected) {
            assert!(got < expected * factor && got > expected / factor, "{got} for {expected}");
        }
    };
    let tent = |bins| absorbance(bins).word("bin_function", "tent");
    let shared = table(absorbance, clear);
    assert_near(shared, [0.0302, 0.0188, 0.0064, 0.0007, shared[4]], 1.4);
    assert!(shared[4] < 1e-5);
    let shared = table(tent, clear);
    assert_near(shared, [0.0296, 0.0185, 0.0054, shared[3], shared[4]], 1.4);
    assert!(shared[3] < 1e-3 && shared[4] < 1e-7);
    let shared = table(absorbance, often_opaque);
    assert_near(shared, [0.064, 0.036, 0.013, 0.0018, shared[4]], 1.4);
    assert!(shared[4] < 1e-4);
    // the plateau of R3, and naive binning that has none
    assert_near(table(smooth, clear), [0.046, 0.036, 0.029, 0.024, 0.024], 1.2);
    let apart = table(naive, clear);
    assert_near(apart, [0.0306, 0.0205, apart[2], apart[3], apart[4]], 1.4);
    assert!(apart[2] < 0.01 && apart[3] < 1e-7 && apart[4] < 1e-7);
}

#[test]
fn shares_of_absorbance_keep_the_coverage_without_normalisation() {
    for n in 1..=20 {
        let mut pixel = random_pixel(n, n.into());
        for f in &mut pixel {
            f.alpha = f.alpha.min(0.99);
        }
        for bins in [1, 3, 32, 100] {
            let got = lwboit(&absorbance(bins).switch("normalize", false), &pixel);
            assert!((got.transmittance.x - over(&pixel).1).abs() < 1e-12, "{bins} bins: {got:?}");
        }
    }
}

#[test]
fn without_smoothing_the_partition_is_not_there() {
    let scene: Vec<_> = (1..20).map(|n| random_pixel(n, n.into())).collect();
    let partitioned = resolve_all("lwboit", &absorbance(8).switch("smooth", false), &scene);
    assert_eq!(partitioned, resolve_all("lwboit", &naive(8), &scene));
}

/// A layer that crosses a bin's edge in front of another jumps under naive binning, not under smooth ones.
#[test]
fn smooth_bins_have_no_seams() {
    let step = |inputs: Inputs| {
        let inputs = inputs.switch("shape", false);
        let at = |z| lwboit(&inputs, &[fragment(z, [1.0, 0.0, 0.0], 0.5, 0), three_layers()[2]]).color;
        (at(6.998) - at(7.002)).abs().max_element()
    };
    assert!(step(naive(4)) > 0.1);
    assert!(step(smooth(4)) < 1e-3);
    assert!(step(absorbance(4)) < 1e-3);
}

#[test]
fn bins_are_closed_in_front_and_the_last_one_behind_too() {
    // depth 3 opens bin 2 of [1, 3), [3, 5), [5, 7), [7, 9]; 9 and what is beyond it belong to bin 4
    let inputs = naive(4).switch("shape", false);
    let together = |a: f32, b: f32| {
        let pixel = [fragment(a, [1.0, 0.0, 0.0], 0.5, 0), fragment(b, [0.0, 1.0, 0.0], 0.5, 1)];
        difference(lwboit(&inputs, &pixel), over(&pixel).0, 0.25) > 1e-3
    };
    assert!(together(1.0, 2.999_999));
    assert!(!together(2.999_999, 3.0));
    assert!(together(3.0, 4.999_999));
    assert!(together(7.0, 9.0) && together(7.0, 20.0) && together(0.5, 1.5));
    assert!(!together(6.999_999, 9.0));
}

#[test]
fn equal_depths_are_treated_alike() {
    let (a, b) = (fragment(3.0, [1.0, 0.0, 0.5], 0.5, 0), fragment(3.0, [0.0, 1.0, 0.5], 0.5, 1));
    let got = lwboit(&smooth(16), &[a, b]).color - 0.25 * background();
    assert!((got.x - got.y).abs() < F32_STATE);
}

#[test]
fn a_shaped_image_does_not_depend_on_where_the_camera_stands() {
    for inputs in [smooth(16), absorbance(16), naive(16), smooth(16).word("shape_anchor", "edge")] {
        // depths and the shift are multiples of 1/64, so that the sums are exact in f32
        let mut pixel = random_pixel(20, 2);
        for f in &mut pixel {
            f.depth = (f.depth * 64.0).round() / 64.0;
        }
        let mut moved = pixel.clone();
        for f in &mut moved {
            f.depth += 1024.0;
        }
        assert_eq!(lwboit(&inputs, &pixel), lwboit(&inputs, &moved));
        let unshaped = inputs.switch("shape", false);
        assert_ne!(lwboit(&unshaped, &pixel), lwboit(&unshaped, &moved));
    }
}

#[test]
fn weights_see_the_shaped_depth() {
    // shaped at the edge of the first bin, z' is 0 and 2: weights (0 + 1)^-1 and (2 + 1)^-1
    let inputs = naive(1).word("shape_anchor", "edge").word("weight", "inv_pow");
    let inputs = inputs.with("weight_k", Input::Int(1)).with("weight_shift", Input::Int(1));
    let pixel = [fragment(5.0, [1.0, 0.0, 0.0], 0.5, 0), fragment(7.0, [0.0, 1.0, 0.0], 0.5, 1)];
    let color = DVec3::new(0.75 * 0.75, 0.75 * 0.25, 0.0);
    assert_close(lwboit(&inputs, &pixel), color + 0.25 * background(), 0.25, F32_STATE);
}

#[test]
fn ranges_are_the_scenes_the_pixels_or_given() {
    let inputs = |range: Input| naive(2).switch("shape", false).with("range", range);
    let pixel = [fragment(2.0, [1.0, 0.0, 0.0], 0.5, 0), fragment(4.0, [0.0, 1.0, 0.0], 0.5, 1)];
    let apart = |range| difference(lwboit(&inputs(range), &pixel), over(&pixel).0, 0.25) < F32_STATE;
    assert!(!apart(Input::Text("scene".into()))); // [1, 5), [5, 9]
    assert!(apart(Input::Text("pixel".into()))); // [2, 3), [3, 4]
    assert!(apart(Input::Floats(vec![1.0, 5.0])));
    assert!(!apart(Input::Floats(vec![1.0, 50.0])));
}

#[test]
fn lists_hold_what_bins_hold_until_they_are_full() {
    let mut pixel = random_pixel(10, 4);
    pixel.retain(|f| !f.is_zero());
    let lists = smooth(16).word("storage", "ll");
    assert_eq!(lwboit(&lists, &pixel), lwboit(&smooth(16), &pixel));
    let full = lwboit(&lists.clone().with("capacity", Input::Int(4)), &pixel);
    assert_eq!(Resolved { dropped: 0, ..full }, lwboit(&smooth(16), &pixel[..4]));
    assert_eq!(full.dropped, pixel.len() as u64 - 4);
    // a capacity is no param of layered rendering
    assert_eq!(lwboit(&smooth(16).with("capacity", Input::Int(4)), &pixel).dropped, 0);
}

#[test]
fn layered_rendering_costs_a_pass_per_batch_of_bins() {
    let complexity = DepthComplexity { mean: 3.0, max: 9 };
    let cost = |inputs: &Inputs| {
        let cost = build("lwboit", inputs).unwrap().cost(&complexity);
        (cost.geometry_passes, cost.bytes_per_pixel)
    };
    assert_eq!(cost(&smooth(32)), (3.0, 648.0));
    assert_eq!(cost(&smooth(33)), (4.0, 668.0));
    assert_eq!(cost(&smooth(512).switch("shape", false)), (17.0, 10_244.0));
    assert_eq!(cost(&naive(8).switch("shape", false).switch("normalize", false)), (1.0, 160.0));
    assert_eq!(cost(&smooth(512).word("storage", "ll")), (1.0, 76.0));
}

#[test]
fn inactive_params_do_not_tell_variants_apart() {
    let info = crate::techniques::find("lwboit").unwrap();
    let identity = |inputs: Inputs| {
        let inputs: Vec<_> = inputs.into_iter().map(|(n, v)| (n.to_owned(), v)).collect();
        crate::techniques::testing::params(info, &inputs).unwrap().identity()
    };
    assert_eq!(identity(naive(8).word("partition", "absorbance")), identity(naive(8)));
    assert_eq!(identity(smooth(8).with("s_max", Input::Int(20))), identity(smooth(8)));
    assert_eq!(identity(smooth(8).with("weight_k", Input::Int(2))), identity(smooth(8)));
    assert_ne!(identity(absorbance(8).with("s_max", Input::Int(20))), identity(absorbance(8)));
}
