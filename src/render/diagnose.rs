//! What went wrong with each pixel's numbers: everything is computed once more, for those who want to know.

use super::{Options, PIECE_PIXELS, Request, Source, backgrounds, capture, piece, run_ends};
use crate::diagnosis::{Diagnosis, Fault, Faults};
use crate::error::{Error, Result};
use crate::fragments::Fragments;
use crate::order::{CentroidOrder, SubmissionOrder};
use crate::params::View;
use crate::raster::{self, Raster, Rect};
use crate::resolve::{Resolver, Variant};
use crate::technique::Batch;
use crate::threads::with_threads;
use rayon::prelude::*;

/// A technique's faults, each as an image.
#[derive(Debug, Clone, PartialEq)]
pub struct Diagnostics {
    /// The faults that are looked for, with how much of them each pixel has, row by row from the top.
    pub images: Vec<(Fault, Vec<f32>)>,
}

/// The variants and what they have in common.
struct Job<'a> {
    variants: Vec<Variant>,
    centroids: Option<CentroidOrder>,
    stop: &'a (dyn Fn() -> bool + Sync),
}

/// The diagnoses of a rectangle's pixels, variant by variant.
type Part = (Rect, Vec<Vec<Diagnosis>>);

/// What goes wrong with the numbers of each request.
///
/// # Errors
/// As for `render`.
pub fn diagnose(
    source: Source<'_>,
    requests: &[Request],
    options: &Options,
    stop: &(dyn Fn() -> bool + Sync),
) -> Result<Vec<Diagnostics>> {
    with_threads(options.threads, |_| match source {
        Source::Scene(scene) => {
            let raster = Raster::new(scene, options.tile_size, stop);
            let job = Job::new(source, &raster.view(), requests, stop)?;
            job.images(scene.width(), scene.height(), job.scene(&raster))
        }
        Source::Fragments(fragments) => {
            let job = Job::new(source, &fragments.view, requests, stop)?;
            job.images(fragments.width, fragments.height, job.fragments(fragments, options))
        }
    })
}

impl<'a> Job<'a> {
    fn new(
        source: Source<'_>,
        view: &View,
        requests: &[Request],
        stop: &'a (dyn Fn() -> bool + Sync),
    ) -> Result<Self> {
        let bound = requests.iter().map(|request| request.check()?.bind(view));
        let variants = bound.collect::<Result<Vec<_>>>()?;
        let by_centroid = variants.iter().any(|v| v.order == SubmissionOrder::Centroid);
        let centroids = by_centroid.then(|| match source {
            Source::Scene(scene) => CentroidOrder::of_all(&raster::centroid_depths(scene, stop)),
            Source::Fragments(fragments) => fragments.centroid_order(),
        });
        Ok(Self { variants, centroids, stop })
    }

    /// Tile by tile.
    fn scene(&self, raster: &Raster<'_>) -> Vec<Part> {
        let columns = raster.columns();
        let tiles = (0..raster.rows() * columns).into_par_iter();
        let part = |tile| {
            let (rect, lists, background) =
                capture::tile(raster, (tile % columns, tile / columns), self.stop);
            #[expect(clippy::cast_sign_loss, reason = "inside the image")]
            let batch = Batch {
                x: rect.x0 as u32,
                y: rect.y0 as u32,
                width: (rect.x1 - rect.x0) as u32,
                first: 0,
                lists: lists.as_ref(),
                sorted: None,
                background: &background,
            };
            (rect, self.part(&batch))
        };
        tiles.map(part).collect()
    }

    /// Run by run of a captured image's pixels; each run is a row of a rectangle that is as wide as there are pixels.
    fn fragments(&self, fragments: &Fragments, options: &Options) -> Vec<Part> {
        let ends = run_ends(fragments, PIECE_PIXELS, options.max_fragments);
        let starts = std::iter::once(0).chain(ends.iter().copied());
        let runs: Vec<_> = starts.zip(ends.iter().copied()).collect();
        let part = |(first, last): (usize, usize)| {
            let background = backgrounds(fragments, first..last);
            let batch = piece(fragments, first..last, &background);
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_possible_wrap,
                reason = "at most MAX_SIZE squared pixels"
            )]
            let rect = Rect { x0: first as i32, y0: 0, x1: last as i32, y1: 1 };
            (rect, self.part(&batch))
        };
        runs.into_par_iter().map(part).collect()
    }

    fn part(&self, batch: &Batch<'_>) -> Vec<Vec<Diagnosis>> {
        let mut resolver = Resolver::default();
        let of = |variant: &Variant| match variant.technique.faults() {
            Faults::NONE => Vec::new(),
            _ if (self.stop)() => Vec::new(),
            _ => resolver.diagnose(variant, self.centroids.as_ref(), batch),
        };
        self.variants.iter().map(of).collect()
    }

    #[expect(clippy::cast_sign_loss, reason = "inside the image")]
    fn images(&self, width: u32, height: u32, parts: Vec<Part>) -> Result<Vec<Diagnostics>> {
        if (self.stop)() {
            return Err(Error::Cancelled);
        }
        let pixels = width as usize * height as usize;
        let image = |v: usize, fault| {
            let mut image = vec![0.0; pixels];
            for (rect, diagnoses) in &parts {
                let columns = (rect.x1 - rect.x0) as usize;
                for (i, diagnosis) in diagnoses[v].iter().enumerate() {
                    let (x, y) = (rect.x0 as usize + i % columns, rect.y0 as usize + i / columns);
                    image[y * width as usize + x] = diagnosis.amount(fault);
                }
            }
            (fault, image)
        };
        let all = |(v, variant): (usize, &Variant)| Diagnostics {
            images: variant.technique.faults().iter().map(|fault| image(v, fault)).collect(),
        };
        Ok(self.variants.iter().enumerate().map(all).collect())
    }
}
