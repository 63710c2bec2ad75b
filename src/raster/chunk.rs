//! Primitives that are set up, as tiles look them up.

use super::cover::doubled_area;
use super::fetch::fetch;
use super::project::ScreenVertex;
use super::shade::{Paint, Premultiplied};
use crate::scene::Mesh;
use crate::spare::{Spare, bytes_of};
use glam::DVec3;
use std::iter::from_fn;
use std::ops::Range;

/// A triangle that needed no clipping.
#[derive(Debug, Clone, Copy)]
pub struct Triangle<'a> {
    pub face: u32,
    pub vertices: &'a [ScreenVertex; 3],
    /// Its colour, where there is but one: looked up in set-up, once for all tiles.
    pub flat: Option<Premultiplied>,
    /// How bright it is where there are several.
    light: f32,
}

impl Triangle<'_> {
    /// The corners in sub-pixels.
    pub fn points(&self) -> [(i32, i32); 3] {
        points_of(self.vertices)
    }

    /// Which way round the corners go: 1 clockwise on the screen, -1 counter-clockwise.
    pub fn sign(&self) -> i32 {
        if doubled_area(&self.points()) < 0 { -1 } else { 1 }
    }

    /// Its colours, if it is of this mesh.
    #[inline]
    pub fn paint(&self, mesh: &Mesh) -> Paint {
        self.flat.map_or_else(|| Paint::new(mesh, self.face as usize, self.light), Paint::Flat)
    }
}

/// A triangle as it is kept, in as few bytes as a line of the cache has.
#[derive(Debug, Clone, Copy)]
#[repr(align(64))]
pub(super) struct Kept {
    pub vertices: [ScreenVertex; 3],
    /// The colour; of triangles that have several, how bright they are, in the first place.
    pub color: Premultiplied,
}

/// Marks faces that have several colours.
pub(super) const VARYING_BIT: u32 = 1 << 31;

/// Written out, since `map` is called rather than compiled into its caller.
#[inline]
fn points_of([a, b, c]: &[ScreenVertex; 3]) -> [(i32, i32); 3] {
    [(a.x, a.y), (b.x, b.y), (c.x, c.y)]
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
    Triangle(Triangle<'a>),
    Polygon(&'a Polygon),
}

impl Primitive<'_> {
    /// The view depths of the whole triangle's corners.
    fn corner_depths(&self) -> [f64; 3] {
        match self {
            Self::Triangle(t) => [t.vertices[0].z, t.vertices[1].z, t.vertices[2].z],
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

/// Marks a bin entry as an index into the polygons.
pub(super) const POLYGON_BIT: u32 = 1 << 31;

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
    pub(super) triangles: Vec<Kept>,
    /// Of every triangle its face, counted from the chunk's first, and whether its colour varies.
    pub(super) faces: Vec<u32>,
    pub(super) first_face: u32,
    pub(super) polygons: Vec<Polygon>,
    /// Entries of tile `t` are `entries[starts[t]..starts[t + 1]]`.
    pub(super) starts: Vec<u32>,
    pub(super) entries: Vec<u32>,
}

/// The triangles, faces, starts and entries of a chunk.
type Memory = (Vec<Kept>, [Vec<u32>; 3]);

/// Those of chunks that are no more.
static SPARE: Spare<Memory> = Spare::new();

impl Drop for Chunk {
    fn drop(&mut self) {
        let numbers = [&mut self.faces, &mut self.starts, &mut self.entries].map(std::mem::take);
        let triangles = std::mem::take(&mut self.triangles);
        let bytes = bytes_of(&triangles) + numbers.iter().map(bytes_of).sum::<usize>();
        SPARE.give_back((triangles, numbers), bytes);
    }
}

impl Chunk {
    /// Memory for a chunk, whatever is in it.
    pub(super) fn spare() -> Memory {
        SPARE.take(|_| true).unwrap_or_default()
    }

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

    /// How many entries some neighbouring tiles have.
    pub fn count_in(&self, tiles: Range<usize>) -> usize {
        match (self.starts.get(tiles.start), self.starts.get(tiles.end)) {
            (Some(&start), Some(&end)) => (end - start) as usize,
            _ => 0,
        }
    }

    /// Fetches some triangles for later, so that nobody has to wait for them.
    #[inline]
    fn fetch(&self, entries: &[u32]) {
        for &entry in entries.iter().filter(|&&entry| entry & POLYGON_BIT == 0) {
            fetch(&self.triangles[entry as usize]);
            fetch(&self.faces[entry as usize]);
        }
    }

    /// The primitive of this number.
    pub fn primitive(&self, entry: u32) -> Primitive<'_> {
        match entry & POLYGON_BIT {
            0 => Primitive::Triangle(self.triangle(entry as usize)),
            _ => Primitive::Polygon(&self.polygons[(entry & !POLYGON_BIT) as usize]),
        }
    }

    #[inline]
    fn triangle(&self, place: usize) -> Triangle<'_> {
        let (Kept { vertices, color }, face) = (&self.triangles[place], self.faces[place]);
        let flat = (face & VARYING_BIT == 0).then_some(*color);
        Triangle { face: self.first_face + (face & !VARYING_BIT), vertices, flat, light: color[0] }
    }
}

/// Primitives that are fetched while those before them are worked on.
const FETCHED: usize = 32;

/// The entries of a tile in submission order, some at a time, with their chunk and its number. A chunk's triangles of one tile lie
/// together, but those of the next chunk are far away: they are fetched ahead.
#[inline]
pub fn batches<'a>(chunks: &'a [Chunk], tile: usize) -> impl Iterator<Item = (usize, &'a Chunk, &'a [u32])> {
    let batch = move |(number, chunk): (usize, &'a Chunk)| {
        chunk.entries_in(tile).chunks(FETCHED).map(move |entries| (number, chunk, entries))
    };
    let mut batches = chunks.iter().enumerate().flat_map(batch).peekable();
    from_fn(move || {
        let now = batches.next();
        if let Some((_, chunk, entries)) = batches.peek() {
            chunk.fetch(entries);
        }
        now
    })
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

#[cfg(test)]
mod tests {
    use super::*;

    /// A chunk with these entries per tile, of triangles that nobody looks at.
    fn chunk(tiles: &[Vec<u32>]) -> Chunk {
        let triangle = Kept { vertices: [ScreenVertex::NOWHERE; 3], color: [0.0; 4] };
        let mut starts = vec![0];
        starts.extend(tiles.iter().scan(0, |sum, entries| {
            *sum += u32::try_from(entries.len()).unwrap();
            Some(*sum)
        }));
        Chunk {
            mesh: 0,
            first_primitive: 0,
            depth_range: (0.0, 0.0),
            faces_camera: false,
            shown: Shown::Nothing,
            triangles: vec![triangle; 100],
            faces: vec![0; 100],
            first_face: 0,
            polygons: Vec::new(),
            starts,
            entries: tiles.concat(),
        }
    }

    #[test]
    fn batches_have_all_entries_of_a_tile_in_their_order() {
        let polygons = || vec![POLYGON_BIT, POLYGON_BIT | 7];
        let chunks = [
            chunk(&[(0..100).rev().collect(), vec![3]]),
            chunk(&[vec![], vec![]]),
            chunk(&[]),
            chunk(&[polygons(), (0..33).collect()]),
            chunk(&[(5..69).collect(), vec![]]),
        ];
        for tile in 0..3 {
            let mut found = Vec::new();
            for (number, chunk, entries) in batches(&chunks, tile) {
                assert!(std::ptr::eq(chunk, &raw const chunks[number]));
                assert!((1..=FETCHED).contains(&entries.len()));
                found.extend(entries.iter().map(|&entry| (number, entry)));
            }
            let of_chunk = |(number, chunk): (usize, &Chunk)| {
                chunk.entries_in(tile).iter().map(|&entry| (number, entry)).collect::<Vec<_>>()
            };
            assert_eq!(found, chunks.iter().enumerate().flat_map(of_chunk).collect::<Vec<_>>());
            assert_eq!(found.len(), [166, 34, 0][tile]);
        }
    }
}
