//! Which variants are fed while the tiles are rasterised, in which order, and which are resolved from lists.

use crate::raster::Order;
use crate::resolve::Variant;
use crate::technique::Streamed;

/// Places of variants, by how they get their fragments.
#[derive(Debug, Default)]
pub(super) struct Plan {
    /// Sums over all fragments.
    pub sums: Vec<usize>,
    /// Alpha compositing in submission order ...
    pub blends: Vec<usize>,
    /// ... and of whole primitives back to front.
    pub painters: Vec<usize>,
    /// `over` of sorted fragments: fed front to back where a tile allows it, from lists elsewhere.
    pub overs: Vec<usize>,
    /// Everything else.
    pub listed: Vec<usize>,
}

impl Plan {
    pub fn new(variants: &[Variant], is_scene: bool) -> Self {
        let mut plan = Self::default();
        for (v, variant) in variants.iter().enumerate() {
            let place = match variant.streamed().filter(|_| is_scene) {
                Some((Streamed::Sums(_), _)) => &mut plan.sums,
                Some((Streamed::Blend, Order::BackToFront)) => &mut plan.painters,
                Some((Streamed::Blend, _)) => &mut plan.blends,
                Some((Streamed::Over, _)) => &mut plan.overs,
                None => &mut plan.listed,
            };
            place.push(v);
        }
        plan
    }
}
