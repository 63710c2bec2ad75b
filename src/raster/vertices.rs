//! The corners of faces on the screen.

use super::fetch::fetch;
use super::project::{BLOCK, Projector, ScreenVertex};
use crate::scene::Mesh;
use crate::spare::{Spare, bytes_of};
use rayon::prelude::*;

/// Blocks of vertices below which a thread of its own is not worth it.
const BLOCKS: usize = 64;

/// A mesh's vertices, where its faces look them up.
pub enum Vertices<'a> {
    /// Projected all together, which pays off where several faces share a vertex.
    Screen(Vec<[ScreenVertex; BLOCK]>),
    /// In the world, to be projected face by face: where hardly any is shared, writing them down in between costs more.
    World(&'a [[f64; 3]]),
}

static SPARE: Spare<Vec<[ScreenVertex; BLOCK]>> = Spare::new();

impl<'a> Vertices<'a> {
    /// Those of `mesh`. Some may be [`ScreenVertex::NOWHERE`] when `stop` has said so meanwhile.
    pub fn of(mesh: &'a Mesh, projector: &Projector, stop: &(dyn Fn() -> bool + Sync)) -> Self {
        // a face has three corners: with so many vertices each is used one and a half times on average
        if 2 * mesh.faces().len() <= mesh.vertices().len() {
            return Self::World(mesh.vertices());
        }
        let project = |block: &[[f64; 3]]| {
            if stop() { [ScreenVertex::NOWHERE; BLOCK] } else { projector.project_block(block) }
        };
        let mut screen = SPARE.take(|_| true).unwrap_or_default();
        let blocks = mesh.vertices().par_chunks(BLOCK).with_min_len(BLOCKS);
        blocks.map(project).collect_into_vec(&mut screen);
        Self::Screen(screen)
    }

    /// Adds the corners of some faces to `all`.
    pub fn gather(&self, projector: &Projector, faces: &[[u32; 3]], all: &mut Vec<[ScreenVertex; 3]>) {
        match self {
            Self::Screen(screen) => {
                let screen = screen.as_flattened();
                let corners =
                    |&[a, b, c]: &[u32; 3]| [screen[a as usize], screen[b as usize], screen[c as usize]];
                all.extend(faces.iter().map(corners));
            }
            Self::World(world) => {
                faces.chunks(BLOCK).for_each(|faces| {
                    all.extend_from_slice(&project(projector, world, faces)[..faces.len()]);
                });
            }
        }
    }

    /// Fetches what the corners of some faces will be found from.
    pub fn fetch(&self, faces: &[[u32; 3]]) {
        match self {
            Self::Screen(screen) => {
                let screen = screen.as_flattened();
                faces.as_flattened().iter().for_each(|&vertex| fetch(&screen[vertex as usize]));
            }
            Self::World(world) => {
                faces.as_flattened().iter().for_each(|&vertex| fetch(&world[vertex as usize]));
            }
        }
    }
}

/// The corners of up to [`BLOCK`] faces, and nothing behind those.
fn project(projector: &Projector, world: &[[f64; 3]], faces: &[[u32; 3]]) -> [[ScreenVertex; 3]; BLOCK] {
    let mut points = [[[0.0; 3]; 3]; BLOCK];
    for (points, face) in points.iter_mut().zip(faces) {
        for (point, &vertex) in points.iter_mut().zip(face) {
            *point = world[vertex as usize];
        }
    }
    let mut corners = [[ScreenVertex::NOWHERE; 3]; BLOCK];
    let blocks = corners.as_flattened_mut().as_chunks_mut::<BLOCK>().0.iter_mut();
    for (corners, points) in blocks.zip(points.as_flattened().chunks(BLOCK)) {
        *corners = projector.project_block(points);
    }
    corners
}

impl Drop for Vertices<'_> {
    fn drop(&mut self) {
        if let Self::Screen(screen) = self {
            let (bytes, screen) = (bytes_of(screen), std::mem::take(screen));
            SPARE.give_back(screen, bytes);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::hash32;
    use crate::scene::{Camera, Colors, Material, Projection};
    use glam::DVec3;

    /// Meshes with few vertices per face and with many, so that both ways are taken: every corner is where its vertex is projected
    /// to by itself.
    #[test]
    fn corners_are_where_their_vertices_are() {
        let random = |i: u32, k: u32| f64::from(hash32(i, k, 5, 0, 0)) / f64::from(u32::MAX) * 4.0 - 2.0;
        let camera = |projection| {
            Camera::new(DVec3::new(0.0, 0.0, 3.0), DVec3::ZERO, DVec3::Y, projection, 1.5, 4.5).unwrap()
        };
        let (mut outside, mut inside) = (0, 0);
        for projection in [Projection::Perspective { fov_y: 60.0 }, Projection::Orthographic { height: 3.0 }]
        {
            let projector = Projector::new(&camera(projection), 320, 180);
            for (vertices, faces) in
                [(300, 100), (200, 100), (199, 100), (30, 100), (3, 1), (48, 16), (51, 17)]
            {
                let points: Vec<_> = (0..vertices).map(|i| [0, 1, 2].map(|k| random(i, k))).collect();
                let corner = |f: u32, k: u32| hash32(f, k, 6, 0, 0) % vertices;
                let faces: Vec<_> = (0..faces).map(|f| [0, 1, 2].map(|k| corner(f, k))).collect();
                let mesh =
                    Mesh::new(points.clone(), faces.clone(), Colors::Mesh([0.5; 4]), Material::default())
                        .unwrap();
                let found = Vertices::of(&mesh, &projector, &|| false);
                assert_eq!(matches!(found, Vertices::World(_)), 2 * faces.len() <= points.len());
                let mut all = vec![[ScreenVertex::NOWHERE; 3]];
                found.fetch(&faces);
                found.gather(&projector, &faces, &mut all);
                let expected = faces
                    .iter()
                    .map(|face| face.map(|v| projector.project(projector.view_point(points[v as usize]))));
                assert!(all[1..].iter().copied().eq(expected));
                let corners = all[1..].as_flattened();
                outside += corners.iter().filter(|corner| corner.is_outside()).count();
                inside += corners.iter().filter(|corner| !corner.is_outside()).count();
            }
        }
        assert!(outside > 100 && inside > 100, "{outside} {inside}");
    }
}
