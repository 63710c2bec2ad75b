//! Scenes and shorthands for the tests that use the crate from outside.

#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    clippy::cast_precision_loss,
    clippy::cast_sign_loss,
    reason = "small numbers, chosen here"
)]
#![allow(dead_code, reason = "each test binary uses its own part")]

use glam::DVec3;
use oitlab::fragments::Fragments;
use oitlab::frame::{Frame, Image};
use oitlab::params::Input;
use oitlab::random::{hash32, unit};
use oitlab::render::{Options, Request, Source, capture, render};
use oitlab::scene::{Camera, Colors, Material, Mesh, Projection, Scene};
use std::sync::Arc;

/// A camera on the z axis at distance 5 that sees one world unit per pixel.
pub fn pixel_camera(height: u32) -> Camera {
    let eye = DVec3::new(0.0, 0.0, 5.0);
    let projection = Projection::Orthographic { height: f64::from(height) };
    Camera::new(eye, DVec3::ZERO, DVec3::Y, projection, 1.0, 9.0).unwrap()
}

/// A perspective camera on the z axis at distance 5.
pub fn perspective(fov_y: f64, near: f64, far: f64) -> Camera {
    let eye = DVec3::new(0.0, 0.0, 5.0);
    Camera::new(eye, DVec3::ZERO, DVec3::Y, Projection::Perspective { fov_y }, near, far).unwrap()
}

/// A mesh of one color.
pub fn mesh(vertices: Vec<[f64; 3]>, faces: Vec<[u32; 3]>, rgba: [f32; 4], material: Material) -> Arc<Mesh> {
    Arc::new(Mesh::new(vertices, faces, Colors::Mesh(rgba), material).unwrap())
}

/// A rectangle facing the camera at world depth `z`.
pub fn rectangle(x: [f64; 2], y: [f64; 2], z: f64, rgba: [f32; 4], material: Material) -> Arc<Mesh> {
    let vertices = vec![[x[0], y[0], z], [x[1], y[0], z], [x[1], y[1], z], [x[0], y[1], z]];
    mesh(vertices, vec![[0, 1, 2], [0, 2, 3]], rgba, material)
}

/// A scene over dark grey.
pub fn scene(meshes: Vec<Arc<Mesh>>, camera: Camera, width: u32, height: u32) -> Scene {
    Scene::new(meshes, camera, width, height, [0.125, 0.25, 0.375]).unwrap()
}

/// A random number in [0, 1), from a counter.
pub fn random(i: u32, k: u32) -> f64 {
    f64::from(unit(hash32(i, k, 17, 4, 0)))
}

/// Triangles of all sizes around the camera of [`perspective`], many of them cut by near, far and the guard
/// band, with colours that differ from corner to corner.
pub fn soup(count: u32, order: impl Fn(u32) -> u32) -> Arc<Mesh> {
    let (mut vertices, mut faces, mut colors) = (Vec::new(), Vec::new(), Vec::new());
    for place in 0..count {
        let i = order(place);
        let size = [0.2, 1.0, 4.0, 4000.0][i as usize % 4];
        let center: [f64; 3] = std::array::from_fn(|k| 8.0 * random(i, k as u32) - 4.0);
        for corner in 0..3 {
            let k = 3 + corner * 10;
            vertices.push(std::array::from_fn(|d| center[d] + size * (random(i, k + d as u32) - 0.5)));
            colors.push(std::array::from_fn(|c| random(i, k + 3 + c as u32) as f32));
        }
        faces.push([3 * place, 3 * place + 1, 3 * place + 2]);
    }
    Arc::new(Mesh::new(vertices, faces, Colors::Vertex(colors), Material::default()).unwrap())
}

/// Renders with options.
pub fn frames_with(source: Source<'_>, requests: &[Request], options: &Options) -> Vec<Frame> {
    render::<f32>(source, requests, options, &|| false).unwrap()
}

/// One frame with default options.
pub fn frame(source: Source<'_>, id: &str, params: &[(&str, Input)]) -> Frame {
    frames_with(source, &[request(id, params)], &Options::default()).remove(0)
}

/// A request for [`render`].
pub fn request(id: &str, params: &[(&str, Input)]) -> Request {
    let params = params.iter().map(|(n, v)| ((*n).to_owned(), v.clone()));
    (id.to_owned(), params.collect::<Vec<_>>()).into()
}

/// A capture with options.
pub fn capture_with(scene: &Scene, options: &Options) -> Fragments {
    capture(scene, options, &|| false).unwrap()
}

/// The samples of a single-precision image.
pub fn samples(image: &Image) -> &[f32] {
    let Image::F32(samples) = image else { panic!("not single precision") };
    samples
}

/// The color of a pixel.
pub fn pixel(frame: &Frame, x: u32, y: u32) -> [f32; 3] {
    let i = 3 * (y * frame.width + x) as usize;
    let color = samples(&frame.color);
    [color[i], color[i + 1], color[i + 2]]
}
