//! Transmittance functions: where they are exact, equal or as good as none (sheet section 3, identities 1, 2, 8
//! and 10), and what they tend to.

use super::{pixels, text};
use crate::fragments::Fragment;
use crate::params::Input;
use crate::technique::Resolved;
use crate::techniques::testing::{
    F32_STATE, Scene, assert_close, clear_pixels, difference, fragment, over, random_pixel, resolve,
    resolve_all,
};

type Inputs = Vec<(&'static str, Input)>;

const COMPOSITES: [&str; 3] = ["none", "exact_bg", "normalize"];

fn size(name: &'static str, size: i64) -> (&'static str, Input) {
    (name, Input::Int(size))
}

fn off(name: &'static str) -> (&'static str, Input) {
    (name, Input::Bool(false))
}

fn with(inputs: &[(&'static str, Input)], more: (&'static str, Input)) -> Inputs {
    inputs.iter().cloned().chain([more]).collect()
}

/// Coincident fragments among others.
fn scene() -> Scene {
    let round = |mut pixel: Vec<Fragment>| {
        pixel.iter_mut().for_each(|f| f.depth = (f.depth * 0.5).round());
        pixel
    };
    pixels().chain((1..=16).map(|n| round(random_pixel(4 * n, u64::from(n) + 300)))).collect()
}

#[test]
fn room_for_every_step_is_over_ties_included() {
    let curves = [
        ("deep_shadow_maps", ("eps", Input::Float(0.0))),
        ("deep_shadow_maps", size("vertices", 128)),
        ("deep_shadow_maps", size("vertices", i64::MAX)),
        ("avsm", size("layers", 128)),
        ("avsm", size("layers", i64::MAX)),
    ];
    for ((id, room), composite) in curves.iter().flat_map(|curve| COMPOSITES.map(|c| (curve, c))) {
        let inputs = [room.clone(), text("composite", composite)];
        for (got, pixel) in resolve_all(id, &inputs, &scene()).into_iter().zip(scene()) {
            let (color, transmittance) = over(&pixel);
            assert_close(got, color, transmittance, F32_STATE);
        }
    }
}

#[test]
fn a_map_that_tells_no_depths_apart_is_blended_oit() {
    let one_bin = [size("bins", 1), text("interp", "floor"), text("composite", "normalize")];
    let blended = resolve_all("blended_oit", &[], &scene());
    assert_eq!(resolve_all("opacity_shadow_maps", &one_bin, &scene()), blended);
    assert_eq!(resolve_all("wboit", &[text("weight", "one")], &scene()), blended);
    assert_eq!(resolve_all("occupancy_maps", &[size("bits", 1), one_bin[2].clone()], &scene()), blended);
    // sheet 0.3: where every T̂ underflows, all weigh the same
    let far = [("range", Input::Floats(vec![0.0, 0.5])), ("s_max", Input::Float(60.0)), one_bin[2].clone()];
    let dense: Vec<_> =
        (0..20_u8).map(|i| fragment(1.0, [0.05 * f32::from(i), 0.5, 1.0], 1.0, i.into())).collect();
    let average = resolve("blended_oit", &[], &dense);
    for id in ["opacity_shadow_maps", "fourier_opacity_maps", "tfm"] {
        let got = resolve(id, &with(&far, off("self_correct")), &dense);
        assert_close(got, average.color, average.transmittance.x, F32_STATE);
    }
}

#[test]
fn maps_of_equal_bins_are_equal() {
    let bins = |count| size("bins", count);
    for composite in COMPOSITES.map(|c| text("composite", c)) {
        let map = |id, inputs: &[_]| resolve_all(id, &with(inputs, composite.clone()), &scene());
        assert_eq!(
            map("deep_opacity_maps", &[bins(6), text("spacing", "uniform")]),
            map("opacity_shadow_maps", &[bins(6)])
        );
        // a slab per bit leaves nothing to share out
        assert_eq!(
            map("occupancy_maps", &[size("bits", 24), size("slabs", 24)]),
            map("opacity_shadow_maps", &[bins(24), text("interp", "floor")])
        );
        // a budget that nothing exceeds, a bound that nothing is allowed to reach
        assert_eq!(
            map("deep_shadow_maps", &[size("vertices", 128)]),
            map("deep_shadow_maps", &[("eps", Input::Float(0.0))])
        );
    }
}

/// Root mean square distance of the colours from the exact ones.
#[expect(clippy::cast_precision_loss, reason = "some hundred pixels")]
fn error(id: &str, inputs: &[(&str, Input)], scene: &[Vec<Fragment>]) -> f64 {
    let images = resolve_all(id, inputs, scene);
    let far = |(got, pixel): (&Resolved, &Vec<Fragment>)| {
        let (color, transmittance) = over(pixel);
        difference(*got, color, transmittance).powi(2)
    };
    (images.iter().zip(scene).map(far).sum::<f64>() / scene.len() as f64).sqrt()
}

/// A technique, the params that stay, its size and the values it takes.
type Growth = (&'static str, Inputs, &'static str, [i64; 3]);

/// The claim `consistent` of sheet 1.2: errors fall towards nothing as the size grows.
#[test]
fn consistent_maps_converge() {
    let table: [Growth; 9] = [
        ("deep_shadow_maps", vec![], "vertices", [2, 6, 16]),
        ("opacity_shadow_maps", vec![], "bins", [4, 64, 4096]),
        ("opacity_shadow_maps", vec![text("interp", "floor")], "bins", [4, 64, 4096]),
        ("deep_opacity_maps", vec![text("spacing", "uniform")], "bins", [4, 64, 4096]),
        ("fourier_opacity_maps", vec![], "frequencies", [3, 30, 600]),
        ("fourier_opacity_maps", vec![("lanczos", Input::Bool(true))], "frequencies", [3, 30, 600]),
        ("tfm", vec![], "frequencies", [4, 40, 800]),
        ("avsm", vec![], "layers", [2, 6, 16]),
        ("wavelet", vec![], "rank", [1, 5, 10]),
    ];
    let scene = clear_pixels(60);
    for ((id, inputs, name, sizes), composite) in table.iter().flat_map(|row| COMPOSITES.map(|c| (row, c))) {
        let inputs = with(inputs, text("composite", composite));
        let errors = sizes.map(|n| error(id, &with(&inputs, size(name, n)), &scene));
        assert!(errors[0] > errors[1] && errors[1] > 3.0 * errors[2], "{id} {inputs:?}: {errors:?}");
        assert!(errors[2] < 0.01, "{id} {inputs:?}: {errors:?}");
    }
}

/// Those that are not claimed so stall, however large they are.
#[test]
fn inconsistent_maps_plateau() {
    let scene_range = text("range", "scene");
    let charged = vec![off("self_correct"), scene_range.clone()];
    let transmittance = vec![text("project", "transmittance"), scene_range];
    let table: [Growth; 9] = [
        ("opacity_shadow_maps", charged.clone(), "bins", [64, 1024, 1 << 20]),
        ("deep_opacity_maps", vec![], "bins", [8, 50, 400]),
        (
            "deep_opacity_maps",
            vec![text("spacing", "uniform"), off("self_correct")],
            "bins",
            [64, 1024, 1 << 20],
        ),
        ("fourier_opacity_maps", charged.clone(), "frequencies", [30, 100, 600]),
        ("fourier_opacity_maps", vec![("margin", Input::Float(0.0))], "frequencies", [30, 100, 600]),
        ("tfm", charged.clone(), "frequencies", [40, 120, 800]),
        ("tfm", transmittance, "frequencies", [40, 120, 800]),
        ("wavelet", charged, "rank", [6, 8, 10]),
        ("occupancy_maps", vec![], "bits", [128, 2048, 1 << 20]),
    ];
    let scene = clear_pixels(60);
    for (id, inputs, name, sizes) in table {
        let inputs = with(&inputs, text("composite", "exact_bg"));
        let errors = sizes.map(|n| error(id, &with(&inputs, size(name, n)), &scene));
        assert!(errors[2] > 0.02 && errors[2] > 0.6 * errors[0], "{id} {inputs:?}: {errors:?}");
    }
}
