//! Layers in nodes of other formats.

use super::*;
use crate::continuum::nodes::LAYERS;
use crate::diagnosis::Fault;
use crate::format::target::param_specs;
use crate::params::{Input, check};
use crate::techniques::testing::{VIEW, as_pixel, build, fragment};

fn alpha(format: &str) -> StoredAlpha {
    let table: Vec<_> = param_specs(&LAYERS).collect();
    let inputs = [("node_color_format".to_owned(), Input::Text(format.to_owned()))];
    let params = check("demo", &table, &inputs).unwrap().resolve(&table, &VIEW);
    Nodes::from_params(&LAYERS, &params, &VIEW).alpha()
}

#[test]
fn a_layer_keeps_its_transmittance_and_a_fragment_its_alpha() {
    let half = alpha("f16");
    // f16 has 2^-11 between 1/2 and 1, and far more digits near 0
    let faint = 2.0_f64.powi(-13);
    let layer = half.store(DVec3::ZERO, faint);
    assert_eq!((layer.coverage, layer.transmittance), (0.0, 1.0));
    let fragment = StoredAlpha { keeps_alpha: true, ..half }.store(DVec3::ZERO, faint);
    assert_eq!((fragment.coverage, fragment.transmittance), (faint, 1.0 - faint));
}

#[test]
fn a_merge_is_rounded_once() {
    let half = alpha("f16");
    let mut front = half.store(DVec3::splat(1.0), 0.5);
    // 1 + 0.5 · (2^-10 + 2^-20): just above half way between 1 and its successor
    let behind = half.store(DVec3::splat(2.0_f64.powi(-10) + 2.0_f64.powi(-20)), 0.25);
    half.merge(&mut front, &behind);
    assert_eq!(front.color, DVec3::splat(1.0 + 2.0_f64.powi(-10)));
    assert_eq!((front.coverage, front.transmittance), (0.625, 0.375));
}

#[test]
fn double_precision_keeps_both_shares() {
    let wide = alpha("f64");
    let mut front = wide.store(DVec3::ZERO, 1e-20);
    front = {
        let behind = front;
        wide.merge(&mut front, &behind);
        front
    };
    assert_eq!((front.coverage, front.transmittance), (2e-20, 1.0));
}

/// A half holds 65,504 and no 1e-8, samples and thresholds keep what is left of a colour without its alpha, and 8 bits
/// end at 1.
#[test]
fn what_nodes_do_to_colors_is_diagnosed() {
    let pixel = [
        fragment(4.0, [1e5, 0.0, 0.0], 0.75, 0),
        fragment(5.0, [0.0, 1e-8, 0.0], 0.75, 1),
        fragment(6.0, [0.5, 0.5, 0.5], 0.75, 2),
        fragment(7.0, [0.5, 2.0, 0.5], 1.0, 3),
    ];
    let found = |id: &str, format: &str, fault: Fault| {
        let table: &[_] = if id == "slab" { &[("accumulate", "stored")] } else { &[] };
        let inputs = [&[("node_color_format", format)], table].concat();
        let inputs: Vec<_> = inputs.into_iter().map(|(name, x)| (name, Input::Text(x.into()))).collect();
        let technique = build(id, &inputs).unwrap();
        assert!(technique.faults().has(fault), "{id} {format}");
        assert!(!technique.faults().has(Fault::NonFinite), "{id} reads none");
        as_pixel(&pixel, |pixel| technique.diagnose(pixel)).amount(fault)
    };
    for id in
        ["mlab", "k_buffer", "z3", "a_buffer", "mlcb", "multilayer_depth_peeling", "alpha_testing", "slab"]
    {
        assert_eq!(found(id, "f16", Fault::Overflow), 1.0, "{id}");
        assert_eq!(found(id, "f16", Fault::Underflow), 1.0, "{id}");
        assert_eq!(found(id, "bf16", Fault::Overflow), 0.0, "{id}");
        assert_eq!(found(id, "unorm8", Fault::Saturation), 2.0, "{id}");
    }
    // the nearest covers 12 of 16 samples, the others are nearly all behind it
    assert_eq!(found("screen_door", "f16", Fault::Overflow), 1.0);
    assert_eq!(found("stochastic_transparency", "f16", Fault::Overflow), 1.0);
}
