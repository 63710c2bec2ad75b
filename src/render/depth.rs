//! Images of depth alone: the nearest fragment and the number of fragments of every pixel.

use super::{Options, Source};
use crate::error::{Error, Result};
use crate::raster::{Cover, Order, Raster, Rect, Sink, Tile};
use crate::scene::Scene;
use crate::threads::{Workers, with_threads};
use rayon::prelude::*;

/// What is known of a pixel's fragments without looking at their colours.
#[derive(Debug, Clone, PartialEq)]
pub struct DepthImages {
    /// Depth of the nearest fragment; infinite where there is none.
    pub first_depth: Vec<f32>,
    /// Number of fragments.
    pub fragment_count: Vec<u32>,
}

/// The depth images of a source.
///
/// # Errors
/// [`Error::Cancelled`] once `stop` returns true.
pub fn depth_images(
    source: Source<'_>,
    options: &Options,
    stop: &(dyn Fn() -> bool + Sync),
) -> Result<DepthImages> {
    with_threads(options.threads, |_| match source {
        Source::Scene(scene) => of_scene(scene, options, stop),
        Source::Fragments(fragments) => {
            let rows = fragments.lists.as_ref();
            let pixels = 0..rows.len();
            let first = |i| rows.row(i).depth_bounds().map_or(f32::INFINITY, |(first, _)| first);
            #[expect(clippy::cast_possible_truncation, reason = "a pixel's list is far shorter than 2^32")]
            let count = |i| rows.count(i) as u32;
            Ok(DepthImages {
                first_depth: pixels.clone().into_par_iter().map(first).collect(),
                fragment_count: pixels.into_par_iter().map(count).collect(),
            })
        }
    })
}

/// The depth images of one tile.
#[derive(Default)]
struct TileDepth {
    first_depth: Vec<f32>,
    fragment_count: Vec<u32>,
}

impl<'r> Sink<'r> for TileDepth {
    fn take(&mut self, cover: &Cover<'_, 'r>) -> bool {
        cover.at.for_each(|n, pixel| {
            let depth = cover.constant_depth.unwrap_or_else(|| cover.depth[n]);
            self.first_depth[pixel] = self.first_depth[pixel].min(depth);
            self.fragment_count[pixel] += 1;
        });
        true
    }
}

fn of_scene(scene: &Scene, options: &Options, stop: &(dyn Fn() -> bool + Sync)) -> Result<DepthImages> {
    let raster = Raster::new(scene, options.tile_size, stop);
    let workers = Workers::new(Tile::default);
    let tiles: Vec<(Rect, TileDepth)> = (0..raster.rows() * raster.columns())
        .into_par_iter()
        .map_init(|| workers.lend(), |lent, i| tile_depth(&raster, i, lent.get(), stop))
        .collect();
    if stop() {
        return Err(Error::Cancelled);
    }
    let width = scene.width() as usize;
    let pixels = width * scene.height() as usize;
    let mut images = DepthImages { first_depth: vec![0.0; pixels], fragment_count: vec![0; pixels] };
    for (rect, depth) in &tiles {
        for row in 0..rect.height() {
            #[expect(clippy::cast_sign_loss, reason = "tiles lie in the image")]
            let to = (rect.y0 as usize + row) * width + rect.x0 as usize;
            let (to, from) = (to..to + rect.width(), row * rect.width()..(row + 1) * rect.width());
            images.first_depth[to.clone()].copy_from_slice(&depth.first_depth[from.clone()]);
            images.fragment_count[to].copy_from_slice(&depth.fragment_count[from]);
        }
    }
    Ok(images)
}

fn tile_depth(raster: &Raster<'_>, i: usize, tile: &mut Tile, stop: &dyn Fn() -> bool) -> (Rect, TileDepth) {
    let place = (i % raster.columns(), i / raster.columns());
    let rect = raster.rect(place.0, place.1);
    let mut depth =
        TileDepth { first_depth: vec![f32::INFINITY; rect.area()], fragment_count: vec![0; rect.area()] };
    if tile.begin(raster, place, rect, true, stop) {
        tile.transparent(raster, place, Order::Submission, &mut depth, stop);
    }
    (rect, depth)
}
