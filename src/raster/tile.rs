//! One tile: the opaque surfaces first, then the transparent fragments in front of them, as lists in
//! submission order.

use super::Raster;
use super::cover::{Rect, spans};
use super::interpolate::{Hit, Interpolate, Plane, Ray};
use super::setup::{Chunk, Primitive};
use super::shade::Shade;
use crate::fragments::{Fragment, Lists};
use crate::order::sort_key;

/// A tile being rasterised; keep it and its memory is reused.
#[derive(Debug)]
pub struct Tile {
    rect: Rect,
    index: usize,
    /// (depth, primitive) of the opaque surface at each pixel.
    opaque: Vec<u64>,
    /// What is behind the transparent fragments of each pixel.
    background: Vec<[f32; 3]>,
    /// Fragments per pixel before the depth test.
    counts: Vec<u32>,
    /// Where each pixel's next fragment goes.
    cursors: Vec<usize>,
    offsets: Vec<i64>,
    occluded: u64,
}

/// The opaque key of a pixel without an opaque surface.
const NOTHING_OPAQUE: u64 = u64::MAX;

impl Default for Tile {
    fn default() -> Self {
        Self {
            rect: Rect { x0: 0, y0: 0, x1: 0, y1: 0 },
            index: 0,
            opaque: Vec::new(),
            background: Vec::new(),
            counts: Vec::new(),
            cursors: Vec::new(),
            offsets: Vec::new(),
            occluded: 0,
        }
    }
}

impl Tile {
    /// Draws the opaque surfaces of a tile and counts its transparent fragments. False when stopped.
    pub fn begin(&mut self, raster: &Raster<'_>, column: usize, row: usize, stop: &dyn Fn() -> bool) -> bool {
        self.rect = raster.tiling.rect(column, row);
        self.index = row * raster.tiling.columns() + column;
        self.occluded = 0;
        let pixels = self.rect.area();
        self.opaque.clear();
        self.opaque.resize(pixels, NOTHING_OPAQUE);
        self.background.clear();
        self.background.resize(pixels, raster.scene.background());
        self.counts.clear();
        self.counts.resize(pixels, 0);
        let drawn = for_each_primitive(&raster.opaque, self.index, stop, |chunk, primitive| {
            self.draw_opaque(raster, chunk, primitive);
        });
        drawn
            && for_each_primitive(&raster.transparent, self.index, stop, |_, primitive| {
                let (rect, counts) = (self.rect, &mut self.counts);
                primitive_spans(primitive, &rect, |y, x0, x1| {
                    let first = index_in(&rect, x0, y);
                    counts[first..first + span_length(x0, x1)].iter_mut().for_each(|n| *n += 1);
                });
            })
    }

    /// The tile's pixels.
    pub fn rect(&self) -> Rect {
        self.rect
    }
    /// The opaque colour behind each pixel.
    pub fn background(&self) -> &[[f32; 3]] {
        &self.background
    }
    /// Fragments per pixel, before the depth test.
    pub fn counts(&self) -> &[u32] {
        &self.counts
    }
    /// Fragments that [`Tile::fill`] found hidden behind opaque surfaces so far.
    pub fn occluded(&self) -> u64 {
        self.occluded
    }

    fn draw_opaque(&mut self, raster: &Raster<'_>, chunk: &Chunk, primitive: Primitive<'_>) {
        let rect = self.rect;
        raster.visit(chunk, primitive, &rect, |x, y, hit, id, shade| {
            let i = index_in(&rect, x, y);
            let key = sort_key(hit.depth, id);
            if key < self.opaque[i] && shade.passes(hit) {
                let [r, g, b, _] = shade.at(hit);
                self.opaque[i] = key;
                self.background[i] = [r, g, b];
            }
        });
    }

    /// Writes the transparent fragments of pixels `first..last` of the tile into `lists`, those behind an
    /// opaque surface or masked out left out. False when stopped.
    pub fn fill(
        &mut self,
        raster: &Raster<'_>,
        first: usize,
        last: usize,
        lists: &mut Lists,
        stop: &dyn Fn() -> bool,
    ) -> bool {
        self.reserve(first, last, lists);
        let (rect, index) = (self.rect, self.index);
        let rows = row_range(&rect, first, last);
        let (opaque, cursors, occluded) = (&self.opaque, &mut self.cursors, &mut self.occluded);
        let finished = for_each_primitive(&raster.transparent, index, stop, |chunk, primitive| {
            raster.visit(chunk, primitive, &rows, |x, y, hit, primitive, shade| {
                let i = index_in(&rect, x, y);
                if !(first..last).contains(&i) {
                    return;
                }
                if hit.depth > opaque_depth(opaque[i]) {
                    *occluded += 1;
                    return;
                }
                if !shade.passes(hit) {
                    return;
                }
                let [r, g, b, alpha] = shade.at(hit);
                let fragment = Fragment { depth: hit.depth, color: [r, g, b], alpha, primitive };
                lists.set(cursors[i - first], fragment);
                cursors[i - first] += 1;
            });
        });
        self.close_gaps(lists);
        finished
    }

    /// Makes room for as many fragments as were counted.
    #[expect(clippy::cast_sign_loss, clippy::cast_possible_truncation, reason = "offsets count fragments")]
    fn reserve(&mut self, first: usize, last: usize, lists: &mut Lists) {
        self.offsets.clear();
        self.offsets.push(0);
        let mut sum = 0;
        for &count in &self.counts[first..last] {
            sum += i64::from(count);
            self.offsets.push(sum);
        }
        lists.reset_to(&self.offsets);
        self.cursors.clear();
        self.cursors.extend(self.offsets[..last - first].iter().map(|&o| o as usize));
    }

    /// Moves rows together where fewer fragments arrived than were counted.
    #[expect(clippy::cast_sign_loss, clippy::cast_possible_truncation, reason = "offsets count fragments")]
    fn close_gaps(&self, lists: &mut Lists) {
        let full = self.cursors.iter().zip(&self.offsets[1..]).all(|(&end, &next)| end == next as usize);
        if full {
            return;
        }
        let mut write = 0;
        for (i, &end) in self.cursors.iter().enumerate() {
            let start = self.offsets[i] as usize;
            lists.move_rows(start..end, write);
            write += end - start;
            lists.set_row_end(i, write);
        }
        lists.truncate(write);
    }
}

/// Depth of the opaque surface behind `key`; infinite where there is none.
fn opaque_depth(key: u64) -> f32 {
    if key == NOTHING_OPAQUE { f32::INFINITY } else { f32::from_bits((key >> 32) as u32) }
}

/// The rows of the tile that hold pixels `first..last`.
#[expect(clippy::cast_possible_truncation, clippy::cast_possible_wrap, reason = "a tile's rows")]
fn row_range(rect: &Rect, first: usize, last: usize) -> Rect {
    let width = rect.width();
    let (top, bottom) = (first / width, last.div_ceil(width));
    Rect { y0: rect.y0 + top as i32, y1: rect.y0 + bottom as i32, ..*rect }
}

#[expect(clippy::cast_sign_loss, reason = "the pixel lies in the tile")]
fn index_in(rect: &Rect, x: i32, y: i32) -> usize {
    (y - rect.y0) as usize * rect.width() + (x - rect.x0) as usize
}

#[expect(clippy::cast_sign_loss, reason = "spans are not empty")]
fn span_length(x0: i32, x1: i32) -> usize {
    (x1 - x0) as usize
}

fn primitive_spans(primitive: Primitive<'_>, rect: &Rect, span: impl FnMut(i32, i32, i32)) {
    match primitive {
        Primitive::Triangle(t) => spans(&t.vertices.map(|v| (v.x, v.y)), rect, span),
        Primitive::Polygon(p) => spans(&p.points, rect, span),
    }
}

/// Visits the primitives of a tile in submission order; false when stopped on the way.
fn for_each_primitive<'a>(
    chunks: &'a [Chunk],
    tile: usize,
    stop: &dyn Fn() -> bool,
    mut visit: impl FnMut(&'a Chunk, Primitive<'a>),
) -> bool {
    for chunk in chunks {
        for (i, primitive) in chunk.in_tile(tile).enumerate() {
            if i % 64 == 0 && stop() {
                return false;
            }
            visit(chunk, primitive);
        }
    }
    true
}

impl Raster<'_> {
    /// Calls `pixel(x, y, hit, primitive id, shade)` for every pixel of `rect` that the primitive covers.
    fn visit(
        &self,
        chunk: &Chunk,
        primitive: Primitive<'_>,
        rect: &Rect,
        mut pixel: impl FnMut(i32, i32, &Hit, u32, &Shade),
    ) {
        let mesh = &self.scene.meshes()[chunk.mesh];
        let shade = |face: u32, light| (chunk.first_primitive + face, Shade::new(mesh, face as usize, light));
        match primitive {
            Primitive::Triangle(t) => {
                let plane = Plane::new(&t.vertices, self.projector.is_perspective());
                let (id, shade) = shade(t.face, t.light);
                walk(primitive, rect, &plane, |x, y, hit| pixel(x, y, hit, id, &shade));
            }
            Primitive::Polygon(p) => {
                let ray = Ray::new(&self.projector, p.corners);
                let (id, shade) = shade(p.face, p.light);
                walk(primitive, rect, &ray, |x, y, hit| pixel(x, y, hit, id, &shade));
            }
        }
    }
}

fn walk(
    primitive: Primitive<'_>,
    rect: &Rect,
    surface: &impl Interpolate,
    mut pixel: impl FnMut(i32, i32, &Hit),
) {
    primitive_spans(primitive, rect, |y, x0, x1| (x0..x1).for_each(|x| pixel(x, y, &surface.at(x, y))));
}
