//! What a transparency technique is: a function from a pixel's fragment list to a colour, with an entry in
//! the registry that says what it is called, what it costs and what it promises.

use crate::continuum::sums::Blended;
use crate::diagnosis::{Diagnosis, Faults};
use crate::error::Result;
use crate::format::Target;
use crate::fragments::{List, ListsRef};
use crate::gpu::form::MakeForm;
use crate::params::{ParamSpec, Params, View};
use glam::DVec3;
use std::ops::Range;

/// One pixel as a technique sees it.
#[derive(Debug, Clone, Copy)]
pub struct Pixel<'a> {
    /// Column, from the left.
    pub x: u32,
    /// Row, from the top.
    pub y: u32,
    /// The fragments in submission order.
    pub list: List<'a>,
    /// The same fragments by (depth, primitive), nearest first; empty unless the technique asks for it with
    /// [`Technique::NEEDS_SORTED`].
    pub sorted: List<'a>,
    /// The opaque colour behind them.
    pub background: DVec3,
}

/// What a technique makes of a pixel.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Resolved {
    /// Linear colour, background included.
    pub color: DVec3,
    /// The background's share in it, per channel.
    pub transmittance: DVec3,
    /// Fragments that the technique's storage had no room for.
    pub dropped: u64,
}

/// A pixel of a technique that keeps every fragment and attenuates all channels alike: linear colour, background
/// included, and the background's share.
pub type Finished = [f64; 4];

/// Finished pixels, channel by channel: so they are made and stored many at a time.
#[derive(Debug, Default)]
pub struct FinishedPixels {
    /// Channels with room for as many as there ever were.
    planes: [Vec<f64>; 4],
    len: usize,
}

impl FinishedPixels {
    /// So many, each still to be written.
    pub fn resize(&mut self, pixels: usize) {
        if self.planes[0].len() < pixels {
            self.planes.iter_mut().for_each(|plane| plane.resize(pixels, 0.0));
        }
        self.len = pixels;
    }
    /// How many there are.
    pub fn len(&self) -> usize {
        self.len
    }
    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }
    /// One channel after the other of some of them.
    pub fn planes(&self, pixels: Range<usize>) -> [&[f64]; 4] {
        let [r, g, b, share] = &self.planes;
        [&r[pixels.clone()], &g[pixels.clone()], &b[pixels.clone()], &share[pixels]]
    }
    /// One channel after the other of all, to be written.
    pub fn planes_mut(&mut self) -> [&mut [f64]; 4] {
        let ([r, g, b, share], len) = (&mut self.planes, self.len);
        [&mut r[..len], &mut g[..len], &mut b[..len], &mut share[..len]]
    }
    /// Writes one pixel.
    pub fn set(&mut self, i: usize, pixel: Finished) {
        self.planes.iter_mut().zip(pixel).for_each(|(plane, channel)| plane[i] = channel);
    }
}

impl Resolved {
    /// A colour over which the background shows with the same share in every channel.
    pub fn new(color: DVec3, transmittance: f64) -> Self {
        Self { color, transmittance: DVec3::splat(transmittance), dropped: 0 }
    }
    /// A pixel without fragments.
    pub fn background(background: DVec3) -> Self {
        Self::new(background, 1.0)
    }
}

/// How deep an image is: what some techniques' cost depends on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DepthComplexity {
    /// Mean number of fragments per pixel, empty pixels included.
    pub mean: f64,
    /// Largest number of fragments in a pixel.
    pub max: usize,
}

/// What a streaming GPU implementation of a technique would need (sheet 1.2).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cost {
    /// Times the transparent geometry is drawn.
    pub geometry_passes: f64,
    /// The technique's own state, in bytes per pixel.
    pub bytes_per_pixel: f64,
}

impl Cost {
    /// One pass into a list of `layers` nodes of so many bytes, and `more` bytes besides.
    #[expect(clippy::cast_precision_loss, reason = "a cost estimate")]
    pub fn list(layers: usize, node: f64, more: f64) -> Self {
        Self { geometry_passes: 1.0, bytes_per_pixel: node * layers as f64 + more }
    }
}

/// What a technique promises under its params; tests check every claim.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Properties {
    /// The image does not depend on submission order, beyond the rounding of float sums. Where an
    /// ill-conditioned reconstruction follows (moments of near-coincident depths), that rounding may be seen.
    pub order_independent: bool,
    /// The expected image is the exact one.
    pub unbiased: bool,
    /// The error tends to zero as the technique's size parameter grows.
    pub consistent: bool,
    /// A pixel with one fragment is exact, if the fragment covers anything.
    pub exact_for_one: bool,
    /// A pixel whose fragments share one unmultiplied colour is exact.
    pub exact_for_one_color: bool,
    /// The background's share is exactly the product of the fragments' 1 - alpha.
    pub exact_coverage: bool,
}

impl Properties {
    /// No promise at all; name the promises with struct update syntax.
    pub const NONE: Self = Self {
        order_independent: false,
        unbiased: false,
        consistent: false,
        exact_for_one: false,
        exact_for_one_color: false,
        exact_coverage: false,
    };
    /// The reference and what equals it.
    pub const EXACT: Self = Self {
        order_independent: true,
        unbiased: true,
        consistent: true,
        exact_for_one: true,
        exact_for_one_color: true,
        exact_coverage: true,
    };
}

/// What a technique is if it can be fed fragment by fragment.
#[derive(Clone, Copy)]
pub enum Streamed<'a> {
    /// Sums over all fragments.
    Sums(&'a dyn Blended),
    /// Front-to-back compositing of sorted fragments in double precision (sheet 0.1): to be fed front to back.
    Over,
    /// `dst ← C + (1 − a) dst` in single precision, in submission order.
    Blend,
}

/// A transparency technique with its params bound.
pub trait Technique: Send + Sync + 'static {
    /// Working memory, made once per batch of pixels.
    type Scratch: Default;

    /// Whether [`Pixel::sorted`] is wanted.
    const NEEDS_SORTED: bool = false;
    /// Whether [`Pixel::list`] is wanted in submission order; if not, it may come sorted.
    const NEEDS_ARRIVAL: bool = true;
    /// Whether fragments that neither cover nor emit are shown to the technique too (a published defect that
    /// two techniques reproduce, sheet 0.1).
    const SEES_ZERO_FRAGMENTS: bool = false;
    /// Whether the background is attenuated per channel.
    const COLORED_TRANSMITTANCE: bool = false;

    /// The pixel's colour. `pixel.list` holds at least one fragment.
    fn resolve(&self, pixel: &Pixel<'_>, scratch: &mut Self::Scratch) -> Resolved;

    /// What the technique is if it can be fed fragment by fragment; then none need be kept for it.
    fn streamed(&self) -> Option<Streamed<'_>> {
        None
    }

    /// The technique's own transmittance strictly in front of each depth, if it reconstructs one. The exact
    /// function is the product of 1 - alpha over the fragments with a smaller depth.
    fn transmittance(
        &self,
        _pixel: &Pixel<'_>,
        _depths: &[f32],
        _scratch: &mut Self::Scratch,
    ) -> Option<Vec<f64>> {
        None
    }

    /// What can go wrong with the technique's numbers, as far as it is looked for.
    fn faults(&self) -> Faults {
        Faults::NONE
    }

    /// What went wrong with them at a pixel that holds at least one fragment: asked for by those who want to know, and
    /// free to compute everything once more.
    fn diagnose(&self, _pixel: &Pixel<'_>, _scratch: &mut Self::Scratch) -> Diagnosis {
        Diagnosis::CLEAR
    }

    /// The modelled cost on an image of this depth complexity.
    fn cost(&self, complexity: &DepthComplexity) -> Cost;

    /// The promises under the bound params.
    fn properties(&self) -> Properties;
}

/// Pixels that are resolved together: a run of pixels, row by row, of a rectangle of the image.
#[derive(Debug, Clone, Copy)]
pub struct Batch<'a> {
    /// Column of the rectangle's first pixel.
    pub x: u32,
    /// Row of the rectangle's first pixel.
    pub y: u32,
    /// Pixels per row of the rectangle.
    pub width: u32,
    /// The rectangle's pixel with which the batch begins.
    pub first: u32,
    /// Fragments in submission order.
    pub lists: ListsRef<'a>,
    /// Fragments nearest first, where somebody asked for them.
    pub sorted: Option<ListsRef<'a>>,
    /// The opaque colour behind each pixel.
    pub background: &'a [[f32; 3]],
}

impl<'a> Batch<'a> {
    /// The colour behind pixel `i`.
    pub fn background(&self, i: usize) -> DVec3 {
        glam::Vec3::from(self.background[i]).as_dvec3()
    }
    /// Pixel `i` of the batch.
    #[expect(clippy::cast_possible_truncation, reason = "batches are at most MAX_SIZE squared")]
    pub fn pixel(&self, i: usize) -> Pixel<'a> {
        let place = self.first + i as u32;
        Pixel {
            x: self.x + place % self.width,
            y: self.y + place / self.width,
            list: self.lists.row(i),
            sorted: self.sorted.map(|lists| lists.row(i)).unwrap_or_default(),
            background: self.background(i),
        }
    }
}

/// A technique behind a pointer: one dynamic call per batch, none per fragment.
pub trait AnyTechnique: Send + Sync {
    /// See [`Technique::NEEDS_SORTED`].
    fn needs_sorted(&self) -> bool;
    /// See [`Technique::NEEDS_ARRIVAL`].
    fn needs_arrival(&self) -> bool;
    /// See [`Technique::streamed`].
    fn streamed(&self) -> Option<Streamed<'_>>;
    /// See [`Technique::SEES_ZERO_FRAGMENTS`].
    fn sees_zero_fragments(&self) -> bool;
    /// See [`Technique::COLORED_TRANSMITTANCE`].
    fn colored_transmittance(&self) -> bool;
    /// Whether it is called with as many pixels as there are at a time, rather than with what fits the cache: a
    /// call then costs more than the cache saves.
    fn wants_large_batches(&self) -> bool {
        false
    }
    /// See [`Technique::transmittance`].
    fn transmittance(&self, pixel: &Pixel<'_>, depths: &[f32]) -> Option<Vec<f64>>;
    /// The same, of a technique that can fail.
    ///
    /// # Errors
    /// Only those of a technique that was made outside of the core.
    fn try_transmittance(&self, pixel: &Pixel<'_>, depths: &[f32]) -> Result<Option<Vec<f64>>> {
        Ok(self.transmittance(pixel, depths))
    }
    /// See [`Technique::faults`].
    fn faults(&self) -> Faults;
    /// See [`Technique::diagnose`].
    fn diagnose(&self, pixel: &Pixel<'_>) -> Diagnosis;
    /// See [`Technique::cost`].
    fn cost(&self, complexity: &DepthComplexity) -> Cost;
    /// See [`Technique::properties`].
    fn properties(&self) -> Properties;
    /// Resolves the listed pixels of `batch` into `out`, until `stop` says so.
    ///
    /// # Errors
    /// Only those of a technique that was made outside of the core.
    fn resolve_batch(
        &self,
        batch: &Batch<'_>,
        pixels: &[u32],
        out: &mut [Resolved],
        stop: &dyn Fn() -> bool,
    ) -> Result<()>;
}

impl<T: Technique> AnyTechnique for T {
    fn needs_sorted(&self) -> bool {
        T::NEEDS_SORTED
    }
    fn needs_arrival(&self) -> bool {
        T::NEEDS_ARRIVAL
    }
    fn streamed(&self) -> Option<Streamed<'_>> {
        Technique::streamed(self)
    }
    fn sees_zero_fragments(&self) -> bool {
        T::SEES_ZERO_FRAGMENTS
    }
    fn colored_transmittance(&self) -> bool {
        T::COLORED_TRANSMITTANCE
    }
    fn transmittance(&self, pixel: &Pixel<'_>, depths: &[f32]) -> Option<Vec<f64>> {
        Technique::transmittance(self, pixel, depths, &mut T::Scratch::default())
    }
    fn faults(&self) -> Faults {
        Technique::faults(self)
    }
    fn diagnose(&self, pixel: &Pixel<'_>) -> Diagnosis {
        Technique::diagnose(self, pixel, &mut T::Scratch::default())
    }
    fn cost(&self, complexity: &DepthComplexity) -> Cost {
        Technique::cost(self, complexity)
    }
    fn properties(&self) -> Properties {
        Technique::properties(self)
    }
    fn resolve_batch(
        &self,
        batch: &Batch<'_>,
        pixels: &[u32],
        out: &mut [Resolved],
        stop: &dyn Fn() -> bool,
    ) -> Result<()> {
        let mut scratch = T::Scratch::default();
        for (n, &i) in pixels.iter().enumerate() {
            if n % 64 == 0 && stop() {
                break;
            }
            out[i as usize] = self.resolve(&batch.pixel(i as usize), &mut scratch);
        }
        Ok(())
    }
}

/// A technique's row in Wyman's Table 1 (W16), in the paper's words.
#[derive(Debug, Clone, Copy)]
pub struct Axes {
    /// What is stored per pixel.
    pub memory: &'static str,
    /// When a fragment is inserted.
    pub insertion: &'static str,
    /// What happens when there is no room.
    pub merge: &'static str,
    /// How what was lost is made good.
    pub normalize: &'static str,
    /// Continuous alpha or coverage mask.
    pub opacity: &'static str,
}

/// A technique's entry in the registry.
pub struct Info {
    /// The name users write.
    pub id: &'static str,
    /// Other names for it.
    pub aliases: &'static [&'static str],
    /// The name in the literature.
    pub name: &'static str,
    /// Keys into `references.bib`, the original source first.
    pub citation: &'static [&'static str],
    /// What it does, in a sentence or two.
    pub doc: &'static str,
    /// Its place in the continuum.
    pub axes: Axes,
    /// Its own parameters.
    pub params: &'static [ParamSpec],
    /// What it stores per pixel: its formats can be chosen.
    pub targets: &'static [Target],
    /// The submission orders it can be asked for, the default first.
    pub submission_orders: &'static [&'static str],
    /// Whether it draws random numbers.
    pub random: bool,
    /// Geometry passes as a formula.
    pub geometry_passes: &'static str,
    /// Bytes per pixel as a formula.
    pub bytes_per_pixel: &'static str,
    /// Makes the technique.
    pub build: fn(&Params, &View) -> Result<Box<dyn AnyTechnique>>,
    /// Makes its form on a GPU, if it has one.
    pub gpu: Option<MakeForm>,
}

impl Info {
    /// The backends that can render it in this build.
    pub fn backends(&self) -> &'static [&'static str] {
        if cfg!(feature = "gpu") && self.gpu.is_some() { &["cpu", "gpu"] } else { &["cpu"] }
    }
}
