//! Lists of layers: where they are exact (sheet section 3, identities 1 and 12).

use super::{pixels, text};
use crate::fragments::Fragment;
use crate::params::Input;
use crate::techniques::testing::{F32_STATE, Scene, assert_close, over, random_pixel, resolve_all};

/// Coincident fragments.
fn stacks() -> Scene {
    let mut scene: Scene = (1..=16).map(|n| random_pixel(2 * n, u64::from(n) + 300)).collect();
    for pixel in &mut scene {
        for f in pixel.iter_mut() {
            f.depth = (f.depth * 0.5).round();
        }
    }
    scene
}

fn scene() -> Scene {
    pixels().chain(stacks()).collect()
}

#[track_caller]
fn assert_over(id: &str, inputs: &[(&str, Input)], scene: &[Vec<Fragment>]) {
    for (got, pixel) in resolve_all(id, inputs, scene).into_iter().zip(scene) {
        let (color, transmittance) = over(pixel);
        assert_close(got, color, transmittance, F32_STATE);
    }
}

#[test]
fn room_for_all_is_over() {
    let lists = [
        "multilayer_depth_peeling",
        "k_buffer",
        "z3",
        "mlab",
        "adaptive_transparency",
        "hybrid_transparency",
    ];
    for id in lists {
        for layers in [65, 10_000, i64::MAX] {
            assert_over(id, &[("layers", Input::Int(layers))], &scene());
        }
    }
    for id in ["depth_peeling", "dual_depth_peeling"] {
        assert_over(id, &[], &scene());
    }
    for composite in ["none", "exact_bg", "normalize"] {
        let inputs = [("layers", Input::Int(65)), text("composite", composite)];
        assert_over("adaptive_transparency", &inputs, &scene());
    }
    for (tail, correction) in [("exact", "tail"), ("exact", "global"), ("count", "tail"), ("count", "global")]
    {
        let inputs = [("layers", Input::Int(65)), text("tail", tail), text("correction", correction)];
        assert_over("hybrid_transparency", &inputs, &scene());
    }
}

/// Fragments of one primitive and depth, which the sheet rules out, lie in order of arrival.
#[test]
fn twins_are_not_lost() {
    let mut scene = stacks();
    for pixel in &mut scene {
        let twin = Fragment { color: [0.5; 3], alpha: 0.5, ..pixel[0] };
        pixel.push(twin);
    }
    for id in ["multilayer_depth_peeling", "k_buffer", "z3", "mlab", "hybrid_transparency"] {
        assert_over(id, &[("layers", Input::Int(65))], &scene);
    }
}

/// Sheet 2.3: where fragments arrive in order, no later one falls inside a merged span.
#[test]
fn merging_adjacent_layers_is_exact_for_ordered_streams() {
    for order in ["sorted", "back_to_front"] {
        for layers in [1, 2, 3, 7, 20] {
            let inputs = [("layers", Input::Int(layers)), text("submission_order", order)];
            assert_over("mlab", &inputs, &scene());
            let [layers, order] = inputs;
            for depth in ["front", "mean"] {
                let inputs = [layers.clone(), order.clone(), text("merge_depth", depth)];
                assert_over("z3", &inputs, &scene());
            }
            if order == text("submission_order", "sorted") {
                assert_over("k_buffer", &[layers, order], &scene());
            }
        }
    }
}
