use super::*;
use crate::params::{Input, View, check};

/// Relative error of an f32 formula of a dozen operations.
const F32_FORMULA: f64 = 2e-6;

fn weigh(formula: Formula, z: f32, a: f32) -> f64 {
    let mut weights = Vec::new();
    Weighting::new(Function::Published(formula), 1.0, 0.0).evaluate(&[z], &[a], &mut weights);
    f64::from(weights[0])
}

/// The table of sheet 2.4, in f64 and in its own words.
fn by_hand(formula: Formula, z: f64, a: f64, near: f64, far: f64) -> f64 {
    let d = (far * (z - near) / (z * (far - near))).clamp(0.0, 1.0);
    let mb = |x: f64| a * x.clamp(1e-2, 3e3);
    match formula {
        Formula::One => 1.0,
        Formula::Mb7 => mb(10.0 / (1e-5 + (z / 5.0).powi(2) + (z / 200.0).powi(6))),
        Formula::Mb8 => mb(10.0 / (1e-5 + (z / 10.0).powi(3) + (z / 200.0).powi(6))),
        Formula::Mb9 => mb(0.03 / (1e-5 + (z / 200.0).powi(4))),
        Formula::Mb10(_) => a * f64::max(1e-2, 3e3 * (1.0 - d).powi(3)),
        Formula::InvPow { k } => z.powf(-f64::from(k)),
        Formula::Exp { k } => (-f64::from(k) * z).exp(),
        Formula::Fig1 => (z + 5.0).powi(-2),
        Formula::Smoke6 => a * a * z.powi(-6),
        Formula::Fig10 { k } => 10.0 / (1.0 + 10.0 * (f64::from(k) * z).powi(5)),
        Formula::I3d16(_) => (1e3 * a * (1.0 - 0.99 * d).powi(3)).clamp(1e-2, 30.0),
    }
}

fn formulas(near: f64, far: f64) -> [Formula; 12] {
    let planes = Planes::new(near, far);
    [
        Formula::One,
        Formula::Mb7,
        Formula::Mb8,
        Formula::Mb9,
        Formula::Mb10(planes),
        Formula::InvPow { k: 4.0 },
        Formula::InvPow { k: 3.7 },
        Formula::Exp { k: 0.25 },
        Formula::Fig1,
        Formula::Smoke6,
        Formula::Fig10 { k: 0.01 },
        Formula::I3d16(planes),
    ]
}

#[test]
fn each_formula_is_the_papers() {
    let (near, far) = (0.5, 300.0);
    for formula in formulas(near, far) {
        for z in [0.01, 0.3, 0.5, 1.0, 1.5, 4.0, 30.0, 99.0, 157.0, 158.5, 264.0, 300.0, 500.0_f32] {
            for a in [0.01, 0.35, 1.0_f32] {
                let expected = by_hand(formula, z.into(), a.into(), near, far).max(1e-30);
                let got = weigh(formula, z, a);
                let error = (got / expected - 1.0).abs();
                assert!(error < F32_FORMULA, "{formula:?} z={z} a={a}: {got} for {expected}");
            }
        }
    }
}

/// Where each clamp of MB13 eq. 7 to 10 starts to act (sheet R11).
#[test]
fn clamps_act_where_the_sheet_says() {
    let (ceiling, floor) = (f64::from(3e3_f32), f64::from(1e-2_f32));
    let at = |formula, z| weigh(formula, z, 1.0);
    assert_eq!(at(Formula::Mb7, 0.288), ceiling);
    assert!(at(Formula::Mb7, 0.2888) < ceiling);
    assert!(at(Formula::Mb7, 158.0) > floor);
    assert_eq!(at(Formula::Mb7, 159.0), floor);
    assert_eq!(at(Formula::Mb8, 1.49), ceiling);
    assert!(at(Formula::Mb8, 1.50) < ceiling);
    assert!(at(Formula::Mb8, 99.8) > floor);
    assert_eq!(at(Formula::Mb8, 100.0), floor);
    assert!(at(Formula::Mb9, 2.0) < ceiling);
    assert!(at(Formula::Mb9, 263.0) > floor);
    assert_eq!(at(Formula::Mb9, 264.0), floor);
    let mb10 = Formula::Mb10(Planes::new(0.1, 100.0));
    assert!(at(mb10, 6.2) > floor);
    assert_eq!(at(mb10, 6.4), floor);
}

#[test]
fn scale_and_shift_move_the_depth_down_to_a_bound() {
    let mut weights = Vec::new();
    let weighting = Weighting::new(Function::Published(Formula::InvPow { k: 1.0 }), 2.0, -3.0);
    weighting.evaluate(&[2.0, 3.5, 0.0], &[1.0; 3], &mut weights);
    assert_eq!(weights, [1.0, 0.25, MIN_DEPTH.powf(-1.0)]);
}

#[test]
fn gentle_weights_forgive_a_unit_in_the_last_place_of_a_depth() {
    let steep = |formula: Formula| {
        let weighting = Weighting::new(Function::Published(formula), 1.0, 0.0);
        let depths: Vec<f32> = (0..20_000_u16).map(|i| 0.1 + 99.9 * f32::from(i) / 20_000.0).collect();
        let beside: Vec<f32> = depths.iter().map(|z| z.next_up()).collect();
        let (mut at, mut next) = (Vec::new(), Vec::new());
        weighting.evaluate(&depths, &vec![0.5; depths.len()], &mut at);
        weighting.evaluate(&beside, &vec![0.5; depths.len()], &mut next);
        let ulps = at.iter().zip(&next).map(|(a, b)| a.to_bits().abs_diff(b.to_bits()));
        (weighting.is_gentle(), ulps.max().unwrap())
    };
    for formula in formulas(0.1, 100.0) {
        let (gentle, ulps) = steep(formula);
        assert!(ulps <= 24 || !gentle, "{formula:?}: {ulps}");
        assert_eq!(gentle, !matches!(formula, Formula::Exp { .. }), "{formula:?}");
    }
    for formula in [Formula::InvPow { k: 60.0 }, Formula::Mb10(Planes::new(99.0, 100.0))] {
        let (gentle, ulps) = steep(formula);
        assert!(!gentle && ulps > 50, "{formula:?}: {ulps}");
    }
    let seen = |scale, shift| Weighting::new(Function::Published(Formula::Mb7), scale, shift).is_gentle();
    assert_eq!([seen(1.0, -4.99), seen(-1.0, 6.0), seen(9.0, 2.0)], [false, false, true]);
}

#[test]
fn weights_stay_within_their_bounds() {
    let depths = [0.0, 1e-30, 1.0, 1e10, 1e30, f32::MAX];
    let formulas = formulas(1e-30, 1e30).into_iter().chain([
        Formula::InvPow { k: 1e3 },
        Formula::InvPow { k: 1e-3 },
        Formula::Exp { k: 1e30 },
        Formula::Fig10 { k: 1e30 },
        Formula::Mb10(Planes::new(1.0, 1.0 + f64::EPSILON)),
        Formula::I3d16(Planes::new(1e300, 1e308)),
    ]);
    for formula in formulas {
        for (z, a) in depths.iter().flat_map(|&z| [0.0, 1e-30, 1.0].map(|a| (z, a))) {
            for (scale, shift) in [(1.0, 0.0), (1e300, -1e300), (1e-300, 1e300)] {
                let mut weights = Vec::new();
                Weighting::new(Function::Published(formula), scale, shift).evaluate(&[z], &[a], &mut weights);
                let (floor, ceiling) = WEIGHT_BOUNDS;
                assert!((floor..=ceiling).contains(&weights[0]), "{formula:?} z={z} a={a}: {weights:?}");
            }
        }
    }
}

#[test]
fn one_alpha_is_weighed_like_many_equal_ones() {
    for formula in formulas(0.1, 100.0) {
        for (scale, shift) in [(1.0, 0.0), (0.7, 0.0), (1.0, 0.3), (-1.0, 5.0)] {
            let weighting = Weighting::new(Function::Published(formula), scale, shift);
            for len in 0..40_u16 {
                let depth: Vec<f32> = (0..len).map(|i| 0.3 + 2.5 * f32::from(i)).collect();
                for alpha in [0.0, 1e-30, 0.4, 1.0] {
                    let (mut many, mut one) = (Vec::new(), vec![7.0; depth.len()]);
                    weighting.evaluate(&depth, &vec![alpha; depth.len()], &mut many);
                    weighting.evaluate_here(&depth, alpha, &mut one);
                    assert_eq!(one, many, "{formula:?} {scale} {shift} {alpha} {len}");
                }
            }
        }
    }
}

#[test]
fn long_lists_are_weighed_like_short_ones() {
    let depth: Vec<f32> = (0..1000_u16).map(|i| f32::from(i) * 0.1).collect();
    let alpha = vec![0.5; depth.len()];
    let mut all = Vec::new();
    Weighting::new(Function::Published(Formula::Mb7), 1.0, 0.0).evaluate(&depth, &alpha, &mut all);
    for (&z, &w) in depth.iter().zip(&all) {
        assert_eq!(f64::from(w), weigh(Formula::Mb7, z, 0.5));
    }
}

#[test]
fn weights_in_f64_are_the_papers_without_rounding() {
    let (near, far) = (0.5, 300.0);
    for formula in formulas(near, far) {
        let weighting = Weighting::new(Function::Published(formula), 1.0, 0.0);
        for z in [0.01, 0.5, 1.5, 4.0, 99.0, 264.0, 500.0_f32] {
            for a in [0.01, 0.35, 1.0_f32] {
                let (mut weights, mut logs) = (Vec::new(), Vec::new());
                weighting.evaluate_f64(&[z], &[a], &mut weights);
                weighting.evaluate_log2(&[z], &[a], &mut logs);
                let expected = by_hand(formula, z.into(), a.into(), near, far);
                // the planes are f32
                let exact = !matches!(formula, Formula::Mb10(_) | Formula::I3d16(_));
                let tolerance = if exact { 1e-13 } else { F32_FORMULA };
                assert!((weights[0] / expected - 1.0).abs() < tolerance, "{formula:?} {z} {a}: {weights:?}");
                assert!(
                    (logs[0] - expected.log2()).abs() < 10.0 * tolerance,
                    "{formula:?} {z} {a}: {logs:?}"
                );
            }
        }
    }
}

#[test]
fn logarithms_of_weights_neither_overflow_nor_underflow() {
    let log2 = |formula, z, a| {
        let mut logs = Vec::new();
        Weighting::new(Function::Published(formula), 1.0, 0.0).evaluate_log2(&[z], &[a], &mut logs);
        logs[0]
    };
    let steep = log2(Formula::Exp { k: 1e6 }, 1e6, 0.5);
    assert!((steep / (-1e12 * std::f64::consts::LOG2_E) - 1.0).abs() < 1e-6, "{steep}");
    assert!((log2(Formula::InvPow { k: 1e3 }, 1e6, 0.5) / (-6e3 * 10.0_f64.log2()) - 1.0).abs() < 1e-6);
    assert!((log2(Formula::InvPow { k: 1e3 }, 0.0, 0.5) / (4e3 * 10.0_f64.log2()) - 1.0).abs() < 1e-6);
    assert_eq!(log2(Formula::Smoke6, 1.0, 0.0), f64::NEG_INFINITY);
    assert_eq!(log2(Formula::One, 1e6, 0.5), 0.0);
}

/// The published weights as somebody would write them in WGSL. Those of window depth lose what it loses: 1 − d is known
/// to an ulp of 1.
const WRITTEN: [(Formula, &str); 11] = [
    (Formula::One, "a / a"),
    (Formula::Mb7, "a * clamp(10.0 / (1e-5 + pow(z / 5.0, 2.0) + pow(z / 200.0, 6.0)), 1e-2, 3e3)"),
    (Formula::Mb8, "a * max(1e-2, min(3e3, 10.0 / (1e-5 + pow(z / 10.0, 3.0) + pow(z / 200.0, 6.0))))"),
    (
        Formula::Mb9,
        "const far = 200.0;
         fn fourth(x: f32) -> f32 { let s = x * x; return s * s; }
         fn weight(a: f32, z: f32) -> f32 { return a * clamp(0.03 / (1e-5 + fourth(z / far)), 1e-2, 3e3); }",
    ),
    (Formula::Mb10(PLANES), "a * max(1e-2, 3e3 * pow(1.0 - d, 3.0))"),
    (Formula::InvPow { k: 4.0 }, "pow(z, -4)"),
    (Formula::Exp { k: 0.25 }, "exp(-0.25 * z)"),
    (Formula::Fig1, "pow(z + 5.0, -2.0)"),
    (Formula::Smoke6, "pow(a / (z * z * z), 2)"),
    (Formula::Fig10 { k: 0.01 }, "10.0 / (1.0 + 10.0 * pow(0.01 * z, 5.0))"),
    (Formula::I3d16(PLANES), "clamp(1e3 * a * pow(1.0 - 0.99 * d, 3.0), 1e-2, 30.0)"),
];
/// Replaced by those of a near plane at 0.5 and a far one at 300.
const PLANES: Planes = Planes { scale: 0.0, inverse_far: 0.0 };

/// A weighting by a text, between 0.5 and 300.
fn written(text: &str) -> Weighting {
    let specs = [WEIGHT, WEIGHT_K, WEIGHT_SCALE, WEIGHT_SHIFT, NEAR, FAR];
    let inputs = [("weight".to_owned(), Input::Text(text.to_owned()))];
    let view = View { near: 0.5, far: 300.0, ..View::ORDINARY };
    let params = check("demo", &specs, &inputs).unwrap().resolve(&specs, &view);
    Weighting::from_params(&params).unwrap()
}

#[test]
fn published_weights_can_be_written() {
    let mut random = crate::techniques::testing::Random::new(7);
    for (formula, text) in WRITTEN {
        let formula = match formula {
            Formula::Mb10(_) => Formula::Mb10(Planes::new(0.5, 300.0)),
            Formula::I3d16(_) => Formula::I3d16(Planes::new(0.5, 300.0)),
            other => other,
        };
        let own = written(text);
        let depth: Vec<_> = (0..1000).map(|_| 0.3 + 299.0 * random.unit() * random.unit()).collect();
        let alpha: Vec<_> = (0..1000).map(|_| 0.01 + 0.99 * random.unit()).collect();
        let (mut expected, mut got) = (Vec::new(), Vec::new());
        Weighting::new(Function::Published(formula), 1.0, 0.0).evaluate(&depth, &alpha, &mut expected);
        own.evaluate(&depth, &alpha, &mut got);
        for (i, (&got, &expected)) in got.iter().zip(&expected).enumerate() {
            // three times what an ulp of 1 is of 1 - d, or a few ulps
            let rest = (0.5 / 299.5 * (300.0 / depth[i] - 1.0)).clamp(0.0, 1.0);
            let lost = match formula {
                Formula::Mb10(_) => 3.0 * f32::EPSILON / rest.max(1e-3),
                Formula::I3d16(_) => 3.0 * f32::EPSILON / (0.01 + 0.99 * rest),
                _ => 0.0,
            };
            let error = (got / expected - 1.0).abs();
            assert!(error <= 6.0 * f32::EPSILON + lost, "{text} {}: {got} for {expected}", depth[i]);
        }
    }
}

#[test]
fn what_is_no_weight_is_counted_and_replaced() {
    let own = written("select(log(-z), 2.0 - z, z < 5.0)");
    let mut weights = Vec::new();
    let depth = [1.0, 2.0, 3.0, 6.0, 1.5];
    let invalid = own.evaluate_counted(&depth, &[0.5; 5], &mut weights, |i| [1, 10, 100, 1000, 10_000][i]);
    let floor = WEIGHT_BOUNDS.0;
    assert_eq!(weights, [1.0, floor, floor, floor, 0.5]);
    assert_eq!(invalid, 1110);
    let huge = written("1e38 * z");
    assert_eq!(huge.evaluate_counted(&[1.0], &[0.5], &mut weights, |_| 1), 0);
    assert_eq!(weights, [WEIGHT_BOUNDS.1]);
}

#[test]
fn equal_texts_are_the_same_weight() {
    assert!(written("1.0 / z").is_same(&written("1.0 / z")));
    assert!(!written("1.0 / z").is_same(&written("2.0 / z")));
    assert!(!written("1.0 / z").is_same(&Weighting::new(Function::Published(Formula::One), 1.0, 0.0)));
}
