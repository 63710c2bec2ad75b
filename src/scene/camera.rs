//! The camera: where it stands, how it projects, and between which depths it sees.

use crate::error::{Error, Result};
use crate::fragments::check_clip_planes;
use glam::DVec3;

/// How view space becomes the image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Projection {
    /// Perspective with a vertical field of view in degrees.
    Perspective {
        /// In (0, 180).
        fov_y: f64,
    },
    /// Orthographic, showing so many world units from bottom to top.
    Orthographic {
        /// > 0.
        height: f64,
    },
}

/// A pinhole or orthographic camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Camera {
    eye: DVec3,
    right: DVec3,
    up: DVec3,
    forward: DVec3,
    projection: Projection,
    near: f64,
    far: f64,
}

impl Camera {
    /// A camera at `eye` that looks at `target`, with `up` upwards in the image.
    ///
    /// # Errors
    /// [`Error::Argument`] for non-finite numbers, `eye` = `target`, `up` along the line of sight, a field of
    /// view outside (0, 180), a height that is not positive, or planes without 0 < near < far.
    pub fn new(
        eye: DVec3,
        target: DVec3,
        up: DVec3,
        projection: Projection,
        near: f64,
        far: f64,
    ) -> Result<Self> {
        for (name, v) in [("eye", eye), ("target", target), ("up", up)] {
            let limit = f64::from(f32::MAX);
            if !(v.is_finite() && v.abs().max_element() <= limit) {
                let problem = format!("({}, {}, {}) is not finite and within +-{limit:e}", v.x, v.y, v.z);
                return Err(Error::argument(name, problem));
            }
        }
        check_projection(projection)?;
        check_clip_planes(near, far)?;
        let Some(forward) = unit(target - eye) else {
            return Err(Error::argument("target", "is the same point as eye"));
        };
        let sideways = unit(up).and_then(|up| unit_if_clear(forward.cross(up)));
        let Some(right) = sideways else {
            return Err(Error::argument("up", "is zero or parallel to the line of sight"));
        };
        let up = right.cross(forward);
        Ok(Self { eye, right, up, forward, projection, near, far })
    }

    /// The point in view space: x to the right, y up, z forward (positive in front of the camera).
    pub fn to_view(&self, point: DVec3) -> DVec3 {
        let p = point - self.eye;
        DVec3::new(p.dot(self.right), p.dot(self.up), p.dot(self.forward))
    }
    /// World points to view space, a plane of numbers per axis: the bits of [`Camera::to_view`].
    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    pub(crate) fn view_lanes<const N: usize>(&self, [x, y, z]: &[[f64; N]; 3]) -> [[f64; N]; 3] {
        let mut view = [[0.0; N]; 3];
        for lane in 0..N {
            let p = [x[lane] - self.eye.x, y[lane] - self.eye.y, z[lane] - self.eye.z];
            for (axis, to) in [self.right, self.up, self.forward].into_iter().zip(&mut view) {
                to[lane] = p[0] * axis.x + p[1] * axis.y + p[2] * axis.z;
            }
        }
        view
    }
    /// The projection.
    pub fn projection(&self) -> Projection {
        self.projection
    }
    /// Near plane: view-space distance.
    pub fn near(&self) -> f64 {
        self.near
    }
    /// Far plane: view-space distance.
    pub fn far(&self) -> f64 {
        self.far
    }

    pub(super) fn hash_into(&self, hasher: &mut blake3::Hasher) {
        for v in [self.eye, self.right, self.up, self.forward] {
            v.to_array().iter().for_each(|x| _ = hasher.update(&x.to_le_bytes()));
        }
        let (kind, size) = match self.projection {
            Projection::Perspective { fov_y } => (b"p", fov_y),
            Projection::Orthographic { height } => (b"o", height),
        };
        hasher.update(kind);
        [size, self.near, self.far].iter().for_each(|x| _ = hasher.update(&x.to_le_bytes()));
    }
}

fn check_projection(projection: Projection) -> Result<()> {
    match projection {
        Projection::Perspective { fov_y } if !(fov_y > 0.0 && fov_y < 180.0) => {
            Err(Error::argument("fov_y", format!("{fov_y} is not in (0, 180) degrees")))
        }
        Projection::Orthographic { height } if !(height > 0.0 && height.is_finite()) => {
            Err(Error::argument("ortho_height", format!("{height} is not a finite number > 0")))
        }
        _ => Ok(()),
    }
}

/// The vector at length one, scaled first so that its square neither over- nor underflows.
fn unit(v: DVec3) -> Option<DVec3> {
    let scale = v.abs().max_element();
    if scale > 0.0 { (v / scale).try_normalize() } else { None }
}

/// A cross product of unit vectors at length one, unless they are parallel to within rounding.
fn unit_if_clear(v: DVec3) -> Option<DVec3> {
    if v.length() > 1e-12 { v.try_normalize() } else { None }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera(eye: [f64; 3], up: [f64; 3], projection: Projection, near: f64, far: f64) -> Result<Camera> {
        Camera::new(eye.into(), DVec3::ZERO, up.into(), projection, near, far)
    }

    #[test]
    fn view_space_is_right_up_forward() {
        let p = Projection::Perspective { fov_y: 45.0 };
        let camera = camera([0.0, 0.0, 5.0], [0.0, 2.0, 0.1], p, 0.1, 10.0).unwrap();
        let v = camera.to_view(DVec3::new(1.0, 2.0, 3.0));
        assert!((v - DVec3::new(1.0, 2.0, 2.0)).length() < 1e-15);
    }

    /// Their reciprocals and what interpolation makes of them overflow, or they are no f32.
    #[test]
    fn clip_planes_are_depths_of_single_precision() {
        let p = Projection::Perspective { fov_y: 45.0 };
        let fault = |near, far| {
            let camera = camera([0.0, 0.0, 5.0], [0.0, 1.0, 0.0], p, near, far);
            camera.map_or_else(|error| error.to_string(), |_| String::new())
        };
        assert!(fault(1e-310, 1.0).starts_with("near: 1e-310 is not a number >= 1.17"));
        assert!(fault(0.1, 1e300).starts_with("far: 1e300 is not a number <= 3.4"));
        assert_eq!(fault(1.2e-38, 3.4e38), "");
    }

    #[test]
    fn errors_name_the_argument() {
        let p = Projection::Perspective { fov_y: 45.0 };
        let fault =
            |eye, up, projection, near, far| camera(eye, up, projection, near, far).unwrap_err().to_string();
        let (z, y) = ([0.0, 0.0, 5.0], [0.0, 1.0, 0.0]);
        assert!(fault([0.0; 3], y, p, 0.1, 1.0).starts_with("target"));
        assert!(fault([f64::NAN, 0.0, 0.0], y, p, 0.1, 1.0).starts_with("eye"));
        assert!(fault(z, [0.0, 0.0, 1.0], p, 0.1, 1.0).starts_with("up"));
        assert!(fault(z, [0.0; 3], p, 0.1, 1.0).starts_with("up"));
        assert!(fault(z, y, p, 1.0, 1.0).starts_with("far"));
        assert!(fault(z, y, p, -1.0, 1.0).starts_with("near"));
        assert!(fault(z, y, Projection::Perspective { fov_y: 180.0 }, 0.1, 1.0).starts_with("fov_y"));
        assert!(fault(z, y, Projection::Orthographic { height: 0.0 }, 0.1, 1.0).starts_with("ortho_height"));
    }
}
