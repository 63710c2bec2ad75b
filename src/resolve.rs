//! Runs techniques over batches of pixels: hands each the fragments it should see, in the order it should see
//! them, and answers pixels itself where the answer is provably the technique's own.

use crate::diagnosis::Diagnosis;
use crate::error::Result;
use crate::fragments::{Lists, ListsRef};
use crate::order::{CentroidOrder, Reorderer, SubmissionOrder, without_zero_fragments};
use crate::own::in_batches;
use crate::params::Params;
use crate::raster::Order;
use crate::technique::{AnyTechnique, Batch, Resolved, Streamed};
use glam::{DVec3, Vec3};
use std::time::Instant;

/// A technique with its params, ready to run.
pub struct Variant {
    /// The technique's id.
    pub id: &'static str,
    /// What tells it from others if it was made outside of the core.
    pub custom: Option<String>,
    /// Its params, resolved; none if it was made outside, since they are bound already.
    pub params: Params,
    /// The technique itself.
    pub technique: Box<dyn AnyTechnique>,
    /// The order in which it gets the fragments.
    pub order: SubmissionOrder,
    /// Whether it calls functions that are best called for many fragments at once.
    pub calls_out: bool,
}

impl Variant {
    /// Whether the two give the same image.
    pub fn is_same(&self, other: &Self) -> bool {
        self.id == other.id
            && self.custom == other.custom
            && self.params.identity() == other.params.identity()
    }

    /// Whether the fragments are wanted nearest first, beside their submission order or instead.
    pub fn wants_sorted(&self) -> bool {
        self.technique.needs_sorted() || self.order == SubmissionOrder::Sorted
    }

    /// Whether the fragments may come sorted rather than as they arrived.
    pub fn takes_sorted_alone(&self) -> bool {
        match self.order {
            SubmissionOrder::AsIs => self.technique.needs_sorted() && !self.technique.needs_arrival(),
            SubmissionOrder::Sorted | SubmissionOrder::BackToFront => true,
            // ties among equal keys fall back to arrival
            SubmissionOrder::Reversed | SubmissionOrder::Shuffled { .. } | SubmissionOrder::Centroid => false,
        }
    }

    /// What the technique is if it can be fed while rasterising, and the order that it has to be fed in.
    pub fn streamed(&self) -> Option<(Streamed<'_>, Order)> {
        let streamed = self.technique.streamed()?;
        match (streamed, self.order) {
            (Streamed::Over, _) => Some((streamed, Order::FrontToBack)),
            (_, SubmissionOrder::AsIs) => Some((streamed, Order::Submission)),
            (Streamed::Blend, SubmissionOrder::Centroid) => Some((streamed, Order::BackToFront)),
            _ => None,
        }
    }
}

/// What one variant did on some pixels.
#[derive(Debug, Clone, Copy, Default)]
pub struct VariantTally {
    /// Time spent, over all threads.
    pub nanos: u64,
    /// Fragments that did not fit into the technique's storage.
    pub dropped: u64,
    /// Weights of the user's own that were none, where they were blended while rasterising.
    pub invalid_weights: u64,
    /// Pixels of one fragment that were composited directly.
    pub single_fragment_pixels: u64,
    /// Fragments behind one that covers its pixel, which were not looked at.
    pub hidden_fragments: u64,
}

/// Resolves batches; keep it and its memory is reused.
#[derive(Default)]
pub struct Resolver {
    reorderer: Reorderer,
    kept: Lists,
    sorted: Lists,
    sorted_kept: Lists,
    reordered: Lists,
    pixels: Vec<u32>,
}

/// What all batches of a render have in common.
#[derive(Clone, Copy)]
pub struct Context<'a> {
    /// The techniques of the render ...
    pub variants: &'a [Variant],
    /// ... and the places of those that are to be resolved from lists.
    pub selected: &'a [usize],
    /// The primitives by centroid, where a variant asks for that order.
    pub centroids: Option<&'a CentroidOrder>,
    /// Whether pixels may be answered without the technique.
    pub shortcuts: bool,
    /// Says whether to stop.
    pub stop: &'a (dyn Fn() -> bool + Sync),
}

impl Context<'_> {
    fn wants_sorted(&self) -> bool {
        self.selected.iter().any(|&v| self.variants[v].wants_sorted())
    }
}

/// The fragments of a batch: as they are, without those that do nothing, and both of it sorted.
struct Prepared<'a> {
    all: ListsRef<'a>,
    kept: ListsRef<'a>,
    /// Nearest first, where a variant wants that.
    sorted: Option<ListsRef<'a>>,
    sorted_kept: Option<ListsRef<'a>>,
    /// The time that sorting took.
    nanos: u64,
}

impl<'a> Prepared<'a> {
    /// The lists as they arrived and sorted, as a technique sees them.
    fn seen_by(&self, technique: &dyn AnyTechnique) -> (ListsRef<'a>, Option<ListsRef<'a>>) {
        if technique.sees_zero_fragments() { (self.all, self.sorted) } else { (self.kept, self.sorted_kept) }
    }
}

impl Resolver {
    /// Resolves `batch` with every selected variant: `out[v][i]` is pixel `i` under variant `v`. If the batch
    /// comes sorted already, that took `sort_nanos`.
    ///
    /// # Errors
    /// Only those of a technique that was made outside of the core.
    pub fn run(
        &mut self,
        context: &Context<'_>,
        batch: &Batch<'_>,
        sort_nanos: u64,
        out: &mut [Vec<Resolved>],
        tallies: &mut [VariantTally],
    ) -> Result<()> {
        let Self { reorderer, kept, sorted, sorted_kept, reordered, pixels } = self;
        let prepared = prepare(batch, context.wants_sorted(), reorderer, [kept, sorted, sorted_kept]);
        for &v in context.selected {
            let (variant, out, tally) = (&context.variants[v], &mut out[v], &mut tallies[v]);
            let start = Instant::now();
            out.clear();
            out.extend((0..batch.lists.len()).map(|i| Resolved::background(batch.background(i))));
            let (lists, sorted) = submitted(variant, &prepared, context.centroids, reorderer, reordered);
            let batch = Batch { lists, sorted, ..*batch };
            run_variant(context, variant, &batch, pixels, out, tally)?;
            tally.nanos += nanos_since(start);
            if variant.wants_sorted() {
                tally.nanos += sort_nanos + prepared.nanos;
            }
            tally.dropped += out.iter().map(|r| r.dropped).sum::<u64>();
        }
        Ok(())
    }

    /// The transmittance function that `variant` reconstructs at the one pixel of `batch`, if it does.
    ///
    /// # Errors
    /// Only those of a technique that was made outside of the core.
    pub fn transmittance(
        &mut self,
        variant: &Variant,
        centroids: Option<&CentroidOrder>,
        batch: &Batch<'_>,
        depths: &[f32],
    ) -> Result<Option<Vec<f64>>> {
        let Self { reorderer, kept, sorted, sorted_kept, reordered, .. } = self;
        let prepared = prepare(batch, variant.wants_sorted(), reorderer, [kept, sorted, sorted_kept]);
        let (lists, sorted) = submitted(variant, &prepared, centroids, reorderer, reordered);
        variant.technique.try_transmittance(&Batch { lists, sorted, ..*batch }.pixel(0), depths)
    }

    /// What went wrong with the numbers of `variant` at each pixel of `batch`.
    pub fn diagnose(
        &mut self,
        variant: &Variant,
        centroids: Option<&CentroidOrder>,
        batch: &Batch<'_>,
    ) -> Vec<Diagnosis> {
        let Self { reorderer, kept, sorted, sorted_kept, reordered, .. } = self;
        let prepared = prepare(batch, variant.wants_sorted(), reorderer, [kept, sorted, sorted_kept]);
        let (lists, sorted) = submitted(variant, &prepared, centroids, reorderer, reordered);
        let batch = Batch { lists, sorted, ..*batch };
        let of_pixel = |i| match lists.count(i) {
            0 => Diagnosis::CLEAR,
            _ => variant.technique.diagnose(&batch.pixel(i)),
        };
        let mut found = Vec::new();
        let mut look = || found = (0..lists.len()).map(of_pixel).collect();
        if variant.calls_out {
            in_batches(look);
        } else {
            look();
        }
        found
    }
}

/// Filters and sorts once for all variants.
fn prepare<'a>(
    batch: &Batch<'a>,
    sort: bool,
    reorderer: &mut Reorderer,
    [kept, sorted, sorted_kept]: [&'a mut Lists; 3],
) -> Prepared<'a> {
    let all = batch.lists;
    let has_zeros = all.all.iter().any(|f| f.is_zero());
    let start = Instant::now();
    let sorted = match (batch.sorted, sort) {
        (Some(sorted), _) => Some(sorted),
        (None, false) => None,
        (None, true) => {
            reorderer.reorder(all, SubmissionOrder::Sorted, None, sorted);
            Some(sorted.as_ref())
        }
    };
    let nanos = nanos_since(start);
    if !has_zeros {
        return Prepared { all, kept: all, sorted, sorted_kept: sorted, nanos };
    }
    without_zero_fragments(all, kept);
    let sorted_kept = sorted.map(|sorted| {
        without_zero_fragments(sorted, sorted_kept);
        sorted_kept.as_ref()
    });
    Prepared { all, kept: kept.as_ref(), sorted, sorted_kept, nanos }
}

/// The lists as `variant` is to see them, in its submission order and, if it wants that too, sorted.
fn submitted<'a>(
    variant: &Variant,
    prepared: &Prepared<'a>,
    centroids: Option<&CentroidOrder>,
    reorderer: &mut Reorderer,
    reordered: &'a mut Lists,
) -> (ListsRef<'a>, Option<ListsRef<'a>>) {
    let (seen, sorted) = prepared.seen_by(&*variant.technique);
    let lists = match (variant.order, sorted) {
        (SubmissionOrder::AsIs, _) => seen,
        (SubmissionOrder::Sorted, Some(sorted)) => sorted,
        (order, _) => {
            reorderer.reorder(seen, order, centroids, reordered);
            reordered.as_ref()
        }
    };
    (lists, sorted.filter(|_| variant.wants_sorted()))
}

/// Below this coverage a weighted sum in f32 may lose more than two ulp, so that a shortcut would show.
const SHORTCUT_ALPHA: f32 = 1.0 / 1024.0;

fn run_variant(
    context: &Context<'_>,
    variant: &Variant,
    batch: &Batch<'_>,
    pixels: &mut Vec<u32>,
    out: &mut [Resolved],
    tally: &mut VariantTally,
) -> Result<()> {
    let technique = &*variant.technique;
    // sums that may have been streamed cannot be cut short either, and a capture is to give their bits
    let is_sums = matches!(technique.streamed(), Some(Streamed::Sums(_)));
    let shortcut = context.shortcuts && technique.properties().exact_for_one && !is_sums;
    pixels.clear();
    for (i, out) in out.iter_mut().enumerate() {
        match batch.lists.count(i) {
            0 => {}
            1 if shortcut && batch.lists.row(i).alpha[0] >= SHORTCUT_ALPHA => {
                *out = single(batch.lists, i, batch.background(i));
                tally.single_fragment_pixels += 1;
            }
            #[expect(clippy::cast_possible_truncation, reason = "pixels of a batch")]
            _ => pixels.push(i as u32),
        }
    }
    let mut found = Ok(());
    let mut resolve = || found = technique.resolve_batch(batch, pixels, out, &|| (context.stop)());
    if variant.calls_out {
        in_batches(resolve);
    } else {
        resolve();
    }
    found
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
