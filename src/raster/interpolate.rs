//! Depth and perspective-correct barycentric coordinates at pixel centres.
//!
//! Every pixel is evaluated on its own from the primitive's vertices, so that tiles, threads and SIMD widths cannot change a
//! bit; and every result is clamped to the vertices' range.

use super::pixels::Pixels;
use super::project::{CENTER, Projector, SUBPIXELS, ScreenVertex};
use super::runs::Run;
use glam::DVec3;
use multiversion::multiversion;

/// A pixel centre seen on a primitive: view depth and the weights of the three corners.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hit {
    /// View depth.
    pub depth: f32,
    /// Perspective-correct weights; they sum to one.
    pub weights: [f64; 3],
}

/// Pixels that are evaluated together.
pub const LANES: usize = 8;
/// Pixels of a run that are evaluated from the same first one.
const STEPS: usize = 64;

/// What can be evaluated at a pixel centre inside the primitive.
#[derive(Debug, Clone, Copy)]
pub enum Surface<'a> {
    /// A triangle that needed no clipping.
    Plane(Plane),
    /// A clipped one.
    Ray(Ray<'a>),
}

impl Surface<'_> {
    /// Depth and weights at pixel (x, y).
    #[inline]
    pub fn at(&self, x: i32, y: i32) -> Hit {
        match self {
            Self::Plane(plane) => plane.at(x, y),
            Self::Ray(ray) => ray.at(x, y),
        }
    }

    /// The depth of every pixel, if they all have the same.
    pub fn constant_depth(&self) -> Option<f32> {
        let (lo, hi) = self.range();
        #[expect(clippy::cast_possible_truncation, reason = "fragments store depth as f32")]
        (lo == hi).then_some(lo as f32)
    }

    /// No pixel is farther away.
    #[expect(clippy::cast_possible_truncation, reason = "fragments store depth as f32")]
    pub fn farthest(&self) -> f32 {
        self.range().1 as f32
    }

    fn range(&self) -> (f64, f64) {
        match self {
            Self::Plane(plane) => plane.range,
            Self::Ray(ray) => ray.range,
        }
    }
}

/// A triangle that needed no clipping: edge functions of its snapped corners, exact in f64.
#[derive(Debug, Clone, Copy)]
pub struct Plane {
    origin: (i32, i32),
    to_1: (f64, f64),
    to_2: (f64, f64),
    area: f64,
    /// 1/z of the corners in perspective, z otherwise.
    values: [f64; 3],
    perspective: bool,
    range: (f64, f64),
}

/// What gives the depth, the sum of the edge functions times the corners' values, as the affine function of the pixel that it is.
/// That takes fewer steps per pixel, and a few for the triangle: only large ones have it.
///
/// Its terms are as large as the triangle's extents, and cancel where the area is small beside those: slivers do without, as the
/// products of their edge functions are all of one sign.
#[derive(Debug, Clone, Copy)]
struct Slope {
    /// The sum at the first corner.
    at_origin: f64,
    /// What it gains per sub-pixel to the right and down.
    gain: (f64, f64),
}

/// Triangles have a slope whose sides' widths times heights, of the two at the first corner, are more than that of so many pixels.
const LARGE: f64 = (64 * 64 * SUBPIXELS * SUBPIXELS) as f64;
/// How much larger than the sum the slope's terms may be. A handful of them are rounded to 2^-53 of themselves: 2^-37 of the sum at
/// most, where a depth is rounded to 2^-24.
const CANCELLATION: f64 = 4096.0;

impl Plane {
    /// The plane through three unclipped vertices of nonzero area.
    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    pub fn new(v: &[ScreenVertex; 3], perspective: bool) -> Self {
        let difference = |i: usize| (f64::from(v[i].x - v[0].x), f64::from(v[i].y - v[0].y));
        let (to_1, to_2) = (difference(1), difference(2));
        let z = [v[0].z, v[1].z, v[2].z];
        let area = to_1.0 * to_2.1 - to_2.0 * to_1.1;
        let range = (z[0].min(z[1]).min(z[2]), z[0].max(z[1]).max(z[2]));
        // written out: a function's name would be called, and not for the instruction set at hand
        let values = if perspective { [1.0 / z[0], 1.0 / z[1], 1.0 / z[2]] } else { z };
        Self { origin: (v[0].x, v[0].y), to_1, to_2, area, values, perspective, range }
    }
}

impl Plane {
    /// The slope of a large triangle that is no sliver. Not kept: to carry it along would cost the others more than it saves.
    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    fn slope(&self) -> Option<Slope> {
        let (to_1, to_2, [first, second, third]) = (self.to_1, self.to_2, self.values);
        let extents = (to_1.0.abs() + to_2.0.abs()) * (to_1.1.abs() + to_2.1.abs());
        // the largest value over the least is the farthest depth over the nearest
        let (near, far) = self.range;
        (extents > LARGE && extents * far < CANCELLATION * self.area.abs() * near).then(|| {
            let (rise_1, rise_2) = (second - first, third - first);
            let gain = (to_2.1 * rise_1 - to_1.1 * rise_2, to_1.0 * rise_2 - to_2.0 * rise_1);
            Slope { at_origin: self.area * first, gain }
        })
    }

    /// Which way round the corners go: 1 clockwise on the screen, -1 counter-clockwise.
    pub fn sign(&self) -> f64 {
        self.area.signum()
    }

    #[inline]
    #[expect(clippy::cast_possible_truncation, reason = "fragments store depth as f32")]
    fn at(&self, x: i32, y: i32) -> Hit {
        let dx = f64::from(x * SUBPIXELS + CENTER - self.origin.0);
        let dy = f64::from(y * SUBPIXELS + CENTER - self.origin.1);
        let edges @ [l0, l1, l2] = self.edges(dx, dy);
        let sum = match self.slope() {
            Some(slope) => slope.sum(slope.row(dy), dx),
            None => self.sum(edges),
        };
        let [v0, v1, v2] = self.values;
        let (p0, p1, p2) = (l0 * v0, l1 * v1, l2 * v2);
        let all = p0 + p1 + p2;
        let weights = if self.perspective {
            [p0 / all, p1 / all, p2 / all]
        } else {
            [l0 / self.area, l1 / self.area, l2 / self.area]
        };
        Hit { depth: self.depth(sum) as f32, weights }
    }
}

/// The range's end where the depth lies beyond it or is no number.
#[inline(always)]
#[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
fn clamp_depth(depth: f64, (low, high): (f64, f64)) -> f64 {
    let depth = if depth > low { depth } else { low };
    if depth < high { depth } else { high }
}

impl Slope {
    /// What the sums so many sub-pixels below the first corner have in common ...
    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    fn row(self, dy: f64) -> f64 {
        self.at_origin + dy * self.gain.1
    }

    /// ... and the one so many to the right of it.
    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    fn sum(self, row: f64, dx: f64) -> f64 {
        row + dx * self.gain.0
    }
}

impl Plane {
    /// The edge functions so many sub-pixels right of the first corner and below it: whole numbers, and exact inside of
    /// the triangle.
    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    fn edges(&self, dx: f64, dy: f64) -> [f64; 3] {
        let l1 = dx * self.to_2.1 - dy * self.to_2.0;
        let l2 = dy * self.to_1.0 - dx * self.to_1.1;
        [self.area - l1 - l2, l1, l2]
    }

    /// The sum of the edge functions times the corners' values.
    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    fn sum(&self, [l0, l1, l2]: [f64; 3]) -> f64 {
        let [v0, v1, v2] = self.values;
        l0 * v0 + l1 * v1 + l2 * v2
    }

    /// The depth where the sum is this.
    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    fn depth(&self, sum: f64) -> f64 {
        // one division, whichever it is
        let (above, below) = if self.perspective { (self.area, sum) } else { (sum, self.area) };
        clamp_depth(above / below, self.range)
    }

    /// The depths of some pixels: the bits of [`Surface::at`].
    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    #[expect(clippy::cast_possible_truncation, reason = "fragments store depth as f32")]
    pub fn depths_at(&self, pixels: &Pixels, depth: &mut [f32]) {
        let (x0, y0) = pixels.origin();
        let (right, down) =
            (x0 * SUBPIXELS + CENTER - self.origin.0, y0 * SUBPIXELS + CENTER - self.origin.1);
        let pixels = pixels.at().iter().map(|at| {
            let dx = f64::from((at & 0xFFFF).cast_signed() * SUBPIXELS + right);
            let dy = f64::from((at >> 16).cast_signed() * SUBPIXELS + down);
            (dx, dy)
        });
        // loops that need not choose
        if let Some(slope) = self.slope() {
            for (depth, (dx, dy)) in depth.iter_mut().zip(pixels) {
                *depth = self.depth(slope.sum(slope.row(dy), dx)) as f32;
            }
        } else {
            for (depth, (dx, dy)) in depth.iter_mut().zip(pixels) {
                *depth = self.depth(self.sum(self.edges(dx, dy))) as f32;
            }
        }
    }

    /// The depths of all pixels of the runs, one after the other in `depth`, which has room for [`LANES`] more: the
    /// bits of [`Surface::at`]. What is in the room is within the corners' range, too.
    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    fn depths(&self, runs: &[Run], depth: &mut [f32]) {
        let slope = self.slope();
        let mut next = 0;
        for run in runs {
            // whole vectors, the ends of which the next run writes over
            let end = next + run.len as usize;
            let whole = &mut depth[next..next + (end - next).next_multiple_of(LANES)];
            for (x, depth) in (run.x..).step_by(STEPS).zip(whole.chunks_mut(STEPS)) {
                self.depths_from(x, run.y, slope, depth);
            }
            next = end;
        }
    }

    /// The same by the processor's best instructions.
    pub fn depths_of_many(&self, runs: &[Run], depth: &mut [f32]) {
        depths_of_many(self, runs, depth);
    }

    /// The depths of a pixel and those right of it. A plain loop over a number of pixels that is not known before: of one
    /// over eight, a compiler makes scalars.
    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    #[expect(clippy::cast_possible_truncation, reason = "fragments store depth as f32")]
    fn depths_from(&self, x: i32, y: i32, slope: Option<Slope>, depth: &mut [f32]) {
        let first = f64::from(x * SUBPIXELS + CENTER - self.origin.0);
        let dy = f64::from(y * SUBPIXELS + CENTER - self.origin.1);
        if let Some(slope) = slope {
            let row = slope.row(dy);
            for (depth, step) in depth.iter_mut().zip(SUBPIXELS_TO) {
                *depth = self.depth(slope.sum(row, first + step)) as f32;
            }
        } else {
            for (depth, step) in depth.iter_mut().zip(SUBPIXELS_TO) {
                *depth = self.depth(self.sum(self.edges(first + step, dy))) as f32;
            }
        }
    }
}

/// How many sub-pixels right of a pixel the pixels right of it are.
const SUBPIXELS_TO: &[f64; STEPS] = &{
    let mut steps = [0.0; STEPS];
    let mut i = 1;
    while i < STEPS {
        steps[i] = steps[i - 1] + SUBPIXELS as f64;
        i += 1;
    }
    steps
};

#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"))]
fn depths_of_many(plane: &Plane, runs: &[Run], depth: &mut [f32]) {
    plane.depths(runs, depth);
}

/// A clipped triangle: the pixel's ray against the triangle in view space.
#[derive(Debug, Clone, Copy)]
pub struct Ray<'a> {
    projector: &'a Projector,
    corners: [DVec3; 3],
    range: (f64, f64),
}

impl<'a> Ray<'a> {
    /// The triangle with the given view-space corners, seen within its clipped part alone.
    pub fn new(projector: &'a Projector, corners: [DVec3; 3]) -> Self {
        let (near, far) = projector.clip_range();
        let z = corners.map(|c| c.z);
        let (lo, hi) = (z[0].min(z[1]).min(z[2]), z[0].max(z[1]).max(z[2]));
        Self { projector, corners, range: (lo.max(near), hi.min(far)) }
    }
}

impl Ray<'_> {
    #[expect(clippy::cast_possible_truncation, reason = "fragments store depth as f32")]
    #[expect(clippy::cast_sign_loss, reason = "pixels lie in the image")]
    fn at(&self, x: i32, y: i32) -> Hit {
        let (origin, direction) = self.projector.ray(x as u32, y as u32);
        let [a, b, c] = self.corners.map(|corner| corner - origin);
        let volumes = [direction.dot(b.cross(c)), direction.dot(c.cross(a)), direction.dot(a.cross(b))];
        let sign = volumes.iter().sum::<f64>().signum();
        // a snapped outline covers centres a hair outside the true triangle: weights stop at zero
        let inside = volumes.map(|v| (v * sign).max(0.0));
        let sum: f64 = inside.iter().sum();
        let weights = if sum > 0.0 { inside.map(|v| v / sum) } else { [1.0 / 3.0; 3] };
        let depth: f64 = weights.iter().zip(self.corners).map(|(w, corner)| w * corner.z).sum();
        Hit { depth: depth.clamp(self.range.0, self.range.1) as f32, weights }
    }
}

#[cfg(test)]
mod tests {
    use super::super::cover::Rect;
    use super::super::pixels::FEW;
    use super::*;
    use crate::random::hash32;
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
        for projection in [Projection::Perspective { fov_y: 90.0 }, Projection::Orthographic { height: 8.0 }]
        {
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
                    assert!(
                        (sum / expected - 1.0).abs() < 2_f64.powi(-37),
                        "{n}: {sum} {expected} {plane:?}"
                    );
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
}
