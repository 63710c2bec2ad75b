use super::*;
use crate::random::hash32;
use crate::raster::cover::Rect;
use crate::raster::pixels::FEW;
use crate::scene::{Camera, Projection};

fn projector(projection: Projection) -> Projector {
    let eye = DVec3::new(0.0, 0.0, 5.0);
    let camera = Camera::new(eye, DVec3::ZERO, DVec3::Y, projection, 1.0, 9.0).unwrap();
    Projector::new(&camera, 256, 256)
}

/// Corners in view space whose screen positions fall on sub-pixels, with three different depths.
fn corners(projector: &Projector, screen: [(f64, f64); 3], z: [f64; 3]) -> [DVec3; 3] {
    std::array::from_fn(|i| {
        let (o, d) = projector.ray(0, 0);
        let (o2, d2) = projector.ray(1, 1);
        let at = |a: f64, b: f64, t: f64| a + (b - a) * t;
        let (tx, ty) = (screen[i].0 - 0.5, screen[i].1 - 0.5);
        let origin = DVec3::new(at(o.x, o2.x, tx), at(o.y, o2.y, ty), 0.0);
        let direction = DVec3::new(at(d.x, d2.x, tx), at(d.y, d2.y, ty), 1.0);
        origin + z[i] * direction
    })
}

#[test]
fn both_ways_agree_where_snapping_changes_nothing() {
    for projection in [Projection::Perspective { fov_y: 90.0 }, Projection::Orthographic { height: 8.0 }] {
        let projector = projector(projection);
        let screen = [(10.25, 20.5), (200.75, 40.0), (60.0, 220.125)];
        let view = corners(&projector, screen, [2.0, 5.0, 8.0]);
        let plane = Plane::new(&view.map(|p| projector.project(p)), projector.is_perspective());
        let ray = Ray::new(&projector, view);
        for (x, y) in [(50, 60), (90, 90), (120, 50)] {
            let (p, r) = (plane.at(x, y), ray.at(x, y));
            assert!((p.depth - r.depth).abs() < 1e-5, "{p:?} {r:?}");
            assert!((0..3).all(|i| (p.weights[i] - r.weights[i]).abs() < 1e-9), "{p:?} {r:?}");
        }
    }
}

#[test]
fn many_depths_at_once_are_those_of_single_pixels() {
    let projector = projector(Projection::Perspective { fov_y: 90.0 });
    let view = corners(&projector, [(1.25, 2.5), (240.75, 30.0), (40.0, 230.125)], [2.0, 5.0, 8.0]);
    let plane = Plane::new(&view.map(|p| projector.project(p)), true);
    let run = |x, y, len| Run { x, y, first: 0, len };
    for runs in
        [vec![run(60, 80, 1), run(58, 81, 3), run(57, 82, 11)], vec![run(50, 60, 40), run(40, 61, 66)]]
    {
        let count: usize = runs.iter().map(|run| run.len as usize).sum();
        let mut depth = vec![0.0; count + LANES];
        let pixels = runs.iter().flat_map(|run| (0..run.len.cast_signed()).map(|i| (run.x + i, run.y)));
        plane.depths(&runs, &mut depth);
        let mut again = vec![0.0; count + LANES];
        plane.depths_of_many(&runs, &mut again);
        assert_eq!(depth[..count], again[..count]);
        if count <= FEW {
            let mut few = Pixels::default();
            few.begin(Rect { x0: 30, y0: 40, x1: 130, y1: 90 });
            few.list(&runs);
            plane.depths_at(&few, &mut again);
            assert_eq!(depth[..count], again[..count]);
        }
        for ((x, y), depth) in pixels.zip(depth) {
            assert_eq!(plane.at(x, y).depth, depth);
        }
    }
}

#[test]
fn depths_of_runs_are_those_of_single_pixels_as_far_as_corners_reach() {
    // in sub-pixels, just within the guard band
    let far = 65_000 * SUBPIXELS;
    for corners in [
        [(77 - far, 179 - far), (far + 26, 230_502 - far), (33_510, far + 154)],
        [(77 - far, 19_763), (far + 26, 19_482), (far - 102, 48_717)],
        [(far + 51, far + 102), (230 - far, 51 - far), (15_437 - far, far - 205)],
    ] {
        let vertex = |i: usize, z: f64| ScreenVertex { x: corners[i].0, y: corners[i].1, z };
        let plane = Plane::new(&[vertex(0, 1.1), vertex(1, 3.7), vertex(2, 8.9)], true);
        let mut seen = 0;
        for y in 0..256 {
            // inside, the edge functions have the area's sign
            let inside = |x: &i32| {
                let Hit { depth, weights } = plane.at(*x, y);
                depth.is_finite() && weights.iter().all(|w| *w > 0.0)
            };
            let pixels: Vec<i32> = (0..256).filter(inside).collect();
            let Some(&x) = pixels.first() else { continue };
            let run = Run { x, y, first: 0, len: u32::try_from(pixels.len()).unwrap() };
            let mut depth = vec![0.0; pixels.len() + LANES];
            plane.depths_of_many(&[run], &mut depth);
            let alone: Vec<f32> = pixels.iter().map(|&x| plane.at(x, y).depth).collect();
            assert_eq!(depth[..pixels.len()], alone, "{y}");
            seen += pixels.len();
        }
        assert!(seen > 1000, "{seen}");
    }
}

#[test]
fn slopes_are_as_precise_as_edge_functions_and_not_for_slivers() {
    let (mut sloped, mut slivers) = (0, 0);
    for n in 0..3000_u32 {
        let random = |k: u32| f64::from(hash32(n, k, 0, 0, 0)) / f64::from(u32::MAX);
        // up to the guard band, and down to a sub-pixel's width
        let (size, width) = (2_f64.powf(13.0 + 12.0 * random(0)), 2_f64.powf(-24.0 * random(1)));
        let along = |k: u32| (random(k) - 0.5) * size;
        let corner = |k: u32, z: f64| {
            let (t, across) = (along(k), along(k + 1) * width);
            #[expect(clippy::cast_possible_truncation, reason = "sub-pixels of the guard band")]
            let [x, y] = [t * 0.8 - across * 0.6, t * 0.6 + across * 0.8].map(|c| c.round() as i32);
            ScreenVertex { x, y, z }
        };
        let steep = 10_f64.powf(4.0 * random(2));
        let corners = [corner(10, 1.1), corner(20, 1.1 + random(3)), corner(30, 1.1 * steep)];
        for perspective in [true, false] {
            let plane = Plane::new(&corners, perspective);
            if plane.area == 0.0 {
                continue;
            }
            let Some(slope) = plane.slope() else {
                let (width, height) =
                    (plane.to_1.0.abs() + plane.to_2.0.abs(), plane.to_1.1.abs() + plane.to_2.1.abs());
                // the others are too small
                slivers += u32::from(width * height > LARGE);
                continue;
            };
            sloped += 1;
            for k in 40..50 {
                // somewhere in the triangle
                let (mut a, mut b) = (random(k), random(k + 100));
                if a + b > 1.0 {
                    (a, b) = (1.0 - a, 1.0 - b);
                }
                let dx = (a * plane.to_1.0 + b * plane.to_2.0).round();
                let dy = (a * plane.to_1.1 + b * plane.to_2.1).round();
                let edges = plane.edges(dx, dy);
                if edges.iter().any(|l| l * plane.area < 0.0) {
                    continue;
                }
                let (sum, expected) = (slope.sum(slope.row(dy), dx), plane.sum(edges));
                assert!((sum / expected - 1.0).abs() < 2_f64.powi(-37), "{n}: {sum} {expected} {plane:?}");
            }
        }
    }
    assert!(sloped > 500 && slivers > 500, "{sloped} {slivers}");
}

#[test]
fn depths_without_a_slope_are_those_of_single_pixels() {
    let vertex = |x: i32, y: i32, z: f64| ScreenVertex { x, y, z };
    let small = [vertex(300, 410, 1.1), vertex(9800, 700, 3.7), vertex(2000, 10_100, 8.9)];
    // steep rather than narrow, so that it has pixels
    let steep = [vertex(300, 410, 1.1), vertex(60_800, 700, 3.7), vertex(2000, 61_100, 8.9e4)];
    for corners in [small, steep] {
        let plane = Plane::new(&corners, true);
        assert!(plane.slope().is_none());
        let runs: Vec<_> = (4..30).map(|y| Run { x: 4, y, first: 0, len: 2 }).collect();
        let pixels: Vec<_> = runs.iter().flat_map(|run| [(run.x, run.y), (run.x + 1, run.y)]).collect();
        let alone: Vec<_> = pixels.iter().map(|&(x, y)| plane.at(x, y).depth).collect();
        let mut depth = vec![0.0; pixels.len() + LANES];
        plane.depths_of_many(&runs, &mut depth);
        assert_eq!(depth[..pixels.len()], alone);
        let mut few = Pixels::default();
        few.begin(Rect { x0: 0, y0: 0, x1: 64, y1: 64 });
        few.list(&runs);
        plane.depths_at(&few, &mut depth);
        assert_eq!(depth[..pixels.len()], alone);
        assert!(alone.iter().all(|depth| *depth > 1.1));
    }
}

#[test]
fn constant_depth_is_exact() {
    let projector = projector(Projection::Perspective { fov_y: 90.0 });
    let view = corners(&projector, [(1.3, 2.7), (251.1, 3.9), (17.7, 255.3)], [3.3; 3]);
    let plane = Plane::new(&view.map(|p| projector.project(p)), true);
    assert_eq!(plane.at(40, 40).depth, 3.3_f32);
}
