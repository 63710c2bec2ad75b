//! The refusals, and what every composition keeps of its promises.

mod presets;

use crate::fragments::Fragment;
use crate::params::Input;
use crate::technique::{AnyTechnique, DepthComplexity};
use crate::techniques::testing::{
    Random, Scene, build, difference, fragment, over, random_pixel, resolve_all, three_layers,
};

type Inputs = Vec<(&'static str, Input)>;

fn text(name: &'static str, value: &str) -> (&'static str, Input) {
    (name, Input::Text(value.into()))
}

fn int(name: &'static str, value: i64) -> (&'static str, Input) {
    (name, Input::Int(value))
}

/// `"memory / insertion / merge / normalize / opacity / accumulate"`, as the rows of the sheet.
fn row(axes: &str, sizes: Inputs) -> Inputs {
    let names = ["memory", "insertion", "merge", "normalize", "opacity", "accumulate"];
    let values: Vec<_> = axes.split(" / ").collect();
    assert_eq!(values.len(), names.len(), "{axes}");
    names.into_iter().zip(values).map(|(name, value)| text(name, value)).chain(sizes).collect()
}

/// Up to 64 fragments, some opaque, some of alpha 0, some at equal depths; some layers bright.
fn scene() -> Scene {
    let mut scene: Scene =
        [1, 2, 3, 5, 8, 13, 21, 34, 64].into_iter().map(|n| random_pixel(n, u64::from(n) + 900)).collect();
    scene.push(random_pixel(12, 3).iter().map(|f| Fragment { depth: 4.0, ..*f }).collect());
    scene.push(
        random_pixel(9, 4).iter().map(|f| Fragment { color: f.color.map(|c| c * 100.0), ..*f }).collect(),
    );
    scene
}

/// All axes' values.
fn all_rows() -> Vec<String> {
    let mut rows = vec![String::new()];
    for values in [
        &["none", "layers", "unbounded", "samples", "bins"][..],
        &["always", "threshold", "nearest", "stochastic", "never"],
        &[
            "none",
            "discard_furthest",
            "over_furthest",
            "over_nearest",
            "over_closest",
            "smallest_error",
            "over_arrival",
            "discard_occluded",
            "sum",
            "average",
            "discard_occupied",
        ],
        &["none", "tail", "global"],
        &["alpha", "coverage"],
        &["stored", "all"],
    ] {
        rows =
            rows.iter().flat_map(|row| values.iter().map(move |value| format!("{row} / {value}"))).collect();
    }
    rows.iter().map(|row| row.trim_start_matches(" / ").to_owned()).collect()
}

/// Sheet 2.8, in its own words.
fn has_a_meaning(axes: &str) -> bool {
    let [memory, insertion, merge, normalize, opacity, accumulate] =
        axes.split(" / ").collect::<Vec<_>>().try_into().unwrap();
    let merges = match memory {
        "layers" => merge.starts_with("over_") || merge == "discard_furthest" || merge == "smallest_error",
        "samples" => merge == "discard_occluded",
        "bins" => ["sum", "average", "discard_occupied"].contains(&merge),
        _ => merge == "none",
    };
    let all = accumulate == "all";
    let slab = (memory, insertion, merge) == ("layers", "stochastic", "discard_furthest");
    let loses = match merge {
        "discard_furthest" | "discard_occluded" | "discard_occupied" => true,
        "average" => normalize == "global" || insertion != "always",
        "none" => memory == "none" || insertion != "always",
        _ => false,
    };
    let refused = [
        (insertion == "never") != (memory == "none"),
        !merges,
        merge == "over_arrival" && opacity == "coverage",
        opacity == "coverage" && ["bins", "none"].contains(&memory),
        opacity == "alpha" && memory == "samples",
        merge == "sum" && !all,
        all && (["none", "unbounded"].contains(&memory) || merge == "over_nearest"),
        all && normalize == "tail" && !slab,
        !all && normalize != "none" && !loses,
    ];
    !refused.contains(&true)
}

/// Small enough to overflow.
fn small(axes: &str) -> Inputs {
    // where chance decides what is stored, narrow masks; where masks only stand in for alphas, wide ones
    let (layers, bits) = if axes.contains("stochastic") { (2, 4) } else { (3, 64) };
    let layers = if axes.contains("over_arrival") { 1 } else { layers };
    vec![int("layers", layers), int("bins", 4), int("samples", 8), int("bits", bits), text("weight", "mb7")]
}

fn composed() -> Vec<(String, Box<dyn AnyTechnique>)> {
    let with_meaning = all_rows().into_iter().filter(|axes| has_a_meaning(axes));
    with_meaning.map(|axes| (axes.clone(), build("continuum", &row(&axes, small(&axes))).unwrap())).collect()
}

#[test]
fn what_has_no_meaning_is_refused_and_everything_else_is_made() {
    let mut refused = 0;
    for axes in all_rows() {
        let made = build("continuum", &row(&axes, small(&axes)));
        assert_eq!(made.is_ok(), has_a_meaning(&axes), "{axes}");
        refused += usize::from(made.is_err());
    }
    assert!(refused > 2000 && composed().len() > 150, "{refused} {}", composed().len());
}

#[test]
fn refusals_say_why() {
    let cases = [
        ("layers / never / over_furthest / none / alpha / stored", "leaves memory=\"layers\" empty"),
        ("none / always / none / none / alpha / stored", "nowhere to store"),
        ("samples / always / sum / none / coverage / stored", "a sample keeps its nearest fragment"),
        ("bins / always / over_furthest / none / alpha / all", "fragments meet in bins"),
        ("unbounded / always / over_furthest / none / alpha / stored", "never fills up"),
        ("layers / always / none / none / alpha / stored", "layers fill up"),
        ("none / never / average / none / alpha / stored", "nothing is stored that could merge"),
        ("layers / always / over_arrival / none / coverage / stored", "ignores depth"),
        ("bins / always / average / none / coverage / stored", "masks of what adds up"),
        ("none / never / none / none / coverage / stored", "masks of what adds up"),
        ("samples / always / discard_occluded / none / alpha / stored", "covered or it is not"),
        ("layers / always / discard_furthest / tail / alpha / all", "none are left for a tail"),
        ("layers / always / over_furthest / tail / alpha / stored", "loses nothing"),
        ("layers / always / over_closest / global / alpha / stored", "loses nothing"),
        ("layers / always / smallest_error / tail / alpha / stored", "loses nothing"),
        ("unbounded / always / none / global / alpha / stored", "loses nothing"),
        ("bins / always / average / tail / alpha / stored", "loses nothing"),
        ("none / never / none / global / alpha / all", "second pass could see"),
        ("unbounded / always / none / none / alpha / all", "nothing to add"),
        ("layers / always / over_nearest / none / alpha / all", "no depth"),
        ("bins / always / sum / none / alpha / stored", "no colour to composite"),
    ];
    for (axes, reason) in cases {
        let message = build("continuum", &row(axes, small(axes))).err().unwrap().to_string();
        assert!(message.starts_with("continuum: ") && message.contains(reason), "{axes}: {message}");
    }
    let sized = [
        ("layers / always / over_arrival / none / alpha / stored", int("layers", 2), "layers=2"),
        ("layers / always / over_furthest / none / coverage / stored", int("bits", 0), "at least 1 bit"),
        ("bins / always / average / none / alpha / stored", int("bins", 513), "512 at most"),
        ("none / never / none / global / alpha / stored", ("near", Input::Float(100.0)), "near must be less"),
    ];
    for (axes, size, reason) in sized {
        let message = build("continuum", &row(axes, vec![size])).err().unwrap().to_string();
        assert!(message.contains(reason), "{axes}: {message}");
    }
}

#[test]
fn formats_of_what_is_stored_elsewhere_are_refused() {
    for (axes, reason) in [
        ("layers / always / over_arrival / none / alpha / stored", "\"alpha_compositing\""),
        ("bins / always / sum / none / alpha / all", "\"opacity_shadow_maps\""),
        ("bins / always / average / none / alpha / stored", "\"lwboit\""),
    ] {
        let inputs = [small(axes), vec![text("format", "f16")]].concat();
        let message = build("continuum", &row(axes, inputs)).err().unwrap().to_string();
        assert!(message.contains("a format other than the default") && message.contains(reason), "{message}");
    }
}

#[test]
fn the_default_composition_is_mlab() {
    assert!(resolve_all("continuum", &[], &scene()) == resolve_all("mlab", &[], &scene()));
}

/// Relative rounding of f32 sums in another order (sheet 0.7).
const OTHER_ORDER: f64 = 1e-5;

#[test]
fn every_composition_runs_and_promises_no_more_than_it_keeps() {
    // thin layers, so that what an order does to the last one still shows
    let thin = |n, seed| {
        let mut pixel = random_pixel(n, seed);
        pixel
            .iter_mut()
            .for_each(|f| *f = Fragment { color: f.color.map(|c| c / 3.0), alpha: f.alpha / 3.0, ..*f });
        pixel
    };
    let scene: Scene = [three_layers(), random_pixel(30, 9)]
        .into_iter()
        .chain((0..10).flat_map(|seed| [thin(8, seed), thin(48, seed)]))
        .collect();
    let mut random = Random::new(2);
    let shuffles = [(); 3].map(|()| {
        let mut shuffled = scene.clone();
        shuffled.iter_mut().for_each(|pixel| random.shuffle(pixel));
        shuffled
    });
    let complexity = DepthComplexity { mean: 3.0, max: 9 };
    let resolve = |technique: &dyn AnyTechnique, scene: &[Vec<Fragment>]| {
        let order = crate::order::SubmissionOrder::AsIs;
        crate::techniques::testing::run(technique, order, scene)
    };
    for (axes, technique) in composed() {
        let got = resolve(&*technique, &scene);
        let finite =
            |r: &crate::technique::Resolved| r.color.as_vec3().is_finite() && r.transmittance.is_finite();
        assert!(got.iter().all(finite), "{axes}: {got:?}");
        let again = shuffles.iter().flat_map(|shuffled| resolve(&*technique, shuffled));
        let pairs = got.iter().cycle().zip(again);
        let moved = pairs.map(|(a, b)| difference(*a, b.color, b.transmittance.x)).fold(0.0, f64::max);
        if technique.properties().order_independent {
            assert!(moved <= OTHER_ORDER, "{axes}: moved by {moved:e}");
        } else {
            assert!(moved > 10.0 * OTHER_ORDER, "{axes}: only moved by {moved:e}");
        }
        let cost = technique.cost(&complexity);
        assert!(cost.geometry_passes >= 1.0 && cost.bytes_per_pixel >= 8.0, "{axes}: {cost:?}");
    }
}

#[test]
fn one_layer_one_color_and_coverage_are_exact_where_promised() {
    /// Quotients of f32 sums.
    const SUMS: f64 = 1e-5;
    let mut one_color = scene();
    for f in one_color.iter_mut().flatten() {
        *f = fragment(f.depth, [0.2, 0.6, 0.9], f.alpha, f.primitive);
    }
    let one: Scene = [0.01, 0.35, 0.999, 1.0].map(|a| vec![fragment(3.0, [0.9, 0.2, 0.5], a, 3)]).to_vec();
    for (axes, technique) in composed() {
        let check = |scene: &[Vec<Fragment>], color_too: bool, claim: &str| {
            let order = crate::order::SubmissionOrder::AsIs;
            for (got, pixel) in crate::techniques::testing::run(&*technique, order, scene).iter().zip(scene) {
                let (color, transmittance) = over(pixel);
                let color = if color_too { color } else { got.color };
                let far = difference(*got, color, transmittance);
                assert!(far <= SUMS, "{axes}: {claim}: {far:e} at {pixel:?}");
            }
        };
        let promises = technique.properties();
        if promises.exact_for_one {
            check(&one, true, "one");
        }
        if promises.exact_for_one_color {
            check(&one_color, true, "one colour");
        }
        if promises.exact_coverage {
            check(&scene(), false, "coverage");
        }
    }
}

/// The holes that the sheet finds worth measuring, and what they should gain.
#[test]
fn holes_between_the_presets_run() {
    let scene = crate::techniques::testing::clear_pixels(60);
    let rmse = |axes: &str, sizes: Inputs| {
        let got = resolve_all("continuum", &row(axes, sizes), &scene);
        let errors = got.iter().zip(&scene).map(|(got, pixel)| (got.color - over(pixel).0).length_squared());
        (errors.sum::<f64>() / 180.0).sqrt()
    };
    let four = || vec![int("layers", 4)];
    let tail = "layers / always / discard_furthest / tail / alpha / stored";
    let weighted = rmse(tail, [four(), vec![text("weight", "inv_pow")]].concat());
    assert!(weighted < rmse(tail, four()), "a depth weight orders the tail");
    let stored = rmse("layers / always / smallest_error / none / alpha / stored", four());
    assert!(stored < 0.1, "{stored}");
    let normalized = rmse("layers / always / over_furthest / global / alpha / all", four());
    let plain = rmse("layers / always / over_furthest / none / alpha / all", four());
    assert!(normalized < plain, "{normalized} {plain}");
    for merge in ["over_closest", "over_nearest"] {
        let list = |opacity| format!("layers / always / {merge} / none / {opacity} / stored");
        let fine = [four(), vec![int("bits", 1024), text("submission_order", "sorted")]].concat();
        let (alpha, coverage) = (rmse(&list("alpha"), fine.clone()), rmse(&list("coverage"), fine));
        assert!(alpha < 1e-6 && coverage < 0.03, "{merge}: {alpha} {coverage}");
    }
    let sparse = [four(), vec![int("bits", 8)]].concat();
    assert!(rmse("layers / stochastic / over_furthest / none / alpha / stored", sparse).is_finite());
}

#[test]
fn inactive_params_do_not_tell_variants_apart() {
    let identity =
        |inputs: &[(&str, Input)]| crate::techniques::testing::given(&super::INFO, inputs).identity();
    let default = identity(&[]);
    let unused =
        [int("bins", 3), int("samples", 3), int("bits", 3), text("weight", "mb7"), ("s_max", Input::Int(3))];
    for input in unused {
        assert_eq!(identity(&[input]), default);
    }
    assert_ne!(identity(&[int("layers", 3)]), default);
}
