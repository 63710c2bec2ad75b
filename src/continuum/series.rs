//! Trigonometric series of steps.

use super::functions::sin_cos_of_turns;
use multiversion::multiversion;
use std::f64::consts::PI;

/// So many fragments side by side.
pub const LANES: usize = 8;
/// A number for each of them.
pub type Lanes = [f64; LANES];

/// cos kθ and sin kθ of an angle per lane for k = 1, 2, ..., by rotation as in [`harmonics`].
pub struct Rotor {
    step: (Lanes, Lanes),
    /// The cosines.
    pub cos: Lanes,
    /// The sines.
    pub sin: Lanes,
}

#[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
impl Rotor {
    /// At k = 1.
    #[inline(always)]
    pub fn new(turns: &Lanes) -> Self {
        let (mut cos, mut sin) = ([0.0; LANES], [0.0; LANES]);
        for lane in 0..LANES {
            (sin[lane], cos[lane]) = sin_cos_of_turns(turns[lane]);
        }
        Self { step: (cos, sin), cos, sin }
    }

    /// On to the next k.
    #[inline(always)]
    pub fn turn(&mut self) {
        let (cos, sin) = &self.step;
        for lane in 0..LANES {
            let (c, s) = (self.cos[lane], self.sin[lane]);
            self.cos[lane] = c * cos[lane] - s * sin[lane];
            self.sin[lane] = s * cos[lane] + c * sin[lane];
        }
    }
}

/// The sum over lanes, halves first.
pub fn sum(lanes: &Lanes) -> f64 {
    let [a, b, c, d, e, f, g, h] = lanes;
    ((a + e) + (c + g)) + ((b + f) + (d + h))
}

/// The lanes of a column, in blocks.
pub fn blocks(column: &[f64]) -> &[Lanes] {
    column.as_chunks().0
}

/// Adds `s cos kθ` and `s sin kθ` of each fragment to the sums of k = 1, 2, ... The columns are whole blocks; a
/// lane without a fragment has s = 0.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"))]
pub fn project(turns: &[Lanes], s: &[Lanes], sums: &mut [(Lanes, Lanes)]) {
    for (turns, s) in turns.iter().zip(s) {
        let mut rotor = Rotor::new(turns);
        for (a, b) in &mut *sums {
            for lane in 0..LANES {
                a[lane] += s[lane] * rotor.cos[lane];
                b[lane] += s[lane] * rotor.sin[lane];
            }
            rotor.turn();
        }
    }
}

/// cos kθ and sin kθ for k = 1, 2, ..., by rotation: an error of k ulp, and two functions for all of them.
pub fn harmonics(theta: f64) -> impl Iterator<Item = (f64, f64)> {
    let (sin, cos) = theta.sin_cos();
    let turn = move |&(c, s): &(f64, f64)| Some((c * cos - s * sin, s * cos + c * sin));
    std::iter::successors(Some((cos, sin)), turn)
}

/// πk for k = 1, 2, ...
pub fn half_turns() -> impl Iterator<Item = f64> {
    (1_u32..).map(|k| PI * f64::from(k))
}

#[cfg(test)]
mod tests {
    use super::{Rotor, harmonics, sum};
    use std::f64::consts::TAU;

    #[test]
    fn rotation_keeps_its_precision() {
        for (k, (cos, sin)) in (1..=2000).zip(harmonics(0.7)) {
            let theta = 0.7 * f64::from(k);
            assert!((cos - theta.cos()).abs() < 1e-12 && (sin - theta.sin()).abs() < 1e-12, "{k}");
        }
    }

    #[test]
    fn lanes_turn_as_one_does() {
        let turns = std::array::from_fn(|lane| 0.13 * f64::from(u8::try_from(lane).unwrap()));
        let mut rotor = Rotor::new(&turns);
        for k in 0..50 {
            for (lane, turns) in turns.iter().enumerate() {
                let (cos, sin) = harmonics(TAU * turns).nth(k).unwrap();
                let far = (rotor.cos[lane] - cos).abs().max((rotor.sin[lane] - sin).abs());
                assert!(far < 1e-13, "{k} {turns}: {far:e}");
            }
            rotor.turn();
        }
        assert_eq!(sum(&[1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0, 128.0]), 255.0);
    }
}
