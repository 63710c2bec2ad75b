//! A technique whose stored depths are rounded: it sees every fragment at the depth that its node has.
//!
//! Fragments that come to lie at one depth are told apart by primitive, as coincident ones are. Where pass B looks
//! through stored depths it compares rounded ones, too: a fragment would else be behind its own node.

use super::nodes::Depths;
use crate::diagnosis::{Diagnosis, Faults};
use crate::fragments::{Fragment, List, Lists};
use crate::order::sort_key;
use crate::technique::{Cost, DepthComplexity, Pixel, Properties, Resolved, Technique};

/// A technique and the format of its depths. Its depth ranges are those of the rounded depths.
pub struct Placed<T> {
    technique: T,
    depths: Depths,
}

impl<T> Placed<T> {
    /// `technique` with depths in that format.
    pub fn new(technique: T, depths: Depths) -> Self {
        Self { technique, depths }
    }
}

/// The fragments at their stored depths.
#[derive(Debug, Default)]
pub struct PlacedLists<S> {
    scratch: S,
    list: Lists,
    sorted: Lists,
    nodes: Vec<Fragment>,
}

fn fill(lists: &mut Lists, nodes: &[Fragment]) {
    lists.clear();
    nodes.iter().for_each(|node| lists.push(*node));
    lists.end_row();
}

impl<S> PlacedLists<S> {
    fn place(&mut self, depths: Depths, pixel: &Pixel<'_>) {
        let placed = |list: List<'_>, nodes: &mut Vec<Fragment>| {
            nodes.clear();
            nodes.extend(list.iter().map(|f| Fragment { depth: depths.place(f.depth), ..f }));
        };
        placed(pixel.list, &mut self.nodes);
        fill(&mut self.list, &self.nodes);
        placed(pixel.sorted, &mut self.nodes);
        // stable, so that twins stay as they came
        self.nodes.sort_by_key(|node| sort_key(node.depth, node.primitive));
        fill(&mut self.sorted, &self.nodes);
    }
}

impl<T: Technique> Placed<T> {
    /// What the technique makes of the pixel.
    fn see<R>(
        &self,
        pixel: &Pixel<'_>,
        lists: &mut PlacedLists<T::Scratch>,
        see: impl FnOnce(&T, &Pixel<'_>, &mut T::Scratch) -> R,
    ) -> R {
        if self.depths.are_exact() {
            return see(&self.technique, pixel, &mut lists.scratch);
        }
        lists.place(self.depths, pixel);
        let PlacedLists { scratch, list, sorted, .. } = lists;
        let placed = Pixel { list: list.as_ref().row(0), sorted: sorted.as_ref().row(0), ..*pixel };
        see(&self.technique, &placed, scratch)
    }
}

impl<T: Technique> Technique for Placed<T> {
    type Scratch = PlacedLists<T::Scratch>;
    const NEEDS_SORTED: bool = T::NEEDS_SORTED;
    const NEEDS_ARRIVAL: bool = T::NEEDS_ARRIVAL;
    const SEES_ZERO_FRAGMENTS: bool = T::SEES_ZERO_FRAGMENTS;
    const COLORED_TRANSMITTANCE: bool = T::COLORED_TRANSMITTANCE;

    fn resolve(&self, pixel: &Pixel<'_>, lists: &mut Self::Scratch) -> Resolved {
        self.see(pixel, lists, T::resolve)
    }
    /// Depths are rounded before they are compared, as those of fragments are.
    fn transmittance(
        &self,
        pixel: &Pixel<'_>,
        depths: &[f32],
        lists: &mut Self::Scratch,
    ) -> Option<Vec<f64>> {
        let placed: Vec<_> = depths.iter().map(|&depth| self.depths.place(depth)).collect();
        self.see(pixel, lists, |technique, pixel, scratch| technique.transmittance(pixel, &placed, scratch))
    }
    fn faults(&self) -> Faults {
        self.technique.faults()
    }
    fn diagnose(&self, pixel: &Pixel<'_>, lists: &mut Self::Scratch) -> Diagnosis {
        self.see(pixel, lists, T::diagnose)
    }
    fn cost(&self, complexity: &DepthComplexity) -> Cost {
        self.technique.cost(complexity)
    }
    fn properties(&self) -> Properties {
        self.technique.properties()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::format::Format;
    use crate::technique::Technique;
    use crate::techniques::testing::{VIEW, as_pixel, fragment};

    /// Says where it sees fragments, in list order and sorted.
    struct Depth;

    impl Technique for Depth {
        type Scratch = ();
        const NEEDS_SORTED: bool = true;

        fn resolve(&self, pixel: &Pixel<'_>, (): &mut ()) -> Resolved {
            let seen = |list: List<'_>| list.iter().fold(0.0, |seen, f| 10.0 * seen + f64::from(f.primitive));
            let color = [seen(pixel.list), seen(pixel.sorted), pixel.list.depth[0].into()];
            Resolved::new(color.into(), 1.0)
        }
        fn transmittance(&self, _pixel: &Pixel<'_>, depths: &[f32], (): &mut ()) -> Option<Vec<f64>> {
            Some(depths.iter().map(|z| f64::from(*z)).collect())
        }
        fn cost(&self, _complexity: &DepthComplexity) -> Cost {
            Cost { geometry_passes: 1.0, bytes_per_pixel: 4.0 }
        }
        fn properties(&self) -> Properties {
            Properties::NONE
        }
    }

    #[test]
    fn fragments_at_one_stored_depth_are_sorted_by_primitive() {
        // in half precision 4.0001 and 4.001 are 4
        let pixel =
            [(4.001, 1), (3.0, 7), (4.0001, 5), (4.0, 3)].map(|(z, key)| fragment(z, [1.0; 3], 0.5, key));
        let resolve = |format| {
            let placed = Placed::new(Depth, Depths::new(format, &VIEW));
            let mut lists = PlacedLists::default();
            let color = as_pixel(&pixel, |pixel| placed.resolve(pixel, &mut lists).color);
            let depths = as_pixel(&pixel, |pixel| placed.transmittance(pixel, &[4.001], &mut lists));
            (color.to_array(), depths.unwrap()[0])
        };
        let exact = f64::from(4.001_f32);
        assert_eq!(resolve(Format::F32), ([1753.0, 7351.0, exact], exact));
        assert_eq!(resolve(Format::F16), ([1753.0, 7135.0, 4.0], 4.0));
    }
}
