//! What holds for every technique and every valid fragment list, on lists made to be nasty: layers at the same
//! depth or at the eye, fragments that cover nothing or all, pure emission, twins of a primitive, bright light.

#![allow(clippy::cast_possible_truncation, reason = "small numbers, chosen here")]

mod common;

use common::{frames_with, samples};
use oitlab::fragments::{Background, Fragment, Fragments, FragmentsInput, Lists};
use oitlab::frame::Frame;
use oitlab::params::{Input, Kind, ParamSpec, View, check};
use oitlab::render::{Options, Request, Source};
use oitlab::technique::{AnyTechnique, Info};
use oitlab::techniques::REGISTRY;
use proptest::prelude::*;
use proptest::sample::{Index, select};
use proptest::test_runner::RngSeed;
use std::collections::HashSet;

const BACKGROUND: [f32; 3] = [0.25, 0.5, 0.75];
const VIEW: View = View { near: 0.1, far: 100.0, depth_range: (1.0, 9.0) };
/// Images per property. Each has some pixels, and every variant of every technique resolves them.
const CASES: u32 = 24;
const MAX_PIXELS: usize = 4;
/// How far a weighted mean may leave its colours' hull, relative to the largest of them: its weights and sums
/// over up to 64 fragments are kept in f32.
const HULL: f32 = 1e-5;

fn config() -> ProptestConfig {
    ProptestConfig {
        cases: CASES,
        rng_seed: RngSeed::Fixed(3),
        failure_persistence: None,
        max_shrink_iters: 400,
        ..ProptestConfig::default()
    }
}

/// A technique with params bound, and the request that makes it.
struct Variant {
    id: &'static str,
    request: Request,
    technique: Box<dyn AnyTechnique>,
}

/// Values of a param worth trying.
fn values(spec: &ParamSpec) -> Vec<Input> {
    let text = |word: &&str| Input::Text((*word).to_owned());
    match spec.kind {
        Kind::Choice(_) if spec.name == "submission_order" => vec![text(&"shuffled")],
        Kind::Choice(words) => words.iter().map(text).collect(),
        Kind::Function { names, signature } => {
            let own = format!("1.0 / (1.0 + {0} * {0})", signature.arguments[0]);
            names.iter().map(text).chain([Input::Text(own)]).collect()
        }
        Kind::Format(formats) => formats.iter().map(|format| text(&format.name())).collect(),
        Kind::Bool => vec![Input::Bool(false), Input::Bool(true)],
        Kind::DepthRange => vec![text(&"pixel"), text(&"scene"), Input::Floats(vec![2.0, 6.0])],
        Kind::IntChoice(numbers) => numbers.iter().copied().map(Input::Int).collect(),
        Kind::Int { .. } => [0, 1, 3].map(Input::Int).to_vec(),
        Kind::Float { .. } | Kind::FloatOrRgb { .. } => [0.0, 0.3, 20.0].map(Input::Float).to_vec(),
    }
}

/// `None` where the technique refuses these params.
fn variant(info: &'static Info, params: Vec<(String, Input)>) -> Option<Variant> {
    let table = info.param_table();
    let bound = check(info.id, &table, &params).ok()?.resolve(&table, &VIEW);
    let technique = (info.build)(&bound, &VIEW).ok()?;
    Some(Variant { id: info.id, request: (info.id.to_owned(), params).into(), technique })
}

/// Every technique with its defaults, and with one param changed at a time; the same with everything in half precision for
/// the choices among algorithms, where storage can be chosen.
fn variants() -> Vec<Variant> {
    let one = |spec: &ParamSpec| {
        let name = spec.name.to_owned();
        values(spec).into_iter().map(move |value| vec![(name.clone(), value)]).collect::<Vec<_>>()
    };
    let changed = |info: &'static Info| {
        let table = info.param_table();
        let is_algorithm =
            |spec: &&ParamSpec| matches!(spec.kind, Kind::Choice(_) | Kind::Function { .. } | Kind::Bool);
        let narrow = table.iter().filter(is_algorithm).filter(|_| !info.targets.is_empty());
        let narrow: Vec<_> = narrow.flat_map(one).map(in_half).collect();
        let params: Vec<_> = table.iter().flat_map(one).chain(narrow).collect();
        params.into_iter().filter_map(move |params| variant(info, params))
    };
    let defaults = |info| variant(info, vec![]).expect("a technique takes its own defaults");
    REGISTRY.iter().flat_map(|info| std::iter::once(defaults(info)).chain(changed(info))).collect()
}

fn in_half(mut params: Vec<(String, Input)>) -> Vec<(String, Input)> {
    params.push(("format".to_owned(), Input::Text("f16".to_owned())));
    params
}

/// Formats that a technique lists are formats that it takes, each alone and all together.
#[test]
fn every_format_of_every_target_is_taken() {
    for info in REGISTRY.iter().filter(|info| !info.targets.is_empty()) {
        for spec in info.param_table().iter().filter(|spec| matches!(spec.kind, Kind::Format(_))) {
            for value in values(spec) {
                let made = variant(info, vec![(spec.name.to_owned(), value.clone())]);
                assert!(made.is_some(), "{} refuses {} {value:?}", info.id, spec.name);
            }
        }
    }
}

fn depth() -> impl Strategy<Value = f32> {
    prop_oneof![
        Just(0.0),
        select(vec![1.0, 2.5, 2.500_000_2, 9.0, 1e-20, 1e20]),
        (0..8u8).prop_map(|i| 4.0 + f32::from(i) * 1e-5),
        0.0..100.0f32,
    ]
}

fn alpha() -> impl Strategy<Value = f32> {
    prop_oneof![select(vec![0.0, 1e-7, 1.0, 1.0 - 1e-7]), 0.0..=1.0f32]
}

fn channel() -> impl Strategy<Value = f32> {
    prop_oneof![4 => select(vec![0.0, 1.0, 6e4]), 6 => 0.0..=1.0f32]
}

/// A fragment; one that covers nothing emits its colour, or is zero.
fn fragment() -> impl Strategy<Value = Fragment> {
    let rgb = prop::array::uniform3(channel());
    (depth(), rgb, alpha(), any::<bool>(), 0..40u32).prop_map(|(depth, rgb, alpha, emits, primitive)| {
        let share = if alpha == 0.0 { f32::from(u8::from(emits)) } else { alpha };
        Fragment { depth, color: rgb.map(|c| c * share), alpha, primitive }
    })
}

/// Pixels side by side.
type Scene = Vec<Vec<Fragment>>;

fn scene() -> impl Strategy<Value = Scene> {
    let pixel =
        prop_oneof![prop::collection::vec(fragment(), 0..4), prop::collection::vec(fragment(), 0..=64),];
    prop::collection::vec(pixel, 1..=MAX_PIXELS)
}

fn render(scene: &[Vec<Fragment>], variants: &[Variant]) -> Vec<Frame> {
    let mut lists = Lists::new();
    for pixel in scene {
        pixel.iter().for_each(|f| lists.push(*f));
        lists.end_row();
    }
    let fragments = Fragments::new(FragmentsInput {
        width: scene.len() as u32,
        height: 1,
        lists,
        background: Background::Constant(BACKGROUND),
        near: VIEW.near,
        far: VIEW.far,
        depth_range: Some(VIEW.depth_range),
        primitive_depth: None,
    });
    let requests: Vec<_> = variants.iter().map(|v| v.request.clone()).collect();
    let options = Options { skip: false, ..Options::default() };
    frames_with(Source::Fragments(&fragments.expect("the list is valid")), &requests, &options)
}

/// The smallest and largest value of a channel among the fragments' unmultiplied colours and the background.
fn hull(pixel: &[Fragment], channel: usize) -> (f32, f32) {
    let colors = pixel.iter().filter(|f| f.alpha > 0.0).map(|f| f.color[channel] / f.alpha);
    let start = (BACKGROUND[channel], BACKGROUND[channel]);
    colors.fold(start, |(lo, hi), c| (lo.min(c), hi.max(c)))
}

fn brightest(pixel: &[Fragment]) -> f32 {
    (0..3).map(|channel| hull(pixel, channel).1).fold(1.0, f32::max)
}

#[test]
fn every_image_is_finite() {
    let variants = variants();
    proptest!(config(), |(scene in scene())| {
        for (variant, frame) in variants.iter().zip(render(&scene, &variants)) {
            prop_assert!(samples(&frame.color).iter().all(|x| x.is_finite()), "{:?}", variant.request);
            let shares = samples(&frame.transmittance);
            prop_assert!(shares.iter().all(|t| t.is_finite()), "{:?}: {shares:?}", variant.request);
        }
    });
}

/// Fragments that cover nothing emit nothing, and no two of a pixel have depth and primitive in common: two-pass
/// maps see such twins as one place, so that neither hides the other.
fn as_layers(mut scene: Scene) -> Scene {
    for pixel in &mut scene {
        let mut places = HashSet::new();
        for (fresh, f) in (1000..).zip(pixel) {
            f.color = if f.alpha == 0.0 { [0.0; 3] } else { f.color };
            f.primitive = if places.insert((f.depth.to_bits(), f.primitive)) { f.primitive } else { fresh };
        }
    }
    scene
}

/// What is exact for one colour is a mean of the colours.
#[test]
fn means_stay_inside_the_hull_of_the_colors() {
    let mut variants = variants();
    variants.retain(|v| v.technique.properties().exact_for_one_color);
    assert!(variants.len() > REGISTRY.len());
    proptest!(config(), |(scene in scene())| {
        let scene = as_layers(scene);
        for (variant, frame) in variants.iter().zip(render(&scene, &variants)) {
            for (pixel, color) in scene.iter().zip(samples(&frame.color).as_chunks().0) {
                let slack = HULL * brightest(pixel);
                for (channel, x) in <[f32; 3]>::into_iter(*color).enumerate() {
                    let (lo, hi) = hull(pixel, channel);
                    let inside = lo - slack <= x && x <= hi + slack;
                    prop_assert!(inside, "{:?}: {x} is outside {lo} to {hi}", variant.request);
                }
            }
        }
    });
}

#[test]
fn zero_fragments_do_nothing_where_they_are_not_seen() {
    let variants = variants();
    for variant in variants.iter().filter(|v| v.technique.sees_zero_fragments()) {
        assert!(["weighted_average", "hybrid_transparency"].contains(&variant.id));
    }
    let zeros = prop::collection::vec((any::<Index>(), any::<Index>(), depth(), 0..40u32), 1..8);
    proptest!(config(), |(scene in scene(), zeros in zeros)| {
        let mut more = scene.clone();
        for (pixel, place, depth, primitive) in zeros {
            let pixel = &mut more[pixel.index(scene.len())];
            let place = place.index(pixel.len() + 1);
            pixel.insert(place, Fragment { depth, color: [0.0; 3], alpha: 0.0, primitive });
        }
        let pairs = render(&scene, &variants).into_iter().zip(render(&more, &variants));
        for (variant, (without, with)) in variants.iter().zip(pairs) {
            let same = without.color == with.color && without.transmittance == with.transmittance;
            prop_assert!(same || variant.technique.sees_zero_fragments(), "{:?}", variant.request);
        }
    });
}
