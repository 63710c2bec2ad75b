//! The axis *merge*: how a list that holds one node too many makes room.

use super::layers::Node;
use super::opacity::Opacity;
use super::range::{DepthRange, Interval, cell};
use crate::technique::Pixel;
use std::hint::select_unpredictable;

/// What happens on overflow.
pub trait Merge<O: Opacity>: Send + Sync + 'static {
    /// What must be known of the pixel.
    type State: Default;
    /// Nodes that the list holds besides its layers.
    const EXTRA_NODES: usize = 0;

    /// Prepares an empty list.
    fn begin(
        &self,
        _opacity: &O,
        _pixel: &Pixel<'_>,
        _nodes: &mut Vec<Node<O::Paint>>,
        _state: &mut Self::State,
    ) {
    }

    /// Whether `nodes`, to which `nodes[newcomer]` came last, are too many for a list of `layers`. Asked after
    /// every insertion.
    fn is_overfull(
        &self,
        nodes: &[Node<O::Paint>],
        _newcomer: usize,
        layers: usize,
        _state: &mut Self::State,
    ) -> bool {
        nodes.len() > layers.saturating_add(Self::EXTRA_NODES)
    }

    /// Whether a newcomer at that place would be discarded at once, so that it need not be looked at.
    fn is_beyond(&self, _newcomer: usize, _layers: usize) -> bool {
        false
    }

    /// Removes the node that is one too many. `lost` gets the source of what is discarded.
    fn make_room(
        &self,
        opacity: &O,
        nodes: &mut Vec<Node<O::Paint>>,
        newcomer: usize,
        state: &mut Self::State,
        lost: &mut Vec<u32>,
    );

    /// Inserts a node into a list of `layers` that is full, and makes room for it where it needs room. Merges
    /// that know the outcome beforehand move fewer nodes.
    #[expect(clippy::too_many_arguments, reason = "those of an insertion and of make_room")]
    fn insert_into_full(
        &self,
        opacity: &O,
        nodes: &mut Vec<Node<O::Paint>>,
        at: usize,
        newcomer: Node<O::Paint>,
        layers: usize,
        state: &mut Self::State,
        lost: &mut Vec<u32>,
    ) {
        nodes.insert(at, newcomer);
        if self.is_overfull(nodes, at, layers, state) {
            self.make_room(opacity, nodes, at, state, lost);
        }
    }
}

/// Merges node `j + 1` into the adjacent node `j`, which keeps its place.
pub fn merge_pair<O: Opacity>(opacity: &O, nodes: &mut Vec<Node<O::Paint>>, j: usize) {
    let behind = nodes.remove(j + 1);
    opacity.merge(&mut nodes[j].paint, &behind.paint);
}

/// What inserting a node in place `at` and then merging nodes j and j + 1 comes to, with only those moved that
/// lie between.
fn insert_and_merge_pair<O: Opacity>(
    opacity: &O,
    nodes: &mut [Node<O::Paint>],
    at: usize,
    mut newcomer: Node<O::Paint>,
    j: usize,
) {
    if j + 1 == at {
        opacity.merge(&mut nodes[j].paint, &newcomer.paint);
    } else if j == at {
        opacity.merge(&mut newcomer.paint, &nodes[at].paint);
        nodes[at] = newcomer;
    } else if j < at {
        let (front, behind) = nodes.split_at_mut(j + 1);
        opacity.merge(&mut front[j].paint, &behind[0].paint);
        nodes[j + 1..at].rotate_left(1);
        nodes[at - 1] = newcomer;
    } else {
        let (front, behind) = nodes.split_at_mut(j);
        opacity.merge(&mut front[j - 1].paint, &behind[0].paint);
        nodes[at..=j].rotate_right(1);
        nodes[at] = newcomer;
    }
}

/// A list that a newcomer would make longer.
struct Extended<'a, P> {
    nodes: &'a [Node<P>],
    at: usize,
    newcomer: &'a Node<P>,
}

impl<P> Extended<'_, P> {
    fn len(&self) -> usize {
        self.nodes.len() + 1
    }
    fn node(&self, i: usize) -> &Node<P> {
        if i == self.at { self.newcomer } else { &self.nodes[i - usize::from(i > self.at)] }
    }
}

/// The furthest node is discarded.
#[derive(Debug, Clone, Copy)]
pub struct DiscardFurthest;

impl<O: Opacity> Merge<O> for DiscardFurthest {
    type State = ();

    fn is_beyond(&self, newcomer: usize, layers: usize) -> bool {
        newcomer >= layers
    }
    fn make_room(
        &self,
        _opacity: &O,
        nodes: &mut Vec<Node<O::Paint>>,
        _newcomer: usize,
        (): &mut (),
        lost: &mut Vec<u32>,
    ) {
        lost.extend(nodes.pop().map(|node| node.source));
    }
}

/// The two furthest nodes become one (MLAB).
#[derive(Debug, Clone, Copy)]
pub struct OverFurthest;

impl<O: Opacity> Merge<O> for OverFurthest {
    type State = ();
    fn make_room(
        &self,
        opacity: &O,
        nodes: &mut Vec<Node<O::Paint>>,
        _newcomer: usize,
        (): &mut (),
        _lost: &mut Vec<u32>,
    ) {
        merge_pair(opacity, nodes, nodes.len() - 2);
    }
    fn insert_into_full(
        &self,
        opacity: &O,
        nodes: &mut Vec<Node<O::Paint>>,
        at: usize,
        newcomer: Node<O::Paint>,
        _layers: usize,
        (): &mut (),
        _lost: &mut Vec<u32>,
    ) {
        let furthest = nodes.len() - 1;
        insert_and_merge_pair(opacity, nodes, at, newcomer, furthest);
    }
}

/// The nearest node is flushed into an accumulator that counts as in front of all later arrivals (k-buffer).
#[derive(Debug, Clone, Copy)]
pub struct OverNearest;

impl<O: Opacity> Merge<O> for OverNearest {
    type State = ();
    const EXTRA_NODES: usize = 1;

    /// The accumulator is node 0: no key is smaller than its, and a newcomer goes behind its equals.
    fn begin(&self, opacity: &O, _pixel: &Pixel<'_>, nodes: &mut Vec<Node<O::Paint>>, (): &mut ()) {
        nodes.push(Node { key: 0, source: u32::MAX, paint: opacity.empty() });
    }
    fn make_room(
        &self,
        opacity: &O,
        nodes: &mut Vec<Node<O::Paint>>,
        _newcomer: usize,
        (): &mut (),
        _lost: &mut Vec<u32>,
    ) {
        merge_pair(opacity, nodes, 0);
    }
    fn insert_into_full(
        &self,
        opacity: &O,
        nodes: &mut Vec<Node<O::Paint>>,
        at: usize,
        newcomer: Node<O::Paint>,
        _layers: usize,
        (): &mut (),
        _lost: &mut Vec<u32>,
    ) {
        insert_and_merge_pair(opacity, nodes, at, newcomer, 0);
    }
}

/// The two adjacent nodes with the smallest gap become one (Z³), the nearest of such pairs.
#[derive(Debug, Clone, Copy)]
pub struct OverClosest {
    /// Whether the merged node moves to the mean depth; otherwise it stays at the nearer one.
    pub mean_depth: bool,
}

impl<O: Opacity> Merge<O> for OverClosest {
    type State = ();
    fn make_room(
        &self,
        opacity: &O,
        nodes: &mut Vec<Node<O::Paint>>,
        newcomer_at: usize,
        (): &mut (),
        lost: &mut Vec<u32>,
    ) {
        let newcomer = nodes.remove(newcomer_at);
        self.insert_into_full(opacity, nodes, newcomer_at, newcomer, usize::MAX, &mut (), lost);
    }
    fn insert_into_full(
        &self,
        opacity: &O,
        nodes: &mut Vec<Node<O::Paint>>,
        at: usize,
        mut newcomer: Node<O::Paint>,
        _layers: usize,
        (): &mut (),
        _lost: &mut Vec<u32>,
    ) {
        let all = Extended { nodes, at, newcomer: &newcomer };
        let depth = |i: usize| f64::from(all.node(i).depth());
        let mut nearer = depth(0);
        let gap = |j: usize| {
            let further = depth(j + 1);
            let gap = further - nearer;
            nearer = further;
            gap
        };
        let j = smallest(0..all.len() - 1, gap);
        if self.mean_depth {
            // the mean of neighbours is between them, so the order of nodes stays
            let (front, behind) = (all.node(j).depth(), all.node(j + 1).depth());
            let mean = opacity.place(f32::midpoint(front, behind)).max(front).min(behind);
            let kept = if j == at { &mut newcomer } else { &mut nodes[j - usize::from(j > at)] };
            kept.set_depth(mean);
        }
        insert_and_merge_pair(opacity, nodes, at, newcomer, j);
    }
}

/// The step of the transmittance function is removed that changes the area under it least (adaptive
/// transparency): `e_j = (z_j − z_{j−1}) (T_{j−1} − T_j)`, first on ties. The nearer node takes over what the
/// step absorbs, so T is never overestimated.
#[derive(Debug, Clone, Copy)]
pub struct SmallestError {
    /// The first nodes, which are never removed, though they may take over others; at least 1.
    pub protected: usize,
}

impl<O: Opacity> Merge<O> for SmallestError {
    type State = ();
    fn make_room(
        &self,
        opacity: &O,
        nodes: &mut Vec<Node<O::Paint>>,
        newcomer_at: usize,
        (): &mut (),
        lost: &mut Vec<u32>,
    ) {
        let newcomer = nodes.remove(newcomer_at);
        self.insert_into_full(opacity, nodes, newcomer_at, newcomer, usize::MAX, &mut (), lost);
    }
    fn insert_into_full(
        &self,
        opacity: &O,
        nodes: &mut Vec<Node<O::Paint>>,
        at: usize,
        newcomer: Node<O::Paint>,
        _layers: usize,
        (): &mut (),
        _lost: &mut Vec<u32>,
    ) {
        let all = Extended { nodes, at, newcomer: &newcomer };
        let behind = |shown, i: usize| opacity.behind(shown, &all.node(i).paint);
        let mut in_front = (0..self.protected).fold(opacity.clear(), behind);
        let mut nearer = f64::from(all.node(self.protected - 1).depth());
        let error = |j: usize| {
            let (behind, further) = (behind(in_front, j), f64::from(all.node(j).depth()));
            let error = (further - nearer) * (in_front - behind);
            (in_front, nearer) = (behind, further);
            error
        };
        let j = smallest(self.protected..all.len(), error);
        insert_and_merge_pair(opacity, nodes, at, newcomer, j - 1);
    }
}

/// Where `measure` is smallest, first on ties.
fn smallest(places: std::ops::Range<usize>, mut measure: impl FnMut(usize) -> f64) -> usize {
    let mut best = (places.start, f64::INFINITY);
    for j in places {
        let size = measure(j);
        best = select_unpredictable(size < best.1, (j, size), best);
    }
    best.0
}

/// The newcomer goes over the one node there is, wherever they are (alpha compositing).
#[derive(Debug, Clone, Copy)]
pub struct OverArrival;

impl<O: Opacity> Merge<O> for OverArrival {
    type State = ();
    fn make_room(
        &self,
        opacity: &O,
        nodes: &mut Vec<Node<O::Paint>>,
        newcomer: usize,
        (): &mut (),
        _lost: &mut Vec<u32>,
    ) {
        let node = nodes.remove(1 - newcomer);
        opacity.merge(&mut nodes[0].paint, &node.paint);
    }
}

/// There is room for all.
#[derive(Debug, Clone, Copy)]
pub struct NoMerge;

impl<O: Opacity> Merge<O> for NoMerge {
    type State = ();
    fn make_room(
        &self,
        _opacity: &O,
        _nodes: &mut Vec<Node<O::Paint>>,
        _newcomer: usize,
        (): &mut (),
        _lost: &mut Vec<u32>,
    ) {
        unreachable!("an unbounded list does not overflow")
    }
}

/// The depth range is divided in bins, and of two nodes in one bin the further one is discarded (bucket
/// peeling). The list has room for a node in each bin.
#[derive(Debug, Clone, Copy)]
pub struct DiscardOccupied {
    /// How many.
    pub bins: usize,
    /// What they divide.
    pub range: DepthRange,
}

impl<O: Opacity> Merge<O> for DiscardOccupied {
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
        _layers: usize,
        interval: &mut Interval,
    ) -> bool {
        let bin = |node: &Node<O::Paint>| cell(interval.position(node.depth()), self.bins).0;
        let own = bin(&nodes[newcomer]);
        let behind = nodes.get(newcomer + 1).is_some_and(|node| bin(node) == own);
        behind || newcomer.checked_sub(1).is_some_and(|i| bin(&nodes[i]) == own)
    }
    /// The further one of the two is the newcomer, unless it is the node behind it.
    fn make_room(
        &self,
        _opacity: &O,
        nodes: &mut Vec<Node<O::Paint>>,
        newcomer: usize,
        interval: &mut Interval,
        lost: &mut Vec<u32>,
    ) {
        let bin = |node: &Node<O::Paint>| cell(interval.position(node.depth()), self.bins).0;
        let is_nearer = nodes.get(newcomer + 1).is_some_and(|node| bin(node) == bin(&nodes[newcomer]));
        lost.push(nodes.remove(newcomer + usize::from(is_nearer)).source);
    }
}

/// Nodes that nothing shows of are discarded: the depth test of samples.
#[derive(Debug, Clone, Copy)]
pub struct DiscardOccluded;

impl<O: Opacity> Merge<O> for DiscardOccluded {
    type State = ();

    fn is_overfull(&self, _nodes: &[Node<O::Paint>], _newcomer: usize, _layers: usize, (): &mut ()) -> bool {
        true
    }
    fn make_room(
        &self,
        opacity: &O,
        nodes: &mut Vec<Node<O::Paint>>,
        newcomer: usize,
        (): &mut (),
        lost: &mut Vec<u32>,
    ) {
        let shows = |node: &Node<O::Paint>| opacity.behind(opacity.clear(), &node.paint) < opacity.clear();
        lost.extend(nodes.extract_if(newcomer.., |node| !shows(node)).map(|node| node.source));
    }
}
