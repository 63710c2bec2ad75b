//! Scenes: arbitrary meshes, materials and cameras.

use crate::{Number, check_frame, render_exactly, samples};
use arbitrary::Arbitrary;
use glam::DVec3;
use oitlab::fragments::{Fragments, FragmentsInput};
use oitlab::render::{Options, Request, Source, capture};
use oitlab::scene::{AlphaMode, Camera, Colors, Material, Mesh, Projection, Scene, Shading};
use std::sync::Arc;

/// Bytes as a scene.
#[derive(Debug, Arbitrary)]
pub struct Input {
    meshes: Vec<RawMesh>,
    camera: RawCamera,
    width: u8,
    height: u8,
}

#[derive(Debug, Arbitrary)]
enum RawCamera {
    /// At (0, 0, 5), looking at the origin.
    Perspective,
    /// The same, a world unit per pixel.
    Orthographic,
    /// The same between other planes.
    Between(Number, Number),
    Any {
        eye: [Number; 3],
        target: [Number; 3],
        up: [Number; 3],
        size: Number,
        perspective: bool,
        near: Number,
        far: Number,
    },
}

impl RawCamera {
    fn camera(&self, height: u32) -> oitlab::Result<Camera> {
        let eye = DVec3::new(0.0, 0.0, 5.0);
        let at_5 = |projection, near, far| Camera::new(eye, DVec3::ZERO, DVec3::Y, projection, near, far);
        let perspective = Projection::Perspective { fov_y: 60.0 };
        match *self {
            Self::Perspective => at_5(perspective, 0.5, 50.0),
            Self::Orthographic => at_5(Projection::Orthographic { height: f64::from(height) }, 0.5, 50.0),
            Self::Between(near, far) => at_5(perspective, near.get(), far.get()),
            Self::Any { eye, target, up, size, perspective, near, far } => {
                let (size, view) = (size.get(), [eye, target, up].map(|v| DVec3::from(v.map(Number::get))));
                let projection = match perspective {
                    true => Projection::Perspective { fov_y: size },
                    false => Projection::Orthographic { height: size },
                };
                Camera::new(view[0], view[1], view[2], projection, near.get(), far.get())
            }
        }
    }
}

#[derive(Debug, Arbitrary)]
struct RawMesh {
    vertices: Vec<[Number; 3]>,
    faces: Vec<[u8; 3]>,
    colors: RawColors,
    mode: u8,
    lambert: bool,
    double_sided: bool,
    opacity: Option<u8>,
    emission: [u8; 3],
}

#[derive(Debug, Arbitrary)]
enum RawColors {
    Mesh([u8; 4]),
    Vertex(u8),
    Face(u8),
}

/// Pixels along an edge of the image.
const EDGE: u8 = 24;
/// Meshes of a scene, and vertices or faces of a mesh.
const MOST: usize = 12;

impl RawMesh {
    fn mesh(&self) -> oitlab::Result<Mesh> {
        let vertices: Vec<_> = self.vertices.iter().take(MOST).map(|v| v.map(Number::get)).collect();
        let count = vertices.len().max(1) as u32;
        let faces: Vec<_> = self.faces.iter().take(MOST).map(|f| f.map(|v| u32::from(v) % count)).collect();
        let mixed =
            |seed: u8, i: usize, k: usize| seed.wrapping_mul(i as u8 + 1).wrapping_add((91 * k) as u8);
        let row = |seed, i| std::array::from_fn(|k| f32::from(mixed(seed, i, k)) / 255.0);
        let colors = match self.colors {
            RawColors::Mesh(color) => Colors::Mesh(color.map(|c| f32::from(c) / 255.0)),
            RawColors::Vertex(seed) => Colors::Vertex((0..vertices.len()).map(|i| row(seed, i)).collect()),
            RawColors::Face(seed) => Colors::Face((0..faces.len()).map(|i| row(seed, i)).collect()),
        };
        let material = Material {
            alpha_mode: [AlphaMode::Blend, AlphaMode::Opaque, AlphaMode::Mask][usize::from(self.mode) % 3],
            alpha_cutoff: 0.5,
            shading: if self.lambert { Shading::Lambert } else { Shading::Unlit },
            emission: self.emission.map(|e| f32::from(e) / 64.0),
            double_sided: self.double_sided,
            opacity: self.opacity.map(|a| f32::from(a) / 255.0),
        };
        Mesh::new(vertices, faces, colors, material)
    }
}

impl Input {
    fn scene(&self) -> oitlab::Result<Scene> {
        let meshes =
            self.meshes.iter().take(MOST).map(|mesh| mesh.mesh().map(Arc::new)).collect::<Result<_, _>>()?;
        let [width, height] = [self.width, self.height].map(|edge| u32::from(edge % EDGE) + 1);
        Scene::new(meshes, self.camera.camera(height)?, width, height, [0.125, 0.25, 0.375])
    }
}

/// No panic and no hang; a capture is a valid fragment list; images are finite and those of the capture.
pub fn run(input: &Input) {
    let Ok(scene) = input.scene() else { return };
    let fragments = capture(&scene, &Options::default(), &|| false).expect("nobody stops it");
    let again = Fragments::new(FragmentsInput {
        width: fragments.width,
        height: fragments.height,
        lists: fragments.lists.clone(),
        background: fragments.background.clone(),
        near: fragments.view.near,
        far: fragments.view.far,
        depth_range: Some(fragments.view.depth_range),
        primitive_depth: fragments.primitive_depth.clone(),
    });
    let again = again.expect("a capture is a valid list");
    let techniques = ["a_buffer", "wboit", "mlab", "alpha_compositing", "painter"];
    let requests: Vec<Request> = techniques.iter().map(|id| ((*id).to_owned(), vec![]).into()).collect();
    let direct = render_exactly(Source::Scene(&scene), &requests).expect("defaults are valid");
    let captured = render_exactly(Source::Fragments(&again), &requests).expect("defaults are valid");
    for (frame, from_capture) in direct.iter().zip(&captured) {
        check_frame(frame, frame.technique == "a_buffer");
        assert_eq!(samples(&frame.color), samples(&from_capture.color), "{}", frame.technique);
    }
}
