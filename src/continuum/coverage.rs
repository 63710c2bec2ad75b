//! The axis *opacity*, coverage masks: a layer covers samples, and keeps those that nothing in front of it
//! covers (W16 section 5).

use super::layers::Node;
use super::masks::{Mask, RandomMasks, Words};
use super::normalize::Core;
use super::opacity::Opacity;
use super::samples::unmultiplied;
use super::stored_layers::Unmultiplied;
use crate::fragments::Fragment;
use crate::technique::Pixel;
use glam::DVec3;
use std::marker::PhantomData;

/// Random masks of `bits` samples, kept in `W`.
#[derive(Debug, Clone, Copy)]
pub struct Coverage<W> {
    /// How an alpha becomes a mask.
    pub masks: RandomMasks,
    width: PhantomData<W>,
}

impl<W: Words> Coverage<W> {
    /// With masks drawn so.
    pub fn new(masks: RandomMasks) -> Self {
        Self { masks, width: PhantomData }
    }
}

/// A layer of one colour in some samples.
#[derive(Debug, Clone, PartialEq)]
pub struct Samples<W> {
    /// The samples.
    pub mask: Mask<W>,
    /// Unmultiplied, so that its share is the samples' alone.
    pub color: DVec3,
}

impl<W> Unmultiplied for Samples<W> {
    fn color_mut(&mut self) -> &mut DVec3 {
        &mut self.color
    }
}

/// Exact: the numbers of samples that a mask can have.
#[expect(clippy::cast_precision_loss, reason = "far fewer than 2^53 samples")]
fn share<W: Words>(mask: &Mask<W>) -> f64 {
    mask.count() as f64
}

/// Shares are counted in samples and divided by their number in the end, so that they are exact.
impl<W: Words> Opacity for Coverage<W> {
    type Paint = Samples<W>;
    const OCCLUDES: bool = true;

    #[expect(clippy::cast_precision_loss, reason = "far fewer than 2^53 samples")]
    fn clear(&self) -> f64 {
        self.masks.bits as f64
    }
    fn empty(&self) -> Samples<W> {
        Samples { mask: Mask::empty(self.masks.bits), color: DVec3::ZERO }
    }
    /// A fragment that covers nothing has no colour of its own; what it emits is lost.
    fn paint(&self, pixel: &Pixel<'_>, fragment: &Fragment) -> Option<Samples<W>> {
        let mut mask = Mask::default();
        self.masks.draw(pixel.x, pixel.y, fragment.primitive, fragment.alpha, &mut mask);
        (fragment.alpha > 0.0).then(|| Samples { mask, color: unmultiplied(fragment) })
    }
    /// W16 eq. 11, and its other half: a newcomer takes its samples from the layers behind it, or they would
    /// count twice (sheet R16).
    fn occlude(&self, nodes: &mut [Node<Samples<W>>], at: usize) {
        let (in_front, rest) = nodes.split_at_mut(at);
        let [newcomer, behind @ ..] = rest else { return };
        for node in in_front {
            newcomer.paint.mask.subtract(&node.paint.mask);
        }
        for node in behind {
            node.paint.mask.subtract(&newcomer.paint.mask);
        }
    }
    /// W16 eq. 12 and 13. Masks are disjoint, so the union has as many samples as both; where neither has any,
    /// the front one's colour stays.
    fn merge(&self, front: &mut Samples<W>, behind: &Samples<W>) {
        let (n, m) = (share(&front.mask), share(&behind.mask));
        if n + m > 0.0 {
            front.color = (n * front.color + m * behind.color) / (n + m);
            front.mask.unite(&behind.mask);
        }
    }
    fn behind(&self, shown: f64, paint: &Samples<W>) -> f64 {
        shown - share(&paint.mask)
    }
    /// W16 eq. 15.
    fn put_behind(&self, core: &mut Core, paint: &Samples<W>) {
        let n = share(&paint.mask);
        core.color += n * paint.color;
        core.coverage += n;
        core.transmittance -= n;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::continuum::masks::OneWord;

    fn coverage(bits: usize) -> Coverage<OneWord> {
        Coverage::new(RandomMasks { bits, stratified: true, seed: 0 })
    }

    fn node(key: u64, bits: &[usize], color: DVec3) -> Node<Samples<OneWord>> {
        let mut mask = Mask::empty(8);
        bits.iter().for_each(|&i| mask.insert(i));
        Node { key, source: 0, paint: Samples { mask, color } }
    }

    #[test]
    fn a_newcomer_is_hidden_by_what_is_in_front_and_hides_what_is_behind() {
        let mut nodes =
            [node(1, &[0, 1], DVec3::X), node(2, &[1, 2, 3], DVec3::Y), node(3, &[3, 4], DVec3::Z)];
        coverage(8).occlude(&mut nodes, 1);
        let expected = [node(1, &[0, 1], DVec3::X), node(2, &[2, 3], DVec3::Y), node(3, &[4], DVec3::Z)];
        assert!(nodes.iter().zip(&expected).all(|(a, b)| a.paint == b.paint), "{nodes:?}");
        let core = coverage(8).composite(&nodes);
        assert_eq!((core.color, core.transmittance), (DVec3::new(0.25, 0.25, 0.125), 0.375));
        assert_eq!(coverage(8).transmittance(&nodes[..2]), 0.5);
    }

    #[test]
    fn merged_colors_weigh_as_much_as_their_samples() {
        let mut front = node(1, &[0, 1, 2], DVec3::X).paint;
        coverage(8).merge(&mut front, &node(2, &[5], DVec3::Y).paint);
        assert_eq!(front, node(1, &[0, 1, 2, 5], DVec3::new(0.75, 0.25, 0.0)).paint);
        let mut nothing = node(1, &[], DVec3::X).paint;
        coverage(8).merge(&mut nothing, &node(2, &[], DVec3::Y).paint);
        assert_eq!(nothing, node(1, &[], DVec3::X).paint);
        coverage(8).merge(&mut nothing, &node(2, &[1], DVec3::Z).paint);
        assert_eq!(nothing, node(1, &[1], DVec3::Z).paint);
    }
}
