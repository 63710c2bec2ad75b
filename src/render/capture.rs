//! Rasterising into a fragment list that is kept.

use super::{Options, with_threads};
use crate::error::{Error, Result};
use crate::fragments::{Background, Fragments, Lists};
use crate::raster::{self, Raster, Rect, Tile};
use crate::scene::Scene;
use rayon::prelude::*;

/// The fragments of every pixel of `scene`. Rendering them gives the same bits as rendering the scene.
///
/// # Errors
/// [`Error::Cancelled`] once `stop` returns true.
pub fn capture(scene: &Scene, options: &Options, stop: &(dyn Fn() -> bool + Sync)) -> Result<Fragments> {
    with_threads(options.threads, |_| {
        let raster = Raster::new(scene, options.tile_size, stop);
        let bands: Vec<_> = (0..raster.rows()).into_par_iter().map(|row| band(&raster, row, stop)).collect();
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
            raster::view(scene),
            Some(raster::centroid_depths(scene)),
        ))
    })
}

/// One row of tiles: its lists and backgrounds, pixel row by pixel row.
fn band(raster: &Raster<'_>, row: usize, stop: &(dyn Fn() -> bool + Sync)) -> (Lists, Vec<[f32; 3]>) {
    let tiles: Vec<_> = (0..raster.columns())
        .into_par_iter()
        .map(|column| {
            let (mut tile, mut lists) = (Tile::default(), Lists::new());
            let pixels = raster.rect(column, row).area();
            if !(tile.begin(raster, column, row, stop) && tile.fill(raster, 0, pixels, &mut lists, stop)) {
                lists.reset_to(&vec![0; pixels + 1]);
            }
            (tile.rect(), lists, tile.background().to_vec())
        })
        .collect();
    interleave(&tiles)
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
