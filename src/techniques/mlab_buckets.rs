//! Multi-layer alpha blending with depth buckets, as in transparent line rendering (Kern et al. 2021).

use super::mlab::MERGED;
use crate::continuum::insertion::{Always, Arrival, Insertion};
use crate::continuum::layers::{Node, StoredLayers, Stream};
use crate::continuum::merge::{Merge, merge_pair};
use crate::continuum::nodes::{LAYERS, Nodes};
use crate::continuum::normalize::Unnormalized;
use crate::continuum::opacity::{Alpha, Opacity};
use crate::continuum::range::{DepthRange, Interval, cell};
use crate::error::Result;
use crate::fragments::{Fragment, List};
use crate::gpu::form::{Form, MOST_LAYERS, Number, Path, Streaming, at_most, layers, only_default_formats};
use crate::order::sort_key;
use crate::params::{Kind, ParamSpec, Params, Value, View};
use crate::technique::{AnyTechnique, Axes, Cost, Info, Pixel, Properties};
use crate::techniques::ANY_ORDER;
use std::ops::Range;

/// The registry entry.
pub static INFO: Info = Info {
    id: "mlab_buckets",
    aliases: &[],
    name: "Multi-layer alpha blending with depth buckets",
    citation: &["Kern2021", "Salvi2014"],
    doc: "One list spends its layers on whatever arrives first; buckets save some for what decides. min_depth, \
          the published form, finds the nearest fragment that is not faint, merges all in front of it into one \
          layer, and drops what lies behind the nearest opaque one. depth keeps a list in each of a few \
          intervals; transmittance opens another list behind one that hides most.",
    axes: Axes {
        memory: "k layers",
        insertion: "always",
        merge: "merge furthest in a bucket",
        normalize: "no",
        opacity: "alpha",
    },
    params: &[
        ParamSpec::new("layers", Kind::at_least(1), Value::Int(4), "layers per pixel (min_depth) or bucket"),
        ParamSpec::new(
            "mode",
            Kind::Choice(&["min_depth", "depth", "transmittance"]),
            Value::Text("min_depth"),
            "what buckets divide: what is in front of the first surface from the rest, depth, or transmittance",
        ),
        ParamSpec::new("buckets", Kind::at_least(1), Value::Int(4), "lists per pixel, at most")
            .when(|p| p.text("mode") != "min_depth"),
        ParamSpec::new(
            "front_threshold",
            Kind::REAL,
            Value::Float(0.2),
            "the first surface is the nearest fragment of a larger alpha; below 0 it is the nearest fragment",
        )
        .when(|p| p.text("mode") == "min_depth"),
        ParamSpec::new(
            "opaque_threshold",
            Kind::REAL,
            Value::Float(0.98),
            "what is behind a fragment of at least this alpha is dropped; above 1 nothing is",
        )
        .when(|p| p.text("mode") == "min_depth"),
        ParamSpec::new(
            "transmittance_threshold",
            Kind::float(0.0, 1.0),
            Value::Float(0.1),
            "a full list that lets less than this through is split rather than merged",
        )
        .when(|p| p.text("mode") == "transmittance"),
        DepthRange::param("pixel").when(|p| p.text("mode") == "depth"),
    ],
    targets: &LAYERS,
    submission_orders: ANY_ORDER,
    random: false,
    geometry_passes: "min_depth: 2; depth: 1, 1 more for range=\"pixel\"; transmittance: 1",
    bytes_per_pixel: "min_depth: 20 layers + 8; depth: 20 layers buckets, 8 more for range=\"pixel\"; \
                      transmittance: 20 layers buckets; half of a layer in f16, 8 as rgba8 and an f32",
    build,
    gpu: Some(gpu),
};

fn build(params: &Params, view: &View) -> Result<Box<dyn AnyTechnique>> {
    let nodes = Nodes::from_params(INFO.targets, params, view);
    let node = nodes.bytes;
    let (layers, buckets) = (params.size("layers"), params.size("buckets"));
    let all = layers.saturating_mul(buckets);
    Ok(match params.text("mode") {
        "depth" => {
            let range = DepthRange::from_params(params, view);
            let find = f64::from(u8::from(range == DepthRange::Pixel));
            let cost = Cost { geometry_passes: 1.0 + find, ..Cost::list(all, node, 8.0 * find) };
            buckets_of(layers, Always, DepthBuckets { buckets, range }, cost, MERGED).stored(nodes)
        }
        "transmittance" => {
            let threshold = params.float("transmittance_threshold");
            let merge = TransmittanceBuckets { buckets, threshold };
            buckets_of(layers, Always, merge, Cost::list(all, node, 0.0), MERGED).stored(nodes)
        }
        _ => {
            let (front, opaque) = (params.float("front_threshold"), params.float("opaque_threshold"));
            let cost = Cost { geometry_passes: 2.0, ..Cost::list(layers, node, 8.0) };
            let insertion = NotBehindOpaque { threshold: opaque };
            let merge = FrontBucket { threshold: front };
            buckets_of(layers, insertion, merge, cost, min_depth_properties(front, opaque)).stored(nodes)
        }
    })
}

/// Its form on a GPU, with f32 nodes.
fn gpu(params: &Params, view: &View) -> Result<Form> {
    only_default_formats(params, INFO.targets)?;
    let layers = layers(params)?;
    let (mode, nodes, buckets) = match params.text("mode") {
        // a bucket at a time
        "depth" => (DEPTH, layers, at_most(params, "buckets", MOST_BUCKETS)?),
        "transmittance" => {
            let buckets = at_most(params, "buckets", MOST_LAYERS / layers)?;
            (TRANSMITTANCE, layers * buckets, buckets)
        }
        // one in front, one behind
        _ => (MIN_DEPTH, layers.max(2), 0),
    };
    let [front, opaque, dark] = ["front_threshold", "opaque_threshold", "transmittance_threshold"]
        .map(|threshold| params.float(threshold));
    let (of_pixel, nearest, farthest) = match DepthRange::from_params(params, view) {
        DepthRange::Pixel => (true, 0.0, 0.0),
        DepthRange::Fixed(lo, hi) => (false, lo, hi),
    };
    let numbers = vec![
        Number::Whole(layers),
        Number::Whole(buckets),
        Number::below(front),
        Number::above(opaque),
        Number::above(dark),
        Number::Whole(of_pixel.into()),
        Number::float(nearest),
        Number::float(farthest),
    ];
    let stream = Streaming::as_submitted(params).of_layers(nodes).of_sizes(vec![("MODE", mode)]);
    Ok(Form {
        weight: None,
        shader: include_str!("../../shaders/mlab_buckets.wgsl"),
        numbers,
        path: Path::Streamed(stream.in_walks()),
        shows_zero_fragments: false,
        colored_transmittance: false,
    })
}

/// Modes, as the shader numbers them.
const DEPTH: u32 = 0;
const TRANSMITTANCE: u32 = 1;
const MIN_DEPTH: u32 = 2;

/// Buckets of a depth range on a GPU, at most: each takes a walk over the pixel's fragments.
const MOST_BUCKETS: u32 = 512;

fn buckets_of<I, M>(
    layers: usize,
    insertion: I,
    merge: M,
    cost: Cost,
    properties: Properties,
) -> StoredLayers<I, M, Alpha, Unnormalized> {
    let stream = Stream { insertion, merge, opacity: Alpha, layers };
    StoredLayers { stream, normalize: Unnormalized, cost, properties }
}

/// One front layer for any number of faint fragments, or dropping behind the opaque, costs exactness however
/// large k is.
fn min_depth_properties(front: f64, opaque: f64) -> Properties {
    let whole = opaque > 1.0;
    Properties {
        // the nearest fragment hides all others
        order_independent: opaque <= 0.0,
        consistent: whole && front < 0.0,
        exact_for_one_color: whole,
        exact_coverage: whole,
        ..MERGED
    }
}

/// The (depth, primitive) of the nearest fragment of which `is_it`.
fn nearest(list: List<'_>, is_it: impl Fn(&Fragment) -> bool) -> Option<u64> {
    list.iter().filter(is_it).map(|f| sort_key(f.depth, f.primitive)).min()
}

/// Fragments that are not behind the nearest opaque one.
struct NotBehindOpaque {
    /// The alpha at which a fragment counts as opaque.
    threshold: f64,
}

impl<O: Opacity> Insertion<O> for NotBehindOpaque {
    /// The nearest opaque fragment.
    type State = u64;

    fn begin(&self, pixel: &Pixel<'_>, opaque: &mut u64) {
        *opaque = nearest(pixel.list, |f| f64::from(f.alpha) >= self.threshold).unwrap_or(u64::MAX);
    }
    fn admit(&self, arrival: &Arrival<'_, O>, opaque: &mut u64) -> Option<O::Paint> {
        if arrival.key <= *opaque { arrival.paint() } else { None }
    }
}

/// One layer for all that is in front of the first surface, the other layers for the rest.
struct FrontBucket {
    /// The first surface is the nearest fragment of a larger alpha.
    threshold: f64,
}

impl FrontBucket {
    fn split<P>(nodes: &[Node<P>], surface: u64) -> usize {
        nodes.partition_point(|node| node.key < surface)
    }
}

impl<O: Opacity> Merge<O> for FrontBucket {
    /// The first surface.
    type State = u64;

    fn begin(&self, _opacity: &O, pixel: &Pixel<'_>, _nodes: &mut Vec<Node<O::Paint>>, surface: &mut u64) {
        *surface = nearest(pixel.list, |f| f64::from(f.alpha) > self.threshold).unwrap_or(u64::MAX);
    }
    fn is_overfull(
        &self,
        nodes: &[Node<O::Paint>],
        _newcomer: usize,
        layers: usize,
        surface: &mut u64,
    ) -> bool {
        let front = Self::split(nodes, *surface);
        front > 1 || nodes.len() - front > (layers - 1).max(1)
    }
    fn make_room(
        &self,
        opacity: &O,
        nodes: &mut Vec<Node<O::Paint>>,
        _newcomer: usize,
        surface: &mut u64,
        _lost: &mut Vec<u32>,
    ) {
        let overfull = if Self::split(nodes, *surface) > 1 { 0 } else { nodes.len() - 2 };
        merge_pair(opacity, nodes, overfull);
    }
}

/// A list in each of a few equal intervals of a logarithmic scale of depth.
struct DepthBuckets {
    buckets: usize,
    range: DepthRange,
}

impl DepthBuckets {
    /// The nodes that share a bucket with the newcomer.
    fn bucket<P>(&self, nodes: &[Node<P>], newcomer: usize, interval: &Interval) -> Range<usize> {
        let bucket = |node: &Node<P>| cell(interval.log_position(node.depth()), self.buckets).0;
        let own = bucket(&nodes[newcomer]);
        let before = nodes[..newcomer].iter().rev().take_while(|node| bucket(node) == own).count();
        let after = nodes[newcomer..].iter().take_while(|node| bucket(node) == own).count();
        newcomer - before..newcomer + after
    }
}

impl<O: Opacity> Merge<O> for DepthBuckets {
    type State = Interval;

    fn begin(
        &self,
        _opacity: &O,
        pixel: &Pixel<'_>,
        _nodes: &mut Vec<Node<O::Paint>>,
        interval: &mut Interval,
    ) {
        *interval = self.range.interval(pixel.list);
    }
    fn is_overfull(
        &self,
        nodes: &[Node<O::Paint>],
        newcomer: usize,
        layers: usize,
        interval: &mut Interval,
    ) -> bool {
        self.bucket(nodes, newcomer, interval).len() > layers
    }
    fn make_room(
        &self,
        opacity: &O,
        nodes: &mut Vec<Node<O::Paint>>,
        newcomer: usize,
        interval: &mut Interval,
        _lost: &mut Vec<u32>,
    ) {
        let bucket = self.bucket(nodes, newcomer, interval);
        merge_pair(opacity, nodes, bucket.end - 2);
    }
}

/// Lists that split where little light is left.
struct TransmittanceBuckets {
    buckets: usize,
    /// A full list that lets less through is split.
    threshold: f64,
}

/// Which of the lists that begin at `starts` holds node `i`.
fn list_of(starts: &[usize], i: usize) -> usize {
    starts.partition_point(|start| *start <= i) - 1
}

impl<O: Opacity> Merge<O> for TransmittanceBuckets {
    /// The places where lists begin.
    type State = Vec<usize>;

    fn begin(
        &self,
        _opacity: &O,
        _pixel: &Pixel<'_>,
        _nodes: &mut Vec<Node<O::Paint>>,
        starts: &mut Vec<usize>,
    ) {
        starts.clear();
        starts.push(0);
    }
    /// A newcomer belongs to the last list that begins in front of it, or else to the first.
    fn is_overfull(
        &self,
        nodes: &[Node<O::Paint>],
        newcomer: usize,
        layers: usize,
        starts: &mut Vec<usize>,
    ) -> bool {
        starts[1..].iter_mut().filter(|start| **start >= newcomer).for_each(|start| *start += 1);
        let own = list_of(starts, newcomer);
        let end = starts.get(own + 1).copied().unwrap_or(nodes.len());
        end - starts[own] > layers
    }
    fn make_room(
        &self,
        opacity: &O,
        nodes: &mut Vec<Node<O::Paint>>,
        newcomer: usize,
        starts: &mut Vec<usize>,
        _lost: &mut Vec<u32>,
    ) {
        let own = list_of(starts, newcomer);
        let (start, end) = (starts[own], starts.get(own + 1).copied().unwrap_or(nodes.len()));
        let is_dark = opacity.transmittance(&nodes[start..end]) < self.threshold;
        if starts.len() < self.buckets && is_dark && newcomer != start {
            starts.insert(own + 1, newcomer);
        } else {
            merge_pair(opacity, nodes, end - 2);
            starts[own + 1..].iter_mut().for_each(|start| *start -= 1);
        }
    }
}

#[cfg(test)]
mod tests;
