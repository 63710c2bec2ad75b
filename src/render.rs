//! The one way through the house: scene -> raster -> fragments -> technique -> frame.

mod capture;
mod depth;
mod diagnose;
#[cfg(feature = "gpu")]
mod gpu;
mod image;
mod inspect;
mod pieces;
mod plan;
mod request;
mod tally;
mod tiles;

pub use capture::capture;
pub use depth::{DepthImages, depth_images};
pub use diagnose::{Diagnostics, diagnose};
#[cfg(feature = "gpu")]
pub use gpu::{capture_on_gpu, check_on_gpu, render_on_gpu};
pub use inspect::{Transmittance, cost, order_sensitivity, transmittance};
pub use request::{Custom, Make, Request};

use crate::error::{Error, Result};
use crate::fragments::Fragments;
use crate::frame::{Frame, Sample, Stats, skipped};
use crate::order::{CentroidOrder, SubmissionOrder};
use crate::params::{Params, View};
use crate::raster::{self, Raster};
use crate::resolve::{Context, Resolver, Variant, nanos_since};
use crate::scene::Scene;
use crate::technique::{Batch, DepthComplexity};
use crate::threads::{Lent, Workers, with_threads};
use image::{Patch, Target, VariantImage};
use pieces::{Piece, deal};
use plan::Plan;
use rayon::prelude::*;
use request::Asked;
use std::ops::Range;
use std::sync::Arc;
use std::time::Instant;
use tally::Tally;

/// What can be rendered.
#[derive(Debug, Clone, Copy)]
pub enum Source<'a> {
    /// Geometry, to be rasterised.
    Scene(&'a Scene),
    /// Fragments that exist already.
    Fragments(&'a Fragments),
}

impl Source<'_> {
    /// Columns and rows of its image.
    #[cfg(feature = "gpu")]
    fn size(self) -> (u32, u32) {
        match self {
            Self::Scene(scene) => (scene.width(), scene.height()),
            Self::Fragments(fragments) => (fragments.width, fragments.height),
        }
    }

    /// What is known of the view before anything is set up.
    fn provisional_view(self) -> View {
        match self {
            Self::Scene(scene) => raster::provisional_view(scene),
            Self::Fragments(fragments) => fragments.view,
        }
    }
}

/// How to render, as opposed to what.
#[derive(Debug, Clone, Copy)]
pub struct Options {
    /// Worker threads; all cores when absent.
    pub threads: Option<usize>,
    /// Whether provably needless work may be left out.
    pub skip: bool,
    /// Edge of the screen tiles in pixels. Changes time and memory, never a bit of the image.
    pub tile_size: u32,
    /// Fragments that a tile may hold at a time; deeper tiles are resolved in parts. Twice as many are allowed where
    /// nearly all of the tile's primitives have come by then.
    pub max_fragments: usize,
}

impl Default for Options {
    fn default() -> Self {
        Self { threads: None, skip: true, tile_size: 64, max_fragments: 1 << 18 }
    }
}

/// Bytes of state that a technique may keep per pixel: sizes have no limit but memory, and a failed allocation
/// would end the process.
const LARGEST_STATE: f64 = 1_073_741_824.0;

/// Pixels of a captured image that are resolved together, at most.
const PIECE_PIXELS: usize = 4096;

/// Renders `source` once per request, rasterising once for all.
///
/// # Errors
/// For unknown techniques and params before any work starts; [`Error::Cancelled`] once `stop` returns true, which it has to do from
/// then on.
pub fn render<S: Sample>(
    source: Source<'_>,
    requests: &[Request],
    options: &Options,
    stop: &(dyn Fn() -> bool + Sync),
) -> Result<Vec<Frame>> {
    let asked = requests.iter().map(Request::check).collect::<Result<Vec<_>>>()?;
    let start = Instant::now();
    with_threads(options.threads, |threads| match source {
        Source::Scene(scene) => {
            let provisional = source.provisional_view();
            asked.iter().try_for_each(|asked| asked.bind(&provisional).map(drop))?;
            let raster = Raster::new(scene, options.tile_size, stop);
            let setup_nanos = nanos_since(start);
            let job = Job::new::<S>(source, &raster.view(), &asked, options, stop)?;
            let finished = job.scene::<S>(&raster, job.target(scene.width(), scene.height())?)?;
            let wall_nanos = nanos_since(start);
            Ok(job.frames(finished, &Clock { setup_nanos, wall_nanos, threads }))
        }
        Source::Fragments(fragments) => {
            let job = Job::new::<S>(source, &fragments.view, &asked, options, stop)?;
            let target = job.target(fragments.width, fragments.height)?;
            let finished = job.fragments::<S>(fragments, target)?;
            let wall_nanos = nanos_since(start);
            Ok(job.frames(finished, &Clock { setup_nanos: 0, wall_nanos, threads }))
        }
    })
}

/// Refuses what [`render`] would refuse of these requests before it draws anything.
///
/// # Errors
/// As [`render`].
pub fn check(source: Source<'_>, requests: &[Request]) -> Result<()> {
    let view = source.provisional_view();
    requests.iter().try_for_each(|request| request.check()?.bind(&view).map(drop))
}

/// A render with everything decided: each different variant once, and which of them answers which request.
struct Job<'a> {
    variants: Vec<Variant>,
    plan: Plan,
    /// The variants that are resolved from lists where a tile has any that must be: those that are handed what
    /// fits the cache, ...
    from_lists: Vec<usize>,
    /// ... and those that are handed the tile.
    from_tiles: Vec<usize>,
    /// Per request: the variant that answers it, and the params as requested.
    answers: Vec<(usize, Params)>,
    centroids: Option<CentroidOrder>,
    options: &'a Options,
    /// Whether pixels may be answered without the technique.
    shortcuts: bool,
    stop: &'a (dyn Fn() -> bool + Sync),
    /// Wall time spent on centroids and their order.
    centroid_nanos: u64,
}

/// Everything that a run produced.
struct Finished<S> {
    target: Target<S>,
    tally: Tally,
}

impl<'a> Job<'a> {
    fn new<S: Sample>(
        source: Source<'_>,
        view: &View,
        asked: &[Asked],
        options: &'a Options,
        stop: &'a (dyn Fn() -> bool + Sync),
    ) -> Result<Self> {
        let mut variants: Vec<Variant> = Vec::new();
        let mut answers = Vec::new();
        for asked in asked {
            let variant = asked.bind(view)?;
            let params = variant.params.clone();
            let same = |other: &Variant| other.is_same(&variant);
            let known = if options.skip { variants.iter().position(same) } else { None };
            let index = known.unwrap_or_else(|| {
                variants.push(variant);
                variants.len() - 1
            });
            answers.push((index, params));
        }
        let is_scene = matches!(source, Source::Scene(_));
        let plan = Plan::new(&variants, is_scene);
        let listed = plan.listed.iter().chain(&plan.overs).copied();
        let (from_tiles, from_lists) = listed.partition(|&v| variants[v].technique.wants_large_batches());
        let start = Instant::now();
        let by_centroid = plan.listed.iter().any(|&v| variants[v].order == SubmissionOrder::Centroid);
        let centroids = by_centroid.then(|| match source {
            Source::Scene(scene) => CentroidOrder::of_all(&raster::centroid_depths(scene, stop)),
            Source::Fragments(fragments) => fragments.centroid_order(),
        });
        let centroid_nanos = nanos_since(start);
        let shortcuts = options.skip && S::SHORTCUTS;
        Ok(Self {
            variants,
            plan,
            from_lists,
            from_tiles,
            answers,
            centroids,
            options,
            shortcuts,
            stop,
            centroid_nanos,
        })
    }

    fn context<'b>(&'b self, selected: &'b [usize]) -> Context<'b> {
        Context {
            variants: &self.variants,
            selected,
            centroids: self.centroids.as_ref(),
            shortcuts: self.shortcuts,
            stop: self.stop,
        }
    }

    fn target<S: Sample>(&self, width: u32, height: u32) -> Result<Target<S>> {
        let channels = |v: &Variant| if v.technique.colored_transmittance() { 3 } else { 1 };
        Target::new(width, height, &self.variants.iter().map(channels).collect::<Vec<_>>())
    }

    /// Rasterises and resolves tile by tile.
    fn scene<S: Sample>(&self, raster: &Raster<'_>, mut target: Target<S>) -> Result<Finished<S>> {
        let tile_size = self.options.tile_size;
        let workers = Workers::new(|| tiles::Worker::new(self));
        let nothing = || Tally::new(self.variants.len());
        let both = |a: Tally, b| Ok(a.merge(&b));
        let mut bands: Vec<_> = target.bands(tile_size).into_iter().enumerate().collect();
        deal(&mut bands, rayon::current_num_threads(), |(row, _)| raster.primitives_in_row(*row));
        // a band's tiles are cut where it is drawn, not one after the other for all threads
        let bands = bands.into_par_iter().map(|(row, band)| {
            let pieces = self.pieces(raster, row);
            let rects = pieces.iter().map(|piece| piece.rect(raster, row));
            // a working memory and a tally for a run of pieces that one thread draws
            let begin = || (workers.lend(), nothing());
            let runs =
                pieces.par_iter().zip(band.pieces(rects)).try_fold(begin, |(mut worker, mut tally), at| {
                    let (piece, mut patch): (&Piece, Patch<'_, S>) = at;
                    match piece {
                        Piece::Tile(column) => {
                            self.tile(raster, (*column, row), &mut patch, worker.get(), &mut tally)?;
                        }
                        Piece::Empty(columns) => Self::clear(raster, columns.len(), &mut patch, &mut tally),
                    }
                    Ok((worker, tally))
                });
            runs.map(|run| run.map(|(_, tally)| tally)).try_reduce(nothing, both)
        });
        let tally = bands.try_reduce(nothing, both)?;
        if (self.stop)() { Err(Error::Cancelled) } else { Ok(Finished { target, tally }) }
    }

    /// Resolves a fragment list piece by piece.
    fn fragments<S: Sample>(&self, fragments: &Fragments, mut target: Target<S>) -> Result<Finished<S>> {
        let rows = fragments.lists.as_ref();
        let ends = run_ends(fragments, PIECE_PIXELS, self.options.max_fragments);
        let workers =
            Workers::new(|| (Resolver::default(), vec![Vec::new(); self.variants.len()], Vec::new()));
        let run = |lent: &mut Lent<'_, _, _>, (first, mut patch): (usize, Patch<'_, S>)| {
            let rect = patch.rect();
            let last = first + rect.width();
            let background = backgrounds(fragments, first..last);
            let batch = piece(fragments, first..last, &background);
            let (resolver, resolved, counts): &mut (Resolver, Vec<_>, Vec<u32>) = lent.get();
            let mut tally = Tally::new(self.variants.len());
            counts.clear();
            #[expect(clippy::cast_possible_truncation, reason = "a pixel's list is far shorter than 2^32")]
            counts.extend((first..last).map(|i| rows.count(i) as u32));
            tally.count(counts);
            resolver.run(&self.context(&self.plan.listed), &batch, 0, resolved, &mut tally.variants)?;
            resolved.iter().enumerate().for_each(|(v, pixels)| patch.store(v, &rect, 0, pixels));
            Ok(tally)
        };
        let tally = target
            .runs(&ends)
            .into_par_iter()
            .map_init(|| workers.lend(), run)
            .try_reduce(|| Tally::new(self.variants.len()), |a, b| Ok(a.merge(&b)))?;
        if (self.stop)() { Err(Error::Cancelled) } else { Ok(Finished { target, tally }) }
    }

    fn frames<S: Sample>(&self, finished: Finished<S>, clock: &Clock) -> Vec<Frame> {
        let Finished { target, tally } = finished;
        let (width, height) = (target.width, target.height);
        let share = |image: VariantImage<S>| {
            (Arc::new(S::wrap(image.color)), Arc::new(S::wrap(image.transmittance)), image.channels)
        };
        let images: Vec<_> = target.images.into_iter().map(share).collect();
        let mut last_use = vec![0; images.len()];
        for (request, (variant, _)) in self.answers.iter().enumerate() {
            last_use[*variant] = request;
        }
        let answer = |(request, (index, params)): (usize, &(usize, Params))| {
            let (color, transmittance, transmittance_channels) = &images[*index];
            Frame {
                technique: self.variants[*index].id,
                params: params.clone(),
                width,
                height,
                color: Arc::clone(color),
                transmittance: Arc::clone(transmittance),
                transmittance_channels: *transmittance_channels,
                stats: self.stats(*index, last_use[*index] != request, &tally, clock, width, height),
            }
        };
        self.answers.iter().enumerate().map(answer).collect()
    }

    #[expect(clippy::cast_precision_loss, reason = "statistics")]
    fn stats(
        &self,
        index: usize,
        duplicate: bool,
        tally: &Tally,
        clock: &Clock,
        width: u32,
        height: u32,
    ) -> Stats {
        let mean = tally.fragments as f64 / (f64::from(width) * f64::from(height));
        let deepest = usize::try_from(tally.deepest).unwrap_or(usize::MAX);
        let variant = &tally.variants[index];
        let cost = self.variants[index].technique.cost(&DepthComplexity { mean, max: deepest });
        let share = |nanos: u64| nanos as f64 / clock.threads as f64 * 1e-6;
        let drawing = tally.raster_nanos.saturating_sub(tally.streaming_nanos);
        let raster_ms = clock.setup_nanos as f64 * 1e-6 + share(drawing);
        let by_centroid =
            self.plan.listed.contains(&index) && self.variants[index].order == SubmissionOrder::Centroid;
        let ranking_ms = if by_centroid { self.centroid_nanos as f64 * 1e-6 } else { 0.0 };
        let resolve_ms = ranking_ms + share(variant.nanos);
        let alone = self.variants.len() == 1;
        let of_over = |tiles| if self.plan.overs.contains(&index) { tiles } else { 0 };
        let of_sums = |pixels| if self.plan.sums.contains(&index) { pixels } else { 0 };
        Stats {
            total_ms: if alone { clock.wall_nanos as f64 * 1e-6 } else { raster_ms + resolve_ms },
            raster_ms,
            resolve_ms,
            fragments: tally.fragments,
            depth_complexity_mean: mean,
            depth_complexity_max: tally.deepest,
            geometry_passes: cost.geometry_passes,
            bytes_per_pixel: cost.bytes_per_pixel,
            dropped: variant.dropped,
            invalid_weights: variant.invalid_weights + self.variants[index].params.reports().invalid(),
            skipped: skipped(&[
                ("empty_tiles", tally.empty_tiles),
                ("empty_pixels", tally.empty_pixels),
                ("occluded_fragments", tally.occluded.fragments),
                ("occluded_primitives", tally.occluded.primitives),
                ("single_fragment_pixels", variant.single_fragment_pixels),
                ("hidden_fragments", variant.hidden_fragments),
                ("one_color_tiles", of_over(tally.one_color_tiles)),
                ("layered_tiles", of_over(tally.layered_tiles)),
                ("repeated_pixels", of_sums(tally.repeated_pixels)),
                ("duplicate_variants", u64::from(duplicate)),
            ]),
            backend: "cpu",
            threads: clock.threads,
        }
    }
}

/// The end of the longest run of pixels from `first` whose fragments fit the budget; at least one pixel.
fn part_end(first: usize, end: usize, budget: usize, count: impl Fn(usize) -> usize) -> usize {
    let mut sum = count(first);
    (first + 1..end)
        .find(|&i| {
            sum += count(i);
            sum > budget
        })
        .unwrap_or(end)
}

/// Where to cut a captured image into runs of at most so many pixels and, if they have more than one, so many
/// fragments.
fn run_ends(fragments: &Fragments, pixels: usize, budget: usize) -> Vec<usize> {
    let rows = fragments.lists.as_ref();
    let mut ends = Vec::new();
    let mut first = 0;
    while first < fragments.pixels() {
        let limit = fragments.pixels().min(first + pixels);
        first = part_end(first, limit, budget, |i| rows.count(i));
        ends.push(first);
    }
    ends
}

/// Times that all variants of a run share.
struct Clock {
    setup_nanos: u64,
    wall_nanos: u64,
    threads: usize,
}

/// The opaque colours behind some pixels of a captured image.
fn backgrounds(fragments: &Fragments, pixels: Range<usize>) -> Vec<[f32; 3]> {
    pixels.map(|i| fragments.background.at(i)).collect()
}

/// Some pixels of a captured image, over their backgrounds.
#[expect(clippy::cast_possible_truncation, reason = "at most MAX_SIZE squared pixels")]
fn piece<'a>(fragments: &'a Fragments, pixels: Range<usize>, background: &'a [[f32; 3]]) -> Batch<'a> {
    Batch {
        x: 0,
        y: 0,
        width: fragments.width,
        first: pixels.start as u32,
        lists: fragments.lists.as_ref().rows(pixels.start, pixels.end),
        sorted: None,
        background,
    }
}
