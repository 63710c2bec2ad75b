//! What holds at a point of a function: its variables, and which fragments are still there.

use super::{Compiler, FALSE, TRUE, Val};

/// Which of the fragments that came here have not gone elsewhere, by a return or a jump.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Live {
    #[default]
    All,
    None,
    /// Those for which this is true.
    Some(Val),
}

impl Live {
    fn mask(self) -> Val {
        match self {
            Self::All => TRUE,
            Self::None => FALSE,
            Self::Some(mask) => mask,
        }
    }

    pub fn from_mask(mask: Val) -> Self {
        match mask {
            Val::Known(0) => Self::None,
            Val::Known(_) => Self::All,
            Val::Register(_) => Self::Some(mask),
        }
    }
}

/// The variables of all calls, number by number, and who is there.
#[derive(Debug, Clone, Default)]
pub struct State {
    pub slots: Vec<Val>,
    pub live: Live,
}

impl State {
    /// Makes room for some numbers, and says where.
    pub fn push(&mut self, numbers: &[Val]) -> usize {
        self.slots.extend_from_slice(numbers);
        self.slots.len() - numbers.len()
    }
}

impl Compiler<'_> {
    /// Writes a variable's number, for those who are there.
    pub(super) fn store(&mut self, slot: usize, value: Val) {
        let before = self.state.slots[slot];
        self.state.slots[slot] = match self.state.live {
            Live::All => value,
            Live::None => before,
            Live::Some(mask) => self.select(mask, value, before),
        };
    }

    /// What holds after two ways, of which the condition picks one.
    pub(super) fn merge(&mut self, condition: Val, accept: State, reject: &State) -> State {
        let pairs = accept.slots.into_iter().zip(&reject.slots);
        let slots = pairs.map(|(a, &r)| self.select(condition, a, r)).collect();
        let live = match (accept.live, reject.live) {
            (a, r) if a == r => a,
            (a, r) => {
                let mask = match (a.mask(), r.mask()) {
                    (FALSE, TRUE) => self.not(condition),
                    (a, r) => self.select(condition, a, r),
                };
                Live::from_mask(mask)
            }
        };
        State { slots, live }
    }
}
