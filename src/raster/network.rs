//! Eight lists sorted at once: a list is a column of rows of eight numbers, and a sorting network compares whole
//! rows.

use super::interpolate::LANES;
use multiversion::multiversion;
use std::hint::black_box;

/// One number of each list. Keys of fragments, taken for the bits of floating-point numbers, are positive and
/// finite and sort as the integers do, and every instruction set has a minimum and a maximum of such numbers.
pub type Row = [f64; LANES];
/// What shorter lists end in; nothing sorts behind it.
pub const NOTHING: f64 = f64::INFINITY;

/// Sorts every column of the groups of rows `bounds[g]..bounds[g + 1]`.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"))]
pub fn sort_columns(rows: &mut [Row], bounds: &[usize]) {
    for group in bounds.windows(2) {
        let rows = &mut rows[group[0]..group[1]];
        match rows.len() {
            0 | 1 => {}
            2..=4 => {
                let mut few = load(rows);
                sort_4(&mut few);
                store(rows, &few);
            }
            5..=8 => {
                let mut few = load(rows);
                sort_8(&mut few);
                store(rows, &few);
            }
            9..=16 => {
                let mut few = load(rows);
                sort_16(&mut few);
                store(rows, &few);
            }
            _ => merge_exchange(rows),
        }
    }
}

/// Up to `N` rows, to be kept in registers.
#[inline(always)]
#[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
fn load<const N: usize>(rows: &[Row]) -> [Row; N] {
    let mut few = [[NOTHING; LANES]; N];
    for (to, from) in few.iter_mut().zip(rows) {
        *to = *from;
    }
    few
}

#[inline(always)]
#[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
fn store<const N: usize>(rows: &mut [Row], few: &[Row; N]) {
    for (to, from) in rows.iter_mut().zip(few) {
        *to = *from;
    }
}

/// A function that compares and exchanges the given pairs of rows, one after the other.
macro_rules! network {
    ($name:ident, $n:literal, $($a:literal $b:literal),*) => {
        #[inline(always)]
        fn $name(rows: &mut [Row; $n]) {
            $(exchange(rows, $a, $b);)*
        }
    };
}

// what `merge_exchange` does for these numbers of rows, spelled out
network!(
    sort_4, 4,
        0 2, 1 3, 0 1, 2 3, 1 2
);
network!(
    sort_8, 8,
        0 4, 1 5, 2 6, 3 7, 0 2, 1 3, 4 6, 5 7, 2 4, 3 5, 0 1, 2 3, 4 5, 6 7, 1 4, 3 6, 1 2, 3 4, 5 6
);
network!(
    sort_16, 16,
        0 8, 1 9, 2 10, 3 11, 4 12, 5 13, 6 14, 7 15, 0 4, 1 5, 2 6, 3 7, 8 12, 9 13, 10 14, 11 15, 4 8,
        5 9, 6 10, 7 11, 0 2, 1 3, 4 6, 5 7, 8 10, 9 11, 12 14, 13 15, 2 8, 3 9, 6 12, 7 13, 2 4, 3 5, 6 8,
        7 9, 10 12, 11 13, 0 1, 2 3, 4 5, 6 7, 8 9, 10 11, 12 13, 14 15, 1 8, 3 10, 5 12, 7 14, 1 4, 3 6,
        5 8, 7 10, 9 12, 11 14, 1 2, 3 4, 5 6, 7 8, 9 10, 11 12, 13 14
);

/// Batcher's merge exchange (Knuth, TAOCP 3, algorithm 5.2.2M), which takes any number of rows.
#[inline(always)]
#[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
fn merge_exchange(rows: &mut [Row]) {
    let n = rows.len();
    let top = n.next_power_of_two() / 2;
    let mut p = top;
    while p > 0 {
        let (mut q, mut r, mut d) = (top, 0, p);
        loop {
            // all i below n - d with i & p == r
            for from in (r..n - d).step_by(2 * p) {
                for i in from..(from + p).min(n - d) {
                    // a compiler that sees the rows follow each other gathers lanes from eight of them
                    let i = black_box(i);
                    exchange(rows, i, i + d);
                }
            }
            if q == p {
                break;
            }
            (d, q, r) = (q - p, q / 2, p);
        }
        p /= 2;
    }
}

/// The smaller numbers into row `a`, the larger ones into row `b`.
#[inline(always)]
#[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
fn exchange(rows: &mut [Row], a: usize, b: usize) {
    let (front, back) = (rows[a], rows[b]);
    let (mut low, mut high) = (front, back);
    for lane in 0..LANES {
        low[lane] = if back[lane] < front[lane] { back[lane] } else { front[lane] };
    }
    for lane in 0..LANES {
        high[lane] = if back[lane] > front[lane] { back[lane] } else { front[lane] };
    }
    rows[a] = low;
    rows[b] = high;
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::hash32;

    #[test]
    fn every_column_of_every_group_is_sorted() {
        let lengths = (0..70).chain([100, 127, 128, 129, 283, 1000]);
        let (mut rows, mut bounds) = (Vec::new(), vec![0]);
        for n in lengths {
            // few different numbers, so that some are equal
            let number = |i: u32, lane: u32| f64::from(hash32(n, i, lane, 0, 0) % (n / 2 + 2));
            rows.extend((0..n).map(|i| std::array::from_fn(|lane| number(i, u32::try_from(lane).unwrap()))));
            bounds.push(rows.len());
        }
        let before: Vec<Row> = rows.clone();
        sort_columns(&mut rows, &bounds);
        for group in bounds.windows(2) {
            for lane in 0..LANES {
                let column = |rows: &[Row]| rows[group[0]..group[1]].iter().map(|row| row[lane]).collect();
                let (got, mut expected): (Vec<f64>, Vec<f64>) = (column(&rows), column(&before));
                expected.sort_unstable_by(f64::total_cmp);
                assert_eq!(got, expected);
            }
        }
    }
}
