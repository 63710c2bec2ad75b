//! From a scene to fragments: project and snap, clip, set up, bin into tiles, cover, shade.

mod clip;
mod cover;
mod interpolate;
mod project;
mod setup;
mod shade;
mod tile;

pub use cover::Rect;
pub use shade::AMBIENT;
pub use tile::Tile;

use crate::params::View;
use crate::scene::Scene;
use glam::DVec3;
use project::Projector;
use rayon::prelude::*;
use setup::{Chunk, Tiling, set_up};

/// A scene whose primitives are projected and binned, ready to be rasterised tile by tile.
#[derive(Debug)]
pub struct Raster<'a> {
    scene: &'a Scene,
    projector: Projector,
    tiling: Tiling,
    opaque: Vec<Chunk>,
    transparent: Vec<Chunk>,
}

impl<'a> Raster<'a> {
    /// Projects and bins `scene` for tiles of `tile_size` pixels. When `stop` says so on the way the result is
    /// incomplete.
    pub fn new(scene: &'a Scene, tile_size: u32, stop: &(dyn Fn() -> bool + Sync)) -> Self {
        let projector = Projector::new(scene.camera(), scene.width(), scene.height());
        let tiling = Tiling::new(scene.width(), scene.height(), tile_size);
        let (opaque, transparent) = set_up(scene, &projector, &tiling, stop);
        Self { scene, projector, tiling, opaque, transparent }
    }

    /// Tiles per row.
    pub fn columns(&self) -> usize {
        self.tiling.columns()
    }
    /// Rows of tiles.
    pub fn rows(&self) -> usize {
        self.tiling.rows()
    }
    /// The pixels of a tile.
    pub fn rect(&self, column: usize, row: usize) -> Rect {
        self.tiling.rect(column, row)
    }
    /// Linear colour where nothing is drawn.
    pub fn background(&self) -> [f32; 3] {
        self.scene.background()
    }
    /// Whether nothing at all is to be drawn in the tile.
    pub fn is_empty_tile(&self, column: usize, row: usize) -> bool {
        let tile = row * self.columns() + column;
        let none = |chunks: &[Chunk]| chunks.iter().all(|chunk| chunk.in_tile(tile).next().is_none());
        none(&self.opaque) && none(&self.transparent)
    }
}

/// Near, far, and the depth range of the transparent geometry: its vertices' view depths, clipped to near and
/// far (sheet 0.6); the whole of near to far where there is none.
pub fn view(scene: &Scene) -> View {
    let camera = scene.camera();
    let (near, far) = (camera.near(), camera.far());
    let empty = (f64::INFINITY, f64::NEG_INFINITY);
    let union = |a: (f64, f64), b: (f64, f64)| (a.0.min(b.0), a.1.max(b.1));
    let (lo, hi) = scene
        .meshes()
        .iter()
        .filter(|mesh| mesh.material().is_transparent())
        .map(|mesh| {
            let depth = |v: u32| camera.to_view(DVec3::from(mesh.vertices()[v as usize])).z;
            let face =
                |face: &[u32; 3]| face.iter().map(|&v| depth(v)).fold(empty, |range, z| union(range, (z, z)));
            mesh.faces().par_iter().with_min_len(4096).map(face).reduce(|| empty, union)
        })
        .fold(empty, union);
    let depth_range = if lo <= hi { (lo.clamp(near, far), hi.clamp(near, far)) } else { (near, far) };
    View { near, far, depth_range }
}

/// View depth of every primitive's centroid, by primitive id.
pub fn centroid_depths(scene: &Scene) -> Vec<f64> {
    let camera = scene.camera();
    scene
        .meshes()
        .iter()
        .flat_map(|mesh| {
            let depth = |v: u32| camera.to_view(DVec3::from(mesh.vertices()[v as usize])).z;
            mesh.faces().iter().map(move |f| (depth(f[0]) + depth(f[1]) + depth(f[2])) / 3.0)
        })
        .collect()
}
