//! The A-buffer with nodes in other formats: fragments are rounded as they are written, and composited in float64.

use super::super::slab::Replay;
use super::{Size, limited};
use crate::continuum::insertion::{Always, Arrival, Insertion};
use crate::continuum::layers::{StoredLayers, Stream};
use crate::continuum::merge::NoMerge;
use crate::continuum::nodes::Nodes;
use crate::continuum::normalize::{Core, Normalize, Unnormalized};
use crate::continuum::opacity::Opacity;
use crate::continuum::placed::Placed;
use crate::continuum::stored_layers::StoredAlpha;
use crate::continuum::stored_sums::Recipe;
use crate::continuum::stored_tail::StoredTail;
use crate::diagnosis::{Diagnosis, Faults};
use crate::technique::{AnyTechnique, Cost, DepthComplexity, Pixel, Properties, Resolved, Technique};

/// The A-buffer of that size.
pub(super) fn build(size: Size, blend_tail: bool, nodes: Nodes, recipe: Recipe) -> Box<dyn AnyTechnique> {
    if size.capacity == usize::MAX {
        let list = list(Always, Unnormalized, nodes, Properties::EXACT);
        return Box::new(Placed::new(Replay::<_, true>(Listed { list, size }), nodes.depths));
    }
    let first = FirstCome(size.capacity);
    if blend_tail {
        let tail = StoredTail { weighting: None, recipe };
        let list = list(first, tail, nodes, recipe.properties(limited(true)));
        return Box::new(Placed::new(Listed { list, size }, nodes.depths));
    }
    let list = list(first, Dropped, nodes, limited(false));
    Box::new(Placed::new(Listed { list, size }, nodes.depths))
}

/// All that `insertion` admits, in nodes that keep their alpha.
fn list<I, N>(
    insertion: I,
    normalize: N,
    nodes: Nodes,
    properties: Properties,
) -> StoredLayers<I, NoMerge, StoredAlpha, N> {
    let stream = Stream { insertion, merge: NoMerge, opacity: nodes.fragments(), layers: usize::MAX };
    // a list's size follows from the image
    let cost = Cost::list(0, 0.0, 0.0);
    StoredLayers { stream, normalize, cost, properties: nodes.promises(properties) }
}

/// The first fragments of a pixel that are submitted.
struct FirstCome(usize);

impl<O: Opacity> Insertion<O> for FirstCome {
    /// How many there are.
    type State = usize;

    fn begin(&self, _pixel: &Pixel<'_>, stored: &mut usize) {
        *stored = 0;
    }
    fn admit(&self, arrival: &Arrival<'_, O>, stored: &mut usize) -> Option<O::Paint> {
        let has_room = *stored < self.0;
        *stored += usize::from(has_room);
        if has_room { arrival.paint() } else { None }
    }
}

/// What is not stored is lost, and counted.
struct Dropped;

impl Normalize for Dropped {
    fn resolve(&self, pixel: &Pixel<'_>, core: &Core, lost: &[u32], weights: &mut Vec<f32>) -> Resolved {
        let resolved = Unnormalized.resolve(pixel, core, lost, weights);
        Resolved { dropped: lost.len() as u64, ..resolved }
    }
}

/// A list whose size follows from the image.
struct Listed<T> {
    list: T,
    size: Size,
}

impl<T: Technique> Technique for Listed<T> {
    type Scratch = T::Scratch;

    fn resolve(&self, pixel: &Pixel<'_>, scratch: &mut T::Scratch) -> Resolved {
        self.list.resolve(pixel, scratch)
    }
    fn transmittance(&self, pixel: &Pixel<'_>, depths: &[f32], scratch: &mut T::Scratch) -> Option<Vec<f64>> {
        self.list.transmittance(pixel, depths, scratch)
    }
    fn faults(&self) -> Faults {
        self.list.faults()
    }
    fn diagnose(&self, pixel: &Pixel<'_>, scratch: &mut T::Scratch) -> Diagnosis {
        self.list.diagnose(pixel, scratch)
    }
    fn cost(&self, complexity: &DepthComplexity) -> Cost {
        self.size.cost(complexity)
    }
    fn properties(&self) -> Properties {
        self.list.properties()
    }
}
