//! One tile: the opaque surfaces first, then the transparent ones in submission order, handed over as blocks of
//! pixels.

use super::Raster;
use super::cover::{Rect, spans};
use super::interpolate::{Hit, LANES, LANES_I32, Plane, Ray, Surface};
use super::setup::{Chunk, Primitive};
use super::shade::{Paint, Shade};
use crate::order::sort_key;
use multiversion::multiversion;

/// Up to [`LANES`] neighbouring pixels of a row that one primitive covers.
#[derive(Debug, Clone, Copy)]
pub struct Block {
    /// Index of the first pixel in the tile.
    pub first: u32,
    /// One bit per pixel that is covered and not hidden.
    pub mask: u8,
}

/// The visible pixels of one transparent primitive in a tile.
#[derive(Debug, Clone, Copy)]
pub struct Cover<'a, 'r> {
    /// Primitive id.
    pub primitive: u32,
    /// Where it is.
    pub blocks: &'a [Block],
    /// Depths per block. Outside the mask they mean nothing, but are finite.
    pub depth: &'a [[f32; LANES]],
    /// The depth everywhere, if it is constant.
    pub constant_depth: Option<f32>,
    /// Geometry, for what is shaded later.
    pub surface: &'a Surface<'r>,
    /// Colours, for what is shaded later.
    pub paint: &'a Paint,
}

/// What becomes of a tile's transparent fragments.
pub trait Sink<'r> {
    /// Takes a primitive's pixels; false to be given no more.
    fn take(&mut self, cover: &Cover<'_, 'r>) -> bool;
}

/// A tile being rasterised; keep it and its memory is reused.
#[derive(Debug)]
pub struct Tile {
    rect: Rect,
    /// (depth, primitive) of the opaque surface at each pixel; empty while there is none.
    opaque: Vec<u64>,
    /// What is behind the transparent fragments of each pixel.
    background: Vec<[f32; 3]>,
    occluded: u64,
    blocks: Vec<Block>,
    depth: Vec<[f32; LANES]>,
}

/// The opaque key of a pixel without an opaque surface.
const NOTHING_OPAQUE: u64 = u64::MAX;

impl Default for Tile {
    fn default() -> Self {
        Self {
            rect: Rect { x0: 0, y0: 0, x1: 0, y1: 0 },
            opaque: Vec::new(),
            background: Vec::new(),
            occluded: 0,
            blocks: Vec::new(),
            depth: Vec::new(),
        }
    }
}

impl Tile {
    /// Draws the opaque surfaces of `rect`, a part of the given tile. False when stopped.
    pub fn begin(
        &mut self,
        raster: &Raster<'_>,
        (column, row): (usize, usize),
        rect: Rect,
        stop: &dyn Fn() -> bool,
    ) -> bool {
        self.rect = rect;
        self.occluded = 0;
        self.opaque.clear();
        self.background.clear();
        self.background.resize(rect.area(), raster.scene.background());
        for_each_primitive(raster, &raster.opaque, (column, row), stop, |chunk, primitive| {
            self.opaque.resize(rect.area(), NOTHING_OPAQUE);
            let (id, surface, paint) = raster.primitive(chunk, primitive);
            primitive_spans(primitive, &rect, |y, x0, x1| {
                for x in x0..x1 {
                    self.draw_opaque(index_in(&rect, x, y), &surface.at(x, y), id, &paint);
                }
            });
            true
        })
    }

    fn draw_opaque(&mut self, i: usize, hit: &Hit, primitive: u32, paint: &Paint) {
        let key = sort_key(hit.depth, primitive);
        if key < self.opaque[i] && paint.passes(hit) {
            let [r, g, b, _] = paint.at(hit);
            self.opaque[i] = key;
            self.background[i] = [r, g, b];
        }
    }

    /// The pixels.
    pub fn rect(&self) -> Rect {
        self.rect
    }
    /// The opaque colour behind each pixel.
    pub fn background(&self) -> &[[f32; 3]] {
        &self.background
    }
    /// Transparent fragments that were found hidden behind opaque surfaces.
    pub fn occluded(&self) -> u64 {
        self.occluded
    }

    /// Hands the transparent primitives to `sink` in submission order, those of their pixels left out that lie
    /// behind an opaque surface or are masked out. False when stopped, by `stop` or by the sink.
    pub fn transparent<'r>(
        &mut self,
        raster: &'r Raster<'_>,
        tile: (usize, usize),
        sink: &mut impl Sink<'r>,
        stop: &dyn Fn() -> bool,
    ) -> bool {
        for_each_primitive(raster, &raster.transparent, tile, stop, |chunk, primitive| {
            let (id, surface, paint) = raster.primitive(chunk, primitive);
            let constant_depth = surface.constant_depth();
            self.cover(primitive, &surface, constant_depth);
            if self.blocks.is_empty() {
                return true;
            }
            if !self.opaque.is_empty() {
                self.hide();
            }
            if let Paint::Varying(shade) = &paint
                && shade.is_masked()
            {
                self.cut_out(&surface, shade);
            }
            let (blocks, depth) = (&self.blocks[..], &self.depth[..]);
            sink.take(&Cover {
                primitive: id,
                blocks,
                depth,
                constant_depth,
                surface: &surface,
                paint: &paint,
            })
        })
    }

    /// Finds the primitive's blocks and their depths.
    fn cover(&mut self, primitive: Primitive<'_>, surface: &Surface<'_>, constant_depth: Option<f32>) {
        self.blocks.clear();
        self.depth.clear();
        if let (Primitive::Triangle(triangle), Surface::Plane(plane)) = (primitive, surface) {
            let bounds = triangle.bounds(&self.rect);
            if bounds.x0 >= bounds.x1 || bounds.y0 >= bounds.y1 {
                return;
            }
            if bounds.width() <= SMALL && bounds.height() <= SMALL {
                return cover_small(plane, &self.rect, &bounds, &mut self.blocks, &mut self.depth);
            }
        }
        self.cover_spans(primitive);
        match constant_depth {
            Some(depth) => self.depth.resize(self.blocks.len(), [depth; LANES]),
            None => depths(surface, &self.rect, &self.blocks, &mut self.depth),
        }
    }

    /// Cuts the primitive's spans into blocks.
    fn cover_spans(&mut self, primitive: Primitive<'_>) {
        let (rect, blocks) = (self.rect, &mut self.blocks);
        primitive_spans(primitive, &rect, |y, x0, x1| {
            let mut x = x0;
            while x < x1 {
                let left = x1 - x;
                let mask = if left < LANES_I32 { (1 << left) - 1 } else { !0 };
                #[expect(clippy::cast_possible_truncation, reason = "pixels of a tile")]
                blocks.push(Block { first: index_in(&rect, x, y) as u32, mask });
                x += LANES_I32;
            }
        });
    }

    /// Takes the pixels behind opaque surfaces out of the blocks.
    fn hide(&mut self) {
        for (block, depths) in self.blocks.iter_mut().zip(&self.depth) {
            for (lane, depth) in lanes(block.mask).map(|lane| (lane, depths[lane])) {
                if depth > opaque_depth(self.opaque[block.first as usize + lane]) {
                    block.mask &= !(1 << lane);
                    self.occluded += 1;
                }
            }
        }
    }

    /// Takes the pixels that a mask discards out of the blocks.
    fn cut_out(&mut self, surface: &Surface<'_>, shade: &Shade) {
        for block in &mut self.blocks {
            for lane in lanes(block.mask) {
                let (x, y) = pixel_at(&self.rect, block.first as usize + lane);
                if !shade.passes(&surface.at(x, y)) {
                    block.mask &= !(1 << lane);
                }
            }
        }
    }
}

/// Triangles no larger than this, in pixels, are tested pixel by pixel: following their edges costs more.
const SMALL: usize = 16;

/// The blocks of a small triangle: all of its bounding box, by edge functions that its depth needs anyway.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"))]
fn cover_small(
    plane: &Plane,
    rect: &Rect,
    bounds: &Rect,
    blocks: &mut Vec<Block>,
    depth: &mut Vec<[f32; LANES]>,
) {
    for y in bounds.y0..bounds.y1 {
        let mut x = bounds.x0;
        while x < bounds.x1 {
            let left = bounds.x1 - x;
            let valid = if left < LANES_I32 { (1 << left) - 1 } else { !0 };
            let (inside, depths) = plane.cover(x, y);
            let mask = inside & valid;
            if mask != 0 {
                #[expect(clippy::cast_possible_truncation, reason = "pixels of a tile")]
                blocks.push(Block { first: index_in(rect, x, y) as u32, mask });
                depth.push(depths);
            }
            x += LANES_I32;
        }
    }
}

/// The depths of all blocks.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"))]
fn depths(surface: &Surface<'_>, rect: &Rect, blocks: &[Block], depth: &mut Vec<[f32; LANES]>) {
    depth.extend(blocks.iter().map(|block| {
        let (x, y) = pixel_at(rect, block.first as usize);
        surface.depths(x, y)
    }));
}

/// The lanes whose bit is set, ascending.
pub fn lanes(mask: u8) -> impl Iterator<Item = usize> {
    let mut left = mask;
    std::iter::from_fn(move || {
        let lane = left.trailing_zeros() as usize;
        left &= left.wrapping_sub(1);
        (lane < LANES).then_some(lane)
    })
}

/// Depth of the opaque surface behind `key`; infinite where there is none.
fn opaque_depth(key: u64) -> f32 {
    if key == NOTHING_OPAQUE { f32::INFINITY } else { f32::from_bits((key >> 32) as u32) }
}

#[expect(clippy::cast_sign_loss, reason = "the pixel lies in the tile")]
fn index_in(rect: &Rect, x: i32, y: i32) -> usize {
    (y - rect.y0) as usize * rect.width() + (x - rect.x0) as usize
}

/// The image coordinates of a tile's pixel.
#[inline]
#[expect(clippy::cast_possible_truncation, clippy::cast_possible_wrap, reason = "pixels of a tile")]
pub fn pixel_at(rect: &Rect, i: usize) -> (i32, i32) {
    let (i, width) = (i as u32, rect.width() as u32);
    (rect.x0 + (i % width) as i32, rect.y0 + (i / width) as i32)
}

fn primitive_spans(primitive: Primitive<'_>, rect: &Rect, span: impl FnMut(i32, i32, i32)) {
    match primitive {
        Primitive::Triangle(t) => spans(&t.vertices.map(|v| (v.x, v.y)), rect, span),
        Primitive::Polygon(p) => spans(&p.points, rect, span),
    }
}

/// Visits the primitives of a tile in submission order until `visit` says no; false when stopped on the way.
fn for_each_primitive<'a>(
    raster: &Raster<'_>,
    chunks: &'a [Chunk],
    (column, row): (usize, usize),
    stop: &dyn Fn() -> bool,
    mut visit: impl FnMut(&'a Chunk, Primitive<'a>) -> bool,
) -> bool {
    let tile = row * raster.columns() + column;
    for chunk in chunks {
        for (i, primitive) in chunk.in_tile(tile).enumerate() {
            if (i % 64 == 0 && stop()) || !visit(chunk, primitive) {
                return false;
            }
        }
    }
    true
}

impl Raster<'_> {
    /// A primitive's id, geometry and colours.
    fn primitive<'r>(&'r self, chunk: &Chunk, primitive: Primitive<'_>) -> (u32, Surface<'r>, Paint) {
        let mesh = &self.scene.meshes()[chunk.mesh];
        let (face, light, flat, surface) = match primitive {
            Primitive::Triangle(t) => {
                let plane = Plane::new(&t.vertices, self.projector.is_perspective());
                (t.face, t.light, t.flat, Surface::Plane(plane))
            }
            Primitive::Polygon(p) => {
                (p.face, p.light, None, Surface::Ray(Ray::new(&self.projector, p.corners)))
            }
        };
        let paint = flat.map_or_else(|| Paint::new(mesh, face as usize, light), Paint::Flat);
        (chunk.first_primitive + face, surface, paint)
    }
}
