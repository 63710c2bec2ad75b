//! From tiles to pixels: each tile's transparent fragments go into sums, into lists or both, and from there
//! through the techniques.

use super::image::Patch;
use super::{Job, Tally};
use crate::fragments::Lists;
use crate::frame::Sample;
use crate::raster::{Cover, Raster, Rect, Sink, Tile, TileLists};
use crate::resolve::{Resolver, nanos_since};
use crate::stream::TileSums;
use crate::technique::{Batch, Resolved};
use std::time::Instant;

/// Fragments that are shaded, sorted and resolved at a time: few enough to stay in the cache.
const BATCH_FRAGMENTS: usize = 4096;

/// One thread's working memory.
pub(super) struct Worker<'r, 'v> {
    tile: Tile,
    lists: TileLists<'r>,
    sums: TileSums<'v>,
    arrived: Lists,
    sorted: Lists,
    resolver: Resolver,
    resolved: Vec<Vec<Resolved>>,
}

impl<'v> Worker<'_, 'v> {
    pub(super) fn new(job: &'v Job<'_>) -> Self {
        let streamed = job.streamed.iter().filter_map(|&v| job.variants[v].streamed());
        Self {
            tile: Tile::default(),
            lists: TileLists::default(),
            sums: TileSums::new(streamed),
            arrived: Lists::new(),
            sorted: Lists::new(),
            resolver: Resolver::default(),
            resolved: vec![Vec::new(); job.variants.len()],
        }
    }
}

/// Lists, sums or both, whichever the variants want.
struct Collector<'a, 'r, 'v> {
    lists: Option<&'a mut TileLists<'r>>,
    sums: Option<&'a mut TileSums<'v>>,
}

impl<'r> Sink<'r> for Collector<'_, 'r, '_> {
    fn take(&mut self, cover: &Cover<'_, 'r>) -> bool {
        self.sums.as_mut().is_none_or(|sums| sums.take(cover))
            && self.lists.as_mut().is_none_or(|lists| lists.take(cover))
    }
}

impl Job<'_> {
    /// One tile's pixels.
    pub(super) fn tile<'r, S: Sample>(
        &self,
        raster: &'r Raster<'_>,
        tile: (usize, usize),
        patch: &mut Patch<'_, S>,
        worker: &mut Worker<'r, '_>,
    ) -> Tally {
        let mut tally = Tally::new(self.variants.len());
        let rect = patch.rect();
        if self.options.skip && raster.is_empty_tile(tile.0, tile.1) {
            tally.empty_tiles = 1;
            tally.empty_pixels = rect.area() as u64;
            patch.clear(raster.background());
        } else {
            self.part(raster, tile, rect, worker, patch, &mut tally);
        }
        tally
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
    ) {
        let start = Instant::now();
        let Worker { tile: drawn, lists, sums, .. } = worker;
        if !drawn.begin(raster, tile, rect, self.stop) {
            return;
        }
        let budget = if rect.area() > 1 { self.options.max_fragments } else { usize::MAX };
        let (streams, lists_wanted) = (!self.streamed.is_empty(), !self.listed.is_empty());
        if streams {
            sums.begin(rect);
        }
        if lists_wanted {
            lists.begin(rect, budget);
        }
        let mut collector =
            Collector { lists: lists_wanted.then_some(&mut *lists), sums: streams.then_some(&mut *sums) };
        let finished = drawn.transparent(raster, tile, &mut collector, self.stop);
        if lists_wanted && lists.is_over_budget() {
            for half in rect.halves() {
                self.part(raster, tile, half, worker, patch, tally);
            }
            return;
        }
        if !finished {
            return;
        }
        tally.occluded_fragments += drawn.occluded();
        let counts = if lists_wanted { lists.counts() } else { sums.counts() };
        counts.iter().for_each(|&n| tally.count(n as usize));
        if lists_wanted {
            lists.distribute();
        }
        tally.raster_nanos += nanos_since(start);
        self.finish_sums(&rect, worker, patch, tally);
        self.resolve_lists(rect, worker, patch, tally);
    }

    fn finish_sums<S: Sample>(
        &self,
        rect: &Rect,
        worker: &mut Worker<'_, '_>,
        patch: &mut Patch<'_, S>,
        tally: &mut Tally,
    ) {
        let Worker { tile, sums, resolved, .. } = worker;
        for (i, &v) in self.streamed.iter().enumerate() {
            let (nanos, streaming) = sums.finish(i, tile.background(), &mut resolved[v]);
            tally.variants[v].nanos += nanos;
            tally.streaming_nanos += streaming;
            patch.store(v, rect, 0, &resolved[v]);
        }
    }

    /// Resolves the tile's lists in batches that fit the cache.
    fn resolve_lists<S: Sample>(
        &self,
        rect: Rect,
        worker: &mut Worker<'_, '_>,
        patch: &mut Patch<'_, S>,
        tally: &mut Tally,
    ) {
        if self.listed.is_empty() {
            return;
        }
        let Worker { tile, lists, arrived, sorted, resolver, resolved, .. } = worker;
        let of_listed = |wants: fn(&crate::resolve::Variant) -> bool| {
            self.listed.iter().any(|&v| wants(&self.variants[v]))
        };
        let wants_arrival = of_listed(|variant| !variant.takes_sorted_alone());
        let wants_sorted = of_listed(|variant| variant.wants_sorted() || variant.takes_sorted_alone());
        let mut first = 0;
        while first < rect.area() {
            let last = super::part_end(first, rect.area(), BATCH_FRAGMENTS, |i| lists.counts()[i] as usize);
            if wants_arrival {
                lists.shade(first, last, arrived);
            }
            let start = Instant::now();
            if wants_sorted {
                lists.sort(first, last);
                lists.shade(first, last, sorted);
            }
            let sort_nanos = nanos_since(start);
            #[expect(
                clippy::cast_sign_loss,
                clippy::cast_possible_truncation,
                reason = "pixels of the image"
            )]
            let batch = Batch {
                x: rect.x0 as u32,
                y: rect.y0 as u32,
                width: rect.width() as u32,
                first: first as u32,
                lists: if wants_arrival { arrived.as_ref() } else { sorted.as_ref() },
                sorted: wants_sorted.then(|| sorted.as_ref()),
                background: &tile.background()[first..last],
            };
            resolver.run(&self.context(&self.listed), &batch, sort_nanos, resolved, &mut tally.variants);
            for &v in &self.listed {
                patch.store(v, &rect, first, &resolved[v]);
            }
            first = last;
        }
    }
}
