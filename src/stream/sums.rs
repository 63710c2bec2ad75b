//! Blended techniques fed straight from the rasteriser: sums per pixel of a tile.
//!
//! The arithmetic per pixel is that of [`BlendSums::add`], operation by operation, so that a tile's sums have the
//! bits of the same fragments blended from a list. Techniques of one weight share their sums.
//!
//! [`BlendSums::add`]: crate::continuum::sums::BlendSums::add

mod aligned;
mod cells;
mod deferred;
mod kernels;
mod pending;
mod rows;
mod weigh;

use super::touched::Touched;
use super::{Stopwatch, flat_color, shade};
use crate::continuum::sums::{Behind, Blended, FAINT, SumsOf};
use crate::raster::{Cover, LANES, Opaque, Premultiplied, Rect, Sink, Where};
use crate::resolve::nanos_since;
use crate::technique::FinishedPixels;
use crate::weight::Weighting;
use aligned::Aligned;
pub use cells::{Cells, Strip};
use deferred::Deferred;
use kernels::{
    Places, add_constant, add_constant_to_few, add_few, add_flat, add_weighted, attenuate, blend_few,
    blend_flat, clear,
};
use pending::Pending;
use std::ops::Range;
use std::time::Instant;
use weigh::{Roomy, constant_term, weigh_flat, weigh_shaded};

/// The sums of all blended variants over a tile.
#[derive(Default)]
pub struct TileSums<'a> {
    /// Per variant: the technique, and which of the weights is its own.
    variants: Vec<(&'a dyn Blended, usize)>,
    weights: Vec<Weight<'a>>,
    sums: Sums,
    pending: Pending,
    /// What waits for weights of somebody's own.
    deferred: Deferred,
    rect: Rect,
    cells: Cells,
    kept: Kept,
    /// The colours of the primitive at hand, if it has several.
    colors: Vec<Premultiplied>,
    alpha: Vec<f32>,
    depth: Vec<f32>,
    /// The weights of its pixels, if it has but one colour ...
    flat_weights: Roomy,
    /// ... and if it has several, or of what waits.
    weight: Vec<f32>,
}

/// What there are sums for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
enum Kept {
    /// Nothing yet.
    #[default]
    Nothing,
    /// The pixels of every row that anything is in.
    Pixels,
    /// Every cell.
    Cells,
    /// The rows that were wanted last, from this pixel on: everything waits until then, so that sums never leave the
    /// first-level cache.
    Rows(usize),
}

/// A weight that some variants share.
#[derive(Default)]
struct Weight<'a> {
    /// All count the same where there is none.
    weighting: Option<&'a Weighting>,
    /// Results of a weight of somebody's own that were none, since the tile was begun.
    invalid: u64,
    stopwatch: Stopwatch,
    /// What it told when it was last looked at, for one of those that share the weight.
    nanos: u64,
}

impl Weight<'_> {
    fn is_own(&self) -> bool {
        self.weighting.is_some_and(Weighting::is_own)
    }
}

/// The running sums of a tile's pixels or cells.
#[derive(Default)]
struct Sums {
    /// Σ w (r, g, b, a) for every weight.
    weighted: Vec<Aligned<[f32; 4]>>,
    /// R, and 1 - R of faint fragments, which all weights share.
    transmittance: Aligned<f64>,
    coverage: Vec<f64>,
    counts: Aligned<u32>,
    /// Whether anything was added to `coverage`.
    faint: bool,
    /// The rows that anything is in, where sums are kept by pixels, ...
    touched: Touched,
    /// ... and those that have been cleared for it.
    cleared: Touched,
}

impl Sums {
    /// Sums for whoever clears them as they are [touched](Self::touch), or does not look at what was there before, as
    /// [`Pending::blend_rows`] and [`Pending::blend_cells`].
    fn make_room(&mut self, places: usize) {
        self.transmittance.make_room(places);
        self.counts.make_room(places);
        self.weighted.iter_mut().for_each(|sums| sums.make_room(places));
        self.clear_coverage(places);
    }

    /// No fragments in these rows, unless there have been sums of them before.
    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    fn touch(&mut self, rows: &Range<usize>, rect: &Rect) {
        self.touched.touch(rows);
        if !self.cleared.contains(self.touched) {
            self.clear_rows(rect);
        }
    }

    /// Several rows at a time: each by itself would take longer than the whole tile.
    fn clear_rows(&mut self, rect: &Rect) {
        let fresh = self.cleared.take_eighths(self.touched);
        for (rows, _) in fresh.stretches(rect.height()).filter(|(_, are_fresh)| *are_fresh) {
            let places = rows.start * rect.width()..rows.end * rect.width();
            clear(&mut self.transmittance[places.clone()], 1.0);
            clear(&mut self.counts[places.clone()], 0);
            self.weighted.iter_mut().for_each(|sums| clear(sums[places.clone()].as_flattened_mut(), 0.0));
        }
    }

    fn clear_coverage(&mut self, places: usize) {
        if self.faint {
            self.coverage.fill(0.0);
            self.faint = false;
        }
        // whole tiles follow parts of them, and what has grown once need not again
        if self.coverage.len() < places {
            self.coverage.resize(places, 0.0);
        }
    }
}

impl<'a> TileSums<'a> {
    /// Sums for these techniques.
    pub fn new(techniques: impl Iterator<Item = &'a dyn Blended>) -> Self {
        let mut all = Self::default();
        for technique in techniques {
            let weighting = technique.weighting();
            let same = |other: &Weight<'_>| match (other.weighting, weighting) {
                (None, None) => true,
                (Some(a), Some(b)) => a.is_same(b),
                _ => false,
            };
            let place = all.weights.iter().position(same).unwrap_or(all.weights.len());
            if place == all.weights.len() {
                all.weights.push(Weight { weighting, ..Weight::default() });
                all.sums.weighted.push(Aligned::default());
            }
            all.variants.push((technique, place));
        }
        all.pending = Pending::with_weights(all.weights.len());
        let own = all.weights.iter().filter(|weight| weight.is_own()).filter_map(|weight| weight.weighting);
        all.deferred = Deferred::of(own.map(Weighting::chunk).max());
        all
    }

    /// Begins with the pixels of `rect`.
    pub fn begin(&mut self, rect: Rect) {
        self.pending.begin(rect.height());
        self.deferred.clear();
        self.weights.iter_mut().for_each(|weight| weight.invalid = 0);
        self.rect = rect;
        self.kept = Kept::Nothing;
    }

    /// Has to come after the last primitive. `share` says whether pixels may share their sums: where the same is
    /// behind all of them. From here on there are either [cells](Self::cells), or pixels that have to be
    /// [reached](Self::reach) before they are counted and finished.
    pub fn flush(&mut self, share: bool) {
        if self.weights.is_empty() {
            return;
        }
        if self.kept != Kept::Nothing {
            self.flush_deferred();
            return self.flush_pending();
        }
        let start = Instant::now();
        self.pending.weigh(&mut self.weights, &mut self.weight);
        if share && self.pending.find_cells(&self.rect, &mut self.cells) {
            self.kept = Kept::Cells;
            self.sums.make_room(self.cells.room());
            self.pending.blend_cells(&self.cells, &mut self.sums);
        } else {
            self.kept = Kept::Rows(0);
        }
        self.spent(start);
    }

    /// Has to come before sums of these pixels, whole rows, are looked at, and may put an end to those of others.
    pub fn reach(&mut self, places: Range<usize>) {
        let columns = self.rect.width();
        let rows = places.start / columns..places.end / columns;
        match &mut self.kept {
            Kept::Rows(first) => {
                *first = places.start;
                self.sums.make_room(places.len());
                self.pending.blend_rows(rows, columns, &mut self.sums, true);
            }
            Kept::Pixels => self.sums.touch(&rows, &self.rect),
            Kept::Nothing | Kept::Cells => {}
        }
    }

    /// The tile's rows, neighbours together as long as there is something in them or nothing, and which it is.
    pub fn stretches(&self) -> impl Iterator<Item = (Range<usize>, bool)> + use<> {
        let rows = self.rect.height();
        let touched = if self.kept == Kept::Pixels { self.sums.touched } else { self.pending.touched(rows) };
        touched.without_gaps().stretches(rows)
    }

    /// Makes room for the sums of all pixels if there is none yet.
    #[inline]
    fn keep_sums(&mut self) {
        if self.kept == Kept::Nothing {
            self.kept = Kept::Pixels;
            self.sums.touched = Touched::none(self.rect.height());
            self.sums.cleared = self.sums.touched;
            self.sums.make_room(self.rect.area() + LANES);
        }
    }

    fn flush_pending(&mut self) {
        if !self.pending.is_empty() {
            self.keep_sums();
            let start = Instant::now();
            self.pending.weigh(&mut self.weights, &mut self.weight);
            for (rows, _) in
                self.pending.touched(self.rect.height()).stretches(self.rect.height()).filter(|(_, any)| *any)
            {
                self.sums.touch(&rows, &self.rect);
            }
            self.pending.blend_rows(0..self.rect.height(), self.rect.width(), &mut self.sums, false);
            self.pending.clear();
            self.spent(start);
        }
    }

    /// Time for all weights: alone, each would have to do about as much.
    fn spent(&mut self, start: Instant) {
        let share = nanos_since(start) / self.weights.len() as u64;
        self.weights.iter_mut().for_each(|weight| weight.stopwatch.add(share));
    }

    fn flush_deferred(&mut self) {
        if !self.deferred.is_empty() {
            self.deferred.blend(&mut self.weights, &mut self.sums.weighted, &mut self.weight);
        }
    }

    /// Results of the weight of variant `v` that were no weights, in this tile.
    pub fn invalid(&self, v: usize) -> u64 {
        self.weights[self.variants[v].1].invalid
    }

    /// The cells whose sums are kept in place of the pixels'.
    pub fn cells(&self) -> Option<&Cells> {
        (self.kept == Kept::Cells).then_some(&self.cells)
    }

    /// Fragments per pixel of some that were reached, or per pixel of a cell.
    pub fn counts(&self, places: Range<usize>) -> &[u32] {
        &self.sums.counts[self.indices(places)]
    }

    /// Where in the sums these pixels or cells are.
    fn indices(&self, places: Range<usize>) -> Range<usize> {
        let first = if let Kept::Rows(first) = self.kept { first } else { 0 };
        debug_assert!(places.start >= first, "{places:?} were not reached: {first}");
        places.start - first..places.end - first
    }

    /// Some pixels of variant `v`, or one of each of some cells.
    pub fn finish(&self, v: usize, places: Range<usize>, background: &Opaque, out: &mut FinishedPixels) {
        let (technique, place) = self.variants[v];
        let at = self.indices(places.clone());
        let colors = background.colors();
        let behind =
            if background.is_one_color() { Behind::One(colors[0]) } else { Behind::Each(&colors[places]) };
        let sums = SumsOf {
            weighted: &self.sums.weighted[place][at.clone()],
            transmittance: &self.sums.transmittance[at.clone()],
            coverage: &self.sums.coverage[at.clone()],
            counts: &self.sums.counts[at],
            background: behind,
        };
        technique.finish_all(&sums, out);
    }

    /// How long each variant took while rasterising, since the last look; variants of one weight share it.
    pub fn nanos(&mut self) -> impl Iterator<Item = u64> {
        for (place, weight) in self.weights.iter_mut().enumerate() {
            let sharers = self.variants.iter().filter(|(_, other)| *other == place).count();
            weight.nanos = weight.stopwatch.take() / sharers as u64;
        }
        self.variants.iter().map(|&(_, place)| self.weights[place].nanos)
    }
}

impl<'r> Sink<'r> for TileSums<'_> {
    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    fn take(&mut self, cover: &Cover<'_, 'r>) -> bool {
        match flat_color(cover) {
            Some(color)
                if self.is_constant(cover) && self.pending.may_take(cover.at, self.kept == Kept::Nothing) =>
            {
                self.keep(cover, color);
            }
            flat => {
                self.stop_waiting();
                self.keep_sums();
                self.sums.touch(&cover.at.rows(&self.rect), &self.rect);
                let fused = self.take_first(cover);
                self.blend(cover, flat, fused);
                if self.deferred.is_wanted() {
                    self.defer(cover, flat);
                }
            }
        }
        true
    }
}

impl TileSums<'_> {
    /// Whether a primitive of one colour has one weight everywhere, too.
    fn is_constant(&self, cover: &Cover<'_, '_>) -> bool {
        cover.constant_depth.is_some() || self.weights.iter().all(|weight| weight.weighting.is_none())
    }

    /// Blends what waits, since something comes that cannot.
    #[inline]
    fn stop_waiting(&mut self) {
        if !self.pending.is_empty() {
            self.pending.count_interruption();
            self.flush_pending();
        }
    }

    /// Keeps a primitive that is the same everywhere for later.
    fn keep(&mut self, cover: &Cover<'_, '_>, color: Premultiplied) {
        self.flush_deferred();
        self.pending.push(&self.rect, cover, color);
        if self.pending.is_full() {
            self.flush_pending();
        }
    }

    /// Keeps a primitive for weights of somebody's own.
    fn defer(&mut self, cover: &Cover<'_, '_>, flat: Option<Premultiplied>) {
        match flat {
            Some(color) => self.deferred.push_flat(cover, color),
            None => self.deferred.push_shaded(cover, &self.colors),
        }
        if self.deferred.is_full() {
            self.flush_deferred();
        }
    }

    /// Blends in a primitive of one colour whose depth varies: the background and the first weight in one go.
    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    fn take_first(&mut self, cover: &Cover<'_, '_>) -> bool {
        let (Some(color), None) = (flat_color(cover), cover.constant_depth) else {
            return false;
        };
        if !color.iter().all(|channel| channel.is_finite()) {
            // the kernels add zero times the colour to pixels beside it
            return false;
        }
        let Some(Weight { weighting: Some(weighting), stopwatch, .. }) = self.weights.first_mut() else {
            return false;
        };
        if weighting.is_own() {
            return false;
        }
        let start = stopwatch.start();
        let weights = &mut self.flat_weights;
        weigh_flat(weighting, cover, color[3], weights);
        let Sums { weighted, transmittance, counts, .. } = &mut self.sums;
        let sums = &mut weighted[0];
        match cover.at {
            Where::Few(pixels) => {
                blend_few(pixels.places(), weights.numbers(), color, Places { transmittance, counts, sums });
            }
            Where::Many(runs) => {
                blend_flat(runs, weights.with_room(), color, Places { transmittance, counts, sums });
            }
        }
        stopwatch.stop(start);
        self.cover_if_faint(cover, color[3].into());
        true
    }

    /// Blends in a primitive, or what [`TileSums::take_first`] has left of it.
    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    fn blend(&mut self, cover: &Cover<'_, '_>, flat: Option<Premultiplied>, fused: bool) {
        match flat {
            _ if fused => {}
            Some([.., alpha]) => self.attenuate_flat(cover, alpha),
            None => self.attenuate_shaded(cover),
        }
        let Self { weights, sums, colors, alpha, flat_weights, weight: numbers, depth, .. } = self;
        let left = weights.iter_mut().zip(&mut sums.weighted).skip(usize::from(fused));
        for (Weight { weighting, stopwatch, .. }, sums) in left.filter(|(weight, _)| !weight.is_own()) {
            let start = stopwatch.start();
            match (flat, *weighting, cover.constant_depth) {
                (Some(color), Some(weighting), None) => {
                    weigh_flat(weighting, cover, color[3], flat_weights);
                    let numbers = flat_weights.numbers();
                    match cover.at {
                        Where::Few(pixels) => add_few(pixels.places(), numbers, color, sums),
                        Where::Many(runs) => add_flat(runs, numbers, color, sums),
                    }
                }
                (Some(color), weighting, z) => {
                    let added = constant_term(weighting, z, color);
                    match cover.at {
                        Where::Few(pixels) => add_constant_to_few(pixels.places(), added, sums),
                        Where::Many(runs) => add_constant(runs, added, sums),
                    }
                }
                (None, weighting, _) => {
                    weigh_shaded(weighting, cover, alpha, depth, numbers);
                    cover.at.for_each(|n, i| add_weighted(numbers[n], colors[n], &mut sums[i]));
                }
            }
            stopwatch.stop(start);
        }
    }

    /// Adds to 1 - R what a primitive covers if it is faint.
    fn cover_if_faint(&mut self, cover: &Cover<'_, '_>, alpha: f64) {
        if alpha <= FAINT {
            self.sums.faint = true;
            kernels::cover_faintly(cover.at, alpha, &mut self.sums.coverage);
        }
    }

    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    fn attenuate_flat(&mut self, cover: &Cover<'_, '_>, alpha: f32) {
        let alpha = f64::from(alpha);
        let Sums { transmittance, counts, .. } = &mut self.sums;
        match cover.at {
            Where::Few(_) => cover.at.for_each(|_, i| {
                transmittance[i] *= 1.0 - alpha;
                counts[i] += 1;
            }),
            Where::Many(runs) => attenuate(runs, alpha, transmittance, counts),
        }
        self.cover_if_faint(cover, alpha);
    }

    /// Attenuates the background by a primitive whose colour varies, which stays in `colors`, its alpha in
    /// `alpha`.
    fn attenuate_shaded(&mut self, cover: &Cover<'_, '_>) {
        shade(cover, &mut self.colors);
        self.alpha.clear();
        self.alpha.extend(self.colors.iter().map(|color| color[3]));
        let Sums { transmittance, coverage, counts, faint, .. } = &mut self.sums;
        *faint = true;
        let alphas = &self.alpha;
        cover.at.for_each(|n, i| {
            let alpha = f64::from(alphas[n]);
            coverage[i] += (1.0 - coverage[i]) * if alpha <= FAINT { alpha } else { 0.0 };
            transmittance[i] *= 1.0 - alpha;
            counts[i] += 1;
        });
    }
}
