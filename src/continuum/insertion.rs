//! The axis *insertion*: which fragments a list takes in.

use super::layers::Node;
use super::opacity::Opacity;
use crate::fragments::Fragment;
use crate::technique::Pixel;

/// A fragment at the door of a list.
pub struct Arrival<'a, O: Opacity> {
    /// Where it is.
    pub pixel: &'a Pixel<'a>,
    /// The fragment.
    pub fragment: &'a Fragment,
    /// Its (depth, primitive).
    pub key: u64,
    /// The stored nodes in front of it.
    pub in_front: &'a [Node<O::Paint>],
    /// How nodes cover.
    pub opacity: &'a O,
}

impl<O: Opacity> Arrival<'_, O> {
    /// The fragment as paint.
    pub fn paint(&self) -> Option<O::Paint> {
        self.opacity.paint(self.pixel, self.fragment)
    }
}

/// When a fragment is stored.
pub trait Insertion<O: Opacity>: Send + Sync + 'static {
    /// What must be remembered of the pixel's earlier fragments.
    type State: Default;

    /// Prepares for a pixel.
    fn begin(&self, _pixel: &Pixel<'_>, _state: &mut Self::State) {}

    /// The fragment that a node stands for if this one is admitted at all; `None` if it never is.
    fn node(&self, fragment: &Fragment) -> Option<Fragment> {
        Some(*fragment)
    }

    /// The paint under which the fragment is stored; `None` refuses it.
    fn admit(&self, arrival: &Arrival<'_, O>, state: &mut Self::State) -> Option<O::Paint>;
}

/// Every fragment.
#[derive(Debug, Clone, Copy)]
pub struct Always;

impl<O: Opacity> Insertion<O> for Always {
    type State = ();

    fn admit(&self, arrival: &Arrival<'_, O>, (): &mut ()) -> Option<O::Paint> {
        arrival.paint()
    }
}

/// Fragments of alpha above a threshold, as if they were opaque.
#[derive(Debug, Clone, Copy)]
pub struct Threshold(pub f64);

impl Threshold {
    /// The opaque fragment `(u, 1)` in place of one that passes.
    pub fn pass(self, fragment: &Fragment) -> Option<Fragment> {
        let alpha = fragment.alpha;
        (f64::from(alpha) > self.0).then(|| Fragment {
            color: fragment.color.map(|c| (c / alpha).min(f32::MAX)),
            alpha: 1.0,
            ..*fragment
        })
    }
}

impl<O: Opacity> Insertion<O> for Threshold {
    type State = ();

    fn node(&self, fragment: &Fragment) -> Option<Fragment> {
        self.pass(fragment)
    }

    fn admit(&self, arrival: &Arrival<'_, O>, (): &mut ()) -> Option<O::Paint> {
        let opaque = self.pass(arrival.fragment)?;
        arrival.opacity.paint(arrival.pixel, &opaque)
    }
}

/// Fragments that are among the nearest so far.
#[derive(Debug, Clone, Copy)]
pub struct Nearest(pub usize);

impl Nearest {
    /// Whether fewer than k of the earlier fragments are nearer; `nearest` holds the keys of the k nearest.
    pub fn pass(self, key: u64, nearest: &mut Vec<u64>) -> bool {
        let place = nearest.partition_point(|&k| k <= key);
        if place < self.0 {
            nearest.truncate(self.0 - 1);
            nearest.insert(place, key);
        }
        place < self.0
    }
}

impl<O: Opacity> Insertion<O> for Nearest {
    type State = Vec<u64>;

    fn begin(&self, _pixel: &Pixel<'_>, nearest: &mut Vec<u64>) {
        nearest.clear();
    }
    fn admit(&self, arrival: &Arrival<'_, O>, nearest: &mut Vec<u64>) -> Option<O::Paint> {
        if self.pass(arrival.key, nearest) { arrival.paint() } else { None }
    }
}
