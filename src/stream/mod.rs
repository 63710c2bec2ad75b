//! Techniques that are fed while the tile is rasterised: a state per pixel, no fragment is kept.

mod layers;
mod over_lists;
mod sums;
mod touched;

pub use layers::{TileBlend, TileOver};
pub use over_lists::over_lists;
pub use sums::{Cells, Strip, TileSums};

use crate::raster::{Cover, Paint, Premultiplied};
use crate::resolve::nanos_since;
use std::time::Instant;

/// Times one call in so many, and scales: reading the clock costs as much as a small triangle.
#[derive(Debug, Default)]
pub struct Stopwatch {
    calls: u64,
    timed: u64,
    nanos: u64,
    exact: u64,
}

impl Stopwatch {
    const TIMED: u64 = 64;

    /// To be handed to [`Stopwatch::stop`] when the work is done.
    fn start(&mut self) -> Option<Instant> {
        let is_timed = self.calls.is_multiple_of(Self::TIMED);
        self.calls += 1;
        is_timed.then(Instant::now)
    }

    fn stop(&mut self, start: Option<Instant>) {
        if let Some(start) = start {
            self.timed += 1;
            self.nanos += nanos_since(start);
        }
    }

    /// Adds the time of something that is timed always.
    fn add(&mut self, nanos: u64) {
        self.exact += nanos;
    }

    /// The time since the last look.
    fn take(&mut self) -> u64 {
        let Self { calls, timed, nanos, exact } = std::mem::take(self);
        exact + nanos * calls / timed.max(1)
    }
}

/// So many numbers, all with the same value.
fn reset<T: Copy>(numbers: &mut Vec<T>, len: usize, value: T) {
    // filling is several times as fast as growing
    numbers.resize(len, value);
    numbers.fill(value);
}

/// The colour of a primitive that has but one.
fn flat_color(cover: &Cover<'_, '_>) -> Option<Premultiplied> {
    match cover.paint {
        Paint::Flat(color) => Some(*color),
        Paint::Varying(_) => None,
    }
}

/// The colours of all pixels of a primitive, in their order.
fn shade(cover: &Cover<'_, '_>, colors: &mut Vec<Premultiplied>) {
    colors.clear();
    if let Some(color) = flat_color(cover) {
        return colors.resize(cover.pixels, color);
    }
    cover.at.for_each_position(|x, y| colors.push(cover.paint.at(&cover.surface.at(x, y))));
}
