//! Depth and perspective-correct barycentric coordinates at pixel centres.
//!
//! Every pixel is evaluated on its own from the primitive's vertices, never stepped from a neighbour, so that
//! tiles, threads and SIMD widths cannot change a bit; and every result is clamped to the vertices' range.

use super::project::{CENTER, Projector, SUBPIXELS, ScreenVertex};
use glam::DVec3;

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
/// The same as a distance between pixels.
pub const LANES_I32: i32 = 8;

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
        let (lo, hi) = match self {
            Self::Plane(plane) => plane.range,
            Self::Ray(ray) => ray.range,
        };
        #[expect(clippy::cast_possible_truncation, reason = "fragments store depth as f32")]
        (lo == hi).then_some(lo as f32)
    }

    /// The depths of [`LANES`] pixels from (x, y) to the right: the bits of [`Surface::at`] inside the
    /// primitive, something finite outside.
    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    pub fn depths(&self, x: i32, y: i32) -> [f32; LANES] {
        match self {
            Self::Plane(plane) => plane.depths(x, y),
            Self::Ray(ray) => {
                let mut x = x - 1;
                [(); LANES].map(|()| {
                    x += 1;
                    ray.at(x, y).depth
                })
            }
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
    /// The least value of each edge function, times the sign of the area, that is inside.
    least: [f64; 3],
}

impl Plane {
    /// The plane through three unclipped vertices of nonzero area.
    pub fn new(v: &[ScreenVertex; 3], perspective: bool) -> Self {
        let difference = |i: usize| (f64::from(v[i].x - v[0].x), f64::from(v[i].y - v[0].y));
        let (to_1, to_2) = (difference(1), difference(2));
        let z = v.map(|v| v.z);
        let area = to_1.0 * to_2.1 - to_2.0 * to_1.1;
        let edges = [(to_2.0 - to_1.0, to_2.1 - to_1.1), (-to_2.0, -to_2.1), to_1];
        Self {
            origin: (v[0].x, v[0].y),
            to_1,
            to_2,
            area,
            least: edges.map(|edge| least_inside(edge, area.signum())),
            values: if perspective { z.map(f64::recip) } else { z },
            perspective,
            range: (z[0].min(z[1]).min(z[2]), z[0].max(z[1]).max(z[2])),
        }
    }
}

/// A centre on an edge is inside if the edge is a top or left one as the triangle is walked clockwise. Edge
/// functions are integers, so that 1/2 tells zero from what is above it.
fn least_inside((dx, dy): (f64, f64), sign: f64) -> f64 {
    let (dx, dy) = (dx * sign, dy * sign);
    if dy < 0.0 || (dy == 0.0 && dx > 0.0) { 0.0 } else { 0.5 }
}

impl Plane {
    /// Which of [`LANES`] pixels from (x, y) to the right are inside, by the top-left rule, and the depths of
    /// them all.
    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    #[expect(clippy::cast_possible_truncation, reason = "fragments store depth as f32")]
    #[expect(clippy::needless_bitwise_bool, reason = "three comparisons without branches")]
    pub fn cover(&self, x: i32, y: i32) -> (u8, [f32; LANES]) {
        let dx = f64::from(x * SUBPIXELS + CENTER - self.origin.0);
        let dy = f64::from(y * SUBPIXELS + CENTER - self.origin.1);
        let [v0, v1, v2] = self.values;
        let sign = self.area.signum();
        let (mut inside, mut depths) = ([false; LANES], [0.0; LANES]);
        for lane in 0..LANES {
            let dx = dx + STEPS[lane];
            let l1 = dx * self.to_2.1 - dy * self.to_2.0;
            let l2 = dy * self.to_1.0 - dx * self.to_1.1;
            let l0 = self.area - l1 - l2;
            inside[lane] =
                (l0 * sign >= self.least[0]) & (l1 * sign >= self.least[1]) & (l2 * sign >= self.least[2]);
            let sum = l0 * v0 + l1 * v1 + l2 * v2;
            let depth = if self.perspective { self.area / sum } else { sum / self.area };
            depths[lane] = depth.max(self.range.0).min(self.range.1) as f32;
        }
        let mask = inside.iter().rev().fold(0, |mask, &inside| mask << 1 | u8::from(inside));
        (mask, depths)
    }

    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    #[expect(clippy::cast_possible_truncation, reason = "fragments store depth as f32")]
    fn depths(&self, x: i32, y: i32) -> [f32; LANES] {
        let dx = f64::from(x * SUBPIXELS + CENTER - self.origin.0);
        let dy = f64::from(y * SUBPIXELS + CENTER - self.origin.1);
        let [v0, v1, v2] = self.values;
        let mut depths = [0.0; LANES];
        for lane in 0..LANES {
            let dx = dx + STEPS[lane];
            let l1 = dx * self.to_2.1 - dy * self.to_2.0;
            let l2 = dy * self.to_1.0 - dx * self.to_1.1;
            let l0 = self.area - l1 - l2;
            let sum = l0 * v0 + l1 * v1 + l2 * v2;
            let depth = if self.perspective { self.area / sum } else { sum / self.area };
            depths[lane] = depth.max(self.range.0).min(self.range.1) as f32;
        }
        depths
    }

    #[inline]
    #[expect(clippy::cast_possible_truncation, reason = "fragments store depth as f32")]
    fn at(&self, x: i32, y: i32) -> Hit {
        let dx = f64::from(x * SUBPIXELS + CENTER - self.origin.0);
        let dy = f64::from(y * SUBPIXELS + CENTER - self.origin.1);
        let l1 = dx * self.to_2.1 - dy * self.to_2.0;
        let l2 = dy * self.to_1.0 - dx * self.to_1.1;
        let l0 = self.area - l1 - l2;
        let [v0, v1, v2] = self.values;
        let (p0, p1, p2) = (l0 * v0, l1 * v1, l2 * v2);
        let sum = p0 + p1 + p2;
        let (depth, weights) = if self.perspective {
            (self.area / sum, [p0 / sum, p1 / sum, p2 / sum])
        } else {
            (sum / self.area, [l0 / self.area, l1 / self.area, l2 / self.area])
        };
        Hit { depth: depth.max(self.range.0).min(self.range.1) as f32, weights }
    }
}

/// Sub-pixels from a block's first pixel to each of its pixels.
const STEPS: [f64; LANES] = {
    let mut steps = [0.0; LANES];
    let mut lane = 1;
    while lane < LANES {
        steps[lane] = steps[lane - 1] + SUBPIXELS as f64;
        lane += 1;
    }
    steps
};

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
    use super::*;
    use crate::random::hash32;
    use crate::raster::cover::{Rect, doubled_area, spans};
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
    fn edge_functions_cover_what_the_spans_cover() {
        let rect = Rect { x0: 0, y0: 0, x1: 16, y1: 16 };
        for n in 0..4000 {
            // half the coordinates on the grid of centres, so that edges pass through them
            let at = |k: u32| {
                let c = (hash32(n, k, 5, 0, 0) % 4096).cast_signed();
                if hash32(n, k, 6, 0, 0).is_multiple_of(2) { c / 128 * 128 } else { c }
            };
            let corner = |k: u32| ScreenVertex { x: at(k), y: at(k + 1), z: 1.0 + f64::from(k) };
            let triangle = [corner(0), corner(2), corner(4)];
            let points = triangle.map(|v| (v.x, v.y));
            if doubled_area(&points) == 0 {
                continue;
            }
            let (mut by_spans, mut by_edges) = ([[false; 16]; 16], [[false; 16]; 16]);
            spans(&points, &rect, |y, x0, x1| {
                (x0..x1)
                    .for_each(|x| by_spans[usize::try_from(y).unwrap()][usize::try_from(x).unwrap()] = true);
            });
            let plane = Plane::new(&triangle, true);
            for (y, row) in (0..).zip(&mut by_edges) {
                for x in [0_u8, 8] {
                    let (mask, depths) = plane.cover(x.into(), y);
                    for (lane, depth) in depths.into_iter().enumerate() {
                        let inside = mask >> lane & 1 == 1;
                        let column = usize::from(x) + lane;
                        row[column] = inside;
                        let exact = plane.at(i32::try_from(column).unwrap(), y).depth;
                        assert!(!inside || depth == exact);
                    }
                }
            }
            assert_eq!(by_spans, by_edges, "{points:?}");
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
