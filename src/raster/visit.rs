//! The transparent primitives of a tile in another order than that of submission.

use super::Raster;
use super::chunk::{Chunk, Primitive, batches};

/// An order in which a tile's primitives can be had.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Order {
    /// As they were submitted.
    Submission,
    /// Whole primitives by the view depth of their centroid, farthest first, the larger id first on ties
    /// (sheet 0.4).
    BackToFront,
    /// By their nearest depth, the smaller id first on ties.
    FrontToBack,
}

/// A primitive and where to find it.
#[derive(Debug, Clone, Copy)]
struct Visit {
    depth: f64,
    /// Its place in submission order: ids ascend with it.
    number: u32,
    chunk: u32,
    entry: u32,
}

/// The primitives of one tile, arranged; keep it and its memory is reused.
#[derive(Debug, Default)]
pub struct Visits(Vec<Visit>);

/// Tiles of no more primitives than these are looked at for a common order, whatever they are.
const FEW: usize = 32;

impl Visits {
    /// Puts the tile's primitives into the given order.
    pub fn arrange(&mut self, raster: &Raster<'_>, tile: (usize, usize), order: Order) {
        match order {
            Order::Submission => self.collect(raster, tile, |_| 0.0),
            Order::BackToFront => {
                let depth = |primitive: &Primitive<'_>| primitive.centroid_depth();
                self.collect(raster, tile, depth);
                self.0.sort_unstable_by(|a, b| b.depth.total_cmp(&a.depth).then(b.number.cmp(&a.number)));
            }
            Order::FrontToBack => {
                self.collect(raster, tile, |primitive| primitive.depth_range().0.into());
                self.0.sort_unstable_by(|a, b| a.depth.total_cmp(&b.depth).then(a.number.cmp(&b.number)));
            }
        }
    }

    /// Whether each primitive, taken as a whole, is in front of those that follow it front to back.
    pub fn front_to_back(&mut self, raster: &Raster<'_>, tile: (usize, usize)) -> bool {
        let face_the_camera = raster.transparent_in(tile).all(|(chunk, _)| chunk.faces_camera);
        if !face_the_camera && raster.transparent_in(tile).map(|(_, count)| count).sum::<usize>() > FEW {
            return false;
        }
        self.arrange(raster, tile, Order::FrontToBack);
        let mut reached = (f32::NEG_INFINITY, 0);
        self.iter(raster).all(|(number, _, primitive)| {
            let (nearest, farthest) = primitive.depth_range();
            let behind = reached.0 < nearest || (reached.0 == nearest && reached.1 < number);
            reached = if farthest >= reached.0 { (farthest, number) } else { reached };
            behind
        })
    }

    /// The primitives in the order they were put into, with their place in submission order.
    pub fn iter<'a>(
        &'a self,
        raster: &'a Raster<'_>,
    ) -> impl Iterator<Item = (u32, &'a Chunk, Primitive<'a>)> {
        self.0.iter().map(|visit| {
            let chunk = &raster.transparent[visit.chunk as usize];
            (visit.number, chunk, chunk.primitive(visit.entry))
        })
    }

    #[expect(clippy::cast_possible_truncation, reason = "fewer primitives than u32 has numbers")]
    fn collect(&mut self, raster: &Raster<'_>, tile: (usize, usize), key: impl Fn(&Primitive<'_>) -> f64) {
        self.0.clear();
        for (index, chunk, entries) in batches(&raster.transparent, tile.1 * raster.columns() + tile.0) {
            for &entry in entries {
                let depth = key(&chunk.primitive(entry));
                self.0.push(Visit { depth, number: self.0.len() as u32, chunk: index as u32, entry });
            }
        }
    }
}
