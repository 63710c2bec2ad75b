//! From world space to snapped screen positions.

use crate::scene::{Camera, Projection};
use glam::DVec3;
use multiversion::multiversion;

/// Sub-pixel steps per pixel: 8 bits, as D3D and Vulkan require.
pub const SUBPIXELS: i32 = 256;
/// A pixel centre's offset in sub-pixel steps.
pub const CENTER: i32 = SUBPIXELS / 2;
/// Pixels around the viewport within which vertices are snapped as they are; farther out triangles are clipped.
/// With it every product of two coordinate differences stays below 2^52, hence exact in i64 and in f64.
pub const GUARD: f64 = 65_536.0;

/// A vertex on the screen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScreenVertex {
    /// Sub-pixels from the left edge; [`ScreenVertex::OUTSIDE`] where the vertex needs clipping.
    pub x: i32,
    /// Sub-pixels from the top edge.
    pub y: i32,
    /// View depth, also where the vertex needs clipping.
    pub z: f64,
}

impl ScreenVertex {
    /// The `x` of vertices beyond a clip plane or the guard band.
    pub const OUTSIDE: i32 = i32::MIN;
    /// A vertex that was not projected.
    pub const NOWHERE: Self = Self { x: Self::OUTSIDE, y: 0, z: 0.0 };

    /// Whether triangles at this vertex must be clipped.
    pub fn is_outside(&self) -> bool {
        self.x == Self::OUTSIDE
    }
}

/// The camera bound to an image size.
#[derive(Debug, Clone, Copy)]
pub struct Projector {
    camera: Camera,
    /// Pixels per unit of x/z (perspective) or x (orthographic); the same for y.
    scale: f64,
    center: (f64, f64),
    perspective: bool,
    limits: ((f64, f64), (f64, f64)),
}

impl Projector {
    /// The projection of `camera` onto an image of the given size.
    pub fn new(camera: &Camera, width: u32, height: u32) -> Self {
        let (w, h) = (f64::from(width), f64::from(height));
        let (scale, perspective) = match camera.projection() {
            Projection::Perspective { fov_y } => (0.5 * h / (0.5 * fov_y).to_radians().tan(), true),
            Projection::Orthographic { height } => (h / height, false),
        };
        let limits = ((-GUARD, w + GUARD), (-GUARD, h + GUARD));
        Self { camera: *camera, scale, center: (0.5 * w, 0.5 * h), perspective, limits }
    }

    /// Whether depth divides.
    pub fn is_perspective(&self) -> bool {
        self.perspective
    }

    /// A world point in view space.
    pub fn view_point(&self, point: [f64; 3]) -> DVec3 {
        self.camera.to_view(DVec3::from(point))
    }

    /// A view-space point on the screen, in pixels.
    pub fn screen_point(&self, p: DVec3) -> (f64, f64) {
        let scale = if self.perspective { self.scale / p.z } else { self.scale };
        (self.center.0 + scale * p.x, self.center.1 - scale * p.y)
    }

    /// Projects and snaps, marking what needs clipping.
    pub fn project(&self, p: DVec3) -> ScreenVertex {
        let outside = ScreenVertex { x: ScreenVertex::OUTSIDE, y: 0, z: p.z };
        if !(self.camera.near()..=self.camera.far()).contains(&p.z) {
            return outside;
        }
        let (x, y) = self.screen_point(p);
        let ((x_min, x_max), (y_min, y_max)) = self.limits;
        if !((x_min..=x_max).contains(&x) && (y_min..=y_max).contains(&y)) {
            return outside;
        }
        ScreenVertex { x: snap(x), y: snap(y), z: p.z }
    }

    /// Projects up to [`BLOCK`] world points at a time.
    pub fn project_block(&self, points: &[[f64; 3]]) -> [ScreenVertex; BLOCK] {
        project_block(self, points)
    }

    /// Signed distances of a view-space point to near, far and the four sides of the guard band; inside is
    /// >= 0. Each is linear in the point.
    pub fn clip_distances(&self, p: DVec3) -> [f64; 6] {
        let w = if self.perspective { p.z } else { 1.0 };
        let (x, y) = (self.scale * p.x + self.center.0 * w, self.center.1 * w - self.scale * p.y);
        let ((x_min, x_max), (y_min, y_max)) = self.limits;
        [
            p.z - self.camera.near(),
            self.camera.far() - p.z,
            x - x_min * w,
            x_max * w - x,
            y - y_min * w,
            y_max * w - y,
        ]
    }

    /// A point that lies on a clip plane of [`Projector::clip_distances`] but for rounding, moved onto it.
    pub fn onto_plane(&self, p: DVec3, plane: usize) -> DVec3 {
        let w = if self.perspective { p.z } else { 1.0 };
        let ((x_min, x_max), (y_min, y_max)) = self.limits;
        let at_x = |x: f64| DVec3 { x: (x - self.center.0) * w / self.scale, ..p };
        let at_y = |y: f64| DVec3 { y: (self.center.1 - y) * w / self.scale, ..p };
        match plane {
            0 => DVec3 { z: self.camera.near(), ..p },
            1 => DVec3 { z: self.camera.far(), ..p },
            2 => at_x(x_min),
            3 => at_x(x_max),
            4 => at_y(y_min),
            _ => at_y(y_max),
        }
    }

    /// A clipped point, snapped: inside the guard band up to the rounding of the clip.
    pub fn snap_clipped(&self, p: DVec3) -> (i32, i32) {
        let (x, y) = self.screen_point(p);
        let ((x_min, x_max), (y_min, y_max)) = self.limits;
        (snap(x.clamp(x_min, x_max)), snap(y.clamp(y_min, y_max)))
    }

    /// The view-space ray through a pixel centre as (point at z = 0, direction with z = 1).
    pub fn ray(&self, x: u32, y: u32) -> (DVec3, DVec3) {
        let dx = (f64::from(x) + 0.5 - self.center.0) / self.scale;
        let dy = (self.center.1 - f64::from(y) - 0.5) / self.scale;
        if self.perspective {
            (DVec3::ZERO, DVec3::new(dx, dy, 1.0))
        } else {
            (DVec3::new(dx, dy, 0.0), DVec3::Z)
        }
    }

    /// Near and far.
    pub fn clip_range(&self) -> (f64, f64) {
        (self.camera.near(), self.camera.far())
    }
}

/// Points that are projected together.
pub const BLOCK: usize = 16;

#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"))]
#[expect(clippy::needless_bitwise_bool, reason = "without branches")]
fn project_block(projector: &Projector, points: &[[f64; 3]]) -> [ScreenVertex; BLOCK] {
    let mut world = [[0.0; BLOCK]; 3];
    for (lane, point) in points.iter().enumerate().take(BLOCK) {
        for axis in 0..3 {
            world[axis][lane] = point[axis];
        }
    }
    let [x, y, z] = projector.camera.view_lanes(&world);
    let (near, far) = projector.clip_range();
    let ((x_min, x_max), (y_min, y_max)) = projector.limits;
    let (mut columns, mut rows) = ([0; BLOCK], [0; BLOCK]);
    for lane in 0..BLOCK {
        let scale = if projector.perspective { projector.scale / z[lane] } else { projector.scale };
        let screen_x = projector.center.0 + scale * x[lane];
        let screen_y = projector.center.1 - scale * y[lane];
        let inside = (near <= z[lane])
            & (z[lane] <= far)
            & (x_min <= screen_x)
            & (screen_x <= x_max)
            & (y_min <= screen_y)
            & (screen_y <= y_max);
        columns[lane] = if inside { snap(screen_x) } else { ScreenVertex::OUTSIDE };
        rows[lane] = if inside { snap(screen_y) } else { 0 };
    }
    let mut projected = [ScreenVertex::NOWHERE; BLOCK];
    for (lane, vertex) in projected.iter_mut().enumerate() {
        *vertex = ScreenVertex { x: columns[lane], y: rows[lane], z: z[lane] };
    }
    projected
}

/// The nearest sub-pixel position, ties to even.
#[inline(always)]
#[expect(clippy::cast_possible_truncation, reason = "the guard band keeps it within 25 bits")]
fn snap(pixels: f64) -> i32 {
    // adding it rounds to the nearest integer, ties to even, on any instruction set, and leaves that in the last bits
    const ROUND: f64 = 6_755_399_441_055_744.0; // 1.5 * 2^52
    (pixels * f64::from(SUBPIXELS) + ROUND).to_bits() as i32
}

#[cfg(test)]
mod tests {
    use super::*;

    fn projector(projection: Projection) -> Projector {
        let eye = DVec3::new(0.0, 0.0, 5.0);
        let camera = Camera::new(eye, DVec3::ZERO, DVec3::Y, projection, 1.0, 9.0).unwrap();
        Projector::new(&camera, 200, 100)
    }

    #[test]
    fn centre_and_edges_of_the_image() {
        let p = projector(Projection::Perspective { fov_y: 90.0 });
        assert_eq!(p.project(DVec3::new(0.0, 0.0, 5.0)), ScreenVertex { x: 25_600, y: 12_800, z: 5.0 });
        let top = p.project(DVec3::new(0.0, 5.0, 5.0));
        assert_eq!((top.x, top.y), (25_600, 0));
        let p = projector(Projection::Orthographic { height: 10.0 });
        let left = p.project(DVec3::new(-10.0, 0.0, 3.0));
        assert_eq!((left.x, left.y), (0, 12_800));
    }

    #[test]
    fn ties_go_to_even() {
        assert_eq!(snap(0.5 / 256.0), 0);
        assert_eq!(snap(1.5 / 256.0), 2);
        assert_eq!(snap(-0.5 / 256.0), 0);
    }

    #[test]
    fn what_needs_clipping_is_marked() {
        let p = projector(Projection::Perspective { fov_y: 90.0 });
        for z in [0.5, 9.5, -2.0] {
            assert!(p.project(DVec3::new(0.0, 0.0, z)).is_outside());
        }
        assert!(p.project(DVec3::new(1e5, 0.0, 1.0)).is_outside());
        assert!(p.clip_distances(DVec3::new(0.0, 0.0, 5.0)).iter().all(|d| *d >= 0.0));
        assert!(p.clip_distances(DVec3::new(1e5, 0.0, 1.0))[3] < 0.0);
    }

    #[test]
    fn rays_go_through_pixel_centres() {
        for projection in [Projection::Perspective { fov_y: 50.0 }, Projection::Orthographic { height: 3.0 }]
        {
            let p = projector(projection);
            let (origin, direction) = p.ray(17, 63);
            let (x, y) = p.screen_point(origin + 4.0 * direction);
            assert!((x - 17.5).abs() < 1e-12 && (y - 63.5).abs() < 1e-12);
        }
    }
}
