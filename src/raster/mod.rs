//! From a scene to fragments: project and snap, clip, set up, bin into tiles, cover, shade.

mod arrivals;
mod chunk;
mod clip;
mod cover;
mod export;
mod faces;
mod fetch;
mod interpolate;
mod lists;
mod network;
mod occlusion;
mod pixels;
mod project;
mod runs;
mod setup;
mod shade;
mod tile;
mod tiling;
mod vertices;
mod visit;

pub use arrivals::Arrivals;
pub use cover::Rect;
pub use export::{Drawn, Linear, Outline, pixel_bounds_of};
pub use interpolate::LANES;
pub use lists::TileLists;
pub use network::{NOTHING, Row};
pub use occlusion::Opaque;
pub use pixels::Where;
pub use runs::Run;
pub use shade::{AMBIENT, Mask, Paint, Premultiplied, Shade};
pub use tile::{Cover, Occluded, Sink, Tile, pixel_at};
pub use visit::Order;

use crate::params::View;
use crate::scene::Scene;
use chunk::{Chunk, Shown};
use glam::DVec3;
use project::Projector;
use rayon::prelude::*;
use setup::set_up;
use tiling::Tiling;

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
    /// Whether all transparent primitives of the tile have one colour, premultiplied colour and coverage alike.
    pub fn is_one_color(&self, tile: (usize, usize)) -> bool {
        let colors = self.transparent_in(tile).map(|(chunk, _)| match chunk.shown {
            Shown::One(color) => Some(color),
            Shown::Nothing | Shown::Several => None,
        });
        colors.fold(Shown::Nothing, Shown::and) != Shown::Several
    }
    /// How many transparent primitives may have pixels in the tile.
    pub fn transparent_primitives(&self, tile: (usize, usize)) -> usize {
        self.transparent_in(tile).map(|(_, count)| count).sum()
    }
    /// How often primitives may have pixels in the tiles of a row.
    pub fn primitives_in_row(&self, row: usize) -> usize {
        let tiles = row * self.columns()..(row + 1) * self.columns();
        self.opaque.iter().chain(&self.transparent).map(|chunk| chunk.count_in(tiles.clone())).sum()
    }
    /// Whether nothing at all is to be drawn in the tile.
    pub fn is_empty_tile(&self, column: usize, row: usize) -> bool {
        let tile = row * self.columns() + column;
        let none = |chunks: &[Chunk]| chunks.iter().all(|chunk| chunk.entries_in(tile).is_empty());
        none(&self.opaque) && none(&self.transparent)
    }
    /// The chunks with transparent primitives in the tile, and how many each has.
    fn transparent_in(&self, (column, row): (usize, usize)) -> impl Iterator<Item = (&Chunk, usize)> {
        let tile = row * self.columns() + column;
        let with_count = move |chunk| (chunk, Chunk::entries_in(chunk, tile).len());
        self.transparent.iter().map(with_count).filter(|(_, count)| *count > 0)
    }
}

impl Raster<'_> {
    /// Near, far, and the depth range of the transparent geometry: its vertices' view depths, clipped to near
    /// and far (sheet 0.6); the whole of near to far where there is none.
    pub fn view(&self) -> View {
        let view = provisional_view(self.scene);
        let empty = (f64::INFINITY, f64::NEG_INFINITY);
        let union = |a: (f64, f64), b: (f64, f64)| (a.0.min(b.0), a.1.max(b.1));
        let (lo, hi) = self.transparent.iter().map(|chunk| chunk.depth_range).fold(empty, union);
        let clip = |z: f64| z.clamp(view.near, view.far);
        if lo <= hi { View { depth_range: (clip(lo), clip(hi)), ..view } } else { view }
    }
}

/// What is known of the view before the geometry has been looked at: the depth range may turn out smaller.
pub fn provisional_view(scene: &Scene) -> View {
    let (near, far) = (scene.camera().near(), scene.camera().far());
    View { near, far, depth_range: (near, far) }
}

/// View depth of every primitive's centroid, by primitive id; incomplete when `stop` says so on the way.
pub fn centroid_depths(scene: &Scene, stop: &(dyn Fn() -> bool + Sync)) -> Vec<f64> {
    const RUN: usize = 16_384;
    let camera = scene.camera();
    let mut depths = Vec::new();
    for mesh in scene.meshes() {
        let depth = |v: u32| camera.to_view(DVec3::from(mesh.vertices()[v as usize])).z;
        let centroid = |f: &[u32; 3]| (depth(f[0]) + depth(f[1]) + depth(f[2])) / 3.0;
        let run = |run: &[[u32; 3]]| if stop() { vec![] } else { run.iter().map(centroid).collect() };
        depths.par_extend(mesh.faces().par_chunks(RUN).flat_map_iter(run));
    }
    depths
}
