//! One tile: the opaque surfaces first, then the transparent ones in the order that is asked for, handed over as
//! runs of pixels, small ones as lists of pixels.

use super::Raster;
use super::chunk::{Chunk, Primitive, batches};
use super::cover::{Rect, lies_beside, pixel_bounds, spans};
use super::interpolate::{LANES, Plane, Ray, Surface};
use super::occlusion::Opaque;
use super::pixels::{FEW, Pixels, Where};
use super::runs::{Run, triangle_runs};
use super::shade::{Paint, Shade};
use super::visit::{Order, Visits};
use multiversion::multiversion;

/// The visible pixels of one transparent primitive in a tile.
#[derive(Debug, Clone, Copy)]
pub struct Cover<'a, 'r> {
    /// Primitive id.
    pub primitive: u32,
    /// How many of the tile's primitives have been looked at, this one included.
    pub visited: usize,
    /// Where it is.
    pub at: Where<'a>,
    /// The number of its pixels.
    pub pixels: usize,
    /// The depth of every pixel, in their order; empty if it is constant. There are [`LANES`] more numbers than
    /// pixels, finite ones.
    pub depth: &'a [f32],
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

/// What was left out of a tile because opaque surfaces hide it.
#[derive(Debug, Clone, Copy, Default)]
pub struct Occluded {
    /// Fragments that were found hidden one by one.
    pub fragments: u64,
    /// Primitives that were found hidden as a whole, once per tile.
    pub primitives: u64,
}

impl Occluded {
    /// Adds another tile's.
    pub fn add(&mut self, other: Self) {
        self.fragments += other.fragments;
        self.primitives += other.primitives;
    }
}

/// A tile being rasterised; keep it and its memory is reused.
#[derive(Debug, Default)]
pub struct Tile {
    rect: Rect,
    opaque: Opaque,
    occluded: Occluded,
    visits: Visits,
    /// How many primitives have been looked at.
    visited: usize,
    runs: Vec<Run>,
    /// The runs that `hide` and `cut_out` leave.
    kept: Vec<Run>,
    depth: Vec<f32>,
    /// The pixels of a small primitive, which has no runs.
    few: Pixels,
    /// The runs of all pixels.
    full_runs: Vec<Run>,
}

impl Tile {
    /// Draws the opaque surfaces of `rect`, a part of the given tile. False when stopped.
    pub fn begin(
        &mut self,
        raster: &Raster<'_>,
        tile: (usize, usize),
        rect: Rect,
        skip: bool,
        stop: &dyn Fn() -> bool,
    ) -> bool {
        self.set_rect(rect);
        self.occluded = Occluded::default();
        self.opaque.begin(rect.area(), raster.background());
        let finished = for_each_primitive(raster, &raster.opaque, tile, stop, |chunk, primitive| {
            let (id, surface, paint) = raster.primitive(chunk, primitive);
            self.opaque.make_room();
            primitive_spans(primitive, &rect, |y, x0, x1| {
                for x in x0..x1 {
                    self.opaque.draw(index_in(&rect, x, y), &surface.at(x, y), id, &paint);
                }
            });
            true
        });
        self.opaque.finish(skip);
        finished
    }

    fn set_rect(&mut self, rect: Rect) {
        self.rect = rect;
        self.few.begin(rect);
        self.full_runs.clear();
        #[expect(clippy::cast_possible_truncation, reason = "pixels of a tile")]
        for y in rect.y0..rect.y1 {
            let (first, len) = (index_in(&rect, rect.x0, y) as u32, rect.width() as u32);
            self.full_runs.push(Run { x: rect.x0, y, first, len });
        }
    }

    /// The opaque surfaces and what else is behind each pixel.
    pub fn background(&self) -> &Opaque {
        &self.opaque
    }
    /// What was found hidden behind opaque surfaces by the last call of [`Tile::transparent`].
    pub fn occluded(&self) -> Occluded {
        self.occluded
    }

    /// Whether the tile's transparent primitives come front to back as a whole in [`Order::FrontToBack`]: none
    /// has pixels behind the nearest of a later one.
    pub fn is_layered(&mut self, raster: &Raster<'_>, tile: (usize, usize)) -> bool {
        self.visits.front_to_back(raster, tile)
    }

    /// Hands the transparent primitives to `sink` in the given order, those of their pixels left out that lie
    /// behind an opaque surface or are masked out. False when stopped, by `stop` or by the sink.
    pub fn transparent<'r>(
        &mut self,
        raster: &'r Raster<'_>,
        tile: (usize, usize),
        order: Order,
        sink: &mut impl Sink<'r>,
        stop: &dyn Fn() -> bool,
    ) -> bool {
        self.occluded = Occluded::default();
        self.visited = 0;
        self.depth.resize(self.rect.area() + 2 * LANES, 0.0);
        if order != Order::Submission {
            let mut visits = std::mem::take(&mut self.visits);
            visits.arrange(raster, tile, order);
            let finished = hand_over_arranged(self, raster, &visits, sink, stop);
            self.visits = visits;
            return finished;
        }
        hand_over_submitted(self, raster, tile, sink, stop)
    }

    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    fn hand_over<'r, K: Sink<'r>>(
        &mut self,
        raster: &'r Raster<'_>,
        chunk: &Chunk,
        primitive: Primitive<'_>,
        sink: &mut K,
    ) -> bool {
        self.visited += 1;
        let behind = self.opaque.is_any() && self.opaque.hides_all(primitive.depth_range().0);
        self.occluded.primitives += u64::from(behind);
        let pixels = if behind { 0 } else { self.cover(primitive) };
        if pixels == 0 {
            return true;
        }
        let perspective = raster.projector.is_perspective();
        let mesh = &raster.scene.meshes()[chunk.mesh];
        match primitive {
            Primitive::Triangle(t) => {
                let surface = Surface::Plane(Plane::new(t.vertices, perspective));
                self.show(pixels, chunk.first_primitive + t.face, &surface, &t.paint(mesh), sink)
            }
            Primitive::Polygon(p) => {
                let surface = Surface::Ray(Ray::new(&raster.projector, p.corners));
                let paint = Paint::new(mesh, p.face as usize, p.light);
                self.show(pixels, chunk.first_primitive + p.face, &surface, &paint, sink)
            }
        }
    }

    /// Hands over what is visible of a primitive's pixels.
    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    fn show<'r, K: Sink<'r>>(
        &mut self,
        mut pixels: usize,
        primitive: u32,
        surface: &Surface<'r>,
        paint: &Paint,
        sink: &mut K,
    ) -> bool {
        let constant_depth = surface.constant_depth();
        if constant_depth.is_none() {
            self.depths(surface);
        }
        if self.opaque.is_any() && self.opaque.may_hide(surface.farthest()) {
            pixels = self.hide(constant_depth);
        }
        if let Paint::Varying(shade) = paint
            && shade.is_masked()
        {
            pixels = self.cut_out(surface, shade, constant_depth);
        }
        if pixels == 0 {
            return true;
        }
        sink.take(&Cover {
            primitive,
            visited: self.visited,
            at: if self.few.is_empty() { Where::Many(&self.runs) } else { Where::Few(&self.few) },
            pixels,
            depth: if constant_depth.is_some() { &[] } else { &self.depth[..pixels + LANES] },
            constant_depth,
            surface,
            paint,
        })
    }

    /// Finds the primitive's pixels, or runs of them; their number.
    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    fn cover(&mut self, primitive: Primitive<'_>) -> usize {
        let (rect, runs, few) = (self.rect, &mut self.runs, &mut self.few);
        runs.clear();
        few.clear();
        let pixels = match primitive {
            Primitive::Triangle(triangle) => {
                let points = triangle.points();
                let bounds = pixel_bounds(&points, &rect);
                if bounds.x0 >= bounds.x1 || bounds.y0 >= bounds.y1 {
                    return 0;
                }
                let sign = triangle.sign();
                if few.list_triangle(points, sign, &bounds) {
                    return few.places().len();
                }
                // a third of the tiles in a large triangle's bounds
                if lies_beside(points, sign, &bounds) {
                    return 0;
                }
                let Some(pixels) = triangle_runs(points, sign.into(), &rect, &bounds, runs) else {
                    runs.extend_from_slice(&self.full_runs);
                    return rect.area();
                };
                pixels
            }
            Primitive::Polygon(polygon) => {
                let mut pixels = 0;
                spans(&polygon.points, &rect, |y, x0, x1| {
                    #[expect(clippy::cast_possible_truncation, reason = "pixels of a tile")]
                    runs.push(Run {
                        x: x0,
                        y,
                        first: index_in(&rect, x0, y) as u32,
                        len: (x1 - x0).cast_unsigned(),
                    });
                    pixels += (x1 - x0).cast_unsigned() as usize;
                });
                pixels
            }
        };
        if pixels <= FEW {
            few.list(runs);
            // or they would be there again once none of those few is left
            runs.clear();
        }
        pixels
    }

    /// The depths of all pixels.
    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    fn depths(&mut self, surface: &Surface<'_>) {
        let Self { few, runs, depth, .. } = self;
        match surface {
            Surface::Plane(plane) if !few.is_empty() => plane.depths_at(few, depth),
            Surface::Plane(plane) => plane.depths_of_many(runs, depth),
            Surface::Ray(_) => {
                let at = if few.is_empty() { Where::Many(runs) } else { Where::Few(few) };
                let mut next = depth.iter_mut();
                at.for_each_position(|x, y| {
                    if let Some(depth) = next.next() {
                        *depth = surface.at(x, y).depth;
                    }
                });
            }
        }
    }

    /// Leaves out the pixels behind opaque surfaces.
    fn hide(&mut self, constant_depth: Option<f32>) -> usize {
        let Self { opaque, occluded, few, runs, kept, depth, .. } = self;
        retain(few, runs, kept, depth, constant_depth, |i, _, _, depth| {
            let visible = !opaque.hides(i, depth);
            occluded.fragments += u64::from(!visible);
            visible
        })
    }

    /// Leaves out the pixels that a mask discards.
    fn cut_out(&mut self, surface: &Surface<'_>, shade: &Shade, constant_depth: Option<f32>) -> usize {
        let Self { few, runs, kept, depth, .. } = self;
        retain(few, runs, kept, depth, constant_depth, |_, x, y, _| shade.passes(&surface.at(x, y)))
    }
}

/// The primitives as they were submitted. From here on everything is inlined, so that all of it is compiled for
/// the instruction set at hand.
#[multiversion(
    targets(
        "x86_64+avx512f+avx512vl+avx512dq+avx512bw+popcnt+bmi1+bmi2",
        "x86_64+avx2+fma+popcnt+bmi1+bmi2"
    ),
    dispatcher = "direct"
)]
fn hand_over_submitted<'r, K: Sink<'r>>(
    tile: &mut Tile,
    raster: &'r Raster<'_>,
    place: (usize, usize),
    sink: &mut K,
    stop: &dyn Fn() -> bool,
) -> bool {
    for_each_primitive(raster, &raster.transparent, place, stop, |chunk, primitive| {
        tile.hand_over(raster, chunk, primitive, sink)
    })
}

/// The primitives as they were arranged.
#[multiversion(
    targets(
        "x86_64+avx512f+avx512vl+avx512dq+avx512bw+popcnt+bmi1+bmi2",
        "x86_64+avx2+fma+popcnt+bmi1+bmi2"
    ),
    dispatcher = "direct"
)]
fn hand_over_arranged<'r, K: Sink<'r>>(
    tile: &mut Tile,
    raster: &'r Raster<'_>,
    visits: &Visits,
    sink: &mut K,
    stop: &dyn Fn() -> bool,
) -> bool {
    for (i, (_, chunk, primitive)) in visits.iter(raster).enumerate() {
        if (i % 64 == 0 && stop()) || !tile.hand_over(raster, chunk, primitive, sink) {
            return false;
        }
    }
    true
}

/// Keeps the pixels that `keep(index, x, y, depth)` wants; their number.
fn retain(
    few: &mut Pixels,
    runs: &mut Vec<Run>,
    kept: &mut Vec<Run>,
    depth: &mut [f32],
    constant_depth: Option<f32>,
    mut keep: impl FnMut(usize, i32, i32, f32) -> bool,
) -> usize {
    if !few.is_empty() {
        return few.retain(depth, constant_depth, keep);
    }
    kept.clear();
    let (mut from, mut to) = (0, 0);
    for run in runs.iter() {
        let mut open: Option<Run> = None;
        for i in 0..run.len {
            let (x, first) = (run.x + i.cast_signed(), run.first + i);
            let z = constant_depth.unwrap_or(depth[from]);
            from += 1;
            if keep(first as usize, x, run.y, z) {
                depth[to] = z;
                to += 1;
                open.get_or_insert(Run { x, y: run.y, first, len: 0 }).len += 1;
            } else {
                kept.extend(open.take());
            }
        }
        kept.extend(open);
    }
    std::mem::swap(runs, kept);
    to
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
        Primitive::Triangle(t) => spans(&t.points(), rect, span),
        Primitive::Polygon(p) => spans(&p.points, rect, span),
    }
}

/// Visits the primitives of a tile in submission order until `visit` says no; false when stopped on the way.
#[inline(always)]
#[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
fn for_each_primitive<'a>(
    raster: &Raster<'_>,
    chunks: &'a [Chunk],
    (column, row): (usize, usize),
    stop: &dyn Fn() -> bool,
    mut visit: impl FnMut(&'a Chunk, Primitive<'a>) -> bool,
) -> bool {
    for (_, chunk, entries) in batches(chunks, row * raster.columns() + column) {
        if stop() || !entries.iter().all(|&entry| visit(chunk, chunk.primitive(entry))) {
            return false;
        }
    }
    true
}

impl Raster<'_> {
    /// A primitive's id, geometry and colours.
    fn primitive<'r>(&'r self, chunk: &Chunk, primitive: Primitive<'_>) -> (u32, Surface<'r>, Paint) {
        let mesh = &self.scene.meshes()[chunk.mesh];
        let (face, paint, surface) = match primitive {
            Primitive::Triangle(t) => {
                let plane = Plane::new(t.vertices, self.projector.is_perspective());
                (t.face, t.paint(mesh), Surface::Plane(plane))
            }
            Primitive::Polygon(p) => {
                let paint = Paint::new(mesh, p.face as usize, p.light);
                (p.face, paint, Surface::Ray(Ray::new(&self.projector, p.corners)))
            }
        };
        (chunk.first_primitive + face, surface, paint)
    }
}
