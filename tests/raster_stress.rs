//! Triangles that break rasterisers, against one without rounding errors (`tests/exact`): every pixel has exactly the
//! fragments that the clipped, snapped corners ask for, and depths are as near as single precision allows.
//!
//! `cargo test --release --test raster_stress -- --ignored --nocapture` also covers an image with 10^7 triangles.

#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    clippy::cast_precision_loss,
    clippy::cast_sign_loss,
    reason = "small numbers, chosen here"
)]

mod common;
mod exact;

use common::{capture_with, mesh, perspective, pixel_camera, random, scene};
use exact::depth::is_seen;
use exact::{Worst, check};
use glam::DVec3;
use oitlab::render::{Options, Source, depth_images};
use oitlab::scene::{Camera, Material, Mesh, Projection, Scene};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;
use std::sync::Arc;

/// Depths are computed in double precision, to 2^-37 where large triangles' are an affine function's, whose terms may be 4096 times
/// its value, and from exact weights of one sign in others; and stored in single: half a unit in the last place.
const WHOLE: f64 = 5.961_2e-8;
/// Clipped triangles are seen by the pixel's ray, whose three determinants of view-space corners cancel: the error
/// grows by so much per farthest corner over near, which is what was measured twice over.
const CUT_PER_SIZE: f64 = 16.0 / 9_007_199_254_740_992.0;

const WIDTH: u32 = 40;
const HEIGHT: u32 = 30;
/// Every so many fragments have their depth compared.
const STRIDE: usize = 5;

type Corner = [f64; 3];

/// One triangle after the other, none of which share corners.
fn triangles(list: impl IntoIterator<Item = [Corner; 3]>) -> Arc<Mesh> {
    let vertices: Vec<_> = list.into_iter().flatten().collect();
    let faces = (0..vertices.len() as u32 / 3).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
    mesh(vertices, faces, [1.0, 0.5, 0.25, 0.5], Material::default())
}

fn draw(camera: Camera, list: impl IntoIterator<Item = [Corner; 3]>) -> Scene {
    scene(vec![triangles(list)], camera, WIDTH, HEIGHT)
}

fn agree(what: &str, scene: &Scene) -> Worst {
    let worst = check(scene, &capture_with(scene, &Options::default()), STRIDE, what);
    println!("{what}: {worst:?}");
    worst
}

/// A number in [-1, 1), from counters.
fn signed(i: u32, k: u32) -> f64 {
    2.0 * random(i, k) - 1.0
}

/// The cameras of every family: orthographic with a world unit per pixel, and perspective. Both stand at z = 5.
fn cameras() -> [Camera; 2] {
    [pixel_camera(HEIGHT), perspective(60.0, 0.5, 50.0)]
}

/// The largest error of depth of clipped triangles that reach `size` times as far as the near plane.
fn cut(size: f64) -> f64 {
    WHOLE + CUT_PER_SIZE * size
}

/// Whole triangles alone, and some.
fn assert_whole(worst: &Worst) {
    assert!(worst.fragments[0] > 50 && worst.whole <= WHOLE, "{worst:?}");
}

#[test]
fn slivers() {
    for camera in cameras() {
        let sliver = |i: u32| {
            let at = |k: u32| [20.0 * signed(i, k), 15.0 * signed(i, k + 1), 3.5 * signed(i, k + 2)];
            let (a, b, t) = (at(0), at(3), random(i, 6));
            let width = 0.5_f64.powi((i % 12) as i32);
            let c = std::array::from_fn(|d| a[d] + t * (b[d] - a[d]) + width * signed(i, 7 + d as u32));
            [a, b, c]
        };
        // some on the grid of sub-pixels, so that edges go through centres
        let rounded =
            |t: [Corner; 3]| t.map(|c| [(2.0 * c[0]).round() / 2.0, (256.0 * c[1]).round() / 256.0, c[2]]);
        let list = (0..600).map(sliver).enumerate();
        let list = list.map(|(i, t)| if i % 3 == 0 { rounded(t) } else { t });
        assert_whole(&agree("slivers", &draw(camera, list)));
    }
}

#[test]
fn triangles_smaller_than_a_pixel() {
    for camera in cameras() {
        let small = |i: u32| {
            let size = 2.0_f64.powi(1 - (i % 12) as i32);
            let center = [0, 1, 2].map(|d: u32| [20.0, 15.0, 3.0][d as usize] * signed(i, d));
            // half of them around the centre of a pixel, where the small ones are seen
            let center = if i.is_multiple_of(2) {
                [center[0].floor() + 0.5, center[1].floor() + 0.5, 0.0]
            } else {
                center
            };
            [3, 6, 9].map(|k| std::array::from_fn(|d| center[d] + size * signed(i, k + d as u32)))
        };
        assert_whole(&agree("sub-pixel", &draw(camera, (0..6000).map(small))));
    }
}

#[test]
fn triangles_a_million_times_the_size_of_the_image() {
    for camera in cameras() {
        for size in [1e2, 1e4, 1e6, 4e7] {
            let huge = |i: u32| {
                let at = |k: u32| [size * signed(i, k), size * signed(i, k + 1), 3.5 * signed(i, k + 2)];
                [at(0), at(3), at(6)]
            };
            let worst = agree(&format!("size {size}"), &draw(camera, (0..60).map(huge)));
            assert!(worst.fragments.iter().sum::<usize>() > 200);
            assert!(worst.whole <= WHOLE && worst.cut <= cut(4.0 * size), "{worst:?}");
        }
    }
}

#[test]
fn corners_on_the_clip_planes_and_behind_the_camera() {
    for camera in cameras() {
        let (near, far) = (5.0 - camera.near(), 5.0 - camera.far());
        let depths = [near, near, far, 5.0, 6.0, 30.0, 2.0, -1.0, near - 1e-9, near + 1e-9];
        let some = |i: u32| {
            let z = |k: u32| depths[(random(i, k) * depths.len() as f64) as usize];
            [0, 3, 6].map(|k| [25.0 * signed(i, k), 20.0 * signed(i, k + 1), z(k + 2)])
        };
        let worst = agree("near plane", &draw(camera, (0..400).map(some)));
        assert!(worst.fragments.iter().all(|n| *n > 50));
        assert!(worst.whole <= WHOLE && worst.cut <= cut(100.0), "{worst:?}");
    }
}

/// Triangles that lie along the planes of the guard band but for rounding, where a polygon's corners may be in and out
/// by turns.
#[test]
fn triangles_along_the_clip_planes() {
    for camera in [perspective(60.0, 0.5, 50.0), perspective(60.0, 0.5, 1e18), pixel_camera(HEIGHT)] {
        let along = |i: u32| {
            let scale =
                f64::from(HEIGHT) / if i.is_multiple_of(2) { 2.0 * 30.0_f64.to_radians().tan() } else { 1.0 };
            let edge = [-65_556.0, 65_556.0, -65_551.0, 65_551.0][i as usize % 4] / scale;
            [0, 5, 10].map(|k| {
                let z = 10.0_f64.powf(20.0 * random(i, k)) * signed(i, k + 1).signum();
                let rounding = 1.0 + f64::EPSILON * (8.0 * signed(i, k + 2)).round();
                let (along, across) = (1e6 * z * signed(i, k + 3), edge * z * rounding);
                let [x, y] = if i % 4 < 2 { [across, along] } else { [along, across] };
                [x, y, 5.0 - z]
            })
        };
        agree("along planes", &draw(camera, (0..1000).map(along)));
    }
}

/// All lengths times `unit`.
fn scaled_camera(unit: f64) -> Camera {
    let (eye, projection) = (DVec3::new(0.0, 0.0, 5.0 * unit), Projection::Perspective { fov_y: 60.0 });
    Camera::new(eye, DVec3::ZERO, DVec3::Y, projection, 0.5 * unit, 50.0 * unit).unwrap()
}

#[test]
fn worlds_of_any_size() {
    for unit in [1e-30, 1e-12, 1e12, 1e30] {
        let any = |i: u32| [0, 3, 6].map(|k| [0, 1, 2].map(|d| unit * 6.0 * signed(i, k + d)));
        let worst = agree(&format!("unit {unit}"), &draw(scaled_camera(unit), (0..120).map(any)));
        assert!(worst.fragments.iter().all(|n| *n > 50));
        assert!(worst.whole <= WHOLE && worst.cut <= cut(100.0), "{worst:?}");
    }
}

/// A triangle of the given size, at any angle, around a point that the cameras may see.
fn through_sight(i: u32, size: f64) -> [Corner; 3] {
    let [u, v, q] = [0, 3, 6].map(|k| DVec3::from_array([0, 1, 2].map(|d| signed(i, k + d))));
    let (q, a, b) = (3.0 * q, size * u, size * v);
    let c = -random(i, 9) * a - random(i, 10) * b;
    [a, b, c].map(|corner| (q + corner).to_array())
}

/// Corners all over a cube, the triangles at any angle: one digit of depth is lost for every one that the cube has
/// more than the depth.
#[test]
fn depth_loses_as_many_digits_as_the_triangle_is_larger() {
    for (i, size) in [1e2, 1e4, 1e6, 1e8, 1e10, 1e12, 1e14].into_iter().enumerate() {
        for camera in cameras() {
            let list = (0..30).map(|n| through_sight(n + 1000 * i as u32, size));
            let worst = agree(&format!("cube of {size:e}"), &draw(camera, list));
            assert!(worst.fragments[1] > 50 && worst.cut <= cut(4.0 * size / camera.near()), "{worst:?}");
        }
    }
}

/// Wherever the true triangle and its surroundings within a sub-pixel agree, so does the picture: clipping moves no
/// outline by more than snapping does, up to 10^8 times the size of the image.
#[test]
fn outlines_stay_within_a_sub_pixel_of_the_truth() {
    let steps = [-1.0, 0.0, 1.0].map(|step| step / 256.0);
    for camera in cameras() {
        for (n, size) in (0..).zip([20.0, 1e4, 1e6, 1e9]) {
            let list = (0..40).map(|i| through_sight(i + 100 * n, size));
            let scene = scene(vec![triangles(list)], camera, 10, 8);
            let fragments = capture_with(&scene, &Options::default());
            assert!(fragments.lists.len() > 40);
            let (mesh, screen) = (&scene.meshes()[0], exact::screen::Screen::new(&scene));
            for (id, face) in (0..).zip(mesh.faces()) {
                let corners = screen.view(face.map(|v| mesh.vertices()[v as usize]));
                for pixel in 0..80 {
                    let center = [(pixel % 10) as f64 + 0.5, (pixel / 10) as f64 + 0.5];
                    let drawn = fragments.lists.as_ref().row(pixel).primitive.contains(&id);
                    let same =
                        |x: f64, y: f64| is_seen(&screen, corners, [center[0] + x, center[1] + y]) == drawn;
                    let near = steps.iter().any(|x| steps.iter().any(|y| same(*x, *y)));
                    assert!(near, "{size:e}: {corners:?} at {center:?}, drawn: {drawn}");
                }
            }
        }
    }
}

/// Corners at 1e30 beside others at 1 or 1e-30: what is drawn is what the clipped corners say, though rounding
/// leaves little of where they should be.
#[test]
fn coordinates_of_all_magnitudes_at_once() {
    let magnitudes = [1e-30, 1.0, 10.0, 1e6, 1e15, 1e18, 1e30, 3e38];
    for camera in cameras().into_iter().chain([wide_open()]) {
        let mixed = |i: u32| {
            let of = |k: u32| magnitudes[(random(i, k + 20) * magnitudes.len() as f64) as usize];
            [0, 3, 6].map(|k| [0, 1, 2].map(|d| of(k + d) * signed(i, k + d)))
        };
        let scene = draw(camera, (0..500).map(mixed));
        let worst = agree("mixed", &scene);
        assert!(worst.fragments[1] > 50 && worst.whole <= WHOLE, "{worst:?}");
        let (near, far) = (camera.near() as f32, camera.far() as f32);
        let fragments = capture_with(&scene, &Options::default());
        assert!(fragments.lists.depth.iter().all(|z| (near..=far).contains(z)));
    }
}

/// From nearly nothing to nearly everything.
fn wide_open() -> Camera {
    let projection = Projection::Perspective { fov_y: 90.0 };
    Camera::new(DVec3::new(0.0, 0.0, 5.0), DVec3::ZERO, DVec3::Y, projection, 1e-30, 1e38).unwrap()
}

#[test]
fn duplicates_in_one_plane() {
    for camera in cameras() {
        let original = |i: u32| {
            [0, 3, 6].map(|k| [22.0 * signed(i, k), 16.0 * signed(i, k + 1), 5.5 * signed(i, k + 2)])
        };
        let turns = |i: u32| {
            let [a, b, c] = original(i);
            [[a, b, c], [a, b, c], [b, c, a], [c, b, a], [a, c, b]]
        };
        let scene = draw(camera, (0..30).flat_map(turns));
        let worst = agree("duplicates", &scene);
        assert!(worst.fragments.iter().all(|n| *n > 50), "{worst:?}");
        assert!(worst.whole <= WHOLE && worst.cut <= cut(100.0), "{worst:?}");
        let fragments = capture_with(&scene, &Options::default());
        for pixel in 0..fragments.pixels() {
            let list: Vec<_> = fragments.lists.as_ref().row(pixel).iter().collect();
            for five in list.chunks(5) {
                assert!(five.iter().all(|f| f.primitive / 5 == five[0].primitive / 5));
                assert_eq!(five[0].depth, five[1].depth, "the same corners in the same order");
            }
        }
    }
}

/// A number worth trying as a coordinate.
fn coordinate() -> impl Strategy<Value = f64> {
    let special = vec![0.0, 0.5, -0.5, 4.0, 4.5, 5.0, 5.5, 1e-30, -1e-30, 1e30, -1e30, 3e38, -3e38];
    prop_oneof![
        3 => prop::sample::select(special),
        4 => (-6000..6000_i32).prop_map(|i| f64::from(i) / 256.0),
        4 => -20.0..20.0_f64,
        1 => -1e8..1e8_f64,
        1 => (any::<bool>(), -100.0..100.0_f64).prop_map(|(minus, e)| if minus { -e.exp2() } else { e.exp2() }),
    ]
}

#[test]
fn anything_at_all() {
    let config = ProptestConfig {
        cases: 400,
        rng_seed: RngSeed::Fixed(11),
        failure_persistence: None,
        ..ProptestConfig::default()
    };
    let corner = || prop::array::uniform3(coordinate());
    let list = prop::collection::vec(prop::array::uniform3(corner()), 1..8);
    let cameras = [pixel_camera(12), perspective(60.0, 0.5, 50.0), wide_open()];
    proptest!(config, |(list in list, camera in 0..3_usize)| {
        let scene = scene(vec![triangles(list)], cameras[camera], 16, 12);
        let worst = check(&scene, &capture_with(&scene, &Options::default()), 3, "anything");
        prop_assert!(worst.whole <= WHOLE, "{worst:?}");
    });
}

/// Rows and columns of quadrilaterals cut in two: corners lie `size` / `count` apart, less than half of that from
/// where a grid would have them.
fn sheet(size: [f64; 2], count: u32, z: impl Fn(u32) -> f64) -> Arc<Mesh> {
    let step = size.map(|s| s / f64::from(count));
    let at = |i: u32| {
        let (column, row) = (i % (count + 1), i / (count + 1));
        let inner = |n: u32| f64::from(u8::from(n > 0 && n < count));
        let x = f64::from(column) + 0.2 * inner(column) * signed(i, 0);
        let y = f64::from(row) + 0.2 * inner(row) * signed(i, 1);
        [step[0] * x - size[0] / 2.0, step[1] * y - size[1] / 2.0, z(i)]
    };
    let vertices = (0..(count + 1) * (count + 1)).map(at).collect();
    let quads = (0..count * count).flat_map(|i| {
        let a = i / count * (count + 1) + i % count;
        let (b, c, d) = (a + 1, a + count + 2, a + count + 1);
        if i % 2 == 0 { [[a, b, c], [a, c, d]] } else { [[a, b, d], [b, c, d]] }
    });
    mesh(vertices, quads.collect(), [1.0, 0.5, 0.25, 0.5], Material::default())
}

fn counts(scene: &Scene) -> Vec<u32> {
    depth_images(Source::Scene(scene), &Options::default(), &|| false).unwrap().fragment_count
}

/// Triangles that reach beyond the guard band and behind the camera still share their edges.
#[test]
fn clipped_sheets_have_no_seams() {
    for camera in cameras() {
        for (size, bend) in [(3e6, 0.0), (1e9, 0.0), (1e6, 2.0), (1e30, 1.0)] {
            let sheet = sheet([size, 0.7 * size], 7, |i| bend * signed(i, 2));
            let counts = counts(&scene(vec![sheet], camera, 200, 150));
            assert!(counts.iter().all(|n| *n == 1), "{size} {bend}");
        }
    }
}

/// A sheet of 2 `count`^2 triangles over the whole image: one fragment per pixel, and of the triangles looked at
/// exactly those that the definition gives.
fn cover_once(count: u32, edge: u32) {
    let sheet = sheet([f64::from(edge); 2], count, |_| 0.0);
    let scene = scene(vec![sheet], pixel_camera(edge), edge, edge);
    assert!(counts(&scene).iter().all(|n| *n == 1));
    let fragments = capture_with(&scene, &Options::default());
    let mut of_face = vec![0; 2 * (count * count) as usize];
    fragments.lists.primitive.iter().for_each(|id| of_face[*id as usize] += 1);
    let (mesh, screen) = (&scene.meshes()[0], exact::screen::Screen::new(&scene));
    for (face, pixels) in of_face.iter().enumerate().step_by(211) {
        let outline = screen.outline(mesh.faces()[face].map(|v| mesh.vertices()[v as usize]));
        assert_eq!(exact::covered(&outline, edge, edge).count(), *pixels, "{face}");
    }
}

#[test]
fn a_million_triangles_cover_every_pixel_once() {
    cover_once(708, 256);
}

#[test]
#[ignore = "takes a release build: 2 s and 0.5 GB there"]
fn ten_million_triangles_cover_every_pixel_once() {
    cover_once(2237, 512);
}
