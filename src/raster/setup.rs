//! Triangle setup and binning: every primitive that can touch the image, listed by the tiles it touches, in
//! submission order.

use super::clip::clip;
use super::cover::{Rect, centers, doubled_area};
use super::project::{BLOCK, Projector, ScreenVertex};
use super::shade::{Premultiplied, flat, light};
use crate::scene::{Mesh, Scene, Shading};
use crate::spare::{Spare, bytes_of};
use glam::DVec3;
use rayon::prelude::*;
use std::hint::black_box;
use std::ops::Range;

/// A triangle that needed no clipping.
#[derive(Debug, Clone, Copy)]
pub struct Triangle {
    pub face: u32,
    pub light: f32,
    pub vertices: [ScreenVertex; 3],
    /// The colour, where there is but one: looked up here, where faces come in order.
    pub flat: Option<Premultiplied>,
}

impl Triangle {
    /// The corners in sub-pixels.
    pub fn points(&self) -> [(i32, i32); 3] {
        points_of(&self.vertices)
    }

    /// Which way round the corners go: 1 clockwise on the screen, -1 counter-clockwise.
    pub fn sign(&self) -> i32 {
        if doubled_area(&self.points()) < 0 { -1 } else { 1 }
    }
}

/// Written out, since `map` is called rather than compiled into its caller.
#[inline]
fn points_of([a, b, c]: &[ScreenVertex; 3]) -> [(i32, i32); 3] {
    [(a.x, a.y), (b.x, b.y), (c.x, c.y)]
}

/// The pixels of `rect` whose centres can be in the triangle by its bounding box, in rows that have their top in
/// and their bottom out; may be empty.
pub fn pixel_bounds([a, b, c]: &[(i32, i32); 3], rect: &Rect) -> Rect {
    let (x0, x1) = centers(a.0.min(b.0).min(c.0), a.0.max(b.0).max(c.0));
    let (y0, y1) = centers(a.1.min(b.1).min(c.1), a.1.max(b.1).max(c.1) - 1);
    Rect { x0: x0.max(rect.x0), y0: y0.max(rect.y0), x1: x1.min(rect.x1), y1: y1.min(rect.y1) }
}

/// What clipping left of a triangle.
#[derive(Debug, Clone)]
pub struct Polygon {
    pub face: u32,
    pub light: f32,
    pub points: Vec<(i32, i32)>,
    /// The whole triangle in view space.
    pub corners: [DVec3; 3],
}

/// A primitive that survived setup.
#[derive(Debug, Clone, Copy)]
pub enum Primitive<'a> {
    Triangle(&'a Triangle),
    Polygon(&'a Polygon),
}

impl Primitive<'_> {
    /// The view depths of the whole triangle's corners.
    fn corner_depths(&self) -> [f64; 3] {
        match self {
            Self::Triangle(t) => t.vertices.map(|v| v.z),
            Self::Polygon(p) => p.corners.map(|c| c.z),
        }
    }

    /// No fragment is nearer than the first or farther than the second, which may lie beyond the clip planes.
    #[expect(clippy::cast_possible_truncation, reason = "fragments store depth as f32")]
    pub fn depth_range(&self) -> (f32, f32) {
        let [a, b, c] = self.corner_depths();
        (a.min(b).min(c) as f32, a.max(b).max(c) as f32)
    }

    /// View depth of the whole triangle's centroid.
    pub fn centroid_depth(&self) -> f64 {
        let [a, b, c] = self.corner_depths();
        (a + b + c) / 3.0
    }
}

/// The image cut into square tiles.
#[derive(Debug, Clone, Copy)]
pub struct Tiling {
    width: i32,
    height: i32,
    size: i32,
    /// 1 / `size`: there are quicker ways to divide than to divide.
    per_pixel: f64,
}

impl Tiling {
    /// Tiles of `size` pixels for an image of the given size.
    #[expect(clippy::cast_possible_wrap, reason = "both are at most MAX_SIZE")]
    pub fn new(width: u32, height: u32, size: u32) -> Self {
        Self {
            width: width as i32,
            height: height as i32,
            size: size as i32,
            per_pixel: f64::from(size).recip(),
        }
    }
    /// Tiles per row.
    #[expect(clippy::cast_sign_loss, reason = "never negative")]
    pub fn columns(&self) -> usize {
        ((self.width + self.size - 1) / self.size) as usize
    }
    /// Rows of tiles.
    #[expect(clippy::cast_sign_loss, reason = "never negative")]
    pub fn rows(&self) -> usize {
        ((self.height + self.size - 1) / self.size) as usize
    }
    /// The pixels of a tile.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_possible_wrap,
        reason = "fewer tiles than pixels"
    )]
    pub fn rect(&self, column: usize, row: usize) -> Rect {
        let (x0, y0) = (column as i32 * self.size, row as i32 * self.size);
        let (x1, y1) = ((x0 + self.size).min(self.width), (y0 + self.size).min(self.height));
        Rect { x0, y0, x1, y1 }
    }

    /// The column or row of tiles that a pixel of the image is in. Half a pixel off, no rounding matters.
    #[expect(clippy::cast_sign_loss, clippy::cast_possible_truncation, reason = "within the image")]
    fn tile_of(&self, pixel: i32) -> u16 {
        ((f64::from(pixel) + 0.5) * self.per_pixel) as u16
    }

    /// The tiles that the sub-pixel bounds touch, as ranges of columns and rows; `None` when the bounds hold
    /// no pixel centre of the image.
    fn touched(&self, points: impl Iterator<Item = (i32, i32)>) -> Option<TileRange> {
        let (mut lo, mut hi) = ((i32::MAX, i32::MAX), (i32::MIN, i32::MIN));
        for (x, y) in points {
            lo = (lo.0.min(x), lo.1.min(y));
            hi = (hi.0.max(x), hi.1.max(y));
        }
        let axis = |lo, hi, limit: i32| {
            let (first, last) = centers(lo, hi);
            let (first, last) = (first.max(0), last.min(limit));
            (first < last).then(|| (self.tile_of(first), self.tile_of(last - 1)))
        };
        let (x0, x1) = axis(lo.0, hi.0, self.width)?;
        let (y0, y1) = axis(lo.1, hi.1, self.height)?;
        Some(TileRange { x0, y0, x1, y1 })
    }
}

/// Columns and rows of tiles, all inclusive.
#[derive(Debug, Clone, Copy)]
struct TileRange {
    x0: u16,
    y0: u16,
    x1: u16,
    y1: u16,
}

impl TileRange {
    fn tiles(self, columns: usize) -> impl Iterator<Item = usize> {
        let row = move |y: u16| {
            let first = usize::from(y) * columns;
            first + usize::from(self.x0)..=first + usize::from(self.x1)
        };
        (self.y0..=self.y1).flat_map(row)
    }
}

/// Faces that are set up together, and the unit in which bins keep submission order.
const CHUNK_FACES: usize = 4096;
/// Faces whose vertices are fetched before the first is used: misses of the cache then overlap.
const GATHERED: usize = 64;
/// Blocks of vertices below which a thread of its own is not worth it.
const BLOCKS: usize = 64;
/// Marks a bin entry as an index into the polygons.
const POLYGON_BIT: u32 = 1 << 31;

/// A run of faces of one mesh, set up and binned.
#[derive(Debug)]
pub struct Chunk {
    /// Index of the mesh.
    pub mesh: usize,
    /// Primitive id of the mesh's first face.
    pub first_primitive: u32,
    /// Smallest and largest view depth of the faces' vertices, seen or not.
    pub depth_range: (f64, f64),
    /// Whether every primitive has one depth.
    pub faces_camera: bool,
    /// The colours of its primitives.
    pub shown: Shown,
    triangles: Vec<Triangle>,
    polygons: Vec<Polygon>,
    /// Entries of tile `t` are `entries[starts[t]..starts[t + 1]]`.
    starts: Vec<u32>,
    entries: Vec<u32>,
}

/// The triangles, starts and entries of chunks that are no more.
static SPARE: Spare<(Vec<Triangle>, Vec<u32>, Vec<u32>)> = Spare::new();

impl Drop for Chunk {
    fn drop(&mut self) {
        let take = std::mem::take::<Vec<u32>>;
        let memory = (std::mem::take(&mut self.triangles), take(&mut self.starts), take(&mut self.entries));
        let bytes = bytes_of(&memory.0) + bytes_of(&memory.1) + bytes_of(&memory.2);
        SPARE.give_back(memory, bytes);
    }
}

/// Working memory of a thread that sets up chunks.
#[derive(Default)]
struct Scratch {
    /// The corners of faces at hand.
    gathered: Vec<[ScreenVertex; 3]>,
    /// The triangles as the faces come.
    triangles: Vec<Triangle>,
    /// The entries as they come, with the tiles that they touch.
    touched: Vec<(u32, TileRange)>,
    /// Places in another order, tile by tile.
    cursors: Vec<u32>,
    order: Vec<u32>,
}

static SPARE_SCRATCH: Spare<Scratch> = Spare::new();

impl Chunk {
    /// The primitives that touch tile `tile`, in submission order.
    pub fn in_tile(&self, tile: usize) -> impl Iterator<Item = Primitive<'_>> {
        self.entries_in(tile).iter().map(|&entry| self.primitive(entry))
    }

    /// The same as numbers for [`Chunk::primitive`].
    pub fn entries_in(&self, tile: usize) -> &[u32] {
        match self.starts.get(tile..=tile + 1) {
            Some(&[start, end]) => &self.entries[start as usize..end as usize],
            _ => &[],
        }
    }

    /// Fetches some triangles, so that misses of the cache overlap.
    #[inline]
    pub fn touch(&self, entries: &[u32]) {
        let triangles = entries.iter().filter(|&&entry| entry & POLYGON_BIT == 0);
        black_box(triangles.fold(0, |seen, &entry| {
            let triangle = &self.triangles[entry as usize];
            seen ^ triangle.face ^ triangle.vertices[2].x.cast_unsigned()
        }));
    }

    /// The primitive of this number.
    pub fn primitive(&self, entry: u32) -> Primitive<'_> {
        match entry & POLYGON_BIT {
            0 => Primitive::Triangle(&self.triangles[entry as usize]),
            _ => Primitive::Polygon(&self.polygons[(entry & !POLYGON_BIT) as usize]),
        }
    }
}

/// What is known of the colours of some primitives.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Shown {
    /// There are none.
    Nothing,
    /// All have this one colour.
    One(Premultiplied),
    /// There are several.
    Several,
}

impl Shown {
    /// With another primitive, which has one colour or several.
    pub fn and(self, flat: Option<Premultiplied>) -> Self {
        match (self, flat) {
            (Self::Nothing, Some(color)) => Self::One(color),
            (Self::One(one), Some(color)) if one == color => self,
            _ => Self::Several,
        }
    }
}

/// A run of faces still to be set up.
struct Job<'a> {
    mesh: &'a Mesh,
    index: usize,
    first_primitive: u32,
    faces: Range<usize>,
    screen: &'a Screen,
}

/// The projected vertices of a mesh.
type Screen = Vec<[ScreenVertex; BLOCK]>;

static SPARE_SCREENS: Spare<Screen> = Spare::new();

/// Projects, clips, culls and bins the scene's primitives: first the chunks of opaque meshes, then those of
/// transparent ones, each in submission order. Empty when `stop` says so meanwhile.
pub fn set_up(
    scene: &Scene,
    projector: &Projector,
    tiling: &Tiling,
    stop: &(dyn Fn() -> bool + Sync),
) -> (Vec<Chunk>, Vec<Chunk>) {
    let project = |block: &[[f64; 3]]| {
        if stop() { [ScreenVertex::NOWHERE; BLOCK] } else { projector.project_block(block) }
    };
    let screen = |mesh: &std::sync::Arc<Mesh>| {
        let mut screen = SPARE_SCREENS.take(|_| true).unwrap_or_default();
        let blocks = mesh.vertices().par_chunks(BLOCK).with_min_len(BLOCKS);
        blocks.map(project).collect_into_vec(&mut screen);
        screen
    };
    let screens: Vec<Screen> = scene.meshes().iter().map(screen).collect();
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
            screen: &screens[index],
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
    let chunks = (run(jobs.0), run(jobs.1));
    for screen in screens {
        let bytes = bytes_of(&screen);
        SPARE_SCREENS.give_back(screen, bytes);
    }
    chunks
}

impl Job<'_> {
    fn run(&self, projector: &Projector, tiling: &Tiling) -> Chunk {
        let (triangles, starts, entries) = SPARE.take(|_| true).unwrap_or_default();
        let mut chunk = Chunk {
            mesh: self.index,
            first_primitive: self.first_primitive,
            depth_range: (f64::INFINITY, f64::NEG_INFINITY),
            faces_camera: true,
            shown: Shown::Nothing,
            triangles,
            polygons: Vec::new(),
            starts,
            entries,
        };
        let mut scratch = SPARE_SCRATCH.take(|_| true).unwrap_or_default();
        let Scratch { gathered, triangles, touched, .. } = &mut scratch;
        triangles.clear();
        touched.clear();
        for first in self.faces.clone().step_by(GATHERED) {
            let faces = first..(first + GATHERED).min(self.faces.end);
            gathered.clear();
            let screen = self.screen.as_flattened();
            let corners =
                |&[a, b, c]: &[u32; 3]| [screen[a as usize], screen[b as usize], screen[c as usize]];
            gathered.extend(self.mesh.faces()[faces.clone()].iter().map(corners));
            for (face, vertices) in faces.zip(&*gathered) {
                touched.extend(self.face(face, vertices, projector, tiling, triangles, &mut chunk));
            }
        }
        chunk.bin(&mut scratch, tiling);
        let Scratch { triangles, touched, cursors, order, .. } = &scratch;
        let bytes = bytes_of(triangles) + bytes_of(touched) + bytes_of(cursors) + bytes_of(order);
        SPARE_SCRATCH.give_back(scratch, bytes);
        chunk
    }

    /// Sets up one face; its entry and the tiles it touches, or nothing if it covers no pixel centre for sure.
    #[expect(clippy::cast_possible_truncation, reason = "a chunk has few faces; ids fit by Scene::new")]
    fn face(
        &self,
        face: usize,
        vertices: &[ScreenVertex; 3],
        projector: &Projector,
        tiling: &Tiling,
        triangles: &mut Vec<Triangle>,
        chunk: &mut Chunk,
    ) -> Option<(u32, TileRange)> {
        let [a, b, c] = [vertices[0].z, vertices[1].z, vertices[2].z];
        let (lo, hi) = (lesser(lesser(a, b), c), -lesser(lesser(-a, -b), -c));
        chunk.depth_range = (lesser(chunk.depth_range.0, lo), -lesser(-chunk.depth_range.1, -hi));
        if vertices.iter().any(ScreenVertex::is_outside) {
            let (polygon, tiles) = self.clipped(face, projector, tiling)?;
            chunk.faces_camera &= polygon.corners.iter().all(|c| c.z == polygon.corners[0].z);
            chunk.shown = chunk.shown.and(flat(self.mesh, face, polygon.light));
            chunk.polygons.push(polygon);
            return Some(((chunk.polygons.len() - 1) as u32 | POLYGON_BIT, tiles));
        }
        let points = points_of(vertices);
        let tiles = tiling.touched(points.into_iter())?;
        self.is_seen(doubled_area(&points)).then_some(())?;
        let light = match self.mesh.material().shading {
            Shading::Unlit => 1.0,
            shading @ Shading::Lambert => {
                light(shading, self.corners(face, projector), projector.is_perspective())
            }
        };
        let flat = flat(self.mesh, face, light);
        chunk.faces_camera &= lo == hi;
        chunk.shown = chunk.shown.and(flat);
        triangles.push(Triangle { face: face as u32, light, vertices: *vertices, flat });
        Some(((triangles.len() - 1) as u32, tiles))
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
    fn bin(&mut self, scratch: &mut Scratch, tiling: &Tiling) {
        self.triangles.clear();
        self.starts.clear();
        self.entries.clear();
        if scratch.touched.is_empty() {
            return;
        }
        let columns = tiling.columns();
        let tiles = columns * tiling.rows();
        self.take_triangles(scratch, columns, tiles);
        let Scratch { touched, cursors, .. } = scratch;
        self.starts.resize(tiles + 1, 0);
        for (_, range) in touched.iter() {
            range.tiles(columns).for_each(|tile| self.starts[tile + 1] += 1);
        }
        let total = accumulate(&mut self.starts);
        self.entries.resize(total as usize, 0);
        cursors.clone_from(&self.starts);
        for (entry, range) in touched.iter() {
            for tile in range.tiles(columns) {
                self.entries[cursors[tile] as usize] = *entry;
                cursors[tile] += 1;
            }
        }
    }

    fn take_triangles(&mut self, scratch: &mut Scratch, columns: usize, tiles: usize) {
        let Scratch { triangles, touched, cursors, order, .. } = scratch;
        let first_tile = |range: &TileRange| usize::from(range.y0) * columns + usize::from(range.x0);
        let is_triangle = |entry: u32| entry & POLYGON_BIT == 0;
        cursors.clear();
        cursors.resize(tiles + 1, 0);
        for (_, range) in touched.iter().filter(|(entry, _)| is_triangle(*entry)) {
            cursors[first_tile(range) + 1] += 1;
        }
        accumulate(cursors);
        order.clear();
        order.resize(triangles.len(), 0);
        for (entry, range) in touched.iter_mut().filter(|(entry, _)| is_triangle(*entry)) {
            let place = &mut cursors[first_tile(range)];
            order[*place as usize] = *entry;
            *entry = *place;
            *place += 1;
        }
        self.triangles.extend(order.iter().map(|&i| triangles[i as usize]));
    }
}

/// The smaller of two numbers, in one instruction: no depth is NaN.
fn lesser(a: f64, b: f64) -> f64 {
    if a < b { a } else { b }
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
