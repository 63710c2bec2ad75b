//! What a tile's primitives cover, kept as it comes: runs or single pixels, and their depths.

use super::pixels::Where;
use super::runs::Run;
use super::tile::Cover;

/// The primitives of a tile in the order in which they came.
#[derive(Debug, Default)]
pub struct Arrivals {
    shares: Vec<Share>,
    runs: Vec<Run>,
    /// The pixels of small primitives, which have no runs.
    pixels: Vec<u32>,
    depth: Vec<f32>,
}

/// How much of the runs, the pixels and the depths is one primitive's.
#[derive(Debug, Clone, Copy)]
struct Share {
    runs: usize,
    pixels: usize,
    fragments: usize,
}

/// One primitive's fragments: in runs if it has any, in pixels otherwise.
#[derive(Debug, Clone, Copy)]
pub struct Arrived<'a> {
    pub runs: &'a [Run],
    pub pixels: &'a [u32],
    pub depth: &'a [f32],
}

impl Arrived<'_> {
    /// The fragments' pixels as indices in the tile.
    pub fn places(&self) -> impl Iterator<Item = usize> {
        let pixels = self.pixels.iter().map(|&pixel| pixel as usize);
        pixels.chain(self.runs.iter().flat_map(|run| run.pixels()))
    }
}

impl Arrivals {
    /// Forgets everything.
    pub fn clear(&mut self) {
        self.shares.clear();
        self.runs.clear();
        self.pixels.clear();
        self.depth.clear();
    }

    /// The number of fragments.
    pub fn fragments(&self) -> usize {
        self.depth.len()
    }

    /// The depths of all fragments.
    pub fn depth(&self) -> &[f32] {
        &self.depth
    }

    /// The number of runs, a single pixel counted as one.
    pub fn runs(&self) -> usize {
        self.runs.len() + self.pixels.len()
    }

    /// Keeps a primitive's fragments.
    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    pub fn push(&mut self, cover: &Cover<'_, '_>) {
        let mut share = Share { runs: 0, pixels: 0, fragments: cover.pixels };
        match cover.at {
            Where::Few(pixels) => {
                share.pixels = cover.pixels;
                self.pixels.extend_from_slice(pixels.places());
            }
            Where::Many(runs) => {
                share.runs = runs.len();
                self.runs.extend_from_slice(runs);
            }
        }
        self.shares.push(share);
        match cover.constant_depth {
            Some(depth) => self.depth.resize(self.depth.len() + cover.pixels, depth),
            None => self.depth.extend_from_slice(&cover.depth[..cover.pixels]),
        }
    }

    /// So many fragments, of whatever depth.
    #[cfg(test)]
    pub fn resize(&mut self, fragments: usize) {
        self.depth.resize(fragments, 1.0);
    }

    /// The primitives one by one.
    pub fn iter(&self) -> impl Iterator<Item = Arrived<'_>> {
        let (mut runs, mut pixels, mut depth) = (&self.runs[..], &self.pixels[..], &self.depth[..]);
        self.shares.iter().map(move |share| Arrived {
            runs: take(&mut runs, share.runs),
            pixels: take(&mut pixels, share.pixels),
            depth: take(&mut depth, share.fragments),
        })
    }
}

/// Takes so much from the front of a slice.
#[inline]
fn take<'s, T>(slice: &mut &'s [T], len: usize) -> &'s [T] {
    let (now, later) = slice.split_at(len);
    *slice = later;
    now
}
