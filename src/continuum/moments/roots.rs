//! [`real_roots`](super::polynomial::real_roots) of a block of polynomials, one beside the other in loops that
//! vectorise. Every one goes through the same operations as it would alone, so its roots are the same to the bit.
#![expect(clippy::inline_always, reason = "these take on their caller's instruction set")]
#![expect(clippy::needless_bitwise_bool, reason = "a branch would keep loops from vectorising")]

use super::polynomial::{LAST_STEP, MAX_DEGREE, MAX_STEPS, bounds, derivative, quadratic};
use crate::continuum::series::LANES;

/// So many polynomials stand side by side: enough to hide how long a step of Newton's method takes, which is over
/// when the slowest of them is done.
pub const BLOCK: usize = 32;

/// A number for each fragment of a block.
pub type Column = [f64; BLOCK];

/// The places of a block, filled up to whole blocks of lanes with copies of the last, and how many that makes:
/// loops then leave no rest that is done one by one.
#[inline(always)]
pub fn in_whole_blocks(places: &[f64]) -> (Column, usize) {
    let mut column = [0.0; BLOCK];
    let count = places.len().next_multiple_of(LANES).min(BLOCK);
    column[..places.len()].copy_from_slice(places);
    column[places.len()..count].fill(places.last().copied().unwrap_or_default());
    (column, count)
}

/// The coefficients of monic polynomials, ascending, without the leading one; or roots, ascending.
pub type Columns = [Column; MAX_DEGREE];

/// The roots of the first `count` polynomials, all of degree N.
#[inline(always)]
pub fn real_roots_of_monic<const N: usize>(p: &Columns, count: usize, roots: &mut Columns) {
    match N {
        2 => quadratics(p, count, roots),
        3 => cubics(p, count, roots),
        4 => quartics(p, count, roots),
        _ => unreachable!("degree {N}"),
    }
}

#[inline(always)]
fn quadratics(p: &Columns, count: usize, roots: &mut Columns) {
    for i in 0..count {
        [roots[0][i], roots[1][i]] = quadratic(p[0][i], p[1][i]);
    }
}

#[inline(always)]
fn cubics(p: &Columns, count: usize, roots: &mut Columns) {
    let mut turns = [[0.0; BLOCK]; MAX_DEGREE];
    quadratics(&derivatives::<3>(p, count), count, &mut turns);
    roots_between::<3>(p, &turns, count, roots);
}

#[inline(always)]
fn quartics(p: &Columns, count: usize, roots: &mut Columns) {
    let mut turns = [[0.0; BLOCK]; MAX_DEGREE];
    cubics(&derivatives::<4>(p, count), count, &mut turns);
    roots_between::<4>(p, &turns, count, roots);
}

/// Polynomial `i`, with the leading coefficient.
#[inline(always)]
fn coefficients<const N: usize>(p: &Columns, i: usize) -> [f64; MAX_DEGREE + 1] {
    std::array::from_fn(|k| if k < N { p[k][i] } else { 1.0 })
}

#[inline(always)]
fn derivatives<const N: usize>(p: &Columns, count: usize) -> Columns {
    let mut derivatives = [[0.0; BLOCK]; MAX_DEGREE];
    for i in 0..count {
        let derivative = derivative(&coefficients::<N>(p, i)[..=N]);
        for (column, d) in derivatives.iter_mut().zip(derivative).take(N - 1) {
            column[i] = d;
        }
    }
    derivatives
}

/// The value at `x`, and the slope.
#[inline(always)]
fn evaluate<const N: usize>(p: &Columns, i: usize, x: f64) -> (f64, f64) {
    let (mut value, mut slope) = (x + p[N - 1][i], 1.0);
    for k in (0..N - 1).rev() {
        (value, slope) = (value * x + p[k][i], slope * x + value);
    }
    (value, slope)
}

/// A root between neighbouring turns each, and beyond the outer ones.
#[inline(always)]
fn roots_between<const N: usize>(p: &Columns, turns: &Columns, count: usize, roots: &mut Columns) {
    let mut search = Search::default();
    let (mut lows, mut lasts) = ([0.0; BLOCK], [0.0; BLOCK]);
    for i in 0..count {
        let (first, last) = bounds(&coefficients::<N>(p, i)[..=N]);
        (lows[i], lasts[i]) = (first.min(turns[0][i]), last);
    }
    for root in 0..N {
        for i in 0..count {
            let high = if root + 1 < N { turns[root][i] } else { lasts[i].max(lows[i]) };
            search.begin::<N>(p, i, lows[i], high);
            lows[i] = high;
        }
        search.run::<N>(p, count);
        roots[root][..count].copy_from_slice(&search.x[..count]);
    }
}

/// Searches for one root of each polynomial.
struct Search {
    low: Column,
    high: Column,
    x: Column,
    /// 1 where the polynomial is negative at the lower end.
    negative: [u64; BLOCK],
    /// 1 where the root is yet to be found.
    active: [u64; BLOCK],
}

impl Default for Search {
    fn default() -> Self {
        let column = [0.0; BLOCK];
        Self { low: column, high: column, x: column, negative: [0; BLOCK], active: [0; BLOCK] }
    }
}

impl Search {
    /// In the middle; at the end nearer to 0 where the polynomial does not change its sign.
    #[inline(always)]
    fn begin<const N: usize>(&mut self, p: &Columns, i: usize, low: f64, high: f64) {
        let (at_low, at_high) = (evaluate::<N>(p, i, low).0, evaluate::<N>(p, i, high).0);
        let crosses = (at_low < 0.0) != (at_high < 0.0);
        let end = if at_low.abs() < at_high.abs() { low } else { high };
        self.x[i] = if crosses { 0.5 * (low + high) } else { end };
        (self.low[i], self.high[i]) = (low, high);
        self.negative[i] = u64::from(at_low < 0.0);
        self.active[i] = u64::from(crosses);
    }

    /// Until all are done.
    #[inline(always)]
    fn run<const N: usize>(&mut self, p: &Columns, count: usize) {
        for _ in 0..MAX_STEPS {
            if self.step::<N>(p, count) == 0 {
                return;
            }
        }
    }

    /// One step of each search that is active; the number of those that still are.
    #[inline(always)]
    fn step<const N: usize>(&mut self, p: &Columns, count: usize) -> u64 {
        let mut still = 0;
        for i in 0..count {
            let (x, low, high) = (self.x[i], self.low[i], self.high[i]);
            let active = self.active[i] == 1;
            let (value, slope) = evaluate::<N>(p, i, x);
            let newton = x - value / slope;
            let exact = value == 0.0;
            let close = (newton - x).abs() <= LAST_STEP * x.abs();
            let is_low = u64::from(value < 0.0) == self.negative[i];
            let low = if is_low { x } else { low };
            let high = if is_low { high } else { x };
            let inside = (low < newton) & (newton < high);
            let next = if inside { newton } else { 0.5 * (low + high) };
            let next = if exact {
                x
            } else if close {
                newton
            } else {
                next
            };
            let on = u64::from(active & !exact & !close);
            self.x[i] = if active { next } else { x };
            self.low[i] = low;
            self.high[i] = high;
            self.active[i] = on;
            still += on;
        }
        still
    }
}

#[cfg(test)]
mod tests {
    use super::super::polynomial::real_roots;
    use super::*;
    use crate::techniques::testing::Random;

    /// Monic polynomials with roots in [−2, 2], some of them double, and some with none.
    fn polynomials(n: usize, count: usize) -> Vec<Vec<f64>> {
        let mut random = Random::new(n as u64);
        let mut one = |i: usize| {
            let mut p = vec![1.0];
            let mut root = 0.0;
            for k in 0..n {
                root = if k > 0 && i.is_multiple_of(5) { root } else { f64::from(random.unit()) * 4.0 - 2.0 };
                p.insert(0, 0.0);
                for k in 0..p.len() - 1 {
                    p[k] -= root * p[k + 1];
                }
            }
            p[0] += if i.is_multiple_of(7) { 0.3 } else { 0.0 };
            p
        };
        (0..count).map(&mut one).collect()
    }

    fn check<const N: usize>() {
        for count in [1, 7, 16, 29, BLOCK] {
            let polynomials = polynomials(N, count);
            let (mut p, mut roots) = ([[0.0; BLOCK]; MAX_DEGREE], [[0.0; BLOCK]; MAX_DEGREE]);
            for (i, polynomial) in polynomials.iter().enumerate() {
                (0..N).for_each(|k| p[k][i] = polynomial[k]);
            }
            real_roots_of_monic::<N>(&p, count, &mut roots);
            for (i, polynomial) in polynomials.iter().enumerate() {
                let alone = real_roots(polynomial);
                assert_eq!(roots.map(|column| column[i])[..N], alone[..N], "{N} {i} {polynomial:?}");
            }
        }
    }

    #[test]
    fn side_by_side_they_are_those_of_one_alone() {
        check::<2>();
        check::<3>();
        check::<4>();
    }
}
