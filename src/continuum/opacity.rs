//! The axis *opacity*: what a stored layer hides. Here continuous alpha; coverage masks implement the same
//! trait.

use super::layers::Node;
use super::normalize::Core;
use crate::diagnosis::Faults;
use crate::fragments::Fragment;
use crate::technique::Pixel;
use glam::Vec3;

/// How a layer of a list covers what is behind it.
pub trait Opacity: Send + Sync + 'static {
    /// What a node holds besides its place in depth.
    type Paint: 'static;
    /// Whether [`Opacity::occlude`] does anything.
    const OCCLUDES: bool = false;

    /// What shows through an empty list, in the unit that this opacity counts in.
    fn clear(&self) -> f64 {
        1.0
    }

    /// The paint that neither covers nor emits.
    fn empty(&self) -> Self::Paint;

    /// A fragment of `pixel` as paint; `None` if it cannot be one.
    fn paint(&self, pixel: &Pixel<'_>, fragment: &Fragment) -> Option<Self::Paint>;

    /// What can befall fragments as they become paint, as far as it is looked for.
    fn faults(&self) -> Faults {
        Faults::NONE
    }

    /// What befalls one.
    fn written(&self, _fragment: &Fragment) -> Faults {
        Faults::NONE
    }

    /// The depth that a node can be stored at, nearest to a wanted one.
    fn place(&self, depth: f32) -> f32 {
        depth
    }

    /// Lets the newcomer `nodes[at]` and the nodes around it hide each other.
    fn occlude(&self, _nodes: &mut [Node<Self::Paint>], _at: usize) {}

    /// Puts `behind` under `front`.
    fn merge(&self, front: &mut Self::Paint, behind: &Self::Paint);

    /// What still shows through `paint` of what shows in front of it.
    fn behind(&self, shown: f64, paint: &Self::Paint) -> f64;

    /// Puts `paint` under what is composited already; all of `core` counts in the unit of [`Opacity::clear`].
    fn put_behind(&self, core: &mut Core, paint: &Self::Paint);

    /// Nodes composited front to back.
    fn composite(&self, nodes: &[Node<Self::Paint>]) -> Core {
        let clear = self.clear();
        let mut core = Core { transmittance: clear, ..Core::CLEAR };
        for node in nodes {
            self.put_behind(&mut core, &node.paint);
        }
        Core {
            color: core.color / clear,
            coverage: core.coverage / clear,
            transmittance: core.transmittance / clear,
        }
    }

    /// The transmittance of nodes together.
    fn transmittance(&self, nodes: &[Node<Self::Paint>]) -> f64 {
        let clear = self.clear();
        nodes.iter().fold(clear, |shown, node| self.behind(shown, &node.paint)) / clear
    }
}

/// Continuous alpha.
#[derive(Debug, Clone, Copy)]
pub struct Alpha;

/// A layer of premultiplied colour. Coverage and its complement are both kept, for the same reason as in
/// [`super::sums::BlendSums`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Layer {
    /// Premultiplied.
    pub color: Vec3,
    /// a.
    pub coverage: f64,
    /// t = 1 − a.
    pub transmittance: f64,
}

impl Layer {
    /// The layer that is not there.
    pub const CLEAR: Self = Self { color: Vec3::ZERO, coverage: 0.0, transmittance: 1.0 };

    /// A fragment's layer.
    pub fn new(fragment: &Fragment) -> Self {
        let coverage = f64::from(fragment.alpha);
        Self { color: fragment.color.into(), coverage, transmittance: 1.0 - coverage }
    }

    /// Puts `behind` under this layer (sheet 2.3); what overflows f32 counts as its largest number.
    pub fn put_over(&mut self, behind: &Self) {
        #[expect(clippy::cast_possible_truncation, reason = "colours are stored in f32")]
        let shown = self.transmittance as f32;
        self.color = (self.color + shown * behind.color).min(Vec3::MAX);
        self.coverage += self.transmittance * behind.coverage;
        self.transmittance *= behind.transmittance;
    }
}

impl Opacity for Alpha {
    type Paint = Layer;

    fn empty(&self) -> Layer {
        Layer::CLEAR
    }
    fn paint(&self, _pixel: &Pixel<'_>, fragment: &Fragment) -> Option<Layer> {
        Some(Layer::new(fragment))
    }
    fn merge(&self, front: &mut Layer, behind: &Layer) {
        front.put_over(behind);
    }
    fn behind(&self, shown: f64, paint: &Layer) -> f64 {
        shown * paint.transmittance
    }
    fn put_behind(&self, core: &mut Core, paint: &Layer) {
        core.put_behind(paint.color.as_dvec3(), paint.coverage, paint.transmittance);
    }
}
