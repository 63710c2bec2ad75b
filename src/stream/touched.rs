//! Which rows of a tile anything is in: the others need no sums.

use std::ops::Range;

/// A bit per row of a tile, or per as many neighbouring ones as it takes for 64 bits.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Touched {
    bits: u64,
    /// Rows of a bit are 2 to this.
    shift: u32,
}

impl Touched {
    /// None of so many rows.
    pub fn none(rows: usize) -> Self {
        let of_a_bit = rows.div_ceil(64).max(1).next_power_of_two();
        Self { bits: 0, shift: of_a_bit.ilog2() }
    }

    /// Takes in some rows.
    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    pub fn touch(&mut self, rows: &Range<usize>) {
        debug_assert!(!rows.is_empty());
        let (first, last) = (rows.start >> self.shift, (rows.end - 1) >> self.shift);
        self.bits |= (u64::MAX >> (63 - (last - first))) << first;
    }

    /// Whether all of another's rows are there.
    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    pub fn contains(self, other: Self) -> bool {
        other.bits & !self.bits == 0
    }

    /// Takes in all of another's rows, and those beside them that they share an eighth of the tile with; the ones that were not there
    /// before.
    pub fn take_eighths(&mut self, other: Self) -> Self {
        let missing = other.bits & !self.bits;
        let whole = missing.to_le_bytes().map(|eighth| if eighth == 0 { 0 } else { u8::MAX });
        let fresh = u64::from_le_bytes(whole) & !self.bits;
        self.bits |= fresh;
        Self { bits: fresh, ..*self }
    }

    /// Whether a row is one of them.
    pub fn has(&self, row: usize) -> bool {
        self.bits >> (row >> self.shift) & 1 == 1
    }

    /// The same with those between two of them that are fewer than four rows apart, which to leave out costs more than it saves.
    pub fn without_gaps(self) -> Self {
        let spread = (0..4).fold(0, |bits, rows| bits | u128::from(self.bits) << rows);
        let bits = (0..4).fold(u128::MAX, |bits, rows| bits & spread >> rows);
        #[expect(clippy::cast_possible_truncation, reason = "no row beyond the last one is left")]
        let bits = bits as u64;
        Self { bits, ..self }
    }

    /// Neighbouring rows of so many, as long as all of them are there or none is, and which it is.
    pub fn stretches(self, rows: usize) -> impl Iterator<Item = (Range<usize>, bool)> {
        let mut next = 0;
        std::iter::from_fn(move || {
            let (first, has) = (next, self.has(next.min(rows.saturating_sub(1))));
            while next < rows && self.has(next) == has {
                next += 1;
            }
            (first < next).then_some((first..next, has))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(rows: &[usize]) -> Touched {
        let mut touched = Touched::none(64);
        rows.iter().for_each(|&row| touched.touch(&(row..row + 1)));
        touched
    }

    #[test]
    fn rows_are_there_once_they_are_touched() {
        let mut touched = Touched::none(64);
        touched.touch(&(3..5));
        assert_eq!(touched.stretches(6).collect::<Vec<_>>(), [(0..3, false), (3..5, true), (5..6, false)]);
        assert!(touched.contains(of(&[4])) && !touched.contains(of(&[4, 5])));
        touched.touch(&(0..64));
        assert_eq!(touched.stretches(64).collect::<Vec<_>>(), [(0..64, true)]);
        assert_eq!(touched.stretches(0).count(), 0);
    }

    #[test]
    fn eighths_are_taken_in_once() {
        let mut there = Touched::none(64);
        let fresh = there.take_eighths(of(&[9, 63]));
        assert_eq!(fresh, there);
        let all: Vec<_> = there.stretches(64).collect();
        assert_eq!(all, [(0..8, false), (8..16, true), (16..56, false), (56..64, true)]);
        assert_eq!(there.take_eighths(of(&[10])), Touched::none(64));
        assert_eq!(there.take_eighths(of(&[15, 16])).stretches(64).nth(1), Some((16..24, true)));
    }

    #[test]
    fn small_gaps_are_filled() {
        let all: Vec<_> = of(&[0, 4, 9, 60, 63]).without_gaps().stretches(64).collect();
        assert_eq!(all, [(0..5, true), (5..9, false), (9..10, true), (10..60, false), (60..64, true)]);
        assert_eq!(of(&[]).without_gaps(), of(&[]));
    }

    #[test]
    fn of_many_rows_some_share_a_bit() {
        let mut touched = Touched::none(100);
        touched.touch(&(7..8));
        assert_eq!(
            touched.stretches(100).collect::<Vec<_>>(),
            [(0..6, false), (6..8, true), (8..100, false)]
        );
        touched.touch(&(99..100));
        assert!(touched.has(98) && !touched.has(97));
    }
}
