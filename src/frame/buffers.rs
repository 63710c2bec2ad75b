//! Memory of images that nobody looks at any more, kept for the next render: what comes fresh from the system has to
//! be mapped and cleared page by page, which takes longer than drawing a simple scene into it.

use super::Sample;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Bytes that are kept of each sample type, at most.
const LIMIT: usize = 128 << 20;

/// Buffers that wait for an image of their size, the one that has waited longest first.
#[derive(Debug, Default)]
pub struct Buffers<S>(Mutex<Vec<Vec<S>>>);

impl<S: Sample> Buffers<S> {
    /// No buffers.
    pub const fn new() -> Self {
        Self(Mutex::new(Vec::new()))
    }

    /// So many samples of whatever value; none where there is no room for them.
    pub fn take(&self, len: usize) -> Option<Vec<S>> {
        let mut kept = self.kept();
        if let Some(place) = kept.iter().rposition(|buffer| buffer.len() == len) {
            return Some(kept.remove(place));
        }
        drop(kept);
        // a failing vec! would abort
        Vec::<S>::new().try_reserve_exact(len).ok()?;
        Some(vec![S::default(); len])
    }

    /// Keeps a buffer for later, if it is no larger than all that may be kept; others make room for it.
    pub fn give_back(&self, buffer: Vec<S>) {
        let bytes = |buffer: &Vec<S>| buffer.capacity() * size_of::<S>();
        if buffer.is_empty() || bytes(&buffer) > LIMIT {
            return;
        }
        let mut kept = self.kept();
        kept.push(buffer);
        while kept.iter().map(bytes).sum::<usize>() > LIMIT {
            kept.remove(0);
        }
    }

    fn kept(&self) -> MutexGuard<'_, Vec<Vec<S>>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn buffers_of_the_same_size_are_used_again() {
        let buffers = Buffers::<f32>::new();
        buffers.give_back(vec![7.0; 12]);
        assert_eq!(buffers.take(11), Some(vec![0.0; 11]));
        assert_eq!(buffers.take(12), Some(vec![7.0; 12]));
        assert_eq!(buffers.take(12), Some(vec![0.0; 12]));
        assert_eq!(buffers.take(usize::MAX), None);
    }

    #[test]
    fn what_has_waited_longest_makes_room() {
        let buffers = Buffers::<f32>::new();
        let len = LIMIT / 4 / 2;
        for value in [1.0, 2.0, 3.0] {
            buffers.give_back(vec![value; len]);
        }
        buffers.give_back(vec![4.0; 2 * len + 1]);
        assert_eq!(buffers.kept().iter().map(|buffer| buffer[0]).collect::<Vec<_>>(), [2.0, 3.0]);
    }
}
