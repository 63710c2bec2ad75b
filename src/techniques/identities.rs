//! What every technique promises, checked over the registry; and the identities between techniques (sheet
//! section 3).

mod formats;
mod lists;
mod oracles;
mod order;
mod random;

use super::testing::{
    BACKGROUND, Random, difference, fragment, over, params, random_pixel, resolve, resolve_all, run,
    submission_order,
};
use super::{REGISTRY, find};
use crate::format::{Format, FormatSet};
use crate::fragments::Fragment;
use crate::params::{Input, Kind, Params, check};
use crate::technique::{AnyTechnique, Info, Properties, Resolved};
use std::collections::HashSet;

/// Relative error of sums in f32 in another order (sheet 0.7).
const OTHER_ORDER: f64 = 1e-5;
/// Relative error of an exact result that went through a quotient of f32 sums of up to 64 terms.
const EXACT: f64 = 1e-5;
/// Error of a product of 64 factors in f64.
const EXACT_PRODUCT: f64 = 1e-13;

/// A technique with params bound.
struct Variant {
    info: &'static Info,
    params: Params,
    technique: Box<dyn AnyTechnique>,
}

impl Variant {
    /// `None` where the params do not go together.
    fn new(info: &'static Info, inputs: &[(String, Input)]) -> Option<Self> {
        let params = params(info, inputs).unwrap();
        let technique = (info.build)(&params, &super::testing::VIEW).ok()?;
        Some(Self { info, params, technique })
    }
    fn properties(&self) -> Properties {
        self.technique.properties()
    }
    fn resolve(&self, pixel: &[Fragment]) -> Resolved {
        run(&*self.technique, submission_order(&self.params), &[pixel.to_vec()])[0]
    }
    fn name(&self) -> String {
        format!("{} {:?}", self.info.id, self.params.identity())
    }
    #[track_caller]
    fn expect(&self, claim: &str, pixel: &[Fragment], tolerance: f64) {
        let (got, (color, transmittance)) = (self.resolve(pixel), over(pixel));
        let far = difference(got, color, transmittance) / color.max_element().max(1.0);
        assert!(far <= tolerance, "{}: {claim}: {far:e} from {color} at {pixel:?}", self.name());
    }
}

/// Values that params of any kind might take.
fn candidates(kind: Kind) -> Vec<Input> {
    let ints = [0, 1, 2, 3, 4, 6, 8, 33, 512].map(Input::Int);
    let floats = [-5.0, 0.0, 1e-3, 0.01, 0.25, 2.5, 60.0].map(Input::Float);
    let lists = [vec![2.0, 6.0], vec![0.5, 20.0], vec![0.0, 0.5, 1.0]].map(Input::Floats);
    let words = ["pixel", "scene"].into_iter().chain(match kind {
        Kind::Choice(choices) | Kind::Function { names: choices, .. } => choices.iter().copied(),
        _ => [].iter().copied(),
    });
    let formats = match kind {
        Kind::Format(formats) => formats,
        _ => FormatSet::of(&[]),
    };
    let words = words.chain(formats.iter().map(Format::name)).map(|w| Input::Text(w.to_owned()));
    [Input::Bool(false), Input::Bool(true)]
        .into_iter()
        .chain(ints)
        .chain(floats)
        .chain(lists)
        .chain(words)
        .collect()
}

/// Every technique with its defaults, with one param changed at a time, and with random params.
fn variants() -> Vec<Variant> {
    const MIXES: usize = 40;
    let mut variants = Vec::new();
    for info in REGISTRY {
        // of its own, so that one technique's new param leaves the others' mixes as they were
        let mut random = Random::new(info.id.bytes().map(u64::from).sum());
        let table = info.param_table();
        let choices: Vec<Vec<(String, Input)>> = (table.iter())
            .map(|spec| {
                candidates(spec.kind).into_iter().map(|input| (spec.name.to_owned(), input)).collect()
            })
            .map(|inputs: Vec<_>| {
                let fits =
                    |input: &(String, Input)| check(info.id, &table, std::slice::from_ref(input)).is_ok();
                inputs.into_iter().filter(fits).collect()
            })
            .collect();
        assert!(choices.iter().all(|c| !c.is_empty()), "{}: no candidate fits a param", info.id);
        variants.extend(Variant::new(info, &[]));
        for input in choices.iter().flatten() {
            variants.extend(Variant::new(info, std::slice::from_ref(input)));
        }
        for _ in 0..MIXES {
            let mix: Vec<_> = choices.iter().map(|c| c[random.index(c.len())].clone()).collect();
            variants.extend(Variant::new(info, &mix));
        }
    }
    variants
}

fn pixels() -> impl Iterator<Item = Vec<Fragment>> {
    [1, 2, 3, 5, 8, 13, 31, 64].into_iter().map(|n| random_pixel(n, u64::from(n) + 100))
}

#[test]
fn ids_are_unique_and_entries_complete() {
    let mut names = HashSet::new();
    for info in REGISTRY {
        for name in info.aliases.iter().chain([&info.id]) {
            assert!(names.insert(*name), "{name} is registered twice");
        }
        assert!(info.id.chars().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_'));
        let axes = info.axes;
        let texts = [info.name, info.doc, info.geometry_passes, info.bytes_per_pixel];
        let axes = [axes.memory, axes.insertion, axes.merge, axes.normalize, axes.opacity];
        assert!(texts.iter().chain(&axes).all(|text| !text.is_empty()), "{}", info.id);
        assert!(!info.citation.is_empty() && !info.submission_orders.is_empty(), "{}", info.id);
        let mut params = HashSet::new();
        for spec in info.param_table() {
            assert!(params.insert(spec.name), "{} has two params {}", info.id, spec.name);
            assert!(!spec.doc.is_empty(), "{}: {}", info.id, spec.name);
        }
        assert!(std::ptr::eq(find(info.id).unwrap(), *info));
    }
}

#[test]
fn every_citation_is_in_the_bibliography() {
    let entries = include_str!("../../references.bib").lines().filter_map(|line| line.strip_prefix('@'));
    let keys: Vec<_> = entries.map(|e| e.split_once('{').unwrap().1.trim_end_matches(',')).collect();
    assert_eq!(keys.len(), keys.iter().collect::<HashSet<_>>().len(), "a key occurs twice");
    for info in REGISTRY {
        for key in info.citation {
            assert!(keys.contains(key), "{} cites {key}, which references.bib lacks", info.id);
        }
    }
}

#[test]
fn costs_are_modelled() {
    let complexity = crate::technique::DepthComplexity { mean: 2.5, max: 20 };
    for variant in variants() {
        let cost = variant.technique.cost(&complexity);
        assert!(cost.geometry_passes >= 1.0 && cost.bytes_per_pixel > 0.0, "{}: {cost:?}", variant.name());
    }
}

#[test]
fn one_fragment_is_exact_where_claimed() {
    let alphas = [1e-6, 0.01, 0.35, 0.999, 1.0];
    for variant in variants().iter().filter(|v| v.properties().exact_for_one) {
        for (alpha, depth) in alphas.iter().flat_map(|&a| [0.0, 1.0, 4.7, 9.0, 300.0].map(|z| (a, z))) {
            variant.expect("one", &[fragment(depth, [0.9, 0.2, 0.5], alpha, 3)], EXACT);
            variant.expect("one bright", &[fragment(depth, [6e4, 0.2, 0.5], alpha, 3)], EXACT);
        }
    }
}

#[test]
fn one_color_is_exact_where_claimed() {
    for variant in variants().iter().filter(|v| v.properties().exact_for_one_color) {
        for mut pixel in pixels() {
            for f in &mut pixel {
                *f = fragment(f.depth, [0.2, 0.6, 0.9], f.alpha, f.primitive);
            }
            variant.expect("one colour", &pixel, EXACT);
        }
    }
}

#[test]
fn coverage_is_exact_where_claimed() {
    for variant in variants().iter().filter(|v| v.properties().exact_coverage) {
        for pixel in pixels() {
            let (got, exact) = (variant.resolve(&pixel).transmittance, over(&pixel).1);
            let far = (got - exact).abs().max_element();
            assert!(far <= EXACT_PRODUCT, "{}: {got} for {exact}", variant.name());
        }
    }
}

/// Sheet 1.2, columns SOI and CO, and what its section 3 says of one fragment, one colour and coverage.
#[test]
fn default_promises_are_the_sheets() {
    let table = [
        ("a_buffer", Properties::EXACT),
        ("depth_peeling", Properties::EXACT),
        ("alpha_compositing", promises([false, false, true, true, true])),
        ("screen_door", promises([true, false, false, false, false])),
        (
            "stochastic_transparency",
            Properties { unbiased: true, ..promises([true, true, false, false, false]) },
        ),
        ("slab", promises([true, true, true, true, true])),
        ("continuum", promises([false, true, true, true, true])),
        ("mlcb", promises([false, true, false, false, false])),
        ("painter", promises([true, false, true, true, true])),
        ("weighted_sum", promises([true, false, true, false, false])),
        ("weighted_average", promises([true, false, true, false, false])),
        ("blended_oit", promises([true, false, true, true, true])),
        ("wboit", promises([true, false, true, true, true])),
        ("lwboit", promises([true, false, true, true, true])),
        ("opacity_shadow_maps", promises([true, true, false, false, false])),
        ("density_clustering", promises([true, false, false, false, false])),
        ("deep_opacity_maps", promises([true, false, false, false, false])),
        ("occupancy_maps", promises([true, false, false, false, false])),
        ("fourier_opacity_maps", promises([true, true, false, false, false])),
        ("tfm", promises([true, true, false, false, false])),
        ("wavelet", promises([true, true, true, true, true])),
        ("deep_shadow_maps", promises([true, true, false, false, false])),
        ("avsm", promises([false, true, true, false, true])),
        ("mboit_power", promises([true, false, true, true, true])),
        ("mboit_trig", promises([true, false, true, true, true])),
        ("phenomenological", promises([true, false, true, true, true])),
        ("gs_wsr", promises([true, false, false, false, false])),
    ];
    for (id, expected) in table {
        let variant = Variant::new(find(id).unwrap(), &[]).unwrap();
        assert_eq!(variant.properties(), expected, "{id}");
    }
}

fn promises(claims: [bool; 5]) -> Properties {
    let [order_independent, consistent, exact_for_one, exact_for_one_color, exact_coverage] = claims;
    Properties {
        order_independent,
        unbiased: false,
        consistent,
        exact_for_one,
        exact_for_one_color,
        exact_coverage,
    }
}

#[test]
fn zero_fragments_change_nothing_but_where_they_are_seen() {
    for variant in variants().iter().filter(|v| !v.technique.sees_zero_fragments()) {
        for pixel in pixels() {
            let mut kept = pixel.clone();
            kept.retain(|f| !f.is_zero());
            let mut more = kept.clone();
            let near_and_far = [fragment(0.0, [0.0; 3], 0.0, 99_998), fragment(50.0, [0.0; 3], 0.0, 99_999)];
            more.splice(0..0, near_and_far);
            assert_eq!(variant.resolve(&more), variant.resolve(&kept), "{}", variant.name());
        }
    }
}

#[test]
fn no_fragment_leaves_the_background() {
    for variant in variants() {
        let background = Resolved::background(glam::Vec3::from(BACKGROUND).as_dvec3());
        assert_eq!(variant.resolve(&[]), background);
        assert_eq!(variant.resolve(&[fragment(2.0, [0.0; 3], 0.0, 0)]), background, "{}", variant.name());
    }
}

#[test]
fn nothing_valid_makes_a_number_that_is_none() {
    let mut random = Random::new(4);
    let mut pick = |values: &[f32]| values[random.index(values.len())];
    let scenes: Vec<Vec<Fragment>> = (0..60)
        .map(|i| {
            let one = |k| Fragment {
                depth: pick(&[0.0, 1e-30, 0.1, 1.0, 4.5, 9.0, 100.0, 1e30]),
                color: [pick(&[0.0, 1e-30, 1.0, 6e4]), pick(&[0.0, 1.0]), pick(&[0.0, 1.0, 1e30])],
                alpha: pick(&[0.0, 1e-38, 1e-8, 0.5, 1.0 - 1e-7, 1.0]),
                primitive: k,
            };
            (0..=i % 7).map(one).collect()
        })
        .collect();
    for variant in variants() {
        for (got, pixel) in
            run(&*variant.technique, submission_order(&variant.params), &scenes).iter().zip(&scenes)
        {
            let narrow = got.color.as_vec3();
            assert!(
                narrow.is_finite() && got.transmittance.is_finite(),
                "{}: {got:?} of {pixel:?}",
                variant.name()
            );
        }
    }
}

#[test]
fn ten_thousand_layers() {
    let shades: Vec<_> = (0..10_000_u16)
        .map(|i| {
            let alpha = [1e-4, 0.0, 5e-4][usize::from(i % 3)];
            fragment(1.0 + f32::from(i % 997) * 0.008, [0.7, 0.5, 0.3], alpha, i.into())
        })
        .collect();
    for info in REGISTRY {
        let variant = Variant::new(info, &[]).unwrap();
        let got = variant.resolve(&shades);
        assert!(got.color.is_finite(), "{}", variant.name());
        if variant.properties().exact_for_one_color {
            variant.expect("10,000 layers", &shades, 10_000.0 * f64::from(f32::EPSILON));
        }
    }
}

/// A technique, its weight, and what it makes of one, two and three layers: colour without background, and
/// transmittance.
type Row = (&'static str, &'static str, [([f64; 3], f64); 3]);

#[test]
fn one_two_and_three_layers_of_one_alpha_by_hand() {
    let layer = |z: f32, rgb, key| fragment(z, rgb, 0.5, key);
    let pixel =
        [layer(5.0, [1.0, 0.0, 0.0], 0), layer(3.0, [0.0, 1.0, 0.0], 1), layer(7.0, [0.0, 0.0, 1.0], 2)];
    let table: [Row; 8] = [
        ("a_buffer", "", [([0.5, 0.0, 0.0], 0.5), ([0.25, 0.5, 0.0], 0.25), ([0.25, 0.5, 0.125], 0.125)]),
        (
            "depth_peeling",
            "",
            [([0.5, 0.0, 0.0], 0.5), ([0.25, 0.5, 0.0], 0.25), ([0.25, 0.5, 0.125], 0.125)],
        ),
        ("painter", "", [([0.5, 0.0, 0.0], 0.5), ([0.25, 0.5, 0.0], 0.25), ([0.25, 0.5, 0.125], 0.125)]),
        (
            "alpha_compositing",
            "",
            [([0.5, 0.0, 0.0], 0.5), ([0.25, 0.5, 0.0], 0.25), ([0.125, 0.25, 0.5], 0.125)],
        ),
        ("weighted_sum", "", [([0.5, 0.0, 0.0], 0.5), ([0.5, 0.5, 0.0], 0.0), ([0.5; 3], -0.5)]),
        (
            "weighted_average",
            "",
            [([0.5, 0.0, 0.0], 0.5), ([0.375, 0.375, 0.0], 0.25), ([0.875 / 3.0; 3], 0.125)],
        ),
        ("blended_oit", "", [([0.5, 0.0, 0.0], 0.5), ([0.375, 0.375, 0.0], 0.25), ([0.875 / 3.0; 3], 0.125)]),
        ("wboit", "one", [([0.5, 0.0, 0.0], 0.5), ([0.375, 0.375, 0.0], 0.25), ([0.875 / 3.0; 3], 0.125)]),
    ];
    for (id, weight, rows) in table {
        let inputs = [("weight", Input::Text(weight.into()))];
        for (n, (color, transmittance)) in (1..).zip(rows) {
            let got = resolve(id, if weight.is_empty() { &[] } else { &inputs }, &pixel[..n]);
            let color = glam::DVec3::from(color) + transmittance * glam::Vec3::from(BACKGROUND).as_dvec3();
            super::testing::assert_close(got, color, transmittance, super::testing::F32_STATE);
        }
    }
}

fn text(name: &'static str, value: &str) -> (&'static str, Input) {
    (name, Input::Text(value.into()))
}

#[test]
fn wboit_without_weight_is_blended_oit() {
    let scene: Vec<_> = pixels().collect();
    assert_eq!(
        resolve_all("wboit", &[text("weight", "one")], &scene),
        resolve_all("blended_oit", &[], &scene)
    );
}

/// Sheet R13: averages at exact coverage lose emission without coverage where nothing else covers.
#[test]
fn averages_lose_a_lone_emission() {
    let glow = Fragment { depth: 2.0, color: [1.0, 2.0, 3.0], alpha: 0.0, primitive: 0 };
    let background = Resolved::background(glam::Vec3::from(BACKGROUND).as_dvec3());
    let absorbance = [text("partition", "absorbance")];
    let plain = [("normalize", Input::Bool(false))];
    let cases = [
        ("weighted_average", &[][..]),
        ("blended_oit", &[]),
        ("wboit", &[]),
        ("lwboit", &[]),
        ("phenomenological", &[]),
        ("mboit_power", &[]),
        ("mboit_trig", &[]),
        ("lwboit", &absorbance),
        ("lwboit", &plain),
    ];
    for (id, inputs) in cases {
        assert_eq!(resolve(id, inputs, &[glow, glow]), background, "{id}");
    }
}

#[test]
fn lwboit_with_one_bin_is_wboit() {
    let scene: Vec<_> = pixels().collect();
    let weights = ["one", "mb7", "mb8", "mb9", "mb10", "inv_pow", "fig1", "smoke6", "fig10", "i3d16"];
    for weight in weights {
        let one_bin = |normalize| {
            let switch = |name, on| (name, Input::Bool(on));
            let inputs = [
                ("bins", Input::Int(1)),
                switch("smooth", false),
                switch("shape", false),
                switch("normalize", normalize),
                text("weight", weight),
            ];
            resolve_all("lwboit", &inputs, &scene)
        };
        let wboit = resolve_all("wboit", &[text("weight", weight)], &scene);
        for (a, b) in one_bin(true).iter().chain(&one_bin(false)).zip(wboit.iter().cycle()) {
            assert!(difference(*a, b.color, b.transmittance.x) < 1e-12, "{weight}: {a:?} {b:?}");
        }
    }
}

#[test]
fn techniques_of_a_known_order_are_over() {
    let back_to_front = [text("submission_order", "back_to_front")];
    let orders = [("alpha_compositing", &back_to_front[..]), ("painter", &[]), ("depth_peeling", &[])];
    for (id, inputs) in orders {
        for pixel in pixels() {
            let (color, transmittance) = over(&pixel);
            super::testing::assert_close(
                resolve(id, inputs, &pixel),
                color,
                transmittance,
                super::testing::F32_STATE,
            );
        }
    }
}

#[test]
fn painter_is_alpha_compositing_of_sorted_primitives() {
    // primitives that cover several pixels at different depths
    let scene: Vec<_> = (0..8)
        .map(|seed| {
            let mut pixel = random_pixel(12, seed);
            for f in &mut pixel {
                f.primitive %= 64;
            }
            pixel
        })
        .collect();
    let order = [text("submission_order", "centroid")];
    assert_eq!(resolve_all("painter", &[], &scene), resolve_all("alpha_compositing", &order, &scene));
}
