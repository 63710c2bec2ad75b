//! Random techniques: unbiased and consistent where they promise it.
#![expect(clippy::cast_precision_loss, reason = "small counts")]

use super::{text, variants};
use crate::fragments::Fragment;
use crate::params::Input;
use crate::techniques::statistics::{SEEDS, SIGNIFICANT, Sampled};
use crate::techniques::testing::{
    Scene, clear_pixels, over, random_pixel, resolve_all, run, submission_order, three_layers,
};
use std::collections::HashSet;

/// Every pixel draws its own numbers, so copies of one pixel side by side do what seeds do.
fn side_by_side(pixel: &[Fragment], copies: usize) -> Scene {
    vec![pixel.to_vec(); copies]
}

#[test]
fn the_mean_is_over_where_claimed() {
    let scenes =
        [three_layers(), random_pixel(6, 77)].map(|pixel| (over(&pixel), side_by_side(&pixel, SEEDS)));
    let mut seen = HashSet::new();
    for variant in variants().iter().filter(|v| v.info.random && v.properties().unbiased) {
        if !seen.insert(variant.name()) {
            continue;
        }
        for (exact, scene) in &scenes {
            let draws = run(&*variant.technique, submission_order(&variant.params), scene);
            let sampled = Sampled::of(draws.iter().map(|d| d.color.extend(d.transmittance.x)).collect());
            let score = sampled.score(*exact);
            assert!(score < SIGNIFICANT, "{}: {score} in {sampled:?} for {exact:?}", variant.name());
        }
    }
}

/// Root mean square error of the colour.
fn rmse(id: &str, inputs: &[(&str, Input)], pixels: &Scene) -> f64 {
    const COPIES: usize = 8;
    let errors = pixels.iter().flat_map(|pixel| {
        let exact = over(pixel).0;
        let got = resolve_all(id, inputs, &side_by_side(pixel, COPIES));
        got.into_iter().map(move |got| (got.color - exact).length_squared()).collect::<Vec<_>>()
    });
    (errors.sum::<f64>() / (3 * COPIES * pixels.len()) as f64).sqrt()
}

/// A technique, its choices, and the names of its sizes.
type Row = (&'static str, Vec<(&'static str, Input)>, &'static [&'static str]);

#[test]
fn error_vanishes_as_sizes_grow_where_claimed() {
    const SLAB: &[&str] = &["layers", "bits"];
    let slab = |choices: &[(&'static str, &str)]| -> Row {
        ("slab", choices.iter().map(|(name, choice)| text(name, choice)).collect(), SLAB)
    };
    let stochastic = |correction, mode| -> Row {
        ("stochastic_transparency", vec![text("correction", correction), text("mode", mode)], &["samples"])
    };
    let rows = [
        stochastic("none", "color"),
        stochastic("alpha", "color"),
        stochastic("none", "depth"),
        stochastic("alpha", "depth"),
        slab(&[("accumulate", "stored")]),
        slab(&[("correction", "none")]),
        slab(&[("correction", "global"), ("replay", "as_is")]),
        slab(&[("correction", "tail")]),
        slab(&[("accumulate", "stored"), ("variant", "alpha")]),
        slab(&[("correction", "global"), ("variant", "alpha"), ("probability", "random")]),
        slab(&[("correction", "tail"), ("variant", "alpha"), ("replay", "as_is")]),
        ("mlcb", vec![], SLAB),
    ];
    let pixels = clear_pixels(8);
    for (id, choices, sizes) in rows {
        let error = |layers: i64, bits: i64| {
            let mut inputs = choices.clone();
            inputs.extend(
                sizes.iter().map(|&name| (name, Input::Int(if name == "layers" { layers } else { bits }))),
            );
            rmse(id, &inputs, &pixels)
        };
        let errors = [error(2, 4), error(4, 64), error(8, 2048)];
        assert!(errors[1] < errors[0] && errors[2] < errors[1], "{id} {choices:?}: {errors:?}");
        // the noise of 2048 independent samples of colours in [0, 1] is at most 0.011
        assert!(errors[2] < 0.011, "{id} {choices:?}: {errors:?}");
    }
}
