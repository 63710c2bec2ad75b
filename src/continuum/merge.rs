//! The axis *merge*: how a list that holds one node too many makes room.

use super::layers::Node;
use super::opacity::Opacity;

/// What happens on overflow.
pub trait Merge<O: Opacity>: Send + Sync + 'static {
    /// Nodes that the list holds besides its layers.
    const EXTRA_NODES: usize = 0;

    /// Prepares an empty list.
    fn begin(&self, _opacity: &O, _nodes: &mut Vec<Node<O::Paint>>) {}

    /// Removes one of `nodes`, of which `nodes[newcomer]` came last. Returns the source of a node that is
    /// lost.
    fn make_room(&self, opacity: &O, nodes: &mut Vec<Node<O::Paint>>, newcomer: usize) -> Option<u32>;
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
    fn make_room(&self, _opacity: &O, nodes: &mut Vec<Node<O::Paint>>, _newcomer: usize) -> Option<u32> {
        nodes.pop().map(|node| node.source)
    }
}

/// The two furthest nodes become one (MLAB).
#[derive(Debug, Clone, Copy)]
pub struct OverFurthest;

impl<O: Opacity> Merge<O> for OverFurthest {
    fn make_room(&self, opacity: &O, nodes: &mut Vec<Node<O::Paint>>, _newcomer: usize) -> Option<u32> {
        merge_pair(opacity, nodes, nodes.len() - 2);
        None
    }
}

/// The nearest node is flushed into an accumulator that counts as in front of all later arrivals (k-buffer).
#[derive(Debug, Clone, Copy)]
pub struct OverNearest;

impl<O: Opacity> Merge<O> for OverNearest {
    const EXTRA_NODES: usize = 1;

    /// The accumulator is node 0: no key is smaller than its, and a newcomer goes behind its equals.
    fn begin(&self, opacity: &O, nodes: &mut Vec<Node<O::Paint>>) {
        nodes.push(Node { key: 0, source: u32::MAX, paint: opacity.empty() });
    }
    fn make_room(&self, opacity: &O, nodes: &mut Vec<Node<O::Paint>>, _newcomer: usize) -> Option<u32> {
        merge_pair(opacity, nodes, 0);
        None
    }
}

/// The two adjacent nodes with the smallest gap become one (Z³), the nearest of such pairs.
#[derive(Debug, Clone, Copy)]
pub struct OverClosest {
    /// Whether the merged node moves to the mean depth; otherwise it stays at the nearer one.
    pub mean_depth: bool,
}

impl<O: Opacity> Merge<O> for OverClosest {
    fn make_room(&self, opacity: &O, nodes: &mut Vec<Node<O::Paint>>, _newcomer: usize) -> Option<u32> {
        let gap = |j: usize| nodes[j + 1].depth() - nodes[j].depth();
        let j = smallest(0..nodes.len() - 1, gap);
        if self.mean_depth {
            // the mean of neighbours is between them, so the order of nodes stays
            let mean = f64::midpoint(nodes[j].depth(), nodes[j + 1].depth());
            nodes[j].set_depth(mean);
        }
        merge_pair(opacity, nodes, j);
        None
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
    fn make_room(&self, opacity: &O, nodes: &mut Vec<Node<O::Paint>>, _newcomer: usize) -> Option<u32> {
        let shown = |shown, nodes: &[Node<O::Paint>]| {
            nodes.iter().fold(shown, |shown, node| opacity.behind(shown, &node.paint))
        };
        let mut in_front = shown(opacity.clear(), &nodes[..self.protected]);
        let error = |j: usize| {
            let behind = opacity.behind(in_front, &nodes[j].paint);
            let error = (nodes[j].depth() - nodes[j - 1].depth()) * (in_front - behind);
            in_front = behind;
            error
        };
        let j = smallest(self.protected..nodes.len(), error);
        merge_pair(opacity, nodes, j - 1);
        None
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
    fn make_room(&self, opacity: &O, nodes: &mut Vec<Node<O::Paint>>, newcomer: usize) -> Option<u32> {
        let node = nodes.remove(1 - newcomer);
        opacity.merge(&mut nodes[0].paint, &node.paint);
        None
    }
}

/// There is room for all.
#[derive(Debug, Clone, Copy)]
pub struct NoMerge;

impl<O: Opacity> Merge<O> for NoMerge {
    fn make_room(&self, _opacity: &O, _nodes: &mut Vec<Node<O::Paint>>, _newcomer: usize) -> Option<u32> {
        unreachable!("an unbounded list does not overflow")
    }
}
