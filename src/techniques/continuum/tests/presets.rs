//! Presets and their compositions: the same bits (sheet 2.8).

use super::{Inputs, int, row, scene, text};
use crate::params::Input;
use crate::techniques::testing::resolve_all;

#[track_caller]
fn assert_twins(axes: &str, sizes: Inputs, id: &str, twin: Inputs) {
    let scene = scene();
    let seed = int("seed", 7);
    for order in ["as_is", "reversed", "sorted", "shuffled"] {
        let with_order = |mut inputs: Inputs| {
            inputs.extend([text("submission_order", order), seed.clone()]);
            inputs
        };
        let composed = resolve_all("continuum", &with_order(row(axes, sizes.clone())), &scene);
        let preset = resolve_all(id, &with_order(twin.clone()), &scene);
        assert!(composed == preset, "{axes} {sizes:?} is not {id} {twin:?}, {order}");
    }
}

const K: [i64; 4] = [1, 2, 5, 40];

#[test]
fn lists_are_their_compositions() {
    assert_twins("unbounded / always / none / none / alpha / stored", vec![], "a_buffer", vec![]);
    let one = || vec![int("layers", 1)];
    assert_twins(
        "layers / always / over_arrival / none / alpha / stored",
        one(),
        "alpha_compositing",
        vec![],
    );
    for threshold in [0.0, 0.3, 0.5, 0.9] {
        let threshold = || ("threshold", Input::Float(threshold));
        let composed = vec![int("layers", 1), threshold()];
        let axes = "layers / threshold / discard_furthest / none / alpha / stored";
        assert_twins(axes, composed, "alpha_testing", vec![threshold()]);
    }
    for k in K {
        let layers = || vec![int("layers", k)];
        for insertion in ["always", "nearest"] {
            let list =
                |normalize| format!("layers / {insertion} / discard_furthest / {normalize} / alpha / stored");
            assert_twins(&list("none"), layers(), "multilayer_depth_peeling", layers());
            assert_twins(&list("none"), layers(), "depth_peeling", vec![int("passes", k)]);
            for correction in ["tail", "global"] {
                let twin = vec![int("layers", k), text("correction", correction)];
                assert_twins(&list(correction), layers(), "hybrid_transparency", twin);
            }
        }
        let list = |merge| format!("layers / always / {merge} / none / alpha / stored");
        assert_twins(&list("over_nearest"), layers(), "k_buffer", layers());
        assert_twins(&list("over_closest"), layers(), "z3", layers());
        assert_twins(&list("over_furthest"), layers(), "mlab", layers());
        for (normalize, composite) in [("none", "none"), ("global", "normalize")] {
            let axes = format!("layers / always / smallest_error / {normalize} / alpha / all");
            let free = ("protect_front", Input::Bool(false));
            let twin = vec![int("layers", k), free, text("composite", composite)];
            assert_twins(&axes, layers(), "adaptive_transparency", twin);
        }
    }
}

#[test]
fn masks_and_chance_are_their_compositions() {
    for (k, b) in [(1, 1), (2, 4), (4, 32), (5, 64), (4, 100), (40, 8)] {
        let sizes = || vec![int("layers", k), int("bits", b)];
        let axes = "layers / always / over_furthest / none / coverage / stored";
        assert_twins(axes, sizes(), "mlcb", sizes());
        for (opacity, variant) in [("alpha", "alpha"), ("coverage", "mask")] {
            for probability in ["stratified", "random"] {
                let sizes = || vec![int("layers", k), int("bits", b), text("probability", probability)];
                let corrections = [("none", "stored"), ("none", "all"), ("global", "all"), ("tail", "all")];
                for (correction, accumulate) in corrections {
                    let axes = format!(
                        "layers / stochastic / discard_furthest / {correction} / {opacity} / {accumulate}"
                    );
                    let twin = [
                        text("variant", variant),
                        text("correction", correction),
                        text("accumulate", accumulate),
                        text("replay", "as_is"),
                    ];
                    assert_twins(&axes, sizes(), "slab", [sizes(), twin.to_vec()].concat());
                }
            }
        }
    }
}

/// What slab's own tail is, without its second pass.
#[test]
fn the_tail_of_a_stored_slab_is_that_of_all() {
    let tail = |accumulate| {
        let axes = format!("layers / stochastic / discard_furthest / tail / coverage / {accumulate}");
        resolve_all("continuum", &row(&axes, vec![]), &scene())
    };
    assert!(tail("stored") == tail("all"));
}

#[test]
fn samples_are_their_compositions() {
    for samples in [1, 3, 8, 64, 100] {
        let sizes = || vec![int("samples", samples)];
        let axes = "samples / always / discard_occluded / none / coverage / stored";
        assert_twins(axes, sizes(), "screen_door", sizes());
        for (probability, stratified) in [("stratified", true), ("random", false)] {
            for (normalize, correction) in [("none", "none"), ("global", "alpha")] {
                for (accumulate, mode) in [("stored", "color"), ("all", "depth")] {
                    let axes = format!(
                        "samples / stochastic / discard_occluded / {normalize} / coverage / {accumulate}"
                    );
                    let composed = vec![int("samples", samples), text("probability", probability)];
                    let stratified = ("stratified", Input::Bool(stratified));
                    let twin = vec![
                        int("samples", samples),
                        stratified,
                        text("correction", correction),
                        text("mode", mode),
                    ];
                    assert_twins(&axes, composed, "stochastic_transparency", twin);
                }
            }
        }
    }
}

#[test]
fn bins_are_their_compositions() {
    for (bins, range) in [(1, None), (4, None), (32, Some((2.0, 6.0))), (512, Some((0.5, 20.0)))] {
        let sizes = || {
            let range = range.map_or(Input::Text("pixel".into()), |(lo, hi)| Input::Floats(vec![lo, hi]));
            vec![int("bins", bins), ("range", range)]
        };
        for (normalize, composite) in [("none", "none"), ("global", "normalize")] {
            let axes = format!("bins / always / sum / {normalize} / alpha / all");
            let s_max = ("s_max", Input::Float(15.0));
            let composed = [sizes(), vec![s_max.clone()]].concat();
            let twin = [sizes(), vec![s_max, text("interp", "floor"), text("composite", composite)]].concat();
            assert_twins(&axes, composed, "opacity_shadow_maps", twin);
        }
        for (normalize, on) in [("none", false), ("global", true)] {
            for weight in ["one", "mb7", "inv_pow"] {
                let axes = format!("bins / always / average / {normalize} / alpha / stored");
                let composed = [sizes(), vec![text("weight", weight)]].concat();
                let switches = [("smooth", false), ("shape", false), ("normalize", on)];
                let switches = switches.map(|(name, on)| (name, Input::Bool(on))).to_vec();
                assert_twins(&axes, composed.clone(), "lwboit", [composed, switches].concat());
            }
        }
        let [bins, range] = sizes().try_into().unwrap();
        let twin = vec![("layers", bins.1), text("mode", "bucket"), range];
        let axes = "bins / always / discard_occupied / none / alpha / stored";
        assert_twins(axes, sizes(), "multilayer_depth_peeling", twin);
    }
}

#[test]
fn functions_are_their_compositions() {
    assert_twins("none / never / none / none / alpha / stored", vec![], "weighted_sum", vec![]);
    assert_twins("none / never / none / global / alpha / stored", vec![], "blended_oit", vec![]);
    for weight in ["one", "mb7", "mb10", "inv_pow", "fig10"] {
        for (normalize, k) in [("global", 2.5), ("tail", 4.0)] {
            let weight = || vec![text("weight", weight), ("weight_k", Input::Float(k))];
            let axes = format!("none / never / none / {normalize} / alpha / stored");
            assert_twins(&axes, weight(), "wboit", weight());
        }
    }
}

/// The same compositions with nodes and sums in other formats. Peeling layers one by one rounds a target after each pass
/// in place of nodes, so that `depth_peeling` has no twin then.
#[test]
fn formats_are_those_of_the_compositions() {
    let formats = |given: &[(&'static str, &str)]| -> Inputs {
        given.iter().map(|(name, format)| text(name, format)).collect()
    };
    let nodes = [&[("format", "f16")][..], &[("node_color_format", "unorm8"), ("node_depth_format", "bf16")]];
    let packed = [("node_color_format", "rgb9e5"), ("node_depth_format", "d24")];
    for given in nodes.into_iter().chain([&packed[..]]).map(formats) {
        let with = |inputs: Inputs| [inputs, given.clone()].concat();
        let twins = |axes: &str, sizes: Inputs, id: &str, twin: Inputs| {
            assert_twins(axes, with(sizes), id, with(twin));
        };
        twins("unbounded / always / none / none / alpha / stored", vec![], "a_buffer", vec![]);
        let one = vec![int("layers", 1)];
        twins("layers / threshold / discard_furthest / none / alpha / stored", one, "alpha_testing", vec![]);
        let k = || vec![int("layers", 3)];
        let list = |merge, normalize| format!("layers / always / {merge} / {normalize} / alpha / stored");
        let nearest = list("discard_furthest", "none");
        twins(&nearest, k(), "multilayer_depth_peeling", k());
        for correction in ["tail", "global"] {
            let twin = vec![int("layers", 3), text("correction", correction)];
            twins(&list("discard_furthest", correction), k(), "hybrid_transparency", twin);
        }
        for (merge, id) in [("over_nearest", "k_buffer"), ("over_closest", "z3"), ("over_furthest", "mlab")] {
            twins(&list(merge, "none"), k(), id, k());
        }
        let masks = || vec![int("layers", 3), int("bits", 16)];
        twins("layers / always / over_furthest / none / coverage / stored", masks(), "mlcb", masks());
        twins(
            "samples / always / discard_occluded / none / coverage / stored",
            vec![],
            "screen_door",
            vec![int("samples", 8)],
        );
        let buckets = [int("layers", 5), text("mode", "bucket")];
        let bins = "bins / always / discard_occupied / none / alpha / stored";
        twins(bins, vec![int("bins", 5)], "multilayer_depth_peeling", buckets.to_vec());
        for (normalize, correction) in [("none", "none"), ("global", "alpha")] {
            let axes = format!("samples / stochastic / discard_occluded / {normalize} / coverage / stored");
            twins(&axes, vec![], "stochastic_transparency", vec![text("correction", correction)]);
        }
    }
}

#[test]
fn second_passes_have_the_formats_of_their_compositions() {
    for format in ["f16", "bf16", "f64"] {
        let format = || text("format", format);
        for (normalize, composite) in [("none", "none"), ("global", "normalize")] {
            let axes = format!("layers / always / smallest_error / {normalize} / alpha / all");
            let free = ("protect_front", Input::Bool(false));
            let twin = vec![int("layers", 3), free, text("composite", composite), format()];
            assert_twins(&axes, vec![int("layers", 3), format()], "adaptive_transparency", twin);
        }
        for (normalize, correction) in [("none", "none"), ("global", "alpha")] {
            let axes = format!("samples / stochastic / discard_occluded / {normalize} / coverage / all");
            let twin = vec![text("correction", correction), text("mode", "depth"), format()];
            assert_twins(&axes, vec![format()], "stochastic_transparency", twin);
        }
        for (opacity, variant) in [("alpha", "alpha"), ("coverage", "mask")] {
            for (correction, accumulate) in
                [("none", "stored"), ("none", "all"), ("global", "all"), ("tail", "all")]
            {
                let axes = format!(
                    "layers / stochastic / discard_furthest / {correction} / {opacity} / {accumulate}"
                );
                let sizes = vec![int("layers", 3), int("bits", 16), format()];
                let twin = [
                    text("variant", variant),
                    text("correction", correction),
                    text("accumulate", accumulate),
                    text("replay", "as_is"),
                ];
                assert_twins(&axes, sizes.clone(), "slab", [sizes, twin.to_vec()].concat());
            }
        }
        assert_twins(
            "none / never / none / none / alpha / stored",
            vec![format()],
            "weighted_sum",
            vec![format()],
        );
        let weighted = || vec![text("weight", "mb8"), format()];
        assert_twins("none / never / none / global / alpha / stored", weighted(), "wboit", weighted());
    }
}
