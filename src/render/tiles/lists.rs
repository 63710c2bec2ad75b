//! From a tile's lists to pixels.

use super::super::part_end;
use super::{Job, Patch, Tally, Worker};
use crate::error::Result;
use crate::fragments::Lists;
use crate::frame::Sample;
use crate::raster::{Rect, TileLists};
use crate::resolve::nanos_since;
use crate::technique::Batch;
use std::ops::Range;
use std::time::Instant;

/// Fragments that are shaded, sorted and resolved at a time: few enough to stay in the cache.
const BATCH_FRAGMENTS: usize = 4096;
/// Groups of pixels that are resolved at a time, at most.
const MOST_GROUPS: usize = BATCH_FRAGMENTS / TileLists::GROUP;
/// Groups of pixels without fragments that are worth leaving out, one after the other.
const EMPTY_GROUPS: usize = 8;

/// Neighbouring groups of pixels that are resolved at a time, or have no fragments.
struct Groups {
    count: usize,
    are_empty: bool,
}

impl Groups {
    /// As many from one on as fit the cache, up to a number without fragments; or those without, if these `may_skip`. `groups`
    /// has the fragments of each.
    fn from(next: usize, groups: &[u32], may_skip: bool) -> Self {
        let rest = &groups[next..];
        let rest = &rest[..rest.len().min(MOST_GROUPS)];
        if !may_skip {
            return Self {
                count: part_end(0, rest.len(), BATCH_FRAGMENTS, |i| rest[i] as usize),
                are_empty: false,
            };
        }
        let empty = rest.iter().take_while(|fragments| **fragments == 0).count();
        if empty >= EMPTY_GROUPS {
            return Self { count: empty, are_empty: true };
        }
        let count = part_end(0, rest.len(), BATCH_FRAGMENTS, |i| rest[i] as usize);
        let is_empty = |groups: &[u32]| groups.iter().all(|fragments| *fragments == 0);
        let some = rest[..count].windows(EMPTY_GROUPS).position(is_empty);
        Self { count: some.unwrap_or(count), are_empty: false }
    }

    fn pixels(&self, first: usize, area: usize) -> Range<usize> {
        first * TileLists::GROUP..((first + self.count) * TileLists::GROUP).min(area)
    }
}

impl Job<'_> {
    /// Resolves the tile's lists in batches that fit the cache, and all at once where a variant wants that.
    pub(super) fn resolve_lists<S: Sample>(
        &self,
        rect: &Rect,
        worker: &mut Worker<'_, '_>,
        patch: &mut Patch<'_, S>,
        tally: &mut Tally,
    ) -> Result<()> {
        if self.plan.listed.is_empty() {
            return Ok(());
        }
        let Worker { tile, lists, arrived, sorted, whole, resolver, resolved, .. } = worker;
        let colors = tile.background().colors();
        let listed = || self.from_lists.iter().chain(&self.from_tiles).map(|&v| &self.variants[v]);
        let wants_arrival = listed().any(|variant| !variant.takes_sorted_alone());
        let wants_sorted = listed().any(|variant| variant.wants_sorted() || variant.takes_sorted_alone());
        let mut resolve =
            |patch: &mut Patch<'_, S>, variants: &[usize], of: [&Lists; 2], pixels: Range<usize>, nanos| {
                let [arrived, sorted] = of;
                let first = pixels.start;
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
                    background: &colors[pixels],
                };
                resolver.run(&self.context(variants), &batch, nanos, resolved, &mut tally.variants)?;
                for &v in variants {
                    patch.store(v, rect, first, &resolved[v]);
                }
                Ok(())
            };
        whole.iter_mut().for_each(Lists::clear);
        let mut all_sort_nanos = 0;
        let may_skip = self.options.skip && tile.background().is_one_color() && self.from_tiles.is_empty();
        let groups: Vec<_> =
            lists.counts().chunks(TileLists::GROUP).map(|group| group.iter().sum()).collect();
        let mut next = 0;
        while next < groups.len() {
            let batch = Groups::from(next, &groups, may_skip);
            let pixels = batch.pixels(next, rect.area());
            let (first, last) = (pixels.start, pixels.end);
            next += batch.count;
            if batch.are_empty {
                for &v in &self.from_lists {
                    patch.clear_part(v, rect, pixels.clone(), colors[first]);
                }
                continue;
            }
            if wants_arrival {
                lists.shade(first, last, arrived);
            }
            let start = Instant::now();
            if wants_sorted {
                lists.sort(first, last);
                lists.shade(first, last, sorted);
            }
            let sort_nanos = nanos_since(start);
            if !self.from_lists.is_empty() {
                resolve(patch, &self.from_lists, [arrived, sorted], pixels, sort_nanos)?;
            }
            if !self.from_tiles.is_empty() {
                all_sort_nanos += sort_nanos;
                whole.iter_mut().zip([&*arrived, &*sorted]).for_each(|(all, part)| all.append(part));
            }
        }
        if !self.from_tiles.is_empty() {
            resolve(patch, &self.from_tiles, [&whole[0], &whole[1]], 0..rect.area(), all_sort_nanos)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cut(groups: &[u32], may_skip: bool) -> Vec<(usize, bool)> {
        let (mut next, mut all) = (0, Vec::new());
        while next < groups.len() {
            let Groups { count, are_empty } = Groups::from(next, groups, may_skip);
            all.push((count, are_empty));
            next += count;
        }
        all
    }

    #[test]
    fn batches_end_where_nothing_begins() {
        let mut groups = vec![0; 20];
        assert_eq!(cut(&groups, true), [(20, true)]);
        assert_eq!(cut(&groups, false), [(20, false)]);
        groups[3] = 7;
        groups[11] = 1; // seven without between them
        assert_eq!(cut(&groups, true), [(12, false), (8, true)]);
        groups[12] = 5000; // more than are resolved at a time
        assert_eq!(cut(&groups, true), [(12, false), (1, false), (7, false)]);
        groups[2..].fill(0);
        groups[9] = 4000;
        groups[10] = 97;
        assert_eq!(cut(&groups, true), [(9, true), (1, false), (1, false), (9, true)]);
        assert_eq!(cut(&[], true), []);
        let many = vec![0; MOST_GROUPS + 3];
        assert_eq!(cut(&many, false), [(MOST_GROUPS, false), (3, false)]);
    }
}
