//! What is drawn: meshes, a camera, an image size and a background. Plain data, checked on construction.

mod camera;
mod mesh;

pub use camera::{Camera, Projection};
pub use mesh::{AlphaMode, Colors, Material, Mesh, Shading};

use crate::error::{Error, Result};
use crate::fragments::{check_color, check_size};
use std::sync::Arc;

/// Everything a picture is made of.
#[derive(Debug, Clone)]
pub struct Scene {
    meshes: Vec<Arc<Mesh>>,
    camera: Camera,
    width: u32,
    height: u32,
    background: [f32; 3],
}

impl Scene {
    /// A scene of `meshes` in submission order.
    ///
    /// # Errors
    /// [`Error::Argument`] for an image size out of range, a background that is not finite and >= 0, or more
    /// than `u32::MAX` faces in all.
    pub fn new(
        meshes: Vec<Arc<Mesh>>,
        camera: Camera,
        width: u32,
        height: u32,
        background: [f32; 3],
    ) -> Result<Self> {
        check_size(width, height)?;
        check_color("background", background)?;
        let faces: usize = meshes.iter().map(|mesh| mesh.faces().len()).sum();
        if u32::try_from(faces).is_err() {
            return Err(Error::argument(
                "meshes",
                format!("have {faces} faces in all, 2^32 - 1 are allowed"),
            ));
        }
        // -0 equals 0, and is that from here on
        let background = background.map(|channel| channel + 0.0);
        Ok(Self { meshes, camera, width, height, background })
    }

    /// The meshes in submission order.
    pub fn meshes(&self) -> &[Arc<Mesh>] {
        &self.meshes
    }
    /// The camera.
    pub fn camera(&self) -> &Camera {
        &self.camera
    }
    /// Pixels per row.
    pub fn width(&self) -> u32 {
        self.width
    }
    /// Rows.
    pub fn height(&self) -> u32 {
        self.height
    }
    /// Linear colour where no opaque surface is.
    pub fn background(&self) -> [f32; 3] {
        self.background
    }

    /// A hash of everything that decides the picture.
    pub fn content_hash(&self) -> blake3::Hash {
        let mut hasher = blake3::Hasher::new();
        hasher.update(b"oitlab scene 1");
        for mesh in &self.meshes {
            hasher.update(mesh.content_hash().as_bytes());
        }
        self.camera.hash_into(&mut hasher);
        hasher.update(&self.width.to_le_bytes());
        hasher.update(&self.height.to_le_bytes());
        self.background.iter().for_each(|c| _ = hasher.update(&c.to_le_bytes()));
        hasher.finalize()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    fn camera() -> Camera {
        let eye = DVec3::new(0.0, 0.0, 5.0);
        Camera::new(eye, DVec3::ZERO, DVec3::Y, Projection::Perspective { fov_y: 45.0 }, 0.1, 100.0).unwrap()
    }

    fn mesh(x: f64) -> Arc<Mesh> {
        let vertices = vec![[x, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
        let colors = Colors::Mesh([1.0, 0.5, 0.25, 0.5]);
        Arc::new(Mesh::new(vertices, vec![[0, 1, 2]], colors, Material::default()).unwrap())
    }

    #[test]
    fn size_and_background_are_checked() {
        let scene = |w, h, c| Scene::new(vec![], camera(), w, h, c).map(|_| ()).unwrap_err().to_string();
        assert!(scene(0, 1, [0.0; 3]).starts_with("width: 0"));
        assert!(scene(1, 40_000, [0.0; 3]).starts_with("height: 40000"));
        assert!(scene(1, 1, [0.0, f32::NAN, 0.0]).starts_with("background"));
        let black = Scene::new(vec![], camera(), 1, 1, [-0.0; 3]).unwrap();
        assert_eq!(black.background().map(f32::to_bits), [0; 3]);
    }

    #[test]
    fn the_hash_follows_the_content() {
        let scene = |x, w| Scene::new(vec![mesh(x)], camera(), w, 8, [0.2; 3]).unwrap().content_hash();
        assert_eq!(scene(0.0, 8), scene(0.0, 8));
        assert_ne!(scene(0.0, 8), scene(0.5, 8));
        assert_ne!(scene(0.0, 8), scene(0.0, 9));
    }
}
