//! Primitives as another rasteriser takes them: the same snapped outlines, and depth and corner weights as functions
//! of the pixel, so that it covers the same pixels and sees the same surface in them.

use super::Raster;
use super::chunk::{Chunk, Polygon, Primitive, Triangle};
use super::cover::{Rect, centers};
use super::project::{CENTER, Projector, SUBPIXELS};
use super::shade::Paint;
use glam::DVec3;

/// What a primitive covers, in sub-pixels from the image's corner, of which a pixel has 256.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Outline<'a> {
    /// A whole triangle.
    Triangle([(i32, i32); 3]),
    /// What clipping left of one: where snapping folded it, a centre inside is to the right of an odd number of edges.
    Polygon(&'a [(i32, i32)]),
}

impl Outline<'_> {
    /// The corners.
    pub fn points(&self) -> &[(i32, i32)] {
        match self {
            Self::Triangle(points) => points,
            Self::Polygon(points) => points,
        }
    }
}

/// A linear function of the pixel.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Linear {
    /// Its value at the centre of the anchor pixel.
    pub at: f64,
    /// Its step to the next pixel on the right ...
    pub x: f64,
    /// ... and below.
    pub y: f64,
}

impl Linear {
    /// The function through its values at the anchor, so many pixels to the right, and so many below.
    fn through(at: f64, right: f64, below: f64, pixels: f64) -> Self {
        Self { at, x: (right - at) / pixels, y: (below - at) / pixels }
    }
    fn times(self, factor: f64) -> Self {
        Self { at: self.at * factor, x: self.x * factor, y: self.y * factor }
    }
    fn plus(self, other: Self) -> Self {
        Self { at: self.at + other.at, x: self.x + other.x, y: self.y + other.y }
    }
    fn is_finite(self) -> bool {
        self.at.is_finite() && self.x.is_finite() && self.y.is_finite()
    }
}

/// A transparent primitive that may cover pixels of the image.
#[derive(Debug, Clone, Copy)]
pub struct Drawn<'a> {
    /// Primitive id.
    pub primitive: u32,
    /// Where it is.
    pub outline: Outline<'a>,
    /// The pixel that the functions start from: near its first corner, and in the image.
    pub anchor: (i32, i32),
    /// 1 / view depth in perspective, view depth otherwise.
    pub depth: Linear,
    /// The corners' weights times something that they share at each pixel.
    pub weights: [Linear; 3],
    /// The nearest and the farthest depth that it has.
    pub range: (f64, f64),
    /// Its colours.
    pub paint: Paint,
}

impl Raster<'_> {
    /// Whether a depth function of [`Drawn`] is that of the inverse depth.
    pub fn is_perspective(&self) -> bool {
        self.projector.is_perspective()
    }

    /// The transparent primitives in submission order, each once for every tile that it touches: to be asked of a raster
    /// of one tile.
    pub fn drawn(&self) -> impl Iterator<Item = Drawn<'_>> {
        let primitives = |chunk| Chunk::in_tile(chunk, 0).map(move |primitive| (chunk, primitive));
        self.transparent.iter().flat_map(primitives).map(|(chunk, primitive)| self.export(chunk, primitive))
    }

    fn export<'r>(&'r self, chunk: &'r Chunk, primitive: Primitive<'r>) -> Drawn<'r> {
        let mesh = &self.scene.meshes()[chunk.mesh];
        let image = self.rect(0, 0);
        match primitive {
            Primitive::Triangle(triangle) => {
                let outline = Outline::Triangle(triangle.points());
                let anchor = anchor(outline.points(), &image);
                let (depth, weights) = of_triangle(&triangle, anchor, self.is_perspective());
                let z = triangle.vertices.map(|v| v.z);
                Drawn {
                    primitive: chunk.first_primitive + triangle.face,
                    outline,
                    anchor,
                    depth,
                    weights,
                    range: (z[0].min(z[1]).min(z[2]), z[0].max(z[1]).max(z[2])),
                    paint: triangle.paint(mesh),
                }
            }
            Primitive::Polygon(polygon) => {
                let anchor = anchor(&polygon.points, &image);
                let (depth, weights) = of_polygon(polygon, anchor, &self.projector);
                let ((near, far), z) = (self.projector.clip_range(), polygon.corners.map(|c| c.z));
                Drawn {
                    primitive: chunk.first_primitive + polygon.face,
                    outline: Outline::Polygon(&polygon.points),
                    anchor,
                    depth,
                    weights,
                    range: (z[0].min(z[1]).min(z[2]).max(near), z[0].max(z[1]).max(z[2]).min(far)),
                    paint: Paint::new(mesh, polygon.face as usize, polygon.light),
                }
            }
        }
    }
}

/// The pixels of `image` whose centres lie within an outline's bounds; empty ones are as wide or high as nothing.
pub fn pixel_bounds_of(points: &[(i32, i32)], image: &Rect) -> Rect {
    let axis = |of: fn(&(i32, i32)) -> i32, first: i32, last: i32| {
        let (low, high) = points.iter().map(of).fold((i32::MAX, i32::MIN), |(a, b), x| (a.min(x), b.max(x)));
        let (low, high) = centers(low, high);
        (low.max(first), high.min(last).max(low.max(first)))
    };
    let ((x0, x1), (y0, y1)) = (axis(|p| p.0, image.x0, image.x1), axis(|p| p.1, image.y0, image.y1));
    Rect { x0, y0, x1, y1 }
}

/// A pixel of the image near the first corner, within the outline's bounds where they allow it.
fn anchor(points: &[(i32, i32)], image: &Rect) -> (i32, i32) {
    let axis = |of: fn(&(i32, i32)) -> i32, first: i32, last: i32| {
        let (low, high) = points.iter().map(of).fold((i32::MAX, i32::MIN), |(a, b), x| (a.min(x), b.max(x)));
        let (low, high) = centers(low, high);
        let pixel = of(&points[0]).div_euclid(SUBPIXELS).clamp(low, (high - 1).max(low));
        pixel.clamp(first, last - 1)
    };
    (axis(|p| p.0, image.x0, image.x1), axis(|p| p.1, image.y0, image.y1))
}

/// The edge functions of the snapped corners, as `Plane` has them: they are whole numbers and exact.
fn of_triangle(triangle: &Triangle<'_>, anchor: (i32, i32), perspective: bool) -> (Linear, [Linear; 3]) {
    let v = triangle.vertices;
    let difference = |i: usize| (f64::from(v[i].x - v[0].x), f64::from(v[i].y - v[0].y));
    let (to_1, to_2) = (difference(1), difference(2));
    let area = to_1.0 * to_2.1 - to_2.0 * to_1.1;
    let dx = f64::from(anchor.0 * SUBPIXELS + CENTER - v[0].x);
    let dy = f64::from(anchor.1 * SUBPIXELS + CENTER - v[0].y);
    let pixel = f64::from(SUBPIXELS);
    let l1 = Linear { at: dx * to_2.1 - dy * to_2.0, x: pixel * to_2.1, y: -pixel * to_2.0 };
    let l2 = Linear { at: dy * to_1.0 - dx * to_1.1, x: -pixel * to_1.1, y: pixel * to_1.0 };
    let l0 = Linear { at: area - l1.at - l2.at, x: -l1.x - l2.x, y: -l1.y - l2.y };
    let z = v.map(|v| v.z);
    let values = if perspective { z.map(f64::recip) } else { z };
    // the slopes from differences of the corners: where these are alike, nothing may be left
    let (d1, d2) = (values[1] - values[0], values[2] - values[0]);
    let depth = Linear {
        at: (l0.at * values[0] + l1.at * values[1] + l2.at * values[2]) / area,
        x: (l1.x * d1 + l2.x * d2) / area,
        y: (l1.y * d1 + l2.y * d2) / area,
    };
    let shares = if perspective { values } else { [1.0; 3] };
    (depth, [l0.times(shares[0] / area), l1.times(shares[1] / area), l2.times(shares[2] / area)])
}

/// The volumes between the pixel's ray and the corners, as `Ray` has them. They are linear in the pixel.
fn of_polygon(polygon: &Polygon, anchor: (i32, i32), projector: &Projector) -> (Linear, [Linear; 3]) {
    /// Pixels between the rays that the functions are found from: far enough that little is left to rounding.
    const APART: u32 = 1024;
    #[expect(clippy::cast_sign_loss, reason = "the anchor lies in the image")]
    let (x, y) = (anchor.0 as u32, anchor.1 as u32);
    let volumes = |x: u32, y: u32| {
        let (origin, direction) = projector.ray(x, y);
        let [a, b, c] = polygon.corners.map(|corner| corner - origin);
        [direction.dot(b.cross(c)), direction.dot(c.cross(a)), direction.dot(a.cross(b))]
    };
    let (at, right, below) = (volumes(x, y), volumes(x + APART, y), volumes(x, y + APART));
    let linear = |i: usize| Linear::through(at[i], right[i], below[i], f64::from(APART));
    let [a, b, c] = polygon.corners;
    // the volumes' sum times the depth in perspective, the volumes' sum otherwise
    let all = if projector.is_perspective() { a.dot(b.cross(c)) } else { at.iter().sum() };
    let weights = [0, 1, 2].map(|i| linear(i).times(all.recip()));
    let depth = if projector.is_perspective() {
        weights[0].plus(weights[1]).plus(weights[2])
    } else {
        weights[0].times(a.z).plus(weights[1].times(b.z)).plus(weights[2].times(c.z))
    };
    if weights.iter().chain([&depth]).all(|linear| linear.is_finite()) {
        return (depth, weights);
    }
    seen_edge_on(polygon.corners, projector.is_perspective())
}

/// A triangle that has no area as seen: its corners count alike.
fn seen_edge_on(corners: [DVec3; 3], perspective: bool) -> (Linear, [Linear; 3]) {
    let constant = |at| Linear { at, x: 0.0, y: 0.0 };
    let z = (corners[0].z + corners[1].z + corners[2].z) / 3.0;
    (constant(if perspective { z.recip() } else { z }), [constant(1.0 / 3.0); 3])
}

#[cfg(test)]
mod tests {
    use super::super::{Order, Tile, TileLists};
    use super::*;
    use crate::fragments::Lists;
    use crate::scene::{Camera, Colors, Material, Mesh, Projection, Scene};
    use std::sync::Arc;

    const SIZE: (u32, u32) = (48, 40);

    /// Triangles all over the image, of which some reach behind the eye and some far beyond the guard band.
    fn scene(projection: Projection) -> Scene {
        let random = |i: u32| f64::from(crate::random::hash32(i, 1, 2, 3, 4)) / f64::from(u32::MAX);
        let point = |i: u32| {
            let reach = if i.is_multiple_of(11) { 3e4 } else { 3.0 };
            [
                reach * (2.0 * random(3 * i) - 1.0),
                2.0 - 4.0 * random(3 * i + 1),
                6.0 - 9.0 * random(3 * i + 2),
            ]
        };
        let faces = (0..60).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
        let colors = Colors::Vertex((0..180_u16).map(|i| [f32::from(i) / 180.0, 0.5, 0.2, 0.5]).collect());
        let mesh = Mesh::new((0..180).map(point).collect(), faces, colors, Material::default()).unwrap();
        let camera = Camera::new(DVec3::new(0.0, 0.0, 5.0), DVec3::ZERO, DVec3::Y, projection, 0.5, 9.0);
        Scene::new(vec![Arc::new(mesh)], camera.unwrap(), SIZE.0, SIZE.1, [0.0; 3]).unwrap()
    }

    fn inside(points: &[(i32, i32)], x: i32, y: i32) -> bool {
        let (cx, cy) = (i64::from(x * SUBPIXELS + CENTER), i64::from(y * SUBPIXELS + CENTER));
        let left = |i: usize| {
            let (a, b) = (points[i], points[(i + 1) % points.len()]);
            let (top, bottom) = if a.1 < b.1 { (a, b) } else { (b, a) };
            let (tx, ty) = (i64::from(top.0), i64::from(top.1));
            let (dx, dy) = (i64::from(bottom.0) - tx, i64::from(bottom.1) - ty);
            ty <= cy && cy < i64::from(bottom.1) && (cy - ty) * dx <= (cx - tx) * dy
        };
        (0..points.len()).filter(|&i| left(i)).count() % 2 == 1
    }

    /// Every pixel of the image, from the exported functions alone.
    fn from_exports(raster: &Raster<'_>) -> Lists {
        let drawn: Vec<_> = raster.drawn().collect();
        let mut lists = Lists::new();
        for (y, x) in (0..SIZE.1.cast_signed()).flat_map(|y| (0..SIZE.0.cast_signed()).map(move |x| (y, x))) {
            for d in drawn.iter().filter(|d| inside(d.outline.points(), x, y)) {
                let (dx, dy) = (f64::from(x - d.anchor.0), f64::from(y - d.anchor.1));
                let at = |l: &Linear| l.at + l.x * dx + l.y * dy;
                let depth = if raster.is_perspective() { at(&d.depth).recip() } else { at(&d.depth) };
                let shares = d.weights.map(|w| at(&w).max(0.0));
                let sum: f64 = shares.iter().sum();
                let hit = super::super::interpolate::Hit { depth: 0.0, weights: shares.map(|s| s / sum) };
                let [r, g, b, alpha] = d.paint.at(&hit);
                #[expect(clippy::cast_possible_truncation, reason = "fragments store depth as f32")]
                let depth = depth.clamp(d.range.0, d.range.1) as f32;
                lists.push(crate::fragments::Fragment {
                    depth,
                    color: [r, g, b],
                    alpha,
                    primitive: d.primitive,
                });
            }
            lists.end_row();
        }
        lists
    }

    #[test]
    fn exported_functions_give_the_same_fragments() {
        for projection in [Projection::Perspective { fov_y: 60.0 }, Projection::Orthographic { height: 4.0 }]
        {
            let scene = scene(projection);
            let raster = Raster::new(&scene, SIZE.0, &|| false);
            let rect = raster.rect(0, 0);
            let (mut tile, mut lists, mut expected) = (Tile::default(), TileLists::default(), Lists::new());
            lists.begin(rect, 0, usize::MAX);
            tile.begin(&raster, (0, 0), rect, true, &|| false);
            tile.transparent(&raster, (0, 0), Order::Submission, &mut lists, &|| false);
            lists.distribute(false);
            lists.shade(0, rect.area(), &mut expected);
            let got = from_exports(&raster);
            let clipped = raster.drawn().filter(|d| matches!(d.outline, Outline::Polygon(_))).count();
            assert!(expected.len() > 4000 && clipped > 5, "{} {clipped}", expected.len());
            assert_eq!((&got.offsets, &got.primitive), (&expected.offsets, &expected.primitive));
            for i in 0..got.len() {
                let (mine, theirs) = (got.depth[i], expected.depth[i]);
                // a pixel on a clipped triangle's snapped rim may lie a hair outside the triangle
                assert!((mine - theirs).abs() <= 1e-4 * theirs, "{mine} {theirs}");
                let far = (0..3).map(|c| (got.color[i][c] - expected.color[i][c]).abs()).fold(0.0, f32::max);
                assert!(far < 1e-4, "{far}");
            }
        }
    }
}
