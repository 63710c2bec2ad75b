//! Looking inside a technique: its transmittance function at a pixel, and how much it depends on order.

use super::request::Asked;
use super::{Options, PIECE_PIXELS, Request, backgrounds, piece, run_ends};
use crate::error::{Error, Result};
use crate::fragments::Fragments;
use crate::order::SubmissionOrder;
use crate::params::View;
use crate::resolve::{Context, Resolver, Variant, VariantTally};
use crate::technique::{Batch, Cost, DepthComplexity, Resolved};
use crate::threads::with_threads;
use rayon::prelude::*;

/// A pixel's transmittance strictly in front of some depths.
#[derive(Debug, Clone, PartialEq)]
pub struct Transmittance {
    /// The product of 1 - alpha over the fragments nearer than the depth.
    pub exact: Vec<f64>,
    /// What the technique reconstructs.
    pub reconstructed: Vec<f64>,
}

/// The transmittance function of a technique at pixel (x, y), beside the exact step function.
///
/// # Errors
/// [`Error::Argument`] for a pixel outside the image, a depth that is negative or not finite, or a technique
/// that has no transmittance function; [`Error::Param`] as for `render`.
pub fn transmittance(
    fragments: &Fragments,
    request: &Request,
    (x, y): (u32, u32),
    depths: &[f32],
) -> Result<Transmittance> {
    let variant = request.check()?.bind(&fragments.view)?;
    if x >= fragments.width || y >= fragments.height {
        let problem = format!("({x}, {y}) is not in the image of {} x {}", fragments.width, fragments.height);
        return Err(Error::argument("pixel", problem));
    }
    if let Some(i) = depths.iter().position(|z| !(z.is_finite() && *z >= 0.0)) {
        return Err(Error::argument(
            "depths",
            format!("entry {i} is {}, not a finite number >= 0", depths[i]),
        ));
    }
    let i = y as usize * fragments.width as usize + x as usize;
    let list = fragments.lists.as_ref().row(i);
    let exact = depths.iter().map(|&z| {
        let in_front = list.iter().filter(|f| f.depth < z);
        in_front.map(|f| 1.0 - f64::from(f.alpha)).product()
    });
    let exact = exact.collect();
    let background = [fragments.background.at(i)];
    let batch = Batch {
        x,
        y,
        width: 1,
        first: 0,
        lists: fragments.lists.as_ref().rows(i, i + 1),
        sorted: None,
        background: &background,
    };
    let by_centroid = variant.order == SubmissionOrder::Centroid;
    let centroids = with_threads(None, |_| Ok(by_centroid.then(|| fragments.centroid_order())))?;
    let reconstructed = Resolver::default().transmittance(&variant, centroids.as_ref(), &batch, depths)?;
    let none = || Error::argument("technique", format!("{} has no transmittance function", variant.id));
    Ok(Transmittance { exact, reconstructed: reconstructed.ok_or_else(none)? })
}

/// What a streaming GPU implementation of a technique would need for an image so deep.
///
/// # Errors
/// [`Error::Argument`] for a mean that is not a number in `[0, max]`; [`Error::Param`] as for `render`.
pub fn cost(request: &Request, complexity: &DepthComplexity) -> Result<Cost> {
    let DepthComplexity { mean, max } = *complexity;
    #[expect(clippy::cast_precision_loss, reason = "a cost estimate")]
    if !(0.0..=max as f64).contains(&mean) {
        let problem = format!("{mean} is not a number from 0 to depth_complexity_max = {max}");
        return Err(Error::argument("depth_complexity_mean", problem));
    }
    Ok(request.check()?.bind(&View::ORDINARY)?.technique.cost(complexity))
}

/// The variance of every pixel over `shuffles` random submission orders, the mean of its three channels'
/// unbiased variances. A random technique draws the same numbers every time: its seed stays.
///
/// # Errors
/// [`Error::Argument`] for fewer than two shuffles or a technique whose order is its own;
/// [`Error::Cancelled`] once `stop` returns true.
pub fn order_sensitivity(
    fragments: &Fragments,
    request: &Request,
    shuffles: usize,
    seed: u64,
    options: &Options,
    stop: &(dyn Fn() -> bool + Sync),
) -> Result<Vec<f64>> {
    let asked = request.check()?;
    if let Request::Registered(_, params) = request
        && params.iter().any(|(name, _)| name == "submission_order")
    {
        return Err(Error::argument("params", "submission_order is what order_sensitivity varies"));
    }
    if let Asked::Registered(info, _) = asked
        && !info.submission_orders.contains(&"shuffled")
    {
        return Err(Error::argument("technique", format!("{} has an order of its own", info.id)));
    }
    if !(2..=4096).contains(&shuffles) {
        return Err(Error::argument("n", format!("{shuffles} is not in [2, 4096]")));
    }
    let mut variants = Vec::with_capacity(shuffles);
    for shuffle in 0..shuffles as u64 {
        let order = SubmissionOrder::Shuffled { seed: seed.wrapping_add(shuffle) };
        variants.push(Variant { order, ..asked.bind(&fragments.view)? });
    }
    let selected: Vec<_> = (0..shuffles).collect();
    let context =
        Context { variants: &variants, selected: &selected, centroids: None, shortcuts: options.skip, stop };
    with_threads(options.threads, |_| {
        let budget = options.max_fragments / shuffles;
        let pixels = if variants[0].technique.wants_large_batches() {
            // as many as a call is worth while, but no more memory than with so many shuffles and small batches
            (PIECE_PIXELS * 16 / shuffles).clamp(PIECE_PIXELS / 16, PIECE_PIXELS)
        } else {
            PIECE_PIXELS / 16
        };
        let ends = run_ends(fragments, pixels, budget.max(1));
        let starts = std::iter::once(0).chain(ends.iter().copied());
        let pieces: Vec<_> = starts.zip(ends.iter().copied()).collect();
        let variances: Vec<Vec<f64>> = pieces
            .into_par_iter()
            .map(|(first, last)| piece_variance(fragments, &context, first, last))
            .collect::<Result<_>>()?;
        if stop() { Err(Error::Cancelled) } else { Ok(variances.concat()) }
    })
}

fn piece_variance(
    fragments: &Fragments,
    context: &Context<'_>,
    first: usize,
    last: usize,
) -> Result<Vec<f64>> {
    let background = backgrounds(fragments, first..last);
    let batch = piece(fragments, first..last, &background);
    let mut resolved = vec![Vec::new(); context.variants.len()];
    let mut tallies = vec![VariantTally::default(); context.variants.len()];
    Resolver::default().run(context, &batch, 0, &mut resolved, &mut tallies)?;
    Ok((0..last - first).map(|i| variance(resolved.iter().map(|image| image[i]))).collect())
}

#[expect(clippy::cast_precision_loss, reason = "at most 4096 images")]
fn variance(pixels: impl ExactSizeIterator<Item = Resolved> + Clone) -> f64 {
    let n = pixels.len() as f64;
    let mean = pixels.clone().map(|p| p.color / n).sum::<glam::DVec3>();
    let squares: glam::DVec3 = pixels.map(|p| (p.color - mean) * (p.color - mean)).sum();
    squares.element_sum() / (3.0 * (n - 1.0))
}
