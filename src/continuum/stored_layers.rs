//! The axis *opacity* with nodes in other storage formats: every node is rounded when it is written and when it is
//! merged, once (sheet 1.3, "Storage").

use super::layers::Node;
use super::nodes::Nodes;
use super::normalize::Core;
use super::opacity::Opacity;
use super::samples::unmultiplied;
use crate::diagnosis::Faults;
use crate::fragments::Fragment;
use crate::technique::Pixel;
use glam::{DVec3, Vec3};

/// Continuous alpha in nodes of a format.
///
/// In 8 bits a transmittance stays at 1 while alpha is below 1/510: such a fragment hides nothing, and a merge keeps
/// it so (sheet 2.3).
#[derive(Debug, Clone, Copy)]
pub struct StoredAlpha {
    /// Their format.
    pub nodes: Nodes,
    /// Whether nodes keep their alpha instead of their transmittance.
    pub keeps_alpha: bool,
}

/// A layer as its node holds it: premultiplied colour, a and 1 − a.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StoredLayer {
    color: DVec3,
    coverage: f64,
    transmittance: f64,
}

impl StoredAlpha {
    /// A layer of premultiplied colour, as a node keeps it.
    pub fn store(&self, color: DVec3, coverage: f64) -> StoredLayer {
        let nodes = self.nodes;
        let color = nodes.keep(color);
        if self.keeps_alpha || nodes.has_exact_shares() {
            let coverage = nodes.keep_share(coverage);
            return StoredLayer { color, coverage, transmittance: 1.0 - coverage };
        }
        let transmittance = nodes.keep_share(1.0 - coverage);
        StoredLayer { color, coverage: 1.0 - transmittance, transmittance }
    }
}

impl Opacity for StoredAlpha {
    type Paint = StoredLayer;

    fn empty(&self) -> StoredLayer {
        StoredLayer { color: DVec3::ZERO, coverage: 0.0, transmittance: 1.0 }
    }
    fn paint(&self, _pixel: &Pixel<'_>, fragment: &Fragment) -> Option<StoredLayer> {
        Some(self.store(Vec3::from(fragment.color).as_dvec3(), fragment.alpha.into()))
    }
    fn faults(&self) -> Faults {
        self.nodes.faults()
    }
    fn written(&self, fragment: &Fragment) -> Faults {
        self.nodes.written(Vec3::from(fragment.color).as_dvec3())
    }
    fn place(&self, depth: f32) -> f32 {
        self.nodes.depths.place(depth)
    }
    fn merge(&self, front: &mut StoredLayer, behind: &StoredLayer) {
        let (nodes, shown) = (self.nodes, front.transmittance);
        front.color = nodes.put_over(front.color, shown, behind.color);
        front.transmittance = nodes.multiply(behind.transmittance, shown);
        // what is kept in double precision is precise at either end, as in the default's layers
        let precise = front.coverage + shown * behind.coverage;
        front.coverage = if nodes.has_exact_shares() { precise } else { 1.0 - front.transmittance };
    }
    fn behind(&self, shown: f64, paint: &StoredLayer) -> f64 {
        shown * paint.transmittance
    }
    fn put_behind(&self, core: &mut Core, paint: &StoredLayer) {
        core.put_behind(paint.color, paint.coverage, paint.transmittance);
    }
}

/// Paint of an unmultiplied colour.
pub trait Unmultiplied {
    /// The colour.
    fn color_mut(&mut self) -> &mut DVec3;
}

/// An opacity of samples with colours in nodes of a format.
#[derive(Debug, Clone, Copy)]
pub struct Kept<O> {
    /// How nodes cover.
    pub opacity: O,
    /// Their format.
    pub nodes: Nodes,
}

impl<O: Opacity> Kept<O>
where
    O::Paint: Unmultiplied,
{
    fn keep(&self, paint: &mut O::Paint) {
        let color = paint.color_mut();
        *color = self.nodes.keep(*color);
    }
}

impl<O: Opacity> Opacity for Kept<O>
where
    O::Paint: Unmultiplied,
{
    type Paint = O::Paint;
    const OCCLUDES: bool = O::OCCLUDES;

    fn clear(&self) -> f64 {
        self.opacity.clear()
    }
    fn empty(&self) -> O::Paint {
        self.opacity.empty()
    }
    fn paint(&self, pixel: &Pixel<'_>, fragment: &Fragment) -> Option<O::Paint> {
        let mut paint = self.opacity.paint(pixel, fragment)?;
        self.keep(&mut paint);
        Some(paint)
    }
    fn faults(&self) -> Faults {
        self.nodes.faults()
    }
    fn written(&self, fragment: &Fragment) -> Faults {
        if fragment.alpha > 0.0 { self.nodes.written(unmultiplied(fragment)) } else { Faults::NONE }
    }
    fn place(&self, depth: f32) -> f32 {
        self.nodes.depths.place(depth)
    }
    fn occlude(&self, nodes: &mut [Node<O::Paint>], at: usize) {
        self.opacity.occlude(nodes, at);
    }
    fn merge(&self, front: &mut O::Paint, behind: &O::Paint) {
        self.opacity.merge(front, behind);
        self.keep(front);
    }
    fn behind(&self, shown: f64, paint: &O::Paint) -> f64 {
        self.opacity.behind(shown, paint)
    }
    fn put_behind(&self, core: &mut Core, paint: &O::Paint) {
        self.opacity.put_behind(core, paint);
    }
}

#[cfg(test)]
mod tests;
