//! Numbers of which the first lies at the beginning of a cache line: vectors of them that begin at a multiple of their own
//! length lie in one line each, not in two.

use std::ops::{Deref, DerefMut};

/// Bytes of a cache line, and of the widest vectors.
const LINE: usize = 64;

/// A vector whose first number lies at the beginning of a cache line.
#[derive(Debug, Default)]
pub struct Aligned<T> {
    /// With those that lie before the first.
    numbers: Vec<T>,
    first: usize,
}

impl<T: Copy + Default> Aligned<T> {
    /// So many numbers at least, of whatever value.
    pub fn make_room(&mut self, len: usize) {
        if self.len() < len {
            self.set_len(len);
        }
    }

    fn set_len(&mut self, len: usize) {
        let spare = LINE / size_of::<T>();
        if self.numbers.capacity() < len + spare {
            self.numbers = Vec::with_capacity(len + spare);
            // found within the spare ones, since numbers are powers of two in size
            self.first = self.numbers.as_ptr().align_offset(LINE).min(spare);
        }
        self.numbers.resize(self.first + len, T::default());
    }
}

impl<T> Deref for Aligned<T> {
    type Target = [T];
    #[inline]
    fn deref(&self) -> &[T] {
        &self.numbers[self.first..]
    }
}

impl<T> DerefMut for Aligned<T> {
    #[inline]
    fn deref_mut(&mut self) -> &mut [T] {
        &mut self.numbers[self.first..]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_begin_with_a_line_however_many_there_are() {
        let mut numbers = Aligned::<f64>::default();
        let mut quads = Aligned::<[f32; 4]>::default();
        for len in [1, 1000, 10, 4096, 4097] {
            let before = numbers.len();
            numbers.make_room(len);
            quads.make_room(len);
            assert_eq!((numbers.len(), quads.len()), (before.max(len), before.max(len)), "never fewer");
            assert_eq!((numbers.as_ptr() as usize % LINE, quads.as_ptr() as usize % LINE), (0, 0));
            numbers.fill(7.0);
        }
    }
}
