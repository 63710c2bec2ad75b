//! Adaptive transparency's step function in nodes of other formats (sheet 2.3).
//!
//! As published, a node holds the transmittance behind it, of all nodes up to it: a newcomer multiplies those behind
//! it, and each of these products is rounded. Layers with a transmittance of their own ([`super::stored_layers`]) would
//! round other numbers.

use super::nodes::Nodes;
use super::oracle::{Composite, Oracle};
use super::steps::Steps;
use crate::fragments::Fragment;
use crate::order::sort_key;
use crate::technique::{Cost, DepthComplexity, Pixel, Properties};

/// A step: its place, and the transmittance behind it.
type Step = (u64, f64);

/// At most k steps, of which those go first that change the area least.
pub struct RoundedSteps {
    /// k.
    pub layers: usize,
    /// The first steps, which are never removed; at least 1.
    pub protected: usize,
    /// Their formats.
    pub nodes: Nodes,
    /// The modelled cost, both passes together.
    pub cost: Cost,
    /// The promises.
    pub properties: Properties,
}

fn depth(step: &Step) -> f64 {
    f32::from_bits((step.0 >> 32) as u32).into()
}

impl RoundedSteps {
    fn insert(&self, steps: &mut Vec<Step>, fragment: &Fragment) {
        let key = sort_key(fragment.depth, fragment.primitive);
        let factor = 1.0 - f64::from(fragment.alpha);
        let at = steps.partition_point(|step| step.0 <= key);
        let in_front = at.checked_sub(1).map_or(1.0, |last| steps[last].1);
        for step in &mut steps[at..] {
            step.1 = self.nodes.multiply(step.1, factor);
        }
        steps.insert(at, (key, self.nodes.multiply(in_front, factor)));
        if steps.len() > self.layers {
            self.remove_one(steps);
        }
    }

    /// The nearer neighbour takes over what the step of least area absorbs: the first one on ties.
    fn remove_one(&self, steps: &mut Vec<Step>) {
        let area = |j: usize| {
            let (nearer, step) = (&steps[j - 1], &steps[j]);
            (depth(step) - depth(nearer)) * (nearer.1 - step.1)
        };
        let least = (self.protected..steps.len()).min_by(|&i, &j| area(i).total_cmp(&area(j)));
        let least = least.unwrap_or(steps.len() - 1);
        steps[least - 1].1 = steps[least].1;
        steps.remove(least);
    }
}

impl Oracle for RoundedSteps {
    type Map = (Vec<Step>, Steps);

    fn build(&self, pixel: &Pixel<'_>, (list, steps): &mut Self::Map) {
        list.clear();
        steps.clear();
        pixel.list.iter().for_each(|fragment| self.insert(list, &fragment));
        list.iter().for_each(|&(key, transmittance)| steps.push(key, transmittance));
    }
    fn in_front_of(&self, (_, steps): &Self::Map, fragment: &Fragment) -> f64 {
        steps.in_front_of(sort_key(fragment.depth, fragment.primitive))
    }
    fn at(&self, (_, steps): &Self::Map, depth: f32) -> f64 {
        steps.at(depth)
    }
    fn total(&self, (_, steps): &Self::Map) -> f64 {
        steps.total()
    }
    fn cost(&self, _complexity: &DepthComplexity) -> Cost {
        self.cost
    }
    fn properties(&self, _composite: Composite) -> Properties {
        self.properties
    }
}
