//! Lists of k layers: fragments stream into nodes sorted by (depth, primitive) under one choice of each axis
//! (sheet 2.3). A technique names its choices; everything is monomorphised.

use super::insertion::{Arrival, Insertion};
use super::merge::Merge;
use super::nodes::Nodes;
use super::normalize::Normalize;
use super::opacity::{Alpha, Opacity};
use super::oracle::{Composite, Oracle};
use super::placed::Placed;
use super::search::count_leading;
use super::steps::Steps;
use super::stored_layers::StoredAlpha;
use crate::diagnosis::{Diagnosis, Faults};
use crate::fragments::Fragment;
use crate::order::sort_key;
use crate::technique::{AnyTechnique, Cost, DepthComplexity, Pixel, Properties, Resolved, Technique};

/// A stored layer.
#[derive(Debug, Clone)]
pub struct Node<P> {
    /// (depth, primitive) as one ordered integer; of the nearer one where two were merged.
    pub key: u64,
    /// The place in the pixel's list of the fragment it began as.
    pub source: u32,
    /// What it looks like.
    pub paint: P,
}

impl<P> Node<P> {
    /// View-space distance.
    pub fn depth(&self) -> f32 {
        f32::from_bits((self.key >> 32) as u32)
    }
    /// Moves the node, which keeps its primitive.
    pub fn set_depth(&mut self, depth: f32) {
        #[expect(clippy::cast_possible_truncation, reason = "the key's lower half")]
        let primitive = self.key as u32;
        self.key = sort_key(depth, primitive);
    }
}

/// Where in a list sorted by key a newcomer belongs: behind its equals.
pub fn place_of<P>(nodes: &[Node<P>], key: u64) -> usize {
    count_leading(nodes, |node| node.key <= key)
}

/// A choice on the axes that shape the list itself.
#[derive(Debug, Clone, Copy)]
pub struct Stream<I, M, O> {
    /// Which fragments enter.
    pub insertion: I,
    /// What gives way on overflow.
    pub merge: M,
    /// How layers cover.
    pub opacity: O,
    /// k, the number of nodes.
    pub layers: usize,
}

/// One pixel's list.
#[derive(Debug)]
pub struct Stored<P, S> {
    /// The nodes, nearest first.
    pub nodes: Vec<Node<P>>,
    /// The places in the pixel's list of the fragments that were refused or discarded.
    pub lost: Vec<u32>,
    /// What insertion and merge remember.
    state: S,
}

impl<P, S: Default> Default for Stored<P, S> {
    fn default() -> Self {
        Self { nodes: Vec::new(), lost: Vec::new(), state: S::default() }
    }
}

/// What the insertion `I` and the merge `M` remember of a pixel.
type States<I, M, O> = (<I as Insertion<O>>::State, <M as Merge<O>>::State);

impl<I: Insertion<O>, M: Merge<O>, O: Opacity> Stream<I, M, O> {
    /// Streams the pixel's fragments, in submission order, into an empty list.
    pub fn store(&self, pixel: &Pixel<'_>, stored: &mut Stored<O::Paint, States<I, M, O>>) {
        stored.nodes.clear();
        stored.lost.clear();
        self.insertion.begin(pixel, &mut stored.state.0);
        self.merge.begin(&self.opacity, pixel, &mut stored.nodes, &mut stored.state.1);
        for (source, fragment) in (0..).zip(pixel.list.iter()) {
            self.receive(pixel, &fragment, source, stored);
        }
    }

    fn receive(
        &self,
        pixel: &Pixel<'_>,
        fragment: &Fragment,
        source: u32,
        stored: &mut Stored<O::Paint, States<I, M, O>>,
    ) {
        let Stored { nodes, lost, state: (insertion, merge) } = stored;
        let key = sort_key(fragment.depth, fragment.primitive);
        let at = place_of(nodes, key);
        if self.merge.is_beyond(at, self.layers) {
            lost.push(source);
            return;
        }
        let arrival = Arrival { pixel, fragment, key, in_front: &nodes[..at], opacity: &self.opacity };
        let Some(paint) = self.insertion.admit(&arrival, insertion) else {
            lost.push(source);
            return;
        };
        let node = Node { key, source, paint };
        if !O::OCCLUDES && nodes.len() == self.layers.saturating_add(M::EXTRA_NODES) {
            return self.merge.insert_into_full(&self.opacity, nodes, at, node, self.layers, merge, lost);
        }
        nodes.insert(at, node);
        self.opacity.occlude(nodes, at);
        if self.merge.is_overfull(nodes, at, self.layers, merge) {
            self.merge.make_room(&self.opacity, nodes, at, merge, lost);
        }
    }

    /// The step function of what is stored, strictly in front of each depth.
    fn steps(&self, nodes: &[Node<O::Paint>], depths: &[f32]) -> Vec<f64> {
        let in_front = |depth: f32| nodes.partition_point(|node| node.key < sort_key(depth, 0));
        depths.iter().map(|&depth| self.opacity.transmittance(&nodes[..in_front(depth)])).collect()
    }
}

/// A technique that composites the layers it stored (`accumulate="stored"`).
pub struct StoredLayers<I, M, O, N> {
    /// How layers are stored.
    pub stream: Stream<I, M, O>,
    /// What is done about the others.
    pub normalize: N,
    /// The modelled cost.
    pub cost: Cost,
    /// The promises.
    pub properties: Properties,
}

impl<I, M, N> StoredLayers<I, M, Alpha, N>
where
    I: Insertion<Alpha> + Insertion<StoredAlpha>,
    M: Merge<Alpha> + Merge<StoredAlpha>,
    N: Normalize,
{
    /// The technique, with nodes as they are to be stored.
    pub fn stored(self, nodes: Nodes) -> Box<dyn AnyTechnique> {
        if nodes.are_default { Box::new(self) } else { self.with_opacity(nodes.alpha()).placed(nodes) }
    }
}

impl<I, M, O, N> StoredLayers<I, M, O, N> {
    /// The same choices on the other axes.
    pub fn with_opacity<P>(self, opacity: P) -> StoredLayers<I, M, P, N> {
        let Self { stream: Stream { insertion, merge, layers, .. }, normalize, cost, properties } = self;
        StoredLayers { stream: Stream { insertion, merge, opacity, layers }, normalize, cost, properties }
    }
}

impl<I: Insertion<O>, M: Merge<O>, O: Opacity, N: Normalize> StoredLayers<I, M, O, N> {
    /// The technique with depths and promises of these nodes.
    pub fn placed(mut self, nodes: Nodes) -> Box<dyn AnyTechnique> {
        self.properties = nodes.promises(self.properties);
        Box::new(Placed::new(self, nodes.depths))
    }
}

/// One pixel's list and, where the tail is weighted, its weights.
pub struct StoredScratch<P, S> {
    stored: Stored<P, S>,
    weights: Vec<f32>,
}

impl<P, S: Default> Default for StoredScratch<P, S> {
    fn default() -> Self {
        Self { stored: Stored::default(), weights: Vec::new() }
    }
}

impl<I: Insertion<O>, M: Merge<O>, O: Opacity, N: Normalize> Technique for StoredLayers<I, M, O, N> {
    type Scratch = StoredScratch<O::Paint, States<I, M, O>>;
    const SEES_ZERO_FRAGMENTS: bool = N::SEES_ZERO_FRAGMENTS;

    fn resolve(&self, pixel: &Pixel<'_>, scratch: &mut Self::Scratch) -> Resolved {
        let StoredScratch { stored, weights } = scratch;
        self.stream.store(pixel, stored);
        let core = self.stream.opacity.composite(&stored.nodes);
        self.normalize.resolve(pixel, &core, &stored.lost, weights)
    }

    fn transmittance(
        &self,
        pixel: &Pixel<'_>,
        depths: &[f32],
        scratch: &mut Self::Scratch,
    ) -> Option<Vec<f64>> {
        self.stream.store(pixel, &mut scratch.stored);
        Some(self.stream.steps(&scratch.stored.nodes, depths))
    }

    fn faults(&self) -> Faults {
        self.stream.opacity.faults()
    }

    /// What befalls fragments as they are written into nodes; what merging does to nodes is not looked at.
    fn diagnose(&self, pixel: &Pixel<'_>, _scratch: &mut Self::Scratch) -> Diagnosis {
        let mut found = Diagnosis::CLEAR;
        let nodes = pixel.list.iter().filter_map(|fragment| self.stream.insertion.node(&fragment));
        nodes.for_each(|node| found.count_all(self.stream.opacity.written(&node)));
        found
    }

    fn cost(&self, _complexity: &DepthComplexity) -> Cost {
        self.cost
    }

    fn properties(&self) -> Properties {
        self.properties
    }
}

/// The step function of stored layers, for a second pass over all fragments (`accumulate="all"`).
pub struct StoredSteps<I, M, O> {
    /// How layers are stored.
    pub stream: Stream<I, M, O>,
    /// The modelled cost, both passes together.
    pub cost: Cost,
    /// The promises.
    pub properties: Properties,
}

/// A pixel's list and its step function.
pub struct StoredMap<P, S> {
    stored: Stored<P, S>,
    steps: Steps,
}

impl<P, S: Default> Default for StoredMap<P, S> {
    fn default() -> Self {
        Self { stored: Stored::default(), steps: Steps::default() }
    }
}

impl<I: Insertion<O>, M: Merge<O>, O: Opacity> Oracle for StoredSteps<I, M, O> {
    type Map = StoredMap<O::Paint, States<I, M, O>>;

    fn build(&self, pixel: &Pixel<'_>, map: &mut Self::Map) {
        self.stream.store(pixel, &mut map.stored);
        let opacity = &self.stream.opacity;
        let mut shown = opacity.clear();
        map.steps.clear();
        for node in &map.stored.nodes {
            shown = opacity.behind(shown, &node.paint);
            map.steps.push(node.key, shown / opacity.clear());
        }
    }
    fn in_front_of(&self, map: &Self::Map, fragment: &Fragment) -> f64 {
        map.steps.in_front_of(sort_key(fragment.depth, fragment.primitive))
    }
    fn at(&self, map: &Self::Map, depth: f32) -> f64 {
        map.steps.at(depth)
    }
    fn total(&self, map: &Self::Map) -> f64 {
        map.steps.total()
    }
    fn cost(&self, _complexity: &DepthComplexity) -> Cost {
        self.cost
    }
    fn properties(&self, _composite: Composite) -> Properties {
        self.properties
    }
}
