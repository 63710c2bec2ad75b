//! Memory that is not needed at the moment, kept for the next render: what comes fresh from the system has to be
//! mapped and cleared page by page, which takes longer than drawing a simple scene.

use std::collections::VecDeque;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Bytes that are kept of one kind, at most.
const LIMIT: usize = 128 << 20;
/// Parts that are kept of one kind, at most: they are looked through one by one.
const PARTS: usize = 1024;
/// Parts with fewer bytes are not worth it: the allocator keeps those itself.
const SMALL: usize = 1 << 15;

/// Parts that wait to be used again.
#[derive(Debug)]
pub struct Spare<T>(Mutex<Parts<T>>);

/// The part that has waited longest first, each with its size in bytes, and the sum of those.
#[derive(Debug)]
struct Parts<T> {
    waiting: VecDeque<(usize, T)>,
    bytes: usize,
}

impl<T> Spare<T> {
    /// Nothing.
    pub const fn new() -> Self {
        Self(Mutex::new(Parts { waiting: VecDeque::new(), bytes: 0 }))
    }

    /// The part that was given back last of those that fit.
    pub fn take(&self, fits: impl Fn(&T) -> bool) -> Option<T> {
        let mut parts = self.parts();
        let place = parts.waiting.iter().rposition(|(_, part)| fits(part))?;
        let (bytes, part) = parts.waiting.remove(place)?;
        parts.bytes -= bytes;
        Some(part)
    }

    /// Keeps a part for later, if it is neither too small to matter nor larger than all that may be kept; others
    /// make room for it.
    pub fn give_back(&self, part: T, bytes: usize) {
        if !(SMALL..=LIMIT).contains(&bytes) {
            return;
        }
        let mut parts = self.parts();
        parts.waiting.push_back((bytes, part));
        parts.bytes += bytes;
        while parts.bytes > LIMIT || parts.waiting.len() > PARTS {
            let Some((bytes, _)) = parts.waiting.pop_front() else { return };
            parts.bytes -= bytes;
        }
    }

    fn parts(&self) -> MutexGuard<'_, Parts<T>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl<T> Default for Spare<T> {
    fn default() -> Self {
        Self::new()
    }
}

/// The bytes of a vector's memory.
pub fn bytes_of<T>(numbers: &Vec<T>) -> usize {
    numbers.capacity() * size_of::<T>()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_are_used_again() {
        let spare = Spare::new();
        spare.give_back(12, SMALL);
        spare.give_back(13, SMALL);
        spare.give_back(12, SMALL - 1);
        assert_eq!(spare.take(|part| *part == 11), None);
        assert_eq!(spare.take(|part| *part == 12), Some(12));
        assert_eq!(spare.take(|part| *part == 12), None);
        assert_eq!(spare.take(|_| true), Some(13));
    }

    #[test]
    fn what_has_waited_longest_makes_room() {
        let spare = Spare::new();
        for part in 1..=3 {
            spare.give_back(part, LIMIT / 2);
        }
        spare.give_back(4, LIMIT + 1);
        assert_eq!(
            [spare.take(|_| true), spare.take(|_| true), spare.take(|_| true)],
            [Some(3), Some(2), None]
        );
        for part in 0..=PARTS {
            spare.give_back(part, SMALL);
        }
        assert_eq!((spare.take(|part| *part == 0), spare.take(|part| *part == 1)), (None, Some(1)));
    }
}
