//! Memory that is not needed at the moment, kept for the next render: what comes fresh from the system has to be
//! mapped and cleared page by page, which takes longer than drawing a simple scene.

use std::sync::{Mutex, MutexGuard, PoisonError};

/// Bytes that are kept of one kind, at most.
const LIMIT: usize = 128 << 20;

/// Parts that wait to be used again, the one that has waited longest first, each with its size in bytes.
#[derive(Debug, Default)]
pub struct Spare<T>(Mutex<Vec<(usize, T)>>);

impl<T> Spare<T> {
    /// Nothing.
    pub const fn new() -> Self {
        Self(Mutex::new(Vec::new()))
    }

    /// The part that was given back last of those that fit.
    pub fn take(&self, fits: impl Fn(&T) -> bool) -> Option<T> {
        let mut parts = self.parts();
        let place = parts.iter().rposition(|(_, part)| fits(part))?;
        Some(parts.remove(place).1)
    }

    /// Keeps a part for later, if it is no larger than all that may be kept; others make room for it.
    pub fn give_back(&self, part: T, bytes: usize) {
        if bytes == 0 || bytes > LIMIT {
            return;
        }
        let mut parts = self.parts();
        parts.push((bytes, part));
        while parts.iter().map(|(bytes, _)| bytes).sum::<usize>() > LIMIT {
            parts.remove(0);
        }
    }

    fn parts(&self) -> MutexGuard<'_, Vec<(usize, T)>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
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
        spare.give_back(12, 1);
        spare.give_back(13, 1);
        spare.give_back(12, 0);
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
    }
}
