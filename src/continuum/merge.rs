//! The axis *merge*: how a list that holds one node too many makes room.

use super::layers::Node;
use super::opacity::Opacity;
use super::range::{DepthRange, Interval, cell};
use crate::technique::Pixel;

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
}

/// Merges node `j + 1` into the adjacent node `j`, which keeps its place.
pub fn merge_pair<O: Opacity>(opacity: &O, nodes: &mut Vec<Node<O::Paint>>, j: usize) {
    let behind = nodes.remove(j + 1);
    opacity.merge(&mut nodes[j].paint, &behind.paint);
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
        _newcomer: usize,
        (): &mut (),
        _lost: &mut Vec<u32>,
    ) {
        let gap = |j: usize| f64::from(nodes[j + 1].depth()) - f64::from(nodes[j].depth());
        let j = smallest(0..nodes.len() - 1, gap);
        if self.mean_depth {
            // the mean of neighbours is between them, so the order of nodes stays
            let mean = f32::midpoint(nodes[j].depth(), nodes[j + 1].depth());
            nodes[j].set_depth(mean);
        }
        merge_pair(opacity, nodes, j);
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
        _newcomer: usize,
        (): &mut (),
        _lost: &mut Vec<u32>,
    ) {
        let shown = |shown, nodes: &[Node<O::Paint>]| {
            nodes.iter().fold(shown, |shown, node| opacity.behind(shown, &node.paint))
        };
        let mut in_front = shown(opacity.clear(), &nodes[..self.protected]);
        let error = |j: usize| {
            let behind = opacity.behind(in_front, &nodes[j].paint);
            let gap = f64::from(nodes[j].depth()) - f64::from(nodes[j - 1].depth());
            let error = gap * (in_front - behind);
            in_front = behind;
            error
        };
        let j = smallest(self.protected..nodes.len(), error);
        merge_pair(opacity, nodes, j - 1);
    }
}

/// Where `measure` is smallest, first on ties.
fn smallest(places: std::ops::Range<usize>, mut measure: impl FnMut(usize) -> f64) -> usize {
    let mut best = (places.start, f64::INFINITY);
    for j in places {
        let size = measure(j);
        if size < best.1 {
            best = (j, size);
        }
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
