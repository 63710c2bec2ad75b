//! What goes wrong in narrow formats, and what is promised of them (sheets 0.2, 2.5 and 4).

use crate::diagnosis::Fault;
use crate::fragments::Fragment;
use crate::params::Input;
use crate::technique::{DepthComplexity, Resolved};
use crate::techniques::REGISTRY;
use crate::techniques::testing::{
    BACKGROUND, as_pixel, build, difference, fragment, over, random_pixel, resolve,
};
use glam::Vec3;

type Inputs = Vec<(&'static str, Input)>;

fn text(name: &'static str, value: &str) -> (&'static str, Input) {
    (name, Input::Text(value.into()))
}

fn int(name: &'static str, value: i64) -> (&'static str, Input) {
    (name, Input::Int(value))
}

fn total(id: &str, inputs: &[(&str, Input)], pixel: &[Fragment]) -> f64 {
    -resolve(id, inputs, pixel).transmittance.x.ln()
}

/// Sheet 0.2: halves lose all increments below a 2048th of the sum, whatever the map is made of.
#[test]
fn halves_forget_what_is_fainter_than_a_2048th_of_what_is_there() {
    // behind an opaque layer, a thousand of absorbance 0.003: three in all
    let mut pixel = vec![fragment(1.0, [1.0; 3], 1.0, 0)];
    pixel.extend((0..1000).map(|i| fragment(1.0, [1.0; 3], 0.002_995_5, i + 1)));
    let maps = [
        ("opacity_shadow_maps", "bins_format"),
        ("deep_opacity_maps", "bins_format"),
        ("density_clustering", "clusters_format"),
        ("occupancy_maps", "slabs_format"),
        ("fourier_opacity_maps", "coefficients_format"),
        ("tfm", "coefficients_format"),
        ("wavelet", "coefficients_format"),
        ("mboit_power", "absorbance_format"),
        ("mboit_trig", "absorbance_format"),
    ];
    for (id, param) in maps {
        let inputs = |format: &str| [text(param, format), text("composite", "none")];
        let got = ["f64", "f32", "f16"].map(|format| total(id, &inputs(format), &pixel));
        assert!((got[0] - 13.0).abs() < 1e-3 && (got[1] - 13.0).abs() < 1e-2, "{id}: {got:?}");
        assert!((got[2] - 10.0).abs() < 1e-12, "{id}: {got:?}");
        // the faint ones first are three, and then the opaque one
        pixel.rotate_left(1);
        let first = total(id, &inputs("f16"), &pixel);
        pixel.rotate_right(1);
        assert!((first - 13.0).abs() < 0.5, "{id}: {first}");
    }
}

/// Sheet 0.3: the floor under T̂ has to survive its format.
#[test]
fn where_every_weight_underflows_halves_lose_all_color_unless_they_are_scaled() {
    // nothing but what is behind the range, and that is dense
    let stack: Vec<_> =
        (0..20_u8).map(|i| fragment(9.0, [0.05 * f32::from(i), 0.5, 1.0], 1.0, i.into())).collect();
    let inputs = |storage: &[(&'static str, Input)]| -> Inputs {
        let charged = ("self_correct", Input::Bool(false));
        let range = ("range", Input::Floats(vec![1.0, 9.0]));
        [&[int("bins", 1), charged, range, text("composite", "normalize")], storage].concat()
    };
    let seen = |storage: &[(&'static str, Input)]| resolve("opacity_shadow_maps", &inputs(storage), &stack);
    let average = resolve("blended_oit", &[], &stack);
    assert!(difference(seen(&[]), average.color, 0.0) < 1e-5);
    let half = text("accumulation_format", "f16");
    assert_eq!(seen(std::slice::from_ref(&half)), Resolved::new(glam::DVec3::ZERO, 0.0));
    let scaled = seen(&[half, text("summation", "scaled")]);
    assert!(difference(scaled, average.color, 0.0) < 0.02, "{scaled:?}");
}

/// A layer just behind another: halves see both at one depth, in the order of their primitives.
#[test]
fn nodes_of_rounded_depth_hide_no_fragment_of_their_own() {
    let near = 4.0 + 1.0 / 1024.0;
    let pixel = [
        fragment(near, [1.0, 0.0, 0.0], 0.5, 1),
        fragment(4.0, [0.0, 1.0, 0.0], 0.5, 2),
        fragment(7.3, [0.0, 0.0, 1.0], 0.5, 3),
    ];
    let swapped = [Fragment { depth: 4.0, ..pixel[0] }, pixel[1], Fragment { depth: 7.3, ..pixel[2] }];
    for (id, room) in [("avsm", int("layers", 6)), ("deep_shadow_maps", int("vertices", 6))] {
        let got = resolve(id, &[room, text("node_depth_format", "f16")], &pixel);
        let (color, transmittance) = over(&swapped);
        assert!(difference(got, color, transmittance) < 1e-6, "{id}: {got:?} for {color}");
        assert!(difference(got, over(&pixel).0, transmittance) > 0.1, "{id}");
        let technique = build(id, &[text("node_depth_format", "bf16")]).unwrap();
        let seen = as_pixel(&pixel, |pixel| technique.transmittance(pixel, &[near, 7.3, 1e9]).unwrap());
        // 7.3 is 7.3125 in eight digits, and strictly in front of its node
        assert!((seen[0] - 1.0).abs() < 0.02 && (seen[1] - 0.25).abs() < 0.02, "{id}: {seen:?}");
    }
}

const COMPLEXITY: DepthComplexity = DepthComplexity { mean: 2.5, max: 9 };

fn bytes(id: &str, inputs: &[(&str, Input)]) -> f64 {
    build(id, inputs).unwrap().cost(&COMPLEXITY).bytes_per_pixel
}

/// Sheet 1.2 counts 16 bits, but for occupancy maps' slabs, clusters, nodes and moments.
#[test]
fn bytes_follow_the_formats() {
    // beside the numbers of a format: first depth, pixel's range, mask, length of a list
    let table = [
        ("opacity_shadow_maps", 64.0, 0.0),
        ("deep_opacity_maps", 4.0, 4.0),
        ("density_clustering", 12.0, 8.0),
        ("occupancy_maps", 1.0, 16.0 + 8.0),
        ("fourier_opacity_maps", 15.0, 0.0),
        ("tfm", 9.0, 0.0),
        ("wavelet", 16.0, 8.0),
        ("avsm", 16.0, 0.0),
        ("deep_shadow_maps", 4.0 * 2.5, 4.0),
        ("mboit_power", 5.0, 0.0),
        ("mboit_trig", 7.0, 0.0),
    ];
    for (id, numbers, beside) in table {
        let of = |format: &str| bytes(id, &[text("format", format)]);
        for (format, each) in [("f64", 8.0), ("f32", 4.0), ("f16", 2.0), ("bf16", 2.0)] {
            assert_eq!(of(format), each * (numbers + 5.0) + beside, "{id} {format}");
        }
        assert_eq!(bytes(id, &[]), of("f32"), "{id}");
        let half = text("format", "f16");
        let summed = |name: &str| bytes(id, &[half.clone(), text("summation", name)]) - of("f16");
        assert_eq!(["compensated", "scaled", "scaled_double"].map(summed), [8.0, 4.0, 12.0], "{id}");
        assert_eq!(bytes(id, &[text("accumulation_format", "r11g11b10f")]), of("f32") - 10.0, "{id}");
        assert_eq!(bytes(id, &[text("revealage_format", "unorm8")]), of("f32") - 3.0, "{id}");
    }
    // the sheet's 4 + 2 m + 10
    let authors = [text("moments_format", "unorm16"), text("accumulation_format", "f16")];
    assert_eq!(bytes("mboit_power", &[&authors[..], &[text("revealage_format", "f16")]].concat()), 22.0);
    assert_eq!(bytes("avsm", &[text("nodes_format", "unorm8")]), 8.0 * 5.0 + 20.0);
}

#[test]
fn promises_hold_only_where_formats_allow() {
    let promises = |id: &str, inputs: &[(&str, Input)]| build(id, inputs).unwrap().properties();
    let normalize = text("composite", "normalize");
    for id in ["opacity_shadow_maps", "wavelet", "mboit_power", "avsm"] {
        let with =
            |more: &[(&'static str, Input)]| promises(id, &[std::slice::from_ref(&normalize), more].concat());
        let (plain, double) = (with(&[]), with(&[text("format", "f64")]));
        assert_eq!(double, plain, "{id}");
        let half = with(&[text("format", "f16")]);
        assert!(!half.exact_for_one && !half.exact_for_one_color && !half.exact_coverage, "{id}");
        assert!(half.order_independent == plain.order_independent && !half.consistent, "{id}");
    }
    // one colour is exact through any map, one fragment through any that lets it see itself
    let bins = |composite| promises("opacity_shadow_maps", &[text("bins_format", "f16"), composite]);
    assert!(bins(normalize.clone()).exact_for_one && bins(normalize).exact_for_one_color);
    assert!(!bins(text("composite", "exact_bg")).exact_for_one);
    // the product in a node is not that of doubles
    for (format, exact) in [("f64", true), ("f32", false)] {
        assert_eq!(promises("avsm", &[text("nodes_format", format)]).exact_coverage, exact);
    }
    assert!(promises("deep_shadow_maps", &[("eps", Input::Int(0))]).unbiased);
    let packed = [("eps", Input::Int(0)), text("nodes_format", "unorm8")];
    assert!(!promises("deep_shadow_maps", &packed).unbiased);
}

/// A fragment that neither covers nor emits, between others, and alone.
#[test]
fn zero_fragments_are_not_stored() {
    let zero = |z| fragment(z, [0.0; 3], 0.0, 77);
    for info in REGISTRY.iter().filter(|info| info.params.iter().any(|spec| spec.name == "composite")) {
        let storage: &[Inputs] = &[vec![], vec![text("format", "f16")], vec![text("format", "f64")]];
        for inputs in storage.iter().filter(|inputs| inputs.is_empty() || !info.targets.is_empty()) {
            let pixel = random_pixel(9, 4);
            let mut more = pixel.clone();
            more.insert(3, zero(0.5));
            more.push(zero(20.0));
            assert_eq!(resolve(info.id, inputs, &more), resolve(info.id, inputs, &pixel), "{}", info.id);
            let background = Resolved::background(Vec3::from(BACKGROUND).as_dvec3());
            assert_eq!(resolve(info.id, inputs, &[zero(3.0)]), background, "{}", info.id);
        }
    }
}

/// The map's own faults are found in any format, and those of the second pass's sums beside them.
#[test]
fn both_passes_are_diagnosed() {
    let close: Vec<_> = [4.0, 4.00001, 4.00002, 4.00003, 9.0].into_iter().zip(0..5).collect();
    let pixel: Vec<_> = close.iter().map(|(z, i)| fragment(*z, [1e7, 0.0, 0.0], 0.9, *i)).collect();
    let found = |storage: &[(&'static str, Input)], fault: Fault| {
        let unbiased = [int("moments", 6), ("bias", Input::Float(0.0))];
        let technique = build("mboit_power", &[&unbiased, storage].concat()).unwrap();
        assert!(technique.faults().has(fault));
        as_pixel(&pixel, |pixel| technique.diagnose(pixel)).amount(fault)
    };
    let half = text("accumulation_format", "f16");
    assert!(found(&[], Fault::BiasRetries) > 0.0);
    assert!(found(std::slice::from_ref(&half), Fault::BiasRetries) > 0.0);
    assert!(found(std::slice::from_ref(&half), Fault::Overflow) > 0.0);
}
