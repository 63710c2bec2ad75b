//! Transmittance as lists and samples store it: a step function of (depth, primitive).

use super::search::count_leading;
use crate::order::sort_key;

/// Steps from 1 downwards, nearest first. Those at equal depth are told apart by primitive (sheet 0.1).
#[derive(Debug, Clone, Default)]
pub struct Steps {
    /// Where each step is, and the transmittance behind it.
    steps: Vec<(u64, f64)>,
}

impl Steps {
    /// Nothing hides anything.
    pub fn clear(&mut self) {
        self.steps.clear();
    }
    /// Adds a step behind all others, by its [`sort_key`], to the given transmittance.
    pub fn push(&mut self, key: u64, transmittance: f64) {
        debug_assert!(self.steps.last().is_none_or(|last| last.0 <= key));
        self.steps.push((key, transmittance));
    }
    /// The transmittance strictly in front of a [`sort_key`].
    pub fn in_front_of(&self, key: u64) -> f64 {
        match count_leading(&self.steps, |step| step.0 < key) {
            0 => 1.0,
            in_front => self.steps[in_front - 1].1,
        }
    }
    /// The transmittance strictly in front of a depth.
    pub fn at(&self, depth: f32) -> f64 {
        self.in_front_of(sort_key(depth, 0))
    }
    /// The transmittance behind all steps.
    pub fn total(&self) -> f64 {
        self.steps.last().map_or(1.0, |step| step.1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_step_is_behind_its_own_place() {
        let mut steps = Steps::default();
        assert_eq!((steps.at(9.0), steps.total()), (1.0, 1.0));
        for (depth, primitive, transmittance) in [(1.0, 4, 0.5), (2.0, 3, 0.25), (2.0, 7, 0.125)] {
            steps.push(sort_key(depth, primitive), transmittance);
        }
        assert_eq!([0.5, 1.0, 1.5, 2.0, 2.5].map(|z| steps.at(z)), [1.0, 1.0, 0.5, 0.5, 0.125]);
        assert_eq!(
            [0, 3, 4, 7, 8].map(|p| steps.in_front_of(sort_key(2.0, p))),
            [0.5, 0.5, 0.25, 0.25, 0.125]
        );
        assert_eq!(steps.total(), 0.125);
        steps.clear();
        assert_eq!(steps.total(), 1.0);
    }
}
