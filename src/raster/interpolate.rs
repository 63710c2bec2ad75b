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
mod tests;
