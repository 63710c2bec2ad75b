//! Storage formats of lists, peeling and samples, against what rounding by definition makes of small pixels, and what
//! holds in any format.

mod models;

use super::{EXACT, REGISTRY, pixels, text};
use crate::format::{Format, Formats};
use crate::fragments::Fragment;
use crate::params::Input;
use crate::technique::{DepthComplexity, Resolved};
use crate::techniques::testing::{
    BACKGROUND, VIEW, assert_close, build, difference, fragment, given, over, random_pixel, resolve,
    three_layers,
};
use glam::DVec3;
use models::Rounding;

type Inputs = Vec<(&'static str, Input)>;

fn layers(k: i64) -> (&'static str, Input) {
    ("layers", Input::Int(k))
}

/// What follows of techniques that keep fragments apart, with room for all of up to 64.
const LISTS: [&str; 6] =
    ["multilayer_depth_peeling", "k_buffer", "z3", "mlab", "hybrid_transparency", "adaptive_transparency"];

#[test]
fn the_default_format_is_no_other_variant() {
    for info in REGISTRY.iter().filter(|info| !info.targets.is_empty()) {
        let stated = given(info, &[text("format", "f32")]);
        assert!(Formats::from_params(info.targets, &stated).are_default(), "{}", info.id);
        assert_eq!(stated.identity(), given(info, &[]).identity());
        for pixel in pixels() {
            assert_eq!(resolve(info.id, &[text("format", "f32")], &pixel), resolve(info.id, &[], &pixel));
        }
    }
}

/// What is left of the difference is the default's rounding.
#[test]
fn in_f64_it_is_the_same_algorithm() {
    for info in REGISTRY.iter().filter(|info| !info.targets.is_empty()) {
        for pixel in pixels() {
            let plain = resolve(info.id, &[], &pixel);
            let wide = resolve(info.id, &[text("format", "f64")], &pixel);
            let far = difference(wide, plain.color, plain.transmittance.x);
            // moments are ill-conditioned, and their default sums them in f32
            let allowed = if info.id.starts_with("mboit") { 1e-3 } else { EXACT };
            assert!(far <= allowed, "{}: {far:e}", info.id);
        }
    }
}

/// A format's own rounding of nodes against a list that is written down again from the sheet.
#[test]
fn lists_round_their_nodes_when_written_and_when_merged() {
    let mut scene: Vec<_> = pixels().take(6).collect();
    scene.push(three_layers());
    for rounding in Rounding::ALL {
        for pixel in &scene {
            for k in [1, 2, 3] {
                let inputs = [layers(k), rounding.input("node_color_format")];
                let size = usize::try_from(k).unwrap();
                for (id, model) in [
                    ("mlab", models::mlab as models::Model),
                    ("k_buffer", models::k_buffer),
                    ("z3", models::z3),
                    ("multilayer_depth_peeling", models::nearest),
                ] {
                    let (color, transmittance) = model(pixel, size, rounding);
                    let got = resolve(id, &inputs, pixel);
                    assert_close(got, color, transmittance, rounding.tolerance());
                }
            }
        }
    }
}

#[test]
fn peeling_rounds_its_targets_after_every_pass() {
    for rounding in Rounding::ALL {
        let format = [rounding.input("color_format")];
        for pixel in pixels().take(6).chain([three_layers()]) {
            let (color, transmittance) = models::depth_peeling(&pixel, rounding);
            assert_close(
                resolve("depth_peeling", &format, &pixel),
                color,
                transmittance,
                rounding.tolerance(),
            );
            let (color, transmittance) = models::dual_depth_peeling(&pixel, rounding);
            let dual = resolve("dual_depth_peeling", &format, &pixel);
            assert_close(dual, color, transmittance, rounding.tolerance());
        }
    }
}

#[test]
fn a_second_pass_looks_through_rounded_steps() {
    for rounding in Rounding::ALL {
        let share = [rounding.input("node_share_format")];
        for pixel in pixels().take(6).chain([three_layers()]) {
            for k in [1, 2, 5] {
                let inputs =
                    [share.to_vec(), vec![layers(k), ("protect_front", Input::Bool(false))]].concat();
                let (color, transmittance) = models::adaptive(&pixel, usize::try_from(k).unwrap(), rounding);
                // the sums are in f32
                let got = resolve("adaptive_transparency", &inputs, &pixel);
                assert_close(got, color, transmittance, 1e-5);
            }
        }
    }
}

/// A fragment that is kept as it is, is one of a rounded colour: samples and lists with room for all.
#[test]
fn samples_keep_rounded_colors() {
    let masks = || [layers(64), ("bits", Input::Int(32))];
    let stored = text("accumulate", "stored");
    let cases: [(&str, Inputs); 5] = [
        ("screen_door", vec![]),
        ("stochastic_transparency", vec![]),
        ("alpha_testing", vec![]),
        ("mlcb", masks().to_vec()),
        ("slab", [masks().to_vec(), vec![stored]].concat()),
    ];
    for (id, inputs) in cases {
        for rounding in Rounding::ALL {
            let format = [inputs.clone(), vec![rounding.input("node_color_format")]].concat();
            for pixel in pixels() {
                let rounded: Vec<_> = pixel.iter().map(|f| rounding.unmultiplied(f)).collect();
                let expected = resolve(id, &inputs, &rounded);
                let got = resolve(id, &format, &pixel);
                // C = u a went through f32
                assert_close(got, expected.color, expected.transmittance.x, 1e-6);
            }
        }
    }
}

#[test]
fn an_a_buffer_composites_rounded_fragments() {
    for rounding in Rounding::ALL {
        for pixel in pixels() {
            let rounded: Vec<_> = pixel.iter().map(|f| rounding.premultiplied(f)).collect();
            let (color, transmittance) = models::over(&rounded);
            let got = resolve("a_buffer", &[rounding.input("node_color_format")], &pixel);
            assert_close(got, color, transmittance, 1e-12);
        }
    }
}

#[test]
fn a_full_a_buffer_drops_or_blends_the_rest() {
    let limited = |overflow, pixel: &[Fragment]| {
        let inputs = [text("overflow", overflow), ("capacity", Input::Int(2)), text("format", "f64")];
        resolve("a_buffer", &inputs, pixel)
    };
    let (color, transmittance) = over(&three_layers()[..2]);
    let dropped = limited("drop", &three_layers());
    assert_close(dropped, color, transmittance, 1e-12);
    assert_eq!(dropped.dropped, 1);
    let (color, transmittance) = over(&three_layers());
    let blended = limited("tail_blend", &three_layers());
    assert_close(blended, color, transmittance, 1e-7);
    assert_eq!(blended.dropped, 0);
}

/// A tail in halves: the k nearest exactly, the others by MB13 eq. 5 in rounded sums.
#[test]
fn a_tail_has_its_own_formats() {
    let half = |x: f64| Rounding::F16.round(x);
    let pixel = three_layers();
    let [far, middle] = [&pixel[2], &pixel[0]];
    let color =
        DVec3::from(std::array::from_fn(|i| half(half(middle.color[i].into()) + f64::from(far.color[i]))));
    let alpha = half(half(middle.alpha.into()) + f64::from(far.alpha));
    let r = half(half(1.0 - f64::from(middle.alpha)) * (1.0 - f64::from(far.alpha)));
    let near = DVec3::from(pixel[1].color.map(f64::from));
    let shown = 1.0 - f64::from(pixel[1].alpha);
    let background = DVec3::from(BACKGROUND.map(f64::from));
    let expected = near + shown * ((1.0 - r) * color / alpha + r * background);
    let inputs = [layers(1), text("accumulation_format", "f16"), text("revealage_format", "f16")];
    assert_close(resolve("hybrid_transparency", &inputs, &pixel), expected, shown * r, 1e-12);
}

/// Sheet 2.3: in 8 bits a layer of less than 1/510 hides nothing, however many there are.
#[test]
fn eight_bits_of_transmittance_stay_at_one() {
    let faint = |alpha: f32, n: u8| -> Vec<Fragment> {
        (0..n).map(|i| fragment(1.0 + f32::from(i), [1.0; 3], alpha, i.into())).collect()
    };
    for id in ["mlab", "k_buffer", "z3", "multilayer_depth_peeling"] {
        let t = |format, alpha, n| {
            let inputs = [layers(4), text("node_color_format", format)];
            resolve(id, &inputs, &faint(alpha, n)).transmittance.x
        };
        assert_eq!([t("unorm8", 1.0 / 511.0, 1), t("unorm8", 1.0 / 511.0, 200)], [1.0; 2], "{id}");
        assert_eq!(t("unorm8", 1.0 / 509.0, 1), 254.0 / 255.0, "{id}");
        assert!(t("f16", 1.0 / 511.0, 4) < 0.993, "{id}");
    }
    // and a merge of clear ones keeps it so, colour included
    let bytes = [layers(1), text("node_color_format", "unorm8")];
    let got = resolve("mlab", &bytes, &faint(1.0 / 511.0, 200));
    assert_eq!(got, Resolved::background(DVec3::from(BACKGROUND.map(f64::from))));
}

/// Each of n layers is rounded when it is written and at most once per merge, colour and share; all numbers are at
/// most 1, and what a share is off by shows at most once.
#[test]
fn half_precision_is_near_where_there_is_room() {
    let u = Format::F16.unit_roundoff();
    for n in 1..=6_u32 {
        for seed in 0..20 {
            let pixel = random_pixel(n, seed + 50);
            let (color, transmittance) = over(&pixel);
            for id in LISTS.into_iter().chain(["a_buffer", "depth_peeling", "dual_depth_peeling"]) {
                let inputs: Inputs = if LISTS.contains(&id) { vec![layers(8)] } else { vec![] };
                let peels = ["depth_peeling", "dual_depth_peeling"].contains(&id);
                let depth = if peels { "depth_format" } else { "node_depth_format" };
                let inputs = [inputs, vec![text("format", "f16"), text(depth, "f32")]].concat();
                let far = difference(resolve(id, &inputs, &pixel), color, transmittance);
                assert!(far <= 4.0 * f64::from(n) * u, "{id}, {n} layers: {far:e}");
            }
        }
    }
}

/// Fragments are those of the rounded depths: what falls together is sorted by primitive.
#[test]
fn depths_are_rounded_before_they_are_compared() {
    // lwboit's bins divide the range of the fragments themselves
    for info in REGISTRY.iter().filter(|info| info.id != "lwboit") {
        let names = ["node_depth_format", "depth_format"];
        let Some(target) = info.targets.iter().find(|target| names.contains(&target.param)) else { continue };
        // in f32 it is the default, whose samples keep more of a colour
        for format in target.formats.iter().filter(|format| *format != Format::F32) {
            for mut pixel in pixels() {
                // near enough for all formats to bring some together
                pixel.iter_mut().for_each(|f| f.depth = 4.0 + f.depth / 4096.0);
                let moved: Vec<_> =
                    pixel.iter().map(|f| Fragment { depth: models::place(format, f.depth), ..*f }).collect();
                let got = resolve(info.id, &[text(target.param, format.name())], &pixel);
                let expected = resolve(info.id, &[text(target.param, "f64")], &moved);
                assert_eq!(got, expected, "{} {format:?}", info.id);
            }
        }
    }
    // 4.001 is 4 in half precision, and its primitive comes first
    let pixel = [fragment(4.0, [1.0, 0.0, 0.0], 0.5, 3), fragment(4.001, [0.0, 1.0, 0.0], 0.5, 1)];
    let red = |format| resolve("mlab", &[text("node_depth_format", format)], &pixel).color.x;
    assert_eq!([red("f32"), red("f16")], [0.5 + 0.0625, 0.25 + 0.0625]);
}

#[test]
fn packed_nodes_have_the_bytes_of_their_words() {
    let complexity = DepthComplexity { mean: 3.0, max: 9 };
    let color = |format| text("node_color_format", format);
    let depth = |format| text("node_depth_format", format);
    let packed = || vec![color("rgb9e5"), depth("d24")];
    let cases: [(&str, Inputs, f64); 24] = [
        ("mlab", vec![], 80.0),
        ("mlab", vec![color("unorm8")], 32.0),
        ("mlab", vec![color("f16")], 48.0),
        ("mlab", vec![text("format", "f16")], 40.0),
        ("mlab", vec![color("rgb9e5")], 40.0),
        ("mlab", packed(), 32.0),
        ("mlab", vec![text("format", "f64")], 160.0),
        ("z3", packed(), 32.0),
        ("mlab_buckets", vec![color("unorm8")], 40.0),
        ("k_buffer", vec![color("unorm8"), layers(8)], 68.0),
        ("multilayer_depth_peeling", vec![color("unorm8"), layers(8)], 72.0),
        ("hybrid_transparency", vec![color("unorm8"), layers(4)], 52.0),
        ("hybrid_transparency", vec![text("format", "f16"), layers(4)], 50.0),
        ("adaptive_transparency", vec![text("format", "f16"), layers(4)], 26.0),
        ("a_buffer", vec![], 88.0),
        ("a_buffer", vec![color("unorm8")], 52.0),
        ("alpha_testing", vec![color("unorm8")], 8.0),
        ("screen_door", vec![color("unorm8")], 128.0),
        ("stochastic_transparency", packed(), 56.0),
        ("mlcb", vec![color("unorm8")], 48.0),
        ("depth_peeling", vec![text("color_format", "unorm8")], 12.0),
        ("depth_peeling", vec![text("format", "f16")], 12.0),
        ("dual_depth_peeling", vec![text("format", "f16")], 32.0),
        ("continuum", vec![color("unorm8")], 32.0),
    ];
    for (id, inputs, bytes) in cases {
        let got = build(id, &inputs).unwrap().cost(&complexity).bytes_per_pixel;
        assert_eq!(got, bytes, "{id} {inputs:?}");
    }
}

/// Identities of the sheet that hold in any format, since both sides round the same numbers.
#[test]
fn identities_survive_rounding() {
    for format in ["f64", "f16", "bf16", "unorm16"] {
        let format = || text("format", format);
        for pixel in pixels() {
            let same = |a: (&str, &[(&str, Input)]), b: (&str, &[(&str, Input)])| {
                assert_eq!(resolve(a.0, a.1, &pixel), resolve(b.0, b.1, &pixel), "{} {}", a.0, b.0);
            };
            let mlab = [layers(3), format()];
            let one = [layers(3), format(), text("mode", "depth"), ("buckets", Input::Int(1))];
            let whole = ("transmittance_threshold", Input::Float(0.0));
            let never = [layers(3), format(), text("mode", "transmittance"), whole];
            same(("mlab_buckets", &one), ("mlab", &mlab));
            same(("mlab_buckets", &never), ("mlab", &mlab));
            let passes = [layers(2), ("passes", Input::Int(2)), format()];
            same(("multilayer_depth_peeling", &passes), ("multilayer_depth_peeling", &[layers(4), format()]));
            let (unbounded, alpha) = (("bits", Input::Int(0)), text("variant", "alpha"));
            if format() != text("format", "unorm16") {
                let slab = [layers(3), unbounded, alpha, text("accumulate", "stored"), format()];
                same(("slab", &slab), ("multilayer_depth_peeling", &[layers(3), format()]));
            }
        }
    }
}

#[test]
fn window_depth_is_that_of_the_view() {
    // MB13 eq. 11: half way between the planes 0.1 and 100 at 0.2 / 1.001
    let middle = 2.0 * VIEW.near * VIEW.far / (VIEW.near + VIEW.far);
    let place = |z: f64| {
        #[expect(clippy::cast_possible_truncation, reason = "depths are f32")]
        let placed = models::place(Format::Unorm16, z as f32);
        f64::from(placed)
    };
    assert!((place(middle) / middle - 1.0).abs() < 2e-5);
    // steps grow with the square of the distance: at 50, 2500 / 0.1 / 65535 apart
    assert!((place(50.0) - 50.0).abs() < 0.5 * 0.39);
    assert_eq!([place(0.0), place(1e9)].map(|z| (z * 1e4).round() / 1e4), [0.1, 100.0]);
}
