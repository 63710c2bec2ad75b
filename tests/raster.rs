//! What the rasteriser guarantees: watertight coverage, exact clipping, and bits that no tiling or thread
//! count can change.

#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    clippy::cast_precision_loss,
    clippy::cast_sign_loss,
    reason = "small numbers, chosen here"
)]

mod common;

use common::{
    capture_with, frame, frames_with, mesh, perspective, pixel, pixel_camera, random, rectangle, request,
    samples, scene, soup,
};
use oitlab::fragments::{Fragment, Fragments};
use oitlab::frame::Frame;
use oitlab::render::{Options, Source, depth_images};
use oitlab::scene::{AlphaMode, Colors, Material, Mesh};
use std::sync::Arc;

/// Inserts random points of the 1/256 grid into random triangles of a rectangle until there are `count`.
fn mosaic(width: i64, height: i64, count: usize) -> (Vec<(i64, i64)>, Vec<[usize; 3]>) {
    let mut points = vec![(0, 0), (width * 256, 0), (width * 256, height * 256), (0, height * 256)];
    let mut triangles = vec![[0, 1, 2], [0, 2, 3]];
    let mut draw = 0;
    while triangles.len() < count {
        draw += 1;
        let at = (random(draw, 0) * triangles.len() as f64) as usize;
        let t = triangles[at];
        let (u, v) = (random(draw, 1), random(draw, 2));
        let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
        let mix = |a: i64, b: i64, c: i64| a + ((b - a) as f64 * u + (c - a) as f64 * v).round() as i64;
        let [a, b, c] = t.map(|i| points[i]);
        let p = (mix(a.0, b.0, c.0), mix(a.1, b.1, c.1));
        let area = |p: (i64, i64), q: (i64, i64), r: (i64, i64)| {
            (q.0 - p.0) * (r.1 - p.1) - (q.1 - p.1) * (r.0 - p.0)
        };
        if area(a, b, p) > 0 && area(b, c, p) > 0 && area(c, a, p) > 0 {
            points.push(p);
            let n = points.len() - 1;
            triangles[at] = [t[0], t[1], n];
            triangles.push([t[1], t[2], n]);
            triangles.push([t[2], t[0], n]);
        }
    }
    (points, triangles)
}

#[test]
fn a_mosaic_of_shared_edges_covers_every_pixel_once() {
    let (width, height) = (640, 360);
    let (points, triangles) = mosaic(width, height, 100_000);
    let world = |(x, y): (i64, i64)| {
        [x as f64 / 256.0 - width as f64 / 2.0, height as f64 / 2.0 - y as f64 / 256.0, 0.0]
    };
    let vertices = points.into_iter().map(world).collect();
    let faces: Vec<_> = triangles.iter().map(|t| t.map(|v| v as u32)).collect();
    assert!(faces.len() >= 100_000);
    let mesh = mesh(vertices, faces, [1.0, 0.5, 0.25, 0.5], Material::default());
    let scene = scene(vec![mesh], pixel_camera(360), 640, 360);
    let images = depth_images(Source::Scene(&scene), &Options::default(), &|| false).unwrap();
    assert!(images.fragment_count.iter().all(|&n| n == 1));
}

fn options(tile_size: u32, threads: usize, max_fragments: usize) -> Options {
    Options { threads: Some(threads), skip: true, tile_size, max_fragments }
}

#[test]
fn tiles_and_threads_change_no_bit() {
    let scene = scene(vec![soup(2000, |i| i)], perspective(60.0, 0.5, 8.0), 97, 61);
    let reference = capture_with(&scene, &Options::default());
    assert!(reference.lists.len() > 30_000);
    for (tile_size, threads) in [(1, 2), (7, 1), (16, 3), (64, 2), (500, 1)] {
        let other = capture_with(&scene, &options(tile_size, threads, 1 << 18));
        assert!(other.content_hash() == reference.content_hash(), "tiles of {tile_size}");
    }
}

/// Faces that share their vertices, some of them out of sight, as they are or each with vertices of its own.
#[test]
fn vertices_shared_or_not_change_no_bit() {
    let vertices: Vec<[f64; 3]> = (0..400).map(|v| [0, 1, 2].map(|k| 6.0 * random(v, k) - 3.0)).collect();
    let blend = Material::default();
    let masked = Material { alpha_mode: AlphaMode::Mask, ..blend };
    let opaque = Material { alpha_mode: AlphaMode::Opaque, double_sided: false, ..blend };
    let meshes = |are_shared: bool| {
        let of = |(count, material): (u32, Material)| {
            let near = |f: u32, k: u32| (f + (random(f, k) * 9.0) as u32) % 400;
            let faces: Vec<_> = (0..count).map(|f| [near(f, 5), near(f, 6), near(f, 7)]).collect();
            let colors = (0..count).map(|f| [11, 12, 13, 14].map(|k| random(f, k) as f32)).collect();
            let corners = faces.as_flattened().iter().map(|&v| vertices[v as usize]);
            let (vertices, faces) = if are_shared {
                (vertices.clone(), faces)
            } else {
                (corners.collect(), (0..count).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]).collect())
            };
            Arc::new(Mesh::new(vertices, faces, Colors::Face(colors), material).unwrap())
        };
        [(5000, blend), (300, masked), (201, opaque)].map(of).to_vec()
    };
    let capture_of = |are_shared, threads| {
        let scene = scene(meshes(are_shared), perspective(60.0, 0.5, 8.0), 97, 61);
        capture_with(&scene, &options(16, threads, 1 << 18))
    };
    let shared = capture_of(true, 1);
    assert!(shared.lists.len() > 30_000, "{}", shared.lists.len());
    for threads in 1..=3 {
        assert!(capture_of(false, threads).content_hash() == shared.content_hash());
        assert!(capture_of(true, threads).content_hash() == shared.content_hash());
    }
}

fn fragments_of(fragments: &Fragments, pixel: usize) -> Vec<Fragment> {
    fragments.lists.as_ref().row(pixel).iter().collect()
}

#[test]
fn triangle_order_changes_arrival_alone() {
    let count = 400;
    let camera = perspective(60.0, 0.5, 8.0);
    let forward = capture_with(&scene(vec![soup(count, |i| i)], camera, 64, 48), &Options::default());
    let turned = |i| (i * 37 + 11) % count;
    let shuffled = capture_with(&scene(vec![soup(count, turned)], camera, 64, 48), &Options::default());
    for pixel in 0..64 * 48 {
        let mut a = fragments_of(&forward, pixel);
        let mut b = fragments_of(&shuffled, pixel);
        b.iter_mut().for_each(|f| f.primitive = turned(f.primitive));
        let key = |f: &Fragment| f.primitive;
        assert!(a.is_sorted_by_key(key), "arrival is in submission order");
        a.sort_by_key(key);
        b.sort_by_key(key);
        assert_eq!(a, b, "pixel {pixel}");
    }
}

#[test]
fn a_plane_through_the_camera_is_cut_at_near_and_far() {
    // the plane y = -1 as one enormous triangle, seen from (0, 0, 5): pixel rows below the horizon only
    let vertices = vec![[-1e6, -1.0, -1e6], [1e6, -1.0, -1e6], [0.0, -1.0, 1e6]];
    let ground = mesh(vertices, vec![[0, 1, 2]], [1.0, 1.0, 1.0, 0.5], Material::default());
    let (near, far) = (1.5, 20.0);
    let fragments =
        capture_with(&scene(vec![ground], perspective(90.0, near, far), 64, 64), &Options::default());
    for y in 0..64_usize {
        // at 90 degrees a row's slope is dy/dz = (32 - y - 0.5) / 32, so the ray meets y = -1 at z = -1 / slope
        let slope = (31.5 - y as f64) / 32.0;
        let depth = -1.0 / slope;
        for x in 0..64_usize {
            let list = fragments_of(&fragments, y * 64 + x);
            if slope < 0.0 && (near..=far).contains(&depth) {
                assert_eq!(list.len(), 1, "({x}, {y})");
                let error = (f64::from(list[0].depth) - depth).abs() / depth;
                assert!(error < 1e-6, "({x}, {y}): {} is {error} off", list[0].depth);
            } else {
                assert!(list.is_empty(), "({x}, {y})");
            }
        }
    }
}

#[test]
fn what_lies_behind_the_camera_or_has_no_area_draws_nothing() {
    let white = [1.0, 1.0, 1.0, 0.5];
    let behind = rectangle([-9.0, 9.0], [-9.0, 9.0], 7.0, white, Material::default());
    let points = vec![[0.0; 3], [1.0, 1.0, 0.0], [2.0, 2.0, 0.0]];
    let line = mesh(points, vec![[0, 1, 2], [1, 1, 2], [0, 0, 0]], white, Material::default());
    let empty = mesh(vec![], vec![], white, Material::default());
    let scene = scene(vec![behind, line, empty], perspective(60.0, 0.5, 50.0), 32, 32);
    assert!(capture_with(&scene, &Options::default()).lists.is_empty());
}

#[test]
fn interpolation_is_perspective_correct() {
    // the plane y = 1, receding from z = 2 to z = 8, with alpha = (z - 2) / 6 at its corners
    let vertices = vec![[-2.0, 1.0, 3.0], [2.0, 1.0, 3.0], [8.0, 1.0, -3.0], [-8.0, 1.0, -3.0]];
    let colors = [0.0, 0.0, 1.0, 1.0].map(|a| [1.0, 1.0, 1.0, a]).to_vec();
    let quad = Mesh::new(vertices, vec![[0, 1, 2], [0, 2, 3]], Colors::Vertex(colors), Material::default());
    let scene = scene(vec![Arc::new(quad.unwrap())], perspective(90.0, 0.5, 50.0), 128, 128);
    let fragments = capture_with(&scene, &Options::default());
    assert!(!fragments.lists.is_empty());
    for f in fragments.lists.as_ref().all.iter() {
        let expected = (f.depth - 2.0) / 6.0;
        assert!((f.alpha - expected).abs() < 2e-4, "{f:?}");
        assert_eq!(f.color, [f.alpha; 3]);
    }
}

#[test]
fn opaque_surfaces_hide_what_lies_behind_and_keep_what_touches_them() {
    let opaque = Material { alpha_mode: AlphaMode::Opaque, ..Material::default() };
    let all = ([-8.0, 8.0], [-8.0, 8.0]);
    let wall = rectangle(all.0, all.1, 0.0, [0.5, 0.25, 0.125, 0.3], opaque);
    let half = |z, rgba| rectangle([-8.0, 0.0], all.1, z, rgba, Material::default());
    let meshes =
        vec![half(-1.0, [1.0; 4]), half(0.0, [0.0, 0.0, 1.0, 0.5]), wall, half(1.0, [0.0, 1.0, 0.0, 0.5])];
    let scene = scene(meshes, pixel_camera(16), 16, 16);
    let frame = frame(Source::Scene(&scene), "a_buffer", &[]);
    assert_eq!(pixel(&frame, 12, 8), [0.5, 0.25, 0.125]);
    // green over blue over the wall; the quad behind the wall is gone
    assert_eq!(pixel(&frame, 3, 8), [0.125, 0.5625, 0.28125]);
    assert_eq!(frame.stats.fragments, 2 * 8 * 16);
    // the wall fills the tile, so that its two triangles are told hidden as a whole
    let skipped = |frame: &Frame, what| frame.stats.skipped.iter().find(|(name, _)| *name == what).unwrap().1;
    assert_eq!(skipped(&frame, "occluded_primitives"), 2);
    assert_eq!(skipped(&frame, "occluded_fragments"), 0);
    let plain = Options { skip: false, ..Options::default() };
    let full = frames_with(Source::Scene(&scene), &[request("a_buffer", &[])], &plain).remove(0);
    assert!(full.color == frame.color);
    assert_eq!(skipped(&full, "occluded_primitives"), 0);
    assert_eq!(skipped(&full, "occluded_fragments"), 8 * 16);
}

#[test]
fn masks_cut_holes_and_opacity_makes_them_blend() {
    let mask = Material { alpha_mode: AlphaMode::Mask, alpha_cutoff: 0.5, ..Material::default() };
    let quad = |opacity| {
        let vertices = vec![[-8.0, -8.0, 0.0], [8.0, -8.0, 0.0], [8.0, 8.0, 0.0], [-8.0, 8.0, 0.0]];
        let colors = [0.0, 1.0, 1.0, 0.0].map(|a| [1.0, 0.5, 0.0, a]).to_vec();
        let material = Material { opacity, ..mask };
        Arc::new(Mesh::new(vertices, vec![[0, 1, 2], [0, 2, 3]], Colors::Vertex(colors), material).unwrap())
    };
    let render = |opacity| {
        let scene = scene(vec![quad(opacity)], pixel_camera(16), 16, 16);
        frame(Source::Scene(&scene), "a_buffer", &[])
    };
    let masked = render(None);
    assert_eq!(pixel(&masked, 3, 3), [0.125, 0.25, 0.375]);
    assert_eq!(pixel(&masked, 12, 3), [1.0, 0.5, 0.0]);
    assert_eq!(masked.stats.fragments, 0);
    let blended = render(Some(0.5));
    assert_eq!(pixel(&blended, 3, 3), [0.125, 0.25, 0.375]);
    assert_eq!(pixel(&blended, 12, 3), [0.5625, 0.375, 0.1875]);
    assert_eq!(blended.stats.fragments, 8 * 16);
}

/// Of few pixels and of many, of long rows and of short ones, whole and clipped.
#[test]
fn what_is_hidden_stays_hidden_where_a_mask_cuts_holes() {
    let opaque = Material { alpha_mode: AlphaMode::Opaque, ..Material::default() };
    let wall = rectangle([-32.0, 0.0], [-32.0, 32.0], 0.0, [0.5, 0.25, 0.125, 1.0], opaque);
    let mask = Material { alpha_mode: AlphaMode::Mask, opacity: Some(0.5), ..Material::default() };
    for (width, height) in [(2.0, 2.0), (12.0, 12.0), (24.0, 2.0), (24.0, 24.0), (1e6, 1.0), (1e6, 40.0)] {
        let sheet = |x: [f64; 2]| rectangle(x, [-1.0, height - 1.0], -1.0, [1.0; 4], mask);
        let drawn = |x| {
            let scene = scene(vec![wall.clone(), sheet(x)], pixel_camera(64), 64, 64);
            frame(Source::Scene(&scene), "a_buffer", &[])
        };
        assert_eq!(drawn([-4.0 - width, -4.0]).stats.fragments, 0, "{width} x {height}");
        let shown = drawn([4.0, 4.0 + width]).stats.fragments;
        assert_eq!(shown as f64, width.min(28.0) * height.min(33.0), "{width} x {height}");
    }
}

#[test]
fn back_faces_go_where_the_material_says_so() {
    let one_sided = Material { double_sided: false, ..Material::default() };
    let count = |x: [f64; 2]| {
        let quad = rectangle(x, [-4.0, 4.0], 0.0, [1.0; 4], one_sided);
        capture_with(&scene(vec![quad], pixel_camera(16), 16, 16), &Options::default()).lists.len()
    };
    assert_eq!(count([-4.0, 4.0]), 64, "counter-clockwise as seen from the camera");
    assert_eq!(count([4.0, -4.0]), 0, "clockwise");
}

#[test]
fn a_pixel_of_18_700_fragments_is_exact_and_parts_of_tiles_change_no_bit() {
    let layers = 18_700_u32;
    let vertices = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]];
    let at = |i: u32| 3.0 * f64::from(i * 7919 % layers) / f64::from(layers);
    let all = (0..layers).flat_map(|i| vertices.map(|[x, y]| [x, y, at(i)])).collect();
    let faces = (0..layers).flat_map(|i| [[0, 1, 2], [0, 2, 3]].map(|f| f.map(|v| 4 * i + v))).collect();
    let colors = (0..2 * layers).map(|i| [random(i / 2, 0) as f32, 0.5, 0.25, 0.001]).collect();
    let mesh = Mesh::new(all, faces, Colors::Face(colors), Material::default()).unwrap();
    let scene = scene(vec![Arc::new(mesh)], pixel_camera(4), 4, 4);
    let frame = frame(Source::Scene(&scene), "a_buffer", &[]);
    assert_eq!(frame.stats.depth_complexity_max, u64::from(layers));
    assert_eq!(frame.stats.fragments, 4 * u64::from(layers));
    let transmittance = samples(&frame.transmittance)[5];
    assert!((f64::from(transmittance) - (1.0 - f64::from(0.001_f32)).powi(18_700)).abs() < 1e-12);
    let parts = frames_with(Source::Scene(&scene), &[request("a_buffer", &[])], &options(4, 2, 1));
    assert!(parts[0].color == frame.color && parts[0].stats.fragments == frame.stats.fragments);
}

/// Quads with edges along the rows and far beyond the image.
#[test]
fn what_is_larger_than_the_image_fills_it() {
    for size in [1.0, 1.05, 2.0, 80.0, 1e4] {
        let half = 64.0 * size;
        let quad = rectangle([-half, half], [-half, half], 0.0, [1.0, 0.5, 0.25, 0.5], Material::default());
        let scene = scene(vec![quad], pixel_camera(128), 128, 128);
        let images = depth_images(Source::Scene(&scene), &Options::default(), &|| false).unwrap();
        assert!(images.fragment_count.iter().all(|&n| n == 1), "{size}");
    }
}
