//! Triangle setup and binning: every primitive that can touch the image, listed by the tiles it touches, in
//! submission order.

use super::chunk::{Chunk, Kept, POLYGON_BIT, Polygon, Shown, VARYING_BIT};
use super::clip::clip;
use super::cover::doubled_area;
use super::faces::{BLOCK as BLOCK_FACES, Block, Found};
use super::project::{Projector, ScreenVertex};
use super::shade::{flat, light};
use super::tiling::{TileRange, Tiling};
use super::vertices::Vertices;
use crate::scene::{Colors, Mesh, Scene, Shading};
use crate::spare::{Spare, bytes_of};
use glam::DVec3;
use rayon::prelude::*;
use std::hint::black_box;
use std::ops::Range;

/// Faces that are set up together, and the unit in which bins keep submission order. Whoever asks what a chunk shows gets the same
/// answer on any number of threads.
const CHUNK_FACES: usize = 4096;

/// Working memory of a thread that sets up chunks.
#[derive(Default)]
struct Scratch {
    /// The faces at hand.
    block: Box<Block>,
    /// The corners of all faces.
    corners: Vec<[ScreenVertex; 3]>,
    /// The entries as they come, with the tiles that they touch; those of triangles are faces, counted from the
    /// chunk's first, and then places.
    touched: Vec<(u32, TileRange)>,
    /// Places in another order, tile by tile.
    cursors: Vec<u32>,
    order: Vec<u32>,
}

static SPARE_SCRATCH: Spare<Scratch> = Spare::new();

/// A run of faces still to be set up.
struct Job<'a> {
    mesh: &'a Mesh,
    index: usize,
    first_primitive: u32,
    faces: Range<usize>,
    vertices: &'a Vertices<'a>,
}

/// Projects, clips, culls and bins the scene's primitives: first the chunks of opaque meshes, then those of
/// transparent ones, each in submission order. Incomplete when `stop` says so meanwhile.
pub fn set_up(
    scene: &Scene,
    projector: &Projector,
    tiling: &Tiling,
    stop: &(dyn Fn() -> bool + Sync),
) -> (Vec<Chunk>, Vec<Chunk>) {
    let vertices: Vec<_> = scene.meshes().iter().map(|mesh| Vertices::of(mesh, projector, stop)).collect();
    let mut jobs = (Vec::new(), Vec::new());
    let mut first_primitive = 0;
    for (index, mesh) in scene.meshes().iter().enumerate() {
        let count = mesh.faces().len();
        let jobs = if mesh.material().is_transparent() { &mut jobs.1 } else { &mut jobs.0 };
        jobs.extend((0..count).step_by(CHUNK_FACES).map(|start| Job {
            mesh,
            index,
            first_primitive,
            faces: start..(start + CHUNK_FACES).min(count),
            vertices: &vertices[index],
        }));
        #[expect(clippy::cast_possible_truncation, reason = "Scene::new limits the sum of all faces")]
        (first_primitive += count as u32);
    }
    if stop() {
        return (vec![], vec![]); // some vertices may not have been projected
    }
    let run = |jobs: Vec<Job<'_>>| {
        let chunk = |job: &Job<'_>| (!stop()).then(|| job.run(projector, tiling));
        jobs.par_iter().filter_map(chunk).collect()
    };
    (run(jobs.0), run(jobs.1))
}

impl Job<'_> {
    #[expect(clippy::cast_possible_truncation, reason = "ids fit by Scene::new")]
    fn run(&self, projector: &Projector, tiling: &Tiling) -> Chunk {
        let (triangles, [faces, starts, entries]) = Chunk::spare();
        let mut chunk = Chunk {
            mesh: self.index,
            first_primitive: self.first_primitive,
            depth_range: (f64::INFINITY, f64::NEG_INFINITY),
            faces_camera: true,
            shown: Shown::Nothing,
            triangles,
            faces,
            first_face: self.faces.start as u32,
            polygons: Vec::new(),
            starts,
            entries,
        };
        let mut scratch = SPARE_SCRATCH.take(|_| true).unwrap_or_default();
        self.look_at_faces(projector, tiling, &mut scratch, &mut chunk);
        chunk.bin(self, projector, tiling, &mut scratch);
        let Scratch { corners, touched, cursors, order, .. } = &scratch;
        let bytes = bytes_of(corners) + bytes_of(touched) + bytes_of(cursors) + bytes_of(order);
        SPARE_SCRATCH.give_back(scratch, bytes);
        chunk
    }

    /// Finds the faces that can be seen and the tiles that they touch.
    fn look_at_faces(
        &self,
        projector: &Projector,
        tiling: &Tiling,
        scratch: &mut Scratch,
        chunk: &mut Chunk,
    ) {
        let Scratch { block, corners, touched, .. } = scratch;
        corners.clear();
        touched.clear();
        let faces = &self.mesh.faces()[self.faces.clone()];
        let mut numbers = 0..;
        for (n, now) in faces.chunks(BLOCK_FACES).enumerate() {
            self.vertices.fetch(faces.chunks(BLOCK_FACES).nth(n + 1).unwrap_or_default());
            let first = corners.len();
            self.vertices.gather(projector, now, corners);
            block.set(&corners[first..]);
            let (lo, hi) = block.look(tiling, self.mesh.material().double_sided);
            chunk.depth_range = (chunk.depth_range.0.min(lo), chunk.depth_range.1.max(hi));
            for (found, face) in block.found().zip(&mut numbers) {
                match found {
                    Found::Nothing => {}
                    Found::Triangle { tiles, faces_camera } => {
                        chunk.faces_camera &= faces_camera;
                        touched.push((face, tiles));
                    }
                    Found::Outside => touched.extend(self.polygon(face, projector, tiling, chunk)),
                }
            }
        }
    }

    /// Clips a face, counted from the chunk's first, and keeps what is left of it; its entry and the tiles it touches.
    #[expect(clippy::cast_possible_truncation, reason = "a chunk has few faces")]
    fn polygon(
        &self,
        face: u32,
        projector: &Projector,
        tiling: &Tiling,
        chunk: &mut Chunk,
    ) -> Option<(u32, TileRange)> {
        let face = self.faces.start + face as usize;
        let (polygon, tiles) = self.clipped(face, projector, tiling)?;
        chunk.faces_camera &= polygon.corners.iter().all(|c| c.z == polygon.corners[0].z);
        chunk.shown = chunk.shown.and(flat(self.mesh, face, polygon.light));
        chunk.polygons.push(polygon);
        Some(((chunk.polygons.len() - 1) as u32 | POLYGON_BIT, tiles))
    }

    /// How bright a face is.
    fn light(&self, face: usize, projector: &Projector) -> f32 {
        match self.mesh.material().shading {
            Shading::Unlit => 1.0,
            shading @ Shading::Lambert => {
                light(shading, self.corners(face, projector), projector.is_perspective())
            }
        }
    }

    #[expect(clippy::cast_possible_truncation, reason = "ids fit by Scene::new")]
    fn clipped(&self, face: usize, projector: &Projector, tiling: &Tiling) -> Option<(Polygon, TileRange)> {
        let corners = self.corners(face, projector);
        let points: Vec<_> =
            clip(projector, corners).into_iter().map(|p| projector.snap_clipped(p)).collect();
        if points.len() < 3 {
            return None;
        }
        let tiles = tiling.touched(points.iter().copied())?;
        self.is_seen(doubled_area(&points)).then_some(())?;
        let shading = self.mesh.material().shading;
        let light = light(shading, corners, projector.is_perspective());
        Some((Polygon { face: face as u32, light, points, corners }, tiles))
    }

    fn corners(&self, face: usize, projector: &Projector) -> [DVec3; 3] {
        self.mesh.faces()[face].map(|v| projector.view_point(self.mesh.vertices()[v as usize]))
    }

    /// Front faces wind counter-clockwise in world space, hence clockwise reads negative on a screen with y down.
    fn is_seen(&self, doubled_area: i64) -> bool {
        doubled_area < 0 || (doubled_area > 0 && self.mesh.material().double_sided)
    }
}

impl Chunk {
    /// Counting sort of the entries by tile. Triangles move to where the first tile they touch will look for
    /// them: in the order of the faces a tile's triangles would lie all over memory.
    fn bin(&mut self, job: &Job<'_>, projector: &Projector, tiling: &Tiling, scratch: &mut Scratch) {
        self.triangles.clear();
        self.faces.clear();
        self.starts.clear();
        self.entries.clear();
        if scratch.touched.is_empty() {
            return;
        }
        let columns = tiling.columns();
        let tiles = columns * tiling.rows();
        place_triangles(scratch, columns, tiles);
        self.take_triangles(job, projector, scratch);
        let Scratch { touched, cursors, .. } = scratch;
        self.starts.resize(tiles + 1, 0);
        for (_, range) in touched.iter() {
            range.for_each(columns, |tile| self.starts[tile + 1] += 1);
        }
        let total = accumulate(&mut self.starts);
        self.entries.resize(total as usize, 0);
        cursors.clone_from(&self.starts);
        for (entry, range) in touched.iter() {
            range.for_each(columns, |tile| {
                self.entries[cursors[tile] as usize] = *entry;
                cursors[tile] += 1;
            });
        }
    }

    /// Keeps the triangles in the order that has been found for them, with their colours.
    fn take_triangles(&mut self, job: &Job<'_>, projector: &Projector, scratch: &Scratch) {
        self.triangles.reserve(scratch.order.len());
        self.faces.reserve(scratch.order.len());
        touch_colors(job.mesh.colors(), &job.faces);
        for &number in &scratch.order {
            let face = job.faces.start + number as usize;
            let light = job.light(face, projector);
            let flat = flat(job.mesh, face, light);
            self.shown = self.shown.and(flat);
            let color = flat.unwrap_or([light, 0.0, 0.0, 0.0]);
            self.triangles.push(Kept { vertices: scratch.corners[number as usize], color });
            self.faces.push(if flat.is_some() { number } else { number | VARYING_BIT });
        }
    }
}

/// Reads the colours of some faces one after the other, which is foreseen; in the order of tiles each would be waited for.
fn touch_colors(colors: &Colors, faces: &Range<usize>) {
    if let Colors::Face(colors) = colors {
        let alphas = colors[faces.clone()].iter().map(|color| color[3].to_bits());
        black_box(alphas.fold(0, |seen, alpha| seen ^ alpha));
    }
}

/// Lists the triangles by the first tile that they touch, and turns their entries into places in that list.
fn place_triangles(scratch: &mut Scratch, columns: usize, tiles: usize) {
    let Scratch { touched, cursors, order, .. } = scratch;
    let first_tile = |range: &TileRange| usize::from(range.y0) * columns + usize::from(range.x0);
    let is_triangle = |entry: u32| entry & POLYGON_BIT == 0;
    cursors.clear();
    cursors.resize(tiles + 1, 0);
    for (_, range) in touched.iter().filter(|(entry, _)| is_triangle(*entry)) {
        cursors[first_tile(range) + 1] += 1;
    }
    let triangles = accumulate(cursors);
    order.clear();
    order.resize(triangles as usize, 0);
    for (entry, range) in touched.iter_mut().filter(|(entry, _)| is_triangle(*entry)) {
        let place = &mut cursors[first_tile(range)];
        order[*place as usize] = *entry;
        *entry = *place;
        *place += 1;
    }
}

/// Turns counts, each one place late, into starts; their sum.
fn accumulate(counts: &mut [u32]) -> u32 {
    let mut sum = 0;
    for count in counts {
        sum += *count;
        *count = sum;
    }
    sum
}
