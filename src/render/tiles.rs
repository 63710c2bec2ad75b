//! From tiles to pixels: each tile's transparent fragments go into running states, into lists or both, and from
//! there through the techniques.

use super::Job;
mod lists;

use super::image::Patch;
use super::tally::Tally;
use crate::error::Result;
use crate::fragments::Lists;
use crate::frame::Sample;
use crate::raster::{Cover, Order, Raster, Rect, Sink, Tile, TileLists};
use crate::resolve::{Resolver, nanos_since};
use crate::stream::{TileBlend, TileOver, TileSums, over_lists};
use crate::technique::{FinishedPixels, Resolved, Streamed};
use std::ops::Range;
use std::time::Instant;

/// Pixels that are finished at a time.
const BATCH_PIXELS: usize = 256;

/// One thread's working memory.
pub(super) struct Worker<'r, 'v> {
    tile: Tile,
    lists: TileLists<'r>,
    sums: TileSums<'v>,
    blend: TileBlend,
    painter: TileBlend,
    over: TileOver,
    arrived: Lists,
    sorted: Lists,
    /// The same two of a whole tile.
    whole: [Lists; 2],
    resolver: Resolver,
    resolved: Vec<Vec<Resolved>>,
    /// Pixels on their way into the image.
    pixels: FinishedPixels,
}

impl<'v> Worker<'_, 'v> {
    pub(super) fn new(job: &'v Job<'_>) -> Self {
        let sums = job.plan.sums.iter().filter_map(|&v| match job.variants[v].streamed() {
            Some((Streamed::Sums(technique), _)) => Some(technique),
            _ => None,
        });
        Self {
            tile: Tile::default(),
            lists: TileLists::default(),
            sums: TileSums::new(sums),
            blend: TileBlend::default(),
            painter: TileBlend::default(),
            over: TileOver::default(),
            arrived: Lists::new(),
            sorted: Lists::new(),
            whole: [Lists::new(), Lists::new()],
            resolver: Resolver::default(),
            resolved: vec![Vec::new(); job.variants.len()],
            pixels: FinishedPixels::default(),
        }
    }
}

/// What is wanted in submission order.
struct Collector<'a, 'r, 'v> {
    lists: Option<&'a mut TileLists<'r>>,
    sums: Option<&'a mut TileSums<'v>>,
    blend: Option<&'a mut TileBlend>,
}

impl<'r> Sink<'r> for Collector<'_, 'r, '_> {
    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    fn take(&mut self, cover: &Cover<'_, 'r>) -> bool {
        self.sums.as_mut().is_none_or(|sums| sums.take(cover))
            && self.blend.as_mut().is_none_or(|blend| blend.take(cover))
            && self.lists.as_mut().is_none_or(|lists| lists.take(cover))
    }
}

/// What a part of a tile came to.
enum Drawn {
    /// Everything is where it belongs; whether there are lists, whether `over` was fed, and whether the fragments are
    /// counted.
    Done { lists: bool, over: bool, counted: bool },
    /// The lists are too long to be kept.
    TooDeep,
    /// The user does not want it any more.
    Stopped,
}

impl Job<'_> {
    /// One tile's pixels.
    pub(super) fn tile<'r, S: Sample>(
        &self,
        raster: &'r Raster<'_>,
        tile: (usize, usize),
        patch: &mut Patch<'_, S>,
        worker: &mut Worker<'r, '_>,
        tally: &mut Tally,
    ) -> Result<()> {
        self.part(raster, tile, patch.rect(), worker, patch, tally)
    }

    /// A part of a tile: as it is or, if it is too deep for the budget, in halves.
    fn part<'r, S: Sample>(
        &self,
        raster: &'r Raster<'_>,
        tile: (usize, usize),
        rect: Rect,
        worker: &mut Worker<'r, '_>,
        patch: &mut Patch<'_, S>,
        tally: &mut Tally,
    ) -> Result<()> {
        let start = Instant::now();
        match self.draw(raster, tile, rect, worker, tally) {
            Drawn::Stopped => {}
            Drawn::TooDeep => {
                for half in rect.halves() {
                    self.part(raster, tile, half, worker, patch, tally)?;
                }
            }
            Drawn::Done { lists, over, counted } => {
                if lists {
                    // `over` alone gets them sorted
                    worker.lists.distribute(self.plan.listed.is_empty());
                }
                tally.raster_nanos += nanos_since(start);
                self.finish_sums(&rect, counted, worker, patch, tally);
                self.finish_streamed(&rect, over, worker, patch, tally);
                if lists && !self.plan.overs.is_empty() {
                    self.finish_over(&rect, worker, patch, tally);
                }
                self.resolve_lists(&rect, worker, patch, tally)?;
            }
        }
        Ok(())
    }

    /// Rasterises a part of a tile, once for each order that is wanted.
    fn draw<'r>(
        &self,
        raster: &'r Raster<'_>,
        tile: (usize, usize),
        rect: Rect,
        worker: &mut Worker<'r, '_>,
        tally: &mut Tally,
    ) -> Drawn {
        let (plan, stop) = (&self.plan, self.stop);
        let Worker { tile: drawn, lists, sums, blend, painter, over, .. } = worker;
        if !drawn.begin(raster, tile, rect, self.options.skip, stop) {
            return Drawn::Stopped;
        }
        // layers of one colour look the same in any order, so that it need not be found
        let order = match () {
            () if plan.overs.is_empty() || !plan.listed.is_empty() || !self.options.skip => None,
            () if raster.is_one_color(tile) => Some(Order::Submission),
            () if drawn.is_layered(raster, tile) => Some(Order::FrontToBack),
            () => None,
        };
        let over_wanted = order.is_some();
        let lists_wanted = !plan.listed.is_empty() || (!plan.overs.is_empty() && !over_wanted);
        let mut finished = true;
        let mut occluded = None;
        if lists_wanted || !plan.sums.is_empty() || !plan.blends.is_empty() {
            let mut collector = Collector {
                lists: lists_wanted.then_some(&mut *lists),
                sums: (!plan.sums.is_empty()).then_some(&mut *sums),
                blend: (!plan.blends.is_empty()).then_some(&mut *blend),
            };
            let budget = if rect.area() > 1 { self.options.max_fragments } else { usize::MAX };
            collector.begin(rect, raster.transparent_primitives(tile), budget);
            finished = match &mut collector {
                Collector { lists: Some(lists), sums: None, blend: None } => {
                    drawn.transparent(raster, tile, Order::Submission, *lists, stop)
                }
                Collector { lists: None, sums: Some(sums), blend: None } => {
                    drawn.transparent(raster, tile, Order::Submission, *sums, stop)
                }
                all => drawn.transparent(raster, tile, Order::Submission, all, stop),
            };
            sums.flush(self.options.skip && drawn.background().is_one_color());
            if lists_wanted && lists.is_over_budget() {
                return Drawn::TooDeep;
            }
            occluded = Some(drawn.occluded());
        }
        if !plan.painters.is_empty() {
            painter.begin(rect);
            finished &= drawn.transparent(raster, tile, Order::BackToFront, painter, stop);
        }
        if let Some(order) = order {
            over.begin(rect, self.options.skip);
            finished &= drawn.transparent(raster, tile, order, over, stop);
            let tiles = if order == Order::Submission {
                &mut tally.one_color_tiles
            } else {
                &mut tally.layered_tiles
            };
            *tiles += 1;
        }
        if !finished {
            return Drawn::Stopped;
        }
        tally.occluded.add(occluded.unwrap_or(drawn.occluded()));
        let counts = match () {
            () if lists_wanted => Some(lists.counts()),
            () if over_wanted => Some(over.counts()),
            () if !plan.blends.is_empty() => Some(blend.counts()),
            () if !plan.painters.is_empty() => Some(painter.counts()),
            () => None,
        };
        if let Some(counts) = counts {
            tally.count(counts);
        }
        Drawn::Done { lists: lists_wanted, over: over_wanted, counted: counts.is_some() }
    }

    /// Stores what sums came to, and counts their fragments unless that has been done.
    fn finish_sums<S: Sample>(
        &self,
        rect: &Rect,
        counted: bool,
        worker: &mut Worker<'_, '_>,
        patch: &mut Patch<'_, S>,
        tally: &mut Tally,
    ) {
        let plan = &self.plan;
        if plan.sums.is_empty() {
            return;
        }
        let Worker { tile, sums, pixels, .. } = worker;
        let background = tile.background();
        for (i, &v) in plan.sums.iter().enumerate() {
            tally.variants[v].invalid_weights += sums.invalid(i);
        }
        plan.sums.iter().zip(sums.nanos()).for_each(|(&v, nanos)| tally.streamed(v, nanos));
        let mut laps = Laps::of(plan.sums.len());
        if let Some(cells) = sums.cells() {
            let all = 0..cells.count();
            tally.repeated_pixels += (rect.area() - all.end) as u64;
            if !counted {
                tally.count_cells(sums.counts(all.clone()), cells.pixels());
            }
            for (i, &v) in plan.sums.iter().enumerate() {
                sums.finish(i, all.clone(), background, pixels);
                patch.fill(v, rect, cells, pixels);
                tally.variants[v].nanos += laps.lap();
            }
        } else {
            let columns = rect.width();
            let whole_rows = (BATCH_PIXELS / columns).max(1) * columns;
            let may_skip = self.options.skip && background.is_one_color();
            for (rows, any) in sums.stretches() {
                let places = rows.start * columns..rows.end * columns;
                if may_skip && !any {
                    if !counted {
                        tally.empty_pixels += places.len() as u64;
                    }
                    for &v in &plan.sums {
                        patch.clear_part(v, rect, places.clone(), background.colors()[0]);
                        tally.variants[v].nanos += laps.lap();
                    }
                    continue;
                }
                for first in places.clone().step_by(whole_rows) {
                    let batch = first..(first + whole_rows).min(places.end);
                    sums.reach(batch.clone());
                    if !counted {
                        tally.count(sums.counts(batch.clone()));
                    }
                    let share = laps.lap() / plan.sums.len() as u64;
                    for (i, &v) in plan.sums.iter().enumerate() {
                        sums.finish(i, batch.clone(), background, pixels);
                        patch.store_finished(v, rect, first, pixels);
                        tally.variants[v].nanos += share + laps.lap();
                    }
                }
            }
        }
        tally.variants[plan.sums[0]].nanos += laps.rest();
    }

    /// Stores what else was fed while rasterising.
    fn finish_streamed<S: Sample>(
        &self,
        rect: &Rect,
        over_fed: bool,
        worker: &mut Worker<'_, '_>,
        patch: &mut Patch<'_, S>,
        tally: &mut Tally,
    ) {
        let plan = &self.plan;
        let Worker { tile, blend, painter, over, pixels, .. } = worker;
        let background = tile.background();
        for (variants, target) in [(&plan.blends, blend), (&plan.painters, painter)] {
            let nanos = target.nanos() / variants.len().max(1) as u64;
            for &v in variants {
                store(v, rect, patch, tally, pixels, |range, out| target.finish(range, background, out));
                tally.streamed(v, nanos);
            }
        }
        let nanos = over.nanos() / plan.overs.len().max(1) as u64;
        for &v in plan.overs.iter().filter(|_| over_fed) {
            store(v, rect, patch, tally, pixels, |range, out| over.finish(range, background, out));
            tally.streamed(v, nanos);
            tally.variants[v].hidden_fragments += over.hidden();
        }
    }

    /// Composites sorted lists front to back.
    fn finish_over<S: Sample>(
        &self,
        rect: &Rect,
        worker: &mut Worker<'_, '_>,
        patch: &mut Patch<'_, S>,
        tally: &mut Tally,
    ) {
        if !self.plan.listed.is_empty() {
            return; // with the others, from their sorted lists
        }
        let Worker { tile, lists, pixels, .. } = worker;
        let mut hidden = 0;
        for (n, &v) in self.plan.overs.iter().enumerate() {
            store(v, rect, patch, tally, pixels, |range, out| {
                if n == 0 {
                    lists.sort(range.start, range.end);
                }
                hidden += over_lists(lists, range, tile.background().colors(), self.options.skip, out);
            });
            tally.variants[v].hidden_fragments += std::mem::take(&mut hidden);
        }
    }
}

impl Collector<'_, '_, '_> {
    fn begin(&mut self, rect: Rect, primitives: usize, budget: usize) {
        if let Some(lists) = &mut self.lists {
            lists.begin(rect, primitives, budget);
        }
        if let Some(sums) = &mut self.sums {
            sums.begin(rect);
        }
        if let Some(blend) = &mut self.blend {
            blend.begin(rect);
        }
    }
}

/// Makes and stores the pixels of variant `v`, a batch at a time.
fn store<S: Sample>(
    v: usize,
    rect: &Rect,
    patch: &mut Patch<'_, S>,
    tally: &mut Tally,
    pixels: &mut FinishedPixels,
    mut finish: impl FnMut(Range<usize>, &mut FinishedPixels),
) {
    let start = Instant::now();
    for first in (0..rect.area()).step_by(BATCH_PIXELS) {
        finish(first..(first + BATCH_PIXELS).min(rect.area()), pixels);
        patch.store_finished(v, rect, first, pixels);
    }
    tally.variants[v].nanos += nanos_since(start);
}

/// A clock that tells the time of several variants apart. Of one alone it is read once, at the end: each reading takes as
/// long as some fifty pixels.
struct Laps {
    last: Instant,
    several: bool,
}

impl Laps {
    fn of(variants: usize) -> Self {
        Self { last: Instant::now(), several: variants > 1 }
    }

    /// The time since the last reading, where there are several variants.
    fn lap(&mut self) -> u64 {
        if self.several { self.rest() } else { 0 }
    }

    /// All the time since the last reading.
    fn rest(&mut self) -> u64 {
        let now = Instant::now();
        let nanos = now.duration_since(std::mem::replace(&mut self.last, now)).as_nanos();
        u64::try_from(nanos).unwrap_or(u64::MAX)
    }
}
