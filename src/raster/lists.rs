//! A tile's fragments as per-pixel lists: kept as (depth, primitive) and shaded only when they are asked for.
//!
//! Eight pixels share a group of rows, a column each, at least as many rows as the deepest of them has fragments, so
//! that eight lists are sorted at once. What is missing is [`NOTHING`], which sorts behind everything.

use super::arrivals::Arrivals;
use super::cover::Rect;
use super::interpolate::{LANES, Surface};
use super::network::{NOTHING, Row, sort_columns};
use super::pixels::Where;
use super::shade::{Paint, Premultiplied};
use super::tile::{Cover, Sink, pixel_at};
use crate::fragments::{Fragment, Lists};
use crate::order::sort_key;
use multiversion::multiversion;

/// Collects a tile's fragments in submission order.
#[derive(Default)]
pub struct TileLists<'a> {
    rect: Rect,
    budget: usize,
    /// Primitives that are to be looked at, and those that have been.
    expected: usize,
    visited: usize,
    /// The fragments as they came. The n-th primitive has the tile's own number n + 1.
    arrived: Arrivals,
    /// Of every primitive its id, its one colour, and its place in `varying` if it has several. The first is none: it
    /// is what [`NOTHING`] has the number of.
    primitives: Vec<u32>,
    flat: Vec<Premultiplied>,
    places: Vec<u32>,
    varying: Vec<(Surface<'a>, Paint)>,
    /// Whether anything can hide all that is behind it.
    any_covers: bool,
    counts: Vec<u32>,
    /// Depth in the upper half of a number, the primitive's number in the lower, so that the integers' order is
    /// that of (depth, primitive).
    rows: Vec<Row>,
    /// Group `g` has the rows `starts[g]..starts[g + 1]`.
    starts: Vec<usize>,
    cursors: Vec<u32>,
}

/// Runs of at least so many pixels on average go into rows as a whole: their ends cost less than one store per pixel.
const LONG: usize = 2 * LANES;

/// The place of a primitive that is not in `varying`.
const FLAT: u32 = u32::MAX;

impl TileLists<'_> {
    /// Pixels whose lists are kept together; batches begin and end at multiples of it.
    pub const GROUP: usize = LANES;

    /// Forgets everything and gets ready for the pixels of `rect` and so many primitives, as long as they have
    /// about `budget` fragments in all.
    pub fn begin(&mut self, rect: Rect, expected: usize, budget: usize) {
        self.rect = rect;
        self.expected = expected;
        self.visited = 0;
        self.budget = budget;
        self.arrived.clear();
        self.primitives.clear();
        self.primitives.push(0);
        self.flat.clear();
        self.flat.push([0.0; 4]);
        self.places.clear();
        self.places.push(FLAT);
        self.varying.clear();
        self.any_covers = false;
        self.counts.clear();
        self.counts.resize(rect.area(), 0);
    }

    /// Whether more fragments came than the budget allows; the lists are incomplete then. Where nearly all
    /// primitives have been looked at, twice as many are allowed: that costs less than to begin again with two halves.
    pub fn is_over_budget(&self) -> bool {
        let nearly_done = 4 * self.visited >= 3 * self.expected;
        self.arrived.fragments() > self.budget.saturating_mul(1 + usize::from(nearly_done))
    }

    /// Fragments per pixel.
    pub fn counts(&self) -> &[u32] {
        &self.counts
    }

    /// Distributes what arrived over the pixels, each pixel's in arrival order. In any order there may be gaps between
    /// them: no list may be looked at before it has been sorted.
    pub fn distribute(&mut self, any_order: bool) {
        if any_order && self.arrived.fragments() >= LONG * self.arrived.runs() {
            self.distribute_groups();
        } else {
            self.distribute_pixels();
        }
    }

    /// One fragment after the other, into as many rows as the deepest pixel of a group has.
    #[expect(clippy::cast_possible_truncation, reason = "2^32 places are 32 GiB")]
    fn distribute_pixels(&mut self) {
        self.starts.clear();
        self.starts.push(0);
        self.cursors.clear();
        let mut sum = 0;
        for counts in self.counts.chunks(LANES) {
            self.cursors.extend((0..counts.len()).map(|lane| (sum * LANES + lane) as u32));
            sum += counts.iter().max().map_or(0, |&deepest| deepest as usize);
            self.starts.push(sum);
        }
        self.make_room(sum);
        for ((counts, first), last) in self.counts.chunks(LANES).zip(&self.starts).zip(&self.starts[1..]) {
            let rows = &mut self.rows[*first..*last];
            for lane in 0..LANES {
                let count = counts.get(lane).map_or(0, |&n| n as usize);
                rows[count..].iter_mut().for_each(|row| row[lane] = NOTHING);
            }
        }
        let places = self.rows.as_flattened_mut();
        let cursors = &mut self.cursors;
        let mut put = |cursor: &mut u32, z, number| {
            places[*cursor as usize] = pack(z, number);
            *cursor += LANES as u32;
        };
        for (arrived, number) in self.arrived.iter().zip(1..) {
            let mut depth = arrived.depth;
            for run in arrived.runs {
                let (now, later) = depth.split_at(run.len as usize);
                depth = later;
                cursors[run.pixels()].iter_mut().zip(now).for_each(|(cursor, &z)| put(cursor, z, number));
            }
            for (&pixel, &z) in arrived.pixels.iter().zip(depth) {
                put(&mut cursors[pixel as usize], z, number);
            }
        }
    }

    /// Long runs, a row in each group that they touch: where a run ends, rows have pixels with nothing in them, which
    /// only sorting puts behind the others.
    #[expect(clippy::cast_possible_truncation, reason = "2^32 places are 32 GiB")]
    fn distribute_groups(&mut self) {
        let groups = self.counts.len().div_ceil(LANES);
        self.starts.clear();
        self.starts.resize(groups + 1, 0);
        for arrived in self.arrived.iter() {
            for run in arrived.runs {
                self.starts[run.groups()].iter_mut().for_each(|rows| *rows += 1);
            }
            arrived.pixels.iter().for_each(|&pixel| self.starts[pixel as usize / LANES] += 1);
        }
        let mut sum = 0;
        for start in &mut self.starts {
            sum += std::mem::replace(start, sum);
        }
        self.make_room(sum);
        self.cursors.clear();
        self.cursors.extend(self.starts.iter().map(|&start| start as u32));
        place_rows(&self.arrived, &mut self.cursors, &mut self.rows);
    }

    /// What is left of other tiles is written over, by fragments or by [`NOTHING`].
    fn make_room(&mut self, rows: usize) {
        if self.rows.len() < rows {
            self.rows.resize(rows, [NOTHING; LANES]);
        }
    }

    /// Sorts the fragments of pixels `first..last` by (depth, primitive).
    pub fn sort(&mut self, first: usize, last: usize) {
        sort_columns(&mut self.rows, &self.starts[first / LANES..=last.div_ceil(LANES)]);
    }

    /// The list of a pixel, in the order it is in.
    fn list(&self, pixel: usize) -> impl Iterator<Item = f64> {
        let (group, lane) = (pixel / LANES, pixel % LANES);
        let rows = &self.rows[self.starts[group]..][..self.counts[pixel] as usize];
        rows.iter().map(move |row| row[lane])
    }

    /// Shades the fragments of pixels `first..last` into `out`, in the order they are in.
    pub fn shade(&self, first: usize, last: usize, out: &mut Lists) {
        out.clear();
        for pixel in first..last {
            for packed in self.list(pixel) {
                let (depth, number) = unpack(packed);
                let [r, g, b, alpha] = self.color(number, pixel);
                let primitive = self.primitives[number];
                out.push(Fragment { depth, color: [r, g, b], alpha, primitive });
            }
            out.end_row();
        }
    }

    #[inline]
    fn color(&self, number: usize, pixel: usize) -> Premultiplied {
        match self.places[number] {
            FLAT => self.flat[number],
            place => self.shaded(place as usize, pixel),
        }
    }

    /// The rows of a group of pixels, each with a fragment of every pixel or [`NOTHING`].
    pub fn rows_of(&self, group: usize) -> &[Row] {
        &self.rows[self.starts[group]..self.starts[group + 1]]
    }

    /// Whether anything can hide all that is behind it.
    pub fn any_covers(&self) -> bool {
        self.any_covers
    }

    /// The colours of a row's fragments; transparent black where there are none.
    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    pub fn colors_of(&self, row: &Row, pixel: usize) -> [Premultiplied; LANES] {
        let mut colors = [[0.0; 4]; LANES];
        if self.varying.is_empty() {
            for lane in 0..LANES {
                colors[lane] = self.flat[unpack(row[lane]).1];
            }
        } else {
            for lane in 0..LANES {
                colors[lane] = self.color(unpack(row[lane]).1, pixel + lane);
            }
        }
        colors
    }

    #[cold]
    fn shaded(&self, place: usize, pixel: usize) -> Premultiplied {
        let (surface, paint) = &self.varying[place];
        let (x, y) = pixel_at(&self.rect, pixel);
        paint.at(&surface.at(x, y))
    }
}

/// Depth and primitive number as one number.
#[inline(always)]
#[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
fn pack(depth: f32, number: u32) -> f64 {
    f64::from_bits(sort_key(depth, number))
}

/// Depth and primitive number of a packed fragment; the number zero of [`NOTHING`].
#[inline(always)]
#[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
#[expect(clippy::cast_possible_truncation, reason = "the halves of the key")]
fn unpack(packed: f64) -> (f32, usize) {
    let key = packed.to_bits();
    (f32::from_bits((key >> 32) as u32), key as u32 as usize)
}

/// Writes each run into the next row of every group that it touches.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"))]
fn place_rows(arrivals: &Arrivals, cursors: &mut [u32], rows: &mut [Row]) {
    for (arrived, number) in arrivals.iter().zip(1..) {
        let mut depth = arrived.depth;
        for run in arrived.runs {
            let (now, later) = depth.split_at(run.len as usize);
            depth = later;
            place_run(run.first as usize % LANES, now, number, &mut cursors[run.groups()], rows);
        }
        for (&pixel, z) in arrived.pixels.iter().zip(depth.chunks(1)) {
            let pixel = pixel as usize;
            place_run(pixel % LANES, z, number, &mut cursors[pixel / LANES..=pixel / LANES], rows);
        }
    }
}

/// Writes a run of these depths, which begins at lane `lane` of its first group.
#[inline(always)]
#[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
fn place_run(mut lane: usize, mut depth: &[f32], number: u32, cursors: &mut [u32], rows: &mut [Row]) {
    for cursor in cursors {
        let row = &mut rows[*cursor as usize];
        *cursor += 1;
        if let (0, Some(whole)) = (lane, depth.first_chunk::<LANES>()) {
            for lane in 0..LANES {
                row[lane] = pack(whole[lane], number);
            }
            depth = &depth[LANES..];
        } else {
            let (now, later) = depth.split_at(depth.len().min(LANES - lane));
            *row = [NOTHING; LANES];
            for (place, &z) in row[lane..].iter_mut().zip(now) {
                *place = pack(z, number);
            }
            (depth, lane) = (later, 0);
        }
    }
}

impl<'r> Sink<'r> for TileLists<'r> {
    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    fn take(&mut self, cover: &Cover<'_, 'r>) -> bool {
        self.visited = cover.visited;
        match cover.at {
            Where::Few(_) => cover.at.for_each(|_, pixel| self.counts[pixel] += 1),
            Where::Many(runs) => {
                for run in runs {
                    self.counts[run.pixels()].iter_mut().for_each(|n| *n += 1);
                }
            }
        }
        self.arrived.push(cover);
        self.primitives.push(cover.primitive);
        match cover.paint {
            Paint::Flat(color) => {
                self.any_covers |= color[3] == 1.0;
                self.flat.push(*color);
                self.places.push(FLAT);
            }
            Paint::Varying(_) => {
                self.any_covers = true;
                self.flat.push([0.0; 4]);
                #[expect(clippy::cast_possible_truncation, reason = "primitives of one tile")]
                self.places.push(self.varying.len() as u32);
                self.varying.push((*cover.surface, *cover.paint));
            }
        }
        !self.is_over_budget()
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Order, Raster, Tile};
    use super::*;
    use crate::scene::{Camera, Colors, Material, Mesh, Projection, Scene};
    use glam::DVec3;
    use std::sync::Arc;

    /// Triangles of all sizes, seen straight on.
    fn scene() -> Scene {
        let random = |i: u32| f64::from(crate::random::hash32(i, 5, 0, 0, 0)) / f64::from(u32::MAX) - 0.5;
        let point = |i: u32| {
            let size = if (i / 3).is_multiple_of(3) { 0.4 } else { 5.0 };
            let (x, y) = (3.0 * random(i / 3), 3.0 * random(i / 3 + 1000));
            [x + size * random(3 * i), y + size * random(3 * i + 1), random(3 * i + 2)]
        };
        let faces = (0..40).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
        let colors = Colors::Face((0..40_u16).map(|i| [f32::from(i) / 40.0, 0.5, 0.2, 0.5]).collect());
        let mesh = Mesh::new((0..120).map(point).collect(), faces, colors, Material::default()).unwrap();
        let projection = Projection::Perspective { fov_y: 50.0 };
        let camera = Camera::new(DVec3::new(0.0, 0.0, 5.0), DVec3::ZERO, DVec3::Y, projection, 0.5, 9.0);
        Scene::new(vec![Arc::new(mesh)], camera.unwrap(), 45, 37, [0.0; 3]).unwrap()
    }

    #[test]
    fn whole_rows_and_single_fragments_come_to_the_same_lists() {
        let scene = scene();
        let raster = Raster::new(&scene, 64, &|| false);
        let (rect, stop) = (raster.rect(0, 0), || false);
        let (mut tile, mut lists) = (Tile::default(), TileLists::default());
        lists.begin(rect, 40, usize::MAX);
        tile.begin(&raster, (0, 0), rect, true, &stop);
        tile.transparent(&raster, (0, 0), Order::Submission, &mut lists, &stop);
        let sorted = |lists: &mut TileLists<'_>| {
            let mut out = Lists::new();
            lists.sort(0, rect.area());
            lists.shade(0, rect.area(), &mut out);
            out
        };
        lists.distribute_pixels();
        let pixels = sorted(&mut lists);
        lists.distribute_groups();
        let groups = sorted(&mut lists);
        assert!(pixels.len() > 2000 && lists.arrived.iter().any(|arrived| !arrived.pixels.is_empty()));
        assert_eq!((pixels.offsets, pixels.primitive), (groups.offsets, groups.primitive));
        assert_eq!((pixels.depth, pixels.color), (groups.depth, groups.color));
    }

    #[test]
    fn what_is_nearly_done_may_hold_twice_the_budget() {
        let mut lists = TileLists::default();
        let is_over = |lists: &mut TileLists<'_>, fragments, visited| {
            lists.begin(Rect { x0: 0, y0: 0, x1: 8, y1: 8 }, 4, 10);
            lists.arrived.resize(fragments);
            lists.visited = visited;
            lists.is_over_budget()
        };
        assert!(!is_over(&mut lists, 10, 0) && is_over(&mut lists, 11, 2));
        assert!(!is_over(&mut lists, 20, 3) && is_over(&mut lists, 21, 4));
    }
}
