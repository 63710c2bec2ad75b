//! Four power moments in normalised integers of 16 bits (M18; sheet 2.5).
//!
//! Their mean values are stored, not their sums, after a linear transform that makes the most of [0, 1]. So each update
//! divides, adds and multiplies, and needs ordered access: no blend unit does that.

use crate::format::Format;

/// How many moments there are.
pub const COUNT: usize = 4;

/// The moments as numbers in [0, 1]: exactly that interval, over all distributions on [−1, 1].
pub fn encode([b1, b2, b3, b4]: [f64; COUNT]) -> [f64; COUNT] {
    let root = 3.0_f64.sqrt();
    [
        1.5 * b1 - 2.0 * b3 + 0.5,
        4.0 * b2 - 4.0 * b4,
        0.5 * root * b1 - 2.0 / 9.0 * root * b3 + 0.5,
        0.5 * b2 + 0.5 * b4,
    ]
}

/// The moments again.
pub fn decode([q1, q2, q3, q4]: [f64; COUNT]) -> [f64; COUNT] {
    let root = 3.0_f64.sqrt();
    let (q1, q3) = (q1 - 0.5, q3 - 0.5);
    [-q1 / 3.0 + root * q3, 0.125 * q2 + q4, -0.75 * q1 + 0.75 * root * q3, -0.125 * q2 + q4]
}

/// What a pixel stores: total absorbance in a format of its own, and mean values.
#[derive(Debug, Clone, Copy)]
pub struct Quantized {
    absorbance: Format,
    total: f64,
    stored: [f64; COUNT],
}

impl Quantized {
    /// The targets as they are cleared, absorbance in that format.
    pub fn new(absorbance: Format) -> Self {
        Self { absorbance, total: 0.0, stored: [0.0; COUNT] }
    }

    /// Adds absorbance `s` where the powers are these.
    pub fn add(&mut self, s: f64, powers: [f64; COUNT]) {
        if s <= 0.0 {
            return;
        }
        let before = self.absorbance.read(self.total);
        // of the new mean value; all of it where there was nothing
        let share = s / (before + s);
        let means = decode(self.stored);
        let mixed = std::array::from_fn(|k| means[k] + share * (powers[k] - means[k]));
        self.stored = encode(mixed).map(|q| Format::Unorm16.round(q));
        self.total = self.absorbance.accumulate(self.total, s);
    }

    /// Total absorbance.
    pub fn total(&self) -> f64 {
        self.absorbance.read(self.total)
    }

    /// The mean values.
    pub fn means(&self) -> [f64; COUNT] {
        decode(self.stored)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::techniques::testing::Random;

    fn powers(d: f64) -> [f64; COUNT] {
        [d, d * d, d.powi(3), d.powi(4)]
    }

    #[test]
    fn the_transform_is_inverted_and_fills_the_unit_interval() {
        let (mut least, mut most) = ([f64::INFINITY; COUNT], [f64::NEG_INFINITY; COUNT]);
        for i in 0..=40_000_u32 {
            let b = powers(f64::from(i) / 2e4 - 1.0);
            let q = encode(b);
            for k in 0..COUNT {
                assert!((decode(q)[k] - b[k]).abs() < 1e-15, "{b:?}");
                (least[k], most[k]) = (least[k].min(q[k]), most[k].max(q[k]));
            }
        }
        // all distributions are mixtures of points, so that their extremes are those of points
        for k in 0..COUNT {
            assert!(least[k].abs() < 1e-8 && (most[k] - 1.0).abs() < 1e-8, "{k}: {least:?} {most:?}");
        }
    }

    /// By how much the inverse may enlarge half a step of each stored number.
    const INVERSE: [f64; COUNT] = [2.066, 1.125, 2.05, 1.125];

    #[test]
    fn a_round_trip_is_off_by_half_a_step_of_each_number() {
        let mut random = Random::new(5);
        for _ in 0..2000 {
            let b = powers(2.0 * f64::from(random.unit()) - 1.0);
            let back = decode(encode(b).map(|q| Format::Unorm16.round(q)));
            for k in 0..COUNT {
                assert!((back[k] - b[k]).abs() <= INVERSE[k] * 0.5 / 65_535.0, "{b:?} {back:?}");
            }
            // what was stored is stored again
            let again = encode(back).map(|q| Format::Unorm16.round(q));
            assert_eq!(decode(again), back);
        }
    }

    /// Every update rounds, and the next one keeps the share of it that is not new.
    #[test]
    fn the_error_over_many_updates_is_bounded() {
        for seed in 0..50 {
            let mut random = Random::new(seed);
            let (mut stored, mut total, mut sums) = (Quantized::new(Format::F32), 0.0, [0.0; COUNT]);
            for n in 1..=64_u8 {
                let (s, d) = (f64::from(0.01 + random.unit()), 2.0 * f64::from(random.unit()) - 1.0);
                stored.add(s, powers(d));
                total += s;
                (0..COUNT).for_each(|k| sums[k] += s * powers(d)[k]);
                for k in 0..COUNT {
                    let far = (stored.means()[k] - sums[k] / total).abs();
                    assert!(far <= f64::from(n) * INVERSE[k] * 0.5 / 65_535.0, "{n} {k}: {far:e}");
                }
            }
            assert!((stored.total() - total).abs() < 1e-5 * total);
        }
    }

    #[test]
    fn nothing_is_added_by_what_absorbs_nothing() {
        let mut stored = Quantized::new(Format::F32);
        stored.add(0.0, powers(0.3));
        assert_eq!(stored.total(), 0.0);
        stored.add(0.5, powers(-1.0));
        let once = stored.means();
        stored.add(0.0, powers(0.3));
        assert_eq!((stored.means(), stored.total()), (once, 0.5));
        assert!(once.iter().zip([-1.0, 1.0, -1.0, 1.0]).all(|(b, exact)| (b - exact).abs() < 4e-5));
    }
}
