//! Rasterising into a fragment list that is kept.

use super::Options;
use crate::error::{Error, Result};
use crate::fragments::{Background, Fragments, Lists};
use crate::raster::{self, Order, Raster, Rect, Tile, TileLists};
use crate::scene::Scene;
use crate::threads::with_threads;
use rayon::prelude::*;

/// The fragments of every pixel of `scene`. Rendering them gives the same bits as rendering the scene.
///
/// # Errors
/// [`Error::Cancelled`] once `stop` returns true.
pub fn capture(scene: &Scene, options: &Options, stop: &(dyn Fn() -> bool + Sync)) -> Result<Fragments> {
    with_threads(options.threads, |_| {
        let raster = Raster::new(scene, options.tile_size, stop);
        let bands: Vec<_> = (0..raster.rows()).into_par_iter().map(|row| band(&raster, row, stop)).collect();
        let centroid_depths = raster::centroid_depths(scene, stop);
        if stop() {
            return Err(Error::Cancelled);
        }
        let mut lists = Lists::new();
        let mut background = Vec::new();
        for (rows, colors) in bands {
            lists.append(&rows);
            background.extend(colors);
        }
        Ok(Fragments::captured(
            scene.width(),
            scene.height(),
            lists,
            Background::Image(background),
            raster.view(),
            Some(centroid_depths),
        ))
    })
}

/// One row of tiles: its lists and backgrounds, pixel row by pixel row.
fn band(raster: &Raster<'_>, row: usize, stop: &(dyn Fn() -> bool + Sync)) -> (Lists, Vec<[f32; 3]>) {
    let columns = (0..raster.columns()).into_par_iter();
    interleave(&columns.map(|column| tile(raster, (column, row), stop)).collect::<Vec<_>>())
}

/// One tile; without fragments when stopped on the way.
pub(super) fn tile(
    raster: &Raster<'_>,
    place: (usize, usize),
    stop: &(dyn Fn() -> bool + Sync),
) -> (Rect, Lists, Vec<[f32; 3]>) {
    let rect = raster.rect(place.0, place.1);
    let (mut tile, mut collected, mut lists) = (Tile::default(), TileLists::default(), Lists::new());
    collected.begin(rect, 0, usize::MAX);
    if tile.begin(raster, place, rect, true, stop)
        && tile.transparent(raster, place, Order::Submission, &mut collected, stop)
    {
        collected.distribute(false);
        collected.shade(0, rect.area(), &mut lists);
    } else {
        lists = Lists::empty_rows(rect.area());
    }
    (rect, lists, tile.background().colors().to_vec())
}

fn interleave(tiles: &[(Rect, Lists, Vec<[f32; 3]>)]) -> (Lists, Vec<[f32; 3]>) {
    let (mut lists, mut background) = (Lists::new(), Vec::new());
    let height = tiles.first().map_or(0, |(rect, ..)| rect.height());
    for y in 0..height {
        for (rect, tile_lists, colors) in tiles {
            let pixels = y * rect.width()..(y + 1) * rect.width();
            background.extend_from_slice(&colors[pixels.clone()]);
            lists.append_rows(tile_lists.as_ref().rows(pixels.start, pixels.end));
        }
    }
    (lists, background)
}
