//! Rendering on the GPU: the CPU sets scenes up and draws their opaque surfaces, the device does the rest. Fragments that
//! are there already are taken there as lists, or drawn as triangles of one pixel each where blend units want that.

mod sources;

use super::request::Asked;
use super::{Options, Request, Source};
use crate::error::{Error, Result};
use crate::fragments::{Background, Fragments};
use crate::frame::{Frame, Image, Sample, Stats, skipped};
use crate::gpu::form::tiled::RasterPath;
use crate::gpu::form::{Form, Path, Sorting};
use crate::gpu::{Key, Primitives, Shared, Stop, ToDraw, View, check_size, with_gpu};
use crate::order::{CentroidOrder, SubmissionOrder};
use crate::params::{self, Params};
use crate::raster::{self, Raster};
use crate::resolve::Variant;
use crate::scene::Scene;
use crate::technique::DepthComplexity;
use crate::threads::with_threads;
use sources::{given, has_opaque, lists_of, opaque_surfaces, points, reordered, view_of};
use std::sync::Arc;
use std::time::Instant;

/// A variant ready to be drawn.
struct Bound {
    variant: Variant,
    form: Form,
    /// The order in which primitives are drawn.
    order: SubmissionOrder,
}

/// Renders a scene once per request on the GPU. Images are those of the CPU but for rounding: depths, colours, blending and
/// the resolve are in single precision.
///
/// # Errors
/// As [`super::render`]; [`Error::Argument`] and [`Error::Param`] for what has no GPU form or is beyond the device,
/// [`Error::Gpu`] without a device.
pub fn render_on_gpu(
    source: Source<'_>,
    requests: &[Request],
    options: &Options,
    raster: RasterPath,
    stop: &(dyn Fn() -> bool + Sync),
) -> Result<Vec<Frame>> {
    let asked = requests.iter().map(Request::check).collect::<Result<Vec<_>>>()?;
    let forms = forms(&asked, source, raster)?;
    if asked.is_empty() {
        return Ok(Vec::new());
    }
    let start = Instant::now();
    with_threads(options.threads, |threads| {
        with_gpu(|shared| {
            fit(shared, source, &forms, raster)?;
            let mut job = Job::new(source, shared, stop);
            let range = job.range()?;
            let mut answers: Vec<(Bound, Answer)> = Vec::new();
            let mut frames = Vec::new();
            for asked in &asked {
                let bound = bound(asked, source, &range, raster)?;
                let same = |(other, _): &(Bound, Answer)| other.variant.is_same(&bound.variant);
                let known = if options.skip { answers.iter().position(same) } else { None };
                let params = bound.variant.params.clone();
                let place = if let Some(place) = known {
                    place
                } else {
                    let answer = job.answer(&bound, raster)?;
                    answers.push((bound, answer));
                    answers.len() - 1
                };
                let (bound, answer) = &answers[place];
                frames.push(answer.frame(job.size, &bound.variant, params, known.is_some(), threads));
            }
            if let [frame] = &mut frames[..] {
                frame.stats.total_ms = start.elapsed().as_secs_f64() * 1e3;
            }
            Ok(frames)
        })
    })
}

/// Refuses what [`render_on_gpu`] would refuse of these requests before it draws anything. Whether a device can do what is
/// left is asked of that of this process, or of none.
///
/// # Errors
/// As [`render_on_gpu`].
pub fn check_on_gpu(
    source: Source<'_>,
    requests: &[Request],
    raster: RasterPath,
    asks_device: bool,
) -> Result<()> {
    let asked = requests.iter().map(Request::check).collect::<Result<Vec<_>>>()?;
    let forms = forms(&asked, source, raster)?;
    if asks_device { with_gpu(|shared| fit(shared, source, &forms, raster)) } else { Ok(()) }
}

/// The forms of what is asked for, bound to what is known of the view before anything is set up.
fn forms(asked: &[Asked], source: Source<'_>, raster: RasterPath) -> Result<Vec<Form>> {
    let view = source.provisional_view();
    asked.iter().map(|asked| bound(asked, source, &view, raster).map(|bound| bound.form)).collect()
}

/// Refuses images and forms that the device lacks something for.
fn fit(shared: &Shared, source: Source<'_>, forms: &[Form], raster: RasterPath) -> Result<()> {
    let (width, height) = source.size();
    check_size(shared.connection(), width, height)?;
    shared.connection().counts_fragments()?;
    match raster {
        RasterPath::Hardware | RasterPath::Samples => {
            forms.iter().try_for_each(|form| shared.connection().fits(form))
        }
        RasterPath::LinkedLists => shared.connection().fits_linked_lists(),
        RasterPath::Compute => forms.iter().try_for_each(|form| shared.connection().fits_in_tiles(form)),
    }
}

/// The fragments of every pixel of `scene` as the GPU finds them, in submission order. They are those of [`super::capture`]
/// but for rounding.
///
/// # Errors
/// [`Error::Argument`] and [`Error::Memory`] for what is beyond the device, [`Error::Gpu`] without one,
/// [`Error::Cancelled`] once `stop` returns true.
pub fn capture_on_gpu(
    scene: &Scene,
    options: &Options,
    stop: &(dyn Fn() -> bool + Sync),
) -> Result<Fragments> {
    with_threads(options.threads, |_| {
        let (captured, range) = with_gpu(|shared| {
            shared.connection().counts_fragments()?;
            let mut job = Job::new(Source::Scene(scene), shared, stop);
            let key = job.key(SubmissionOrder::AsIs, true);
            let range = if job.shared.has(key) { job.range()? } else { job.load(key)? };
            let Some(captured) = job.shared.capture(key, stop)? else { unreachable!("it was loaded") };
            Ok((captured, range))
        })?;
        let background = if has_opaque(scene) {
            let colors = opaque_surfaces(scene, stop).color;
            Background::Image(colors.into_iter().map(|[r, g, b, _]| [r, g, b]).collect())
        } else {
            Background::Constant(scene.background())
        };
        let centroids = raster::centroid_depths(scene, stop);
        if stop() {
            return Err(Error::Cancelled);
        }
        let (width, height) = (scene.width(), scene.height());
        Ok(Fragments::captured(width, height, lists_of(&captured), background, range, Some(centroids)))
    })
}

fn bound(asked: &Asked, source: Source<'_>, view: &params::View, raster: RasterPath) -> Result<Bound> {
    let (id, make) = match asked {
        Asked::Registered(info, _) => (info.id, info.gpu),
        Asked::Custom(custom) => (custom.id, None),
    };
    let Some(make) = make else {
        return Err(Error::argument("backend", format!("{id:?} has no GPU form; its backends: cpu")));
    };
    let variant = asked.bind(view)?;
    let mut form = make(&variant.params, view)?;
    let fragments = match source {
        Source::Fragments(fragments) => Some(fragments),
        Source::Scene(_) => None,
    };
    if let (Path::Peeled(_), Some(fragments)) = (&form.path, fragments) {
        // fragments may lie beyond the far plane, which depth buffers end at
        let farthest = fragments.lists.depth.iter().fold(view.far, |far, &depth| far.max(depth.into()));
        form = make(&variant.params, &params::View { far: farthest, ..*view })?;
    }
    if let (Path::Blended(blending), RasterPath::Compute) = (&mut form.path, raster) {
        blending.by_depth = match variant.order {
            SubmissionOrder::Sorted => Some(false),
            SubmissionOrder::BackToFront => Some(true),
            _ => None,
        };
    }
    match raster {
        RasterPath::Hardware => {}
        RasterPath::Compute => drop(form.tiled_module()?),
        RasterPath::Samples => form = form.by_samples()?,
        RasterPath::LinkedLists => form.check_lists()?,
    }
    // lists of a scene are sorted on the device, those that are given before they are taken there
    let of_lists = |sorted| match sorted {
        Sorting::Depth if fragments.is_some() => SubmissionOrder::Sorted,
        Sorting::Rank => variant.order,
        Sorting::Depth | Sorting::Submission => SubmissionOrder::AsIs,
    };
    let order = match (&form.path, raster) {
        // depth buffers end ties by the order of ids, in which primitives are then drawn
        (Path::Peeled(_) | Path::Sampled(_), _) => of_lists(Sorting::Depth),
        (Path::Listed(listing), _) => of_lists(listing.sorted),
        // tiles hand fragments over as they are drawn
        (Path::Streamed(stream), RasterPath::Compute) if stream.sorted == Sorting::Submission => {
            if stream.backwards { SubmissionOrder::Reversed } else { SubmissionOrder::AsIs }
        }
        (Path::Streamed(stream), _) => of_lists(stream.sorted),
        (Path::Blended(blending), RasterPath::Compute) if blending.by_depth.is_some() => {
            SubmissionOrder::AsIs
        }
        (Path::Blended(_), _) => variant.order,
    };
    let order = match form.capacity() {
        None => order,
        Some(_) if fragments.is_some() => {
            let problem =
                "a capacity has no form on the backend \"gpu\" for fragments that are there already";
            return Err(variant.params.error(problem, "there capacity is 0, or it is a scene that is drawn"));
        }
        Some(capacity) if raster != RasterPath::Compute || form.is_listed_in_tiles() => {
            of_lists(capacity.sorted)
        }
        // the first ones are those that are drawn first
        Some(_) => variant.order,
    };
    if fragments.is_none() && !order.is_of_primitives() {
        let given = variant.params.text("submission_order");
        let problem = format!(
            "submission_order={given:?} sorts fragments before they are drawn, which the backend \"gpu\" cannot here"
        );
        return Err(variant
            .params
            .error(problem, "there it is one of \"as_is\", \"reversed\", \"shuffled\", \"centroid\""));
    }
    Ok(Bound { variant, form, order })
}

/// A scene or fragments on their way through the device.
struct Job<'a> {
    source: Source<'a>,
    shared: &'a mut Shared,
    hash: blake3::Hash,
    /// Width and height.
    size: (u32, u32),
    stop: &'a (dyn Fn() -> bool + Sync),
}

/// What the device made of a variant.
struct Answer {
    color: Arc<Image>,
    transmittance: Arc<Image>,
    channels: usize,
    raster_ms: f64,
    resolve_ms: f64,
    fragments: u64,
    deepest: u64,
    invalid_weights: u64,
    dropped: u64,
}

impl<'a> Job<'a> {
    fn new(source: Source<'a>, shared: &'a mut Shared, stop: &'a (dyn Fn() -> bool + Sync)) -> Self {
        let hash = match source {
            Source::Scene(scene) => scene.content_hash(),
            Source::Fragments(fragments) => fragments.content_hash(),
        };
        Self { source, shared, hash, size: source.size(), stop }
    }

    /// What is on the device for a form of lists, or one that draws in this order.
    fn key(&self, order: SubmissionOrder, listed: bool) -> Key {
        Key { scene: self.hash, order, listed: listed && matches!(self.source, Source::Fragments(_)) }
    }

    /// Near, far and the depth range, which some params' defaults follow.
    fn range(&mut self) -> Result<params::View> {
        match (self.source, self.shared.range(self.hash)) {
            (Source::Fragments(fragments), _) => Ok(fragments.view),
            (_, Some(range)) => Ok(range),
            (_, None) => self.load(self.key(SubmissionOrder::AsIs, true)),
        }
    }

    fn load(&mut self, key: Key) -> Result<params::View> {
        if key.listed {
            return self.load_lists(key);
        }
        self.drawn(key.order, |shared, drawn, stop| {
            shared.load(key, drawn.range, &drawn.view, (drawn.primitives)(), drawn.ranked, stop)?;
            Ok(drawn.range)
        })
    }

    fn load_lists(&mut self, key: Key) -> Result<params::View> {
        let Source::Fragments(fragments) = self.source else { unreachable!("those of a scene are drawn") };
        let reordered = reordered(fragments, key.order);
        self.shared.load_fragments(key, fragments.view, &view_of(fragments), given(&reordered))?;
        Ok(fragments.view)
    }

    /// Does something with what is drawn in an order.
    fn drawn<T>(
        &mut self,
        order: SubmissionOrder,
        work: impl FnOnce(&mut Shared, &ToDraw<'_>, Stop<'_>) -> Result<T>,
    ) -> Result<T> {
        match self.source {
            Source::Scene(scene) => self.drawn_of_scene(scene, order, work),
            Source::Fragments(fragments) => {
                let reordered = reordered(fragments, order);
                let are_sorted = order == SubmissionOrder::Sorted;
                let primitives =
                    || -> Primitives<'_> { Box::new(points(&reordered, fragments.width, are_sorted)) };
                let (view, range) = (view_of(fragments), fragments.view);
                work(self.shared, &ToDraw { view, range, ranked: false, primitives: &primitives }, self.stop)
            }
        }
    }

    fn drawn_of_scene<T>(
        &mut self,
        scene: &Scene,
        order: SubmissionOrder,
        work: impl FnOnce(&mut Shared, &ToDraw<'_>, Stop<'_>) -> Result<T>,
    ) -> Result<T> {
        let stop = self.stop;
        // the whole image is one tile, so that every primitive comes once
        let raster = Raster::new(scene, scene.width().max(scene.height()), stop);
        let opaque = has_opaque(scene).then(|| opaque_surfaces(scene, stop));
        let by_centroid = order == SubmissionOrder::Centroid;
        let centroids = by_centroid.then(|| CentroidOrder::of_all(&raster::centroid_depths(scene, stop)));
        if stop() {
            return Err(Error::Cancelled);
        }
        let view = View {
            width: scene.width(),
            height: scene.height(),
            perspective: raster.is_perspective(),
            background: scene.background(),
            opaque,
        };
        let (range, ranked) =
            (raster.view(), !matches!(order, SubmissionOrder::AsIs | SubmissionOrder::Reversed));
        if order == SubmissionOrder::AsIs {
            let primitives = || -> Primitives<'_> { Box::new(raster.drawn()) };
            return work(self.shared, &ToDraw { view, range, ranked, primitives: &primitives }, stop);
        }
        let drawn: Vec<_> = raster.drawn().collect();
        let ids: Vec<_> = drawn.iter().map(|primitive| primitive.primitive).collect();
        let places = order.of_primitives(&ids, centroids.as_ref());
        let primitives = || -> Primitives<'_> { Box::new(places.iter().map(|place| drawn[*place as usize])) };
        work(self.shared, &ToDraw { view, range, ranked, primitives: &primitives }, stop)
    }

    fn answer(&mut self, bound: &Bound, raster: RasterPath) -> Result<Answer> {
        let listed = matches!(bound.form.path, Path::Listed(_) | Path::Streamed(_));
        let key = self.key(bound.order, listed && raster != RasterPath::Compute);
        if !self.shared.has(key) {
            self.load(key)?;
        }
        let Some(totals) = self.shared.totals(key) else { unreachable!("it was loaded") };
        let image = if raster == RasterPath::Compute && totals.batches > 1 {
            self.drawn(bound.order, |shared, drawn, stop| {
                shared.draw_in_bands(key, drawn, &bound.form, stop)
            })?
        } else {
            self.shared.draw(key, &bound.form, raster, self.stop)?
        };
        let colored = bound.form.colored_transmittance;
        let (color, transmittance) = split(&image.texels, colored);
        Ok(Answer {
            color: Arc::new(f32::wrap(color)),
            transmittance: Arc::new(f32::wrap(transmittance)),
            channels: if colored { 3 } else { 1 },
            raster_ms: image.times.raster,
            resolve_ms: image.times.resolve,
            fragments: totals.fragments,
            deepest: totals.deepest,
            invalid_weights: image.invalid_weights,
            dropped: image.dropped,
        })
    }
}

/// Texels as colours and background shares.
fn split(texels: &[f32], colored: bool) -> (Vec<f32>, Vec<f32>) {
    let texels = texels.as_chunks::<4>().0;
    if colored {
        let halves =
            |which: usize| texels.iter().skip(which).step_by(2).flat_map(|t| [t[0], t[1], t[2]]).collect();
        return (halves(0), halves(1));
    }
    (texels.iter().flat_map(|t| [t[0], t[1], t[2]]).collect(), texels.iter().map(|t| t[3]).collect())
}

impl Answer {
    fn frame(
        &self,
        (width, height): (u32, u32),
        variant: &Variant,
        params: Params,
        duplicate: bool,
        threads: usize,
    ) -> Frame {
        #[expect(clippy::cast_precision_loss, reason = "statistics")]
        let mean = self.fragments as f64 / (f64::from(width) * f64::from(height));
        let max = usize::try_from(self.deepest).unwrap_or(usize::MAX);
        let cost = variant.technique.cost(&DepthComplexity { mean, max });
        Frame {
            technique: variant.id,
            params,
            width,
            height,
            color: Arc::clone(&self.color),
            transmittance: Arc::clone(&self.transmittance),
            transmittance_channels: self.channels,
            stats: Stats {
                total_ms: self.raster_ms + self.resolve_ms,
                raster_ms: self.raster_ms,
                resolve_ms: self.resolve_ms,
                fragments: self.fragments,
                depth_complexity_mean: mean,
                depth_complexity_max: self.deepest,
                geometry_passes: cost.geometry_passes,
                bytes_per_pixel: cost.bytes_per_pixel,
                dropped: self.dropped,
                invalid_weights: self.invalid_weights,
                skipped: skipped(&[("duplicate_variants", u64::from(duplicate))]),
                backend: "gpu",
                threads,
            },
        }
    }
}
