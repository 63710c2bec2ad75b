//! The pipeline over every technique in the registry: captures, shortcuts, duplicates, cancelling, costs.

#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    clippy::cast_precision_loss,
    clippy::cast_sign_loss,
    reason = "small numbers, chosen here"
)]

mod common;

use common::{
    capture_with, frame, frames_with, mesh, perspective, random, rectangle, request, samples, scene, soup,
};
use oitlab::error::Error;
use oitlab::fragments::{Background, Fragments, FragmentsInput, Lists};
use oitlab::frame::{Frame, Image};
use oitlab::params::Input;
use oitlab::render::{Options, Request, Source, depth_images, render};
use oitlab::scene::{AlphaMode, Material, Scene};
use oitlab::techniques::REGISTRY;
use std::sync::atomic::{AtomicUsize, Ordering};

fn all_techniques() -> Vec<Request> {
    REGISTRY.iter().map(|info| request(info.id, &[])).collect()
}

/// Some of everything: clipped and whole triangles, an opaque wall, empty regions.
fn mixed_scene() -> Scene {
    let opaque = Material { alpha_mode: AlphaMode::Opaque, ..Material::default() };
    let wall = rectangle([-1.0, 1.0], [-1.0, 1.0], -0.5, [0.25, 0.5, 0.75, 1.0], opaque);
    let pane = rectangle([-5.0, -3.0], [-2.0, 2.0], 0.0, [0.9, 0.1, 0.1, 0.4], Material::default());
    scene(vec![wall, soup(60, |i| 4 * i + i % 3), pane], perspective(70.0, 0.5, 12.0), 61, 47)
}

#[test]
fn a_capture_gives_the_same_bits_as_its_scene_for_every_technique() {
    let scene = mixed_scene();
    let fragments = capture_with(&scene, &Options::default());
    let requests = all_techniques();
    let direct = frames_with(Source::Scene(&scene), &requests, &Options::default());
    let captured = frames_with(Source::Fragments(&fragments), &requests, &Options::default());
    for (a, b) in direct.iter().zip(&captured) {
        assert!(a.color == b.color, "{}", a.technique);
        assert!(a.transmittance == b.transmittance, "{}", a.technique);
        assert_eq!(a.stats.fragments, b.stats.fragments);
        assert_eq!(a.stats.depth_complexity_max, b.stats.depth_complexity_max);
    }
    let images = |source| depth_images(source, &Options::default(), &|| false).unwrap();
    assert!(images(Source::Scene(&scene)) == images(Source::Fragments(&fragments)));
}

#[test]
fn a_capture_survives_the_round_trip_through_its_arrays() {
    let fragments = capture_with(&mixed_scene(), &Options::default());
    let again = Fragments::new(FragmentsInput {
        width: fragments.width,
        height: fragments.height,
        lists: fragments.lists.clone(),
        background: fragments.background.clone(),
        near: fragments.view.near,
        far: fragments.view.far,
        depth_range: Some(fragments.view.depth_range),
        primitive_depth: fragments.primitive_depth.clone(),
    });
    assert_eq!(again.unwrap().content_hash(), fragments.content_hash());
}

/// The distance of two samples in units in the last place.
fn ulps(a: f32, b: f32) -> u32 {
    a.to_bits().abs_diff(b.to_bits())
}

/// Compositing one fragment directly avoids a division (architecture section 6).
const SHORTCUT_ULPS: u32 = 2;

#[test]
fn shortcuts_change_two_ulps_at_most_for_every_technique() {
    let scene = mixed_scene();
    let requests = all_techniques();
    let quick = frames_with(Source::Scene(&scene), &requests, &Options::default());
    let plain = Options { skip: false, ..Options::default() };
    let full = frames_with(Source::Scene(&scene), &requests, &plain);
    for (a, b) in quick.iter().zip(&full) {
        let pairs = samples(&a.color).iter().zip(samples(&b.color));
        let worst = pairs.map(|(x, y)| ulps(*x, *y)).max();
        assert!(worst <= Some(SHORTCUT_ULPS), "{}: {worst:?}", a.technique);
    }
    let skipped = |name| quick[0].stats.skipped.iter().find(|(n, _)| *n == name).unwrap().1;
    assert!(skipped("empty_pixels") > 0 && skipped("occluded_fragments") > 0);
    assert!(skipped("single_fragment_pixels") > 0);
}

/// Panes that face the camera, one behind the other in another order than they come in.
fn panes(size: f64, colors: [[f32; 4]; 4]) -> Scene {
    let pane = |(z, color): (f64, [f32; 4])| {
        let (x, y) = ([size * (z - 2.0), size * 2.0], [size * -1.5, size * (1.0 + 0.3 * z)]);
        rectangle(x, y, z, color, Material::default())
    };
    let panes = [0.5, -1.0, 1.0, 0.0].into_iter().zip(colors).map(pane).collect();
    scene(panes, perspective(70.0, 0.5, 12.0), 61, 47)
}

const COLORS: [[f32; 4]; 4] =
    [[1.0, 0.2, 0.1, 0.3], [0.1, 0.9, 0.4, 1.0], [0.3, 0.3, 0.9, 0.6], [0.9, 0.8, 0.2, 0.5]];

/// What is skipped, and where: the image is the same to the bit but for pixels of one fragment.
#[test]
fn skips_change_nothing_and_are_counted() {
    let covering = [COLORS[0], COLORS[3], COLORS[1], COLORS[2]];
    let pane = rectangle([-40.0, 40.0], [-40.0, 40.0], 1.0, COLORS[1], Material::default());
    let crossing = scene(vec![soup(60, |i| i), pane], perspective(70.0, 0.5, 12.0), 61, 47);
    let scenes = [
        (crossing, "hidden_fragments", 1),
        (panes(1.0, COLORS), "layered_tiles", 1),
        (panes(1.0, [COLORS[2]; 4]), "one_color_tiles", 1),
        (panes(20.0, covering), "hidden_fragments", 2 * 61 * 47),
    ];
    let plain = Options { skip: false, ..Options::default() };
    for (scene, what, least) in scenes {
        for info in REGISTRY {
            let requests = [request(info.id, &[])];
            let quick = frames_with(Source::Scene(&scene), &requests, &Options::default()).remove(0);
            let full = frames_with(Source::Scene(&scene), &requests, &plain).remove(0);
            let captured = capture_with(&scene, &Options::default());
            let from_list =
                frames_with(Source::Fragments(&captured), &requests, &Options::default()).remove(0);
            assert!(quick.color == from_list.color, "{} from a list, {what}", info.id);
            let lone = quick.stats.skipped.iter().find(|(n, _)| *n == "single_fragment_pixels").unwrap().1;
            let pairs = samples(&quick.color).iter().zip(samples(&full.color));
            let worst = pairs.map(|(x, y)| ulps(*x, *y)).max().unwrap();
            let allowed = if lone > 0 { SHORTCUT_ULPS } else { 0 };
            assert!(worst <= allowed, "{}: {worst} ulps, {what}", info.id);
            assert_eq!(quick.stats.fragments, full.stats.fragments);
            assert_eq!(quick.stats.depth_complexity_max, full.stats.depth_complexity_max);
            let count = |frame: &Frame, what| frame.stats.skipped.iter().find(|(n, _)| *n == what).unwrap().1;
            if info.id == "wboit" {
                let is_of_panes = (what, least) != ("hidden_fragments", 1);
                assert_eq!(count(&quick, "repeated_pixels") > 0, is_of_panes, "{what}");
                assert_eq!(count(&full, "repeated_pixels"), 0, "{what}");
            }
            if info.id == "a_buffer" {
                let count = |frame: &Frame| count(frame, what);
                assert!(count(&quick) >= least, "{what}");
                assert_eq!(count(&full), 0, "{what}");
            }
        }
    }
}

/// Most rows of these tiles have no fragments, and sums of other tiles are left in them.
#[test]
fn rows_that_nothing_is_in_are_background_for_every_technique() {
    let dense = rectangle([-9.0, -1.5], [-9.0, 9.0], 0.5, COLORS[0], Material::default());
    let opaque = Material { alpha_mode: AlphaMode::Opaque, ..Material::default() };
    let wall = rectangle([0.5, 1.5], [-2.0, 2.0], -0.5, [0.25, 0.5, 0.75, 1.0], opaque);
    let spot = |n: u32| {
        let (x, y, size) =
            (4.0 * random(n, 0) - 1.5, 4.0 * random(n, 1) - 2.0, 0.02 + 0.2 * random(n, 2).powi(4));
        let corners =
            vec![[x, y, 0.3], [x + size, y, -0.2 * random(n, 3)], [x, y + size, 0.4 * random(n, 4)]];
        mesh(corners, vec![[0, 1, 2]], COLORS[n as usize % 4], Material::default())
    };
    let mut spots: Vec<_> = (0..40).map(spot).collect();
    spots.push(dense);
    let alone = scene(spots.clone(), perspective(50.0, 0.5, 12.0), 150, 131);
    spots.push(wall);
    let before_a_wall = scene(spots, perspective(50.0, 0.5, 12.0), 150, 131);
    for (scene, tile_size) in [(&alone, 64), (&alone, 100), (&before_a_wall, 64), (&alone, 30)] {
        let options = Options { tile_size, threads: Some(1), ..Options::default() };
        let plain = Options { skip: false, ..options };
        let full = frames_with(Source::Scene(scene), &all_techniques(), &plain);
        let quick = frames_with(Source::Scene(scene), &all_techniques(), &options);
        for (request, (together, full)) in all_techniques().into_iter().zip(quick.iter().zip(&full)) {
            let alone = frames_with(Source::Scene(scene), &[request], &options).remove(0);
            assert!(alone.color == together.color, "{}", full.technique);
            assert!(alone.transmittance == together.transmittance, "{}", full.technique);
            let pairs = samples(&alone.color).iter().zip(samples(&full.color));
            let worst = pairs.map(|(x, y)| ulps(*x, *y)).max();
            assert!(worst <= Some(SHORTCUT_ULPS), "{}: {worst:?}, tiles of {tile_size}", full.technique);
            assert_eq!(alone.stats.fragments, full.stats.fragments, "{}", full.technique);
            let empty =
                |frame: &Frame| frame.stats.skipped.iter().find(|(n, _)| *n == "empty_pixels").unwrap().1;
            assert_eq!(empty(&alone), empty(together), "{}", full.technique);
            assert!(empty(&alone) > 10_000, "{} {}", full.technique, empty(&alone));
        }
    }
}

/// One after the other or all at once: a variant's image does not depend on what else is rendered.
#[test]
fn company_changes_no_bit() {
    for scene in [mixed_scene(), panes(1.0, COLORS), panes(20.0, [COLORS[2]; 4])] {
        let all = frames_with(Source::Scene(&scene), &all_techniques(), &Options::default());
        for (request, together) in all_techniques().into_iter().zip(all) {
            let alone = frames_with(Source::Scene(&scene), &[request], &Options::default()).remove(0);
            assert!(alone.color == together.color, "{}", alone.technique);
            assert!(alone.transmittance == together.transmittance, "{}", alone.technique);
            assert_eq!(alone.stats.fragments, together.stats.fragments, "{}", alone.technique);
        }
    }
}

#[test]
fn nothing_is_cut_short_in_double_precision() {
    let scene = mixed_scene();
    let run = |skip| {
        let options = Options { skip, ..Options::default() };
        render::<f64>(Source::Scene(&scene), &all_techniques(), &options, &|| false).unwrap()
    };
    for (a, b) in run(true).iter().zip(&run(false)) {
        assert!(a.color == b.color, "{}", a.technique);
    }
}

#[test]
fn equal_variants_are_computed_once() {
    let scene = mixed_scene();
    // weight_k does not act with mb7, so the first two are one variant
    let requests = [
        request("wboit", &[("weight_k", Input::Float(2.0))]),
        request("wboit", &[]),
        request("wboit", &[("weight", Input::Text("one".into()))]),
    ];
    let frames = frames_with(Source::Scene(&scene), &requests, &Options::default());
    let duplicates: Vec<_> = frames
        .iter()
        .map(|f| f.stats.skipped.iter().find(|(n, _)| *n == "duplicate_variants").unwrap().1)
        .collect();
    assert_eq!(duplicates.iter().sum::<u64>(), 1);
    assert!(frames[0].color == frames[1].color);
    assert!(frames[0].color != frames[2].color);
}

#[test]
fn an_empty_scene_is_its_background_for_every_technique() {
    let scene = scene(vec![], perspective(60.0, 0.5, 8.0), 5, 3);
    for frame in frames_with(Source::Scene(&scene), &all_techniques(), &Options::default()) {
        assert!(samples(&frame.color).as_chunks().0.iter().all(|c| *c == [0.125, 0.25, 0.375]));
        assert!(samples(&frame.transmittance).iter().all(|t| *t == 1.0));
        assert_eq!(frame.stats.depth_complexity_max, 0);
    }
}

#[test]
fn double_precision_keeps_what_single_rounds() {
    let scene = mixed_scene();
    let requests = [request("a_buffer", &[])];
    let double = render::<f64>(Source::Scene(&scene), &requests, &Options::default(), &|| false).unwrap();
    let single = frame(Source::Scene(&scene), "over", &[]);
    let Image::F64(exact) = &*double[0].color else { panic!("not double precision") };
    assert!(exact.iter().zip(samples(&single.color)).all(|(a, b)| *a as f32 == *b));
    assert!(exact.iter().any(|a| f64::from(*a as f32) != *a));
    assert_eq!(single.technique, "a_buffer");
}

#[test]
fn errors_come_before_any_work() {
    let scene = mixed_scene();
    let fault = |requests: &[Request], options| {
        render::<f32>(Source::Scene(&scene), requests, &options, &|| panic!("work started")).unwrap_err()
    };
    let unknown = fault(&[request("nonsense", &[])], Options::default());
    assert!(matches!(&unknown, Error::UnknownTechnique { known, .. } if known.contains("wboit")));
    let misspelt = [request("a_buffer", &[]), request("wboit", &[("wieght", Input::Int(1))])];
    assert!(fault(&misspelt, Options::default()).to_string().contains("\"wieght\""));
    let no_threads = Options { threads: Some(0), ..Options::default() };
    assert!(fault(&[], no_threads).to_string().starts_with("threads"));
}

#[test]
fn sizes_beyond_memory_are_an_error() {
    let scene = mixed_scene();
    for (id, param) in [
        ("density_clustering", "bins"),
        ("fourier_opacity_maps", "frequencies"),
        ("tfm", "frequencies"),
        ("stochastic_transparency", "samples"),
        ("mlcb", "bits"),
        ("opacity_shadow_maps", "bins"),
        ("occupancy_maps", "bits"),
    ] {
        let requests = [request(id, &[(param, Input::Int(1_000_000_000_000))])];
        let result = render::<f32>(Source::Scene(&scene), &requests, &Options::default(), &|| false);
        assert!(matches!(&result, Err(Error::Memory(what)) if what.contains(id)), "{id}");
    }
    let coverage = [("opacity", Input::Text("coverage".into())), ("bits", Input::Int(1_000_000_000_000))];
    let requests = [request("continuum", &coverage)];
    let result = render::<f32>(Source::Scene(&scene), &requests, &Options::default(), &|| false);
    assert!(matches!(result, Err(Error::Memory(_))));
    let by_chance = ("insertion", Input::Text("stochastic".into()));
    let bits = |bits| ("bits", Input::Int(bits));
    for too_many in [20_000_000, 7_000_000_000_000_000_000] {
        let requests = [request("continuum", &[by_chance.clone(), bits(too_many)])];
        let result = render::<f32>(Source::Scene(&scene), &requests, &Options::default(), &|| false);
        assert!(matches!(&result, Err(Error::Memory(message)) if message.contains("continuum")));
    }
    // what does not act costs nothing
    let same = [request("continuum", &[bits(7_000_000_000_000_000_000)]), request("continuum", &[])];
    let frames = frames_with(Source::Scene(&scene), &same, &Options::default());
    assert!(frames[0].color == frames[1].color);
}

#[test]
fn stopping_stops() {
    let scene = mixed_scene();
    for after in [0, 1, 5, 20] {
        let calls = AtomicUsize::new(0);
        let stop = || calls.fetch_add(1, Ordering::Relaxed) >= after;
        let result = render::<f32>(Source::Scene(&scene), &all_techniques(), &Options::default(), &stop);
        assert_eq!(result.unwrap_err(), Error::Cancelled);
    }
}

#[test]
fn costs_are_finite_and_grow_with_what_they_depend_on() {
    let mut lists = Lists::new();
    lists.end_row();
    let input = FragmentsInput {
        width: 1,
        height: 1,
        lists,
        background: Background::Constant([0.0; 3]),
        near: 0.1,
        far: 10.0,
        depth_range: None,
        primitive_depth: None,
    };
    let fragments = Fragments::new(input).unwrap();
    for frame in frames_with(Source::Fragments(&fragments), &all_techniques(), &Options::default()) {
        let stats = &frame.stats;
        assert!(stats.geometry_passes >= 1.0 && stats.geometry_passes.is_finite(), "{}", frame.technique);
        assert!(stats.bytes_per_pixel > 0.0 && stats.bytes_per_pixel.is_finite(), "{}", frame.technique);
    }
}
