//! The opaque surfaces of a tile: what lies behind its transparent fragments, and what they hide.

use super::interpolate::Hit;
use super::shade::Paint;
use crate::order::sort_key;

/// The key of a pixel without an opaque surface.
const NOTHING: u64 = u64::MAX;

/// The nearest opaque surface of every pixel of a tile.
#[derive(Debug, Default)]
pub struct Opaque {
    /// (depth, primitive) per pixel; empty while nothing is drawn.
    keys: Vec<u64>,
    colors: Vec<[f32; 3]>,
    pixels: usize,
    /// The nearest and the farthest depth of all pixels; infinite where there is none.
    nearest: f32,
    farthest: f32,
}

impl Opaque {
    /// Nothing but the background, so many times.
    pub fn begin(&mut self, pixels: usize, background: [f32; 3]) {
        let untouched =
            self.keys.is_empty() && self.pixels == pixels && self.colors.first() == Some(&background);
        self.pixels = pixels;
        self.keys.clear();
        if !untouched {
            self.colors.clear();
            self.colors.resize(pixels, background);
        }
        (self.nearest, self.farthest) = (f32::INFINITY, f32::INFINITY);
    }

    /// Has to come before the first pixel is drawn.
    pub fn make_room(&mut self) {
        self.keys.resize(self.pixels, NOTHING);
    }

    /// Draws a surface's pixel.
    pub fn draw(&mut self, i: usize, hit: &Hit, primitive: u32, paint: &Paint) {
        let key = sort_key(hit.depth, primitive);
        if key < self.keys[i] && paint.passes(hit) {
            let [r, g, b, _] = paint.at(hit);
            self.keys[i] = key;
            self.colors[i] = [r, g, b];
        }
    }

    /// Has to come after the last pixel. `skip` says whether whole primitives may be told hidden by the depths
    /// of all pixels together.
    pub fn finish(&mut self, skip: bool) {
        if self.keys.is_empty() {
            return;
        }
        let (first, last) = self.keys.iter().fold((NOTHING, 0), |(a, b), &key| (a.min(key), b.max(key)));
        self.nearest = depth(first);
        self.farthest = if skip { depth(last) } else { f32::INFINITY };
    }

    /// The colour behind each pixel.
    pub fn colors(&self) -> &[[f32; 3]] {
        &self.colors
    }
    /// The depth of the surface in each pixel, infinite where there is none; empty where there is none at all.
    pub fn depths(&self) -> impl Iterator<Item = f32> {
        self.keys.iter().map(|&key| depth(key))
    }
    /// Whether they are one colour, since no opaque surface is among them.
    pub fn is_one_color(&self) -> bool {
        !self.is_any()
    }
    /// Whether there is any opaque surface.
    pub fn is_any(&self) -> bool {
        !self.keys.is_empty()
    }
    /// Whether everything from this depth on is hidden in all pixels.
    pub fn hides_all(&self, nearest: f32) -> bool {
        nearest > self.farthest
    }
    /// Whether something up to this depth may be hidden in some pixel.
    pub fn may_hide(&self, farthest: f32) -> bool {
        farthest > self.nearest
    }
    /// Whether a fragment of this depth is hidden at pixel `i`.
    pub fn hides(&self, i: usize, z: f32) -> bool {
        z > depth(self.keys[i])
    }
}

/// Depth of the surface of this key; infinite where there is none.
fn depth(key: u64) -> f32 {
    if key == NOTHING { f32::INFINITY } else { f32::from_bits((key >> 32) as u32) }
}
