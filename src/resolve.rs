//! Runs techniques over batches of pixels: hands each the fragments it should see, in the order it should see
//! them, and answers pixels itself where the answer is provably the technique's own.

use crate::fragments::{Lists, ListsRef};
use crate::order::{CentroidOrder, Reorderer, SubmissionOrder, without_zero_fragments};
use crate::params::Params;
use crate::technique::{AnyTechnique, Batch, Info, Resolved};
use glam::{DVec3, Vec3};
use std::time::Instant;

/// A technique with its params, ready to run.
pub struct Variant {
    /// Its registry entry.
    pub info: &'static Info,
    /// Its params, resolved.
    pub params: Params,
    /// The technique itself.
    pub technique: Box<dyn AnyTechnique>,
    /// The order in which it gets the fragments.
    pub order: SubmissionOrder,
}

impl Variant {
    fn wants_sorted(&self) -> bool {
        self.technique.needs_sorted() || self.order == SubmissionOrder::Sorted
    }
}

/// What one variant did on some pixels.
#[derive(Debug, Clone, Copy, Default)]
pub struct VariantTally {
    /// Time spent, over all threads.
    pub nanos: u64,
    /// Fragments that did not fit into the technique's storage.
    pub dropped: u64,
    /// Pixels of one fragment that were composited directly.
    pub single_fragment_pixels: u64,
}

/// Resolves batches for a fixed set of variants; keep it and its memory is reused.
#[derive(Default)]
pub struct Resolver {
    reorderer: Reorderer,
    kept: Lists,
    sorted: Lists,
    sorted_with_zeros: Lists,
    reordered: Lists,
    pixels: Vec<u32>,
}

/// What was done for several variants at once.
struct Prepared {
    has_zeros: bool,
    sort_nanos: u64,
    sort_with_zeros_nanos: u64,
}

impl Prepared {
    /// The time that `variant` would have spent on it alone.
    fn nanos_for(&self, variant: &Variant) -> u64 {
        match (variant.wants_sorted(), self.has_zeros && variant.technique.sees_zero_fragments()) {
            (false, _) => 0,
            (true, false) => self.sort_nanos,
            (true, true) => self.sort_with_zeros_nanos,
        }
    }
}

/// What all batches of a render have in common.
#[derive(Clone, Copy)]
pub struct Context<'a> {
    /// The techniques to run.
    pub variants: &'a [Variant],
    /// The primitives by centroid, where a variant asks for that order.
    pub centroids: Option<&'a CentroidOrder>,
    /// Whether shortcuts may be taken.
    pub skip: bool,
    /// Says whether to stop.
    pub stop: &'a (dyn Fn() -> bool + Sync),
}

impl Resolver {
    /// Resolves `batch` with every variant: `out[v][i]` is pixel `i` under variant `v`.
    pub fn run(
        &mut self,
        context: &Context<'_>,
        batch: &Batch<'_>,
        out: &mut [Vec<Resolved>],
        tallies: &mut [VariantTally],
    ) {
        let shared = self.prepare(context.variants, batch.lists);
        for ((variant, out), tally) in context.variants.iter().zip(out).zip(tallies) {
            let start = Instant::now();
            out.clear();
            out.extend((0..batch.lists.len()).map(|i| Resolved::background(batch.background(i))));
            self.run_variant(context, variant, batch, shared.has_zeros, out, tally);
            tally.nanos += nanos_since(start) + shared.nanos_for(variant);
            tally.dropped += out.iter().map(|r| r.dropped).sum::<u64>();
        }
    }

    /// The transmittance function that `variant` reconstructs at the one pixel of `batch`, if it does.
    pub fn transmittance(
        &mut self,
        variant: &Variant,
        centroids: Option<&CentroidOrder>,
        batch: &Batch<'_>,
        depths: &[f32],
    ) -> Option<Vec<f64>> {
        let shared = self.prepare(std::slice::from_ref(variant), batch.lists);
        let (lists, sorted) = self.submitted(variant, centroids, batch.lists, shared.has_zeros);
        variant.technique.transmittance(&Batch { lists, sorted, ..*batch }.pixel(0), depths)
    }

    /// Filters and sorts once for all variants that want it.
    fn prepare(&mut self, variants: &[Variant], lists: ListsRef<'_>) -> Prepared {
        let has_zeros = lists.all.iter().any(|f| f.is_zero());
        if has_zeros {
            without_zero_fragments(lists, &mut self.kept);
        }
        let wants_sorted = |zeros: bool| {
            let same = |v: &&Variant| (has_zeros && v.technique.sees_zero_fragments()) == zeros;
            variants.iter().filter(same).any(Variant::wants_sorted)
        };
        let sort = SubmissionOrder::Sorted;
        let start = Instant::now();
        if wants_sorted(false) {
            let kept = if has_zeros { self.kept.as_ref() } else { lists };
            self.reorderer.reorder(kept, sort, None, &mut self.sorted);
        }
        let sort_nanos = nanos_since(start);
        let start = Instant::now();
        if wants_sorted(true) {
            self.reorderer.reorder(lists, sort, None, &mut self.sorted_with_zeros);
        }
        Prepared { has_zeros, sort_nanos, sort_with_zeros_nanos: nanos_since(start) }
    }

    /// The lists as `variant` is to see them, in its submission order and, if it wants that too, sorted.
    fn submitted<'a>(
        &'a mut self,
        variant: &Variant,
        centroids: Option<&CentroidOrder>,
        lists: ListsRef<'a>,
        has_zeros: bool,
    ) -> (ListsRef<'a>, Option<ListsRef<'a>>) {
        let (seen, sorted) = match (has_zeros, variant.technique.sees_zero_fragments()) {
            (true, false) => (self.kept.as_ref(), &self.sorted),
            (true, true) => (lists, &self.sorted_with_zeros),
            (false, _) => (lists, &self.sorted),
        };
        let sorted = variant.wants_sorted().then(|| sorted.as_ref());
        let submitted = match (variant.order, sorted) {
            (SubmissionOrder::AsIs, _) => seen,
            (SubmissionOrder::Sorted, Some(sorted)) => sorted,
            (order, _) => {
                self.reorderer.reorder(seen, order, centroids, &mut self.reordered);
                self.reordered.as_ref()
            }
        };
        (submitted, sorted)
    }

    fn run_variant(
        &mut self,
        context: &Context<'_>,
        variant: &Variant,
        batch: &Batch<'_>,
        has_zeros: bool,
        out: &mut [Resolved],
        tally: &mut VariantTally,
    ) {
        let technique = &*variant.technique;
        let shortcut = context.skip && technique.properties().exact_for_one;
        let mut pixels = std::mem::take(&mut self.pixels);
        pixels.clear();
        let (lists, sorted) = self.submitted(variant, context.centroids, batch.lists, has_zeros);
        for (i, out) in out.iter_mut().enumerate() {
            match lists.count(i) {
                0 => {}
                // a lone emission without coverage is lost by some techniques, so it is left to them
                1 if shortcut && lists.row(i).alpha[0] > 0.0 => {
                    *out = single(lists, i, batch.background(i));
                    tally.single_fragment_pixels += 1;
                }
                #[expect(clippy::cast_possible_truncation, reason = "pixels of a batch")]
                _ => pixels.push(i as u32),
            }
        }
        let batch = Batch { lists, sorted, ..*batch };
        technique.resolve_batch(&batch, &pixels, out, &|| (context.stop)());
        self.pixels = pixels;
    }
}

/// One fragment over the background.
fn single(lists: ListsRef<'_>, i: usize, background: DVec3) -> Resolved {
    let fragment = lists.row(i).get(0);
    let transmittance = 1.0 - f64::from(fragment.alpha);
    Resolved::new(Vec3::from(fragment.color).as_dvec3() + transmittance * background, transmittance)
}

/// Nanoseconds since `start`.
pub fn nanos_since(start: Instant) -> u64 {
    u64::try_from(start.elapsed().as_nanos()).unwrap_or(u64::MAX)
}
