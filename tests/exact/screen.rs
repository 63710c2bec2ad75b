//! From the world to the screen as it is documented: float64 view space, clipped, rounded to sub-pixels.

use super::cover::Point;
use glam::DVec3;
use oitlab::scene::{Camera, Projection, Scene};

/// Pixels around the image beyond which triangles are clipped.
const GUARD: f64 = 65_536.0;

/// What is left of a triangle.
#[derive(Debug, Clone)]
pub enum Outline {
    /// All of it; snapped, with its corners' view depths.
    Whole([Point; 3], [f64; 3]),
    /// A part, snapped; and the corners in view space of which it is a part.
    Cut(Vec<Point>, [DVec3; 3]),
}

impl Outline {
    /// Its corners in sub-pixels.
    pub fn points(&self) -> &[Point] {
        match self {
            Self::Whole(points, _) => points,
            Self::Cut(points, _) => points,
        }
    }
}

/// A camera and an image size.
#[derive(Debug, Clone, Copy)]
pub struct Screen {
    camera: Camera,
    /// Pixels per unit of x / z in perspective, of x otherwise.
    pub scale: f64,
    /// The middle of the image, in pixels.
    pub middle: [f64; 2],
    /// Whether x and y are divided by depth.
    pub perspective: bool,
    /// Pixels that are not clipped, in either axis.
    limits: [[f64; 2]; 2],
}

impl Screen {
    /// The screen of a scene.
    pub fn new(scene: &Scene) -> Self {
        let size = [f64::from(scene.width()), f64::from(scene.height())];
        let (scale, perspective) = match scene.camera().projection() {
            Projection::Perspective { fov_y } => (0.5 * size[1] / (0.5 * fov_y).to_radians().tan(), true),
            Projection::Orthographic { height } => (size[1] / height, false),
        };
        let limits = size.map(|edge| [-GUARD, edge + GUARD]);
        Self { camera: *scene.camera(), scale, middle: size.map(|edge| 0.5 * edge), perspective, limits }
    }

    /// Near and far.
    pub fn clip_range(&self) -> (f64, f64) {
        (self.camera.near(), self.camera.far())
    }

    fn position(&self, p: DVec3) -> [f64; 2] {
        let scale = if self.perspective { self.scale / p.z } else { self.scale };
        [self.middle[0] + scale * p.x, self.middle[1] - scale * p.y]
    }

    fn is_inside(&self, p: DVec3) -> bool {
        let (near, far) = self.clip_range();
        let within = |(x, [lo, hi]): (f64, [f64; 2])| lo <= x && x <= hi;
        near <= p.z && p.z <= far && self.position(p).into_iter().zip(self.limits).all(within)
    }

    /// How far inside of near, far, and the guard band's left, right, top and bottom a point is.
    fn distances(&self, p: DVec3) -> [f64; 6] {
        let w = if self.perspective { p.z } else { 1.0 };
        let (x, y) = (self.scale * p.x + self.middle[0] * w, self.middle[1] * w - self.scale * p.y);
        let [[left, right], [top, bottom]] = self.limits;
        let (near, far) = self.clip_range();
        [p.z - near, far - p.z, x - left * w, right * w - x, y - top * w, bottom * w - y]
    }

    /// Where the edge from a to b meets a plane, from the end that is nearer to it; the inner one, if both are as
    /// near; the plane's own coordinate is that of the plane.
    fn meeting(&self, a: DVec3, b: DVec3, plane: usize) -> DVec3 {
        let (a, b) = if self.distances(a)[plane] >= 0.0 { (a, b) } else { (b, a) };
        let (da, db) = (self.distances(a)[plane], self.distances(b)[plane]);
        let between = |from: DVec3, to: DVec3, d: f64, e: f64| from + (to - from) * (d / (d - e));
        let mut p = if da <= -db { between(a, b, da, db) } else { between(b, a, db, da) };
        let (near, far) = self.clip_range();
        match plane {
            0 => p.z = near,
            1 => p.z = far,
            _ => {
                let w = if self.perspective { p.z } else { 1.0 };
                let (axis, end) = (plane / 2 - 1, plane % 2);
                let across = (self.limits[axis][end] - self.middle[axis]) * w / self.scale;
                // y goes down on the screen and up in the world
                p[axis] = if axis == 0 { across } else { -across };
            }
        }
        p
    }

    fn clip(&self, triangle: [DVec3; 3]) -> Vec<DVec3> {
        (0..6).fold(triangle.to_vec(), |points, plane| {
            let is_in = |p: DVec3| self.distances(p)[plane] >= 0.0;
            let mut kept = Vec::new();
            for (i, &p) in points.iter().enumerate() {
                let before = points[(i + points.len() - 1) % points.len()];
                if is_in(before) != is_in(p) {
                    kept.push(self.meeting(before, p, plane));
                }
                kept.extend(is_in(p).then_some(p));
            }
            kept
        })
    }

    /// The nearest sub-pixels, ties to even, of a position that clipping may have left a rounding outside.
    fn snap(&self, p: DVec3) -> Point {
        let at = |axis: usize| {
            let [lo, hi] = self.limits[axis];
            (256.0 * self.position(p)[axis].clamp(lo, hi)).round_ties_even() as i64
        };
        (at(0), at(1))
    }

    /// A triangle in view space.
    pub fn view(&self, corners: [[f64; 3]; 3]) -> [DVec3; 3] {
        corners.map(|corner| self.camera.to_view(DVec3::from(corner)))
    }

    /// What is left of a triangle in world space.
    pub fn outline(&self, corners: [[f64; 3]; 3]) -> Outline {
        let view = self.view(corners);
        if view.into_iter().all(|p| self.is_inside(p)) {
            Outline::Whole(view.map(|p| self.snap(p)), view.map(|p| p.z))
        } else {
            Outline::Cut(self.clip(view).into_iter().map(|p| self.snap(p)).collect(), view)
        }
    }
}
