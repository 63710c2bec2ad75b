//! Random numbers that depend on what is drawn, never on when: a counter-based hash (sheet 0.5).

/// The hash state before anything is mixed in.
const START: u32 = 0x6A09_E667;

/// Mixes one more word into a hash state (the finaliser of a 32-bit multiply-xorshift generator).
fn mix(state: u32, word: u32) -> u32 {
    let mut h = (state ^ word).wrapping_mul(0x9E37_79B1);
    h ^= h >> 16;
    h = h.wrapping_mul(0x85EB_CA6B);
    h ^= h >> 13;
    h = h.wrapping_mul(0xC2B2_AE35);
    h ^ (h >> 16)
}

/// A 32-bit hash of pixel, primitive, seed and sample block.
pub fn hash32(x: u32, y: u32, primitive: u32, seed: u64, block: u32) -> u32 {
    Draws::new(x, y, primitive, seed).hash(block)
}

/// The random numbers of one fragment in one pixel, by block: [`hash32`] with its other arguments bound.
#[derive(Debug, Clone, Copy)]
pub struct Draws(u32);

impl Draws {
    /// Those of `primitive` in pixel (`x`, `y`).
    pub fn new(x: u32, y: u32, primitive: u32, seed: u64) -> Self {
        #[expect(clippy::cast_possible_truncation, reason = "both halves of the seed are used")]
        let words = [x, y, primitive, seed as u32, (seed >> 32) as u32];
        Self(words.into_iter().fold(START, mix))
    }
    /// The hash of a block.
    pub fn hash(self, block: u32) -> u32 {
        mix(self.0, block)
    }
    /// A number in [0, 1) with all 32 bits of the block's hash.
    pub fn unit(self, block: u32) -> f64 {
        f64::from(self.hash(block)) / 4_294_967_296.0
    }
    /// A whole number in `0..bound`, as even as 32 bits allow.
    pub fn below(self, bound: u32, block: u32) -> u32 {
        ((u64::from(self.hash(block)) * u64::from(bound)) >> 32) as u32
    }
}

/// The hash as a number in [0, 1), with the 24 bits that f32 can hold.
#[expect(clippy::cast_precision_loss, reason = "24 bits fit")]
pub fn unit(hash: u32) -> f32 {
    (hash >> 8) as f32 / 16_777_216.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn uniform_in_every_argument() {
        let draws: [fn(u32) -> u32; 5] = [
            |i| hash32(i, 0, 0, 0, 0),
            |i| hash32(0, i, 0, 0, 0),
            |i| hash32(0, 0, i, 0, 0),
            |i| hash32(0, 0, 0, u64::from(i), 0),
            |i| hash32(0, 0, 0, 0, i),
        ];
        for draw in draws {
            let mut bins = [0_i32; 16];
            for i in 0..65_536 {
                let x = unit(draw(i));
                bins[(0..16_u16).filter(|k| f32::from(*k) / 16.0 <= x).count() - 1] += 1;
            }
            // chi-square with 15 degrees of freedom; 50 is far beyond the 1e-4 quantile
            let chi2: f64 = bins.iter().map(|n| f64::from(n - 4096).powi(2) / 4096.0).sum();
            assert!(chi2 < 50.0, "{bins:?}");
        }
    }

    #[test]
    fn draws_stay_in_their_range() {
        let draws = Draws::new(3, 4, 5, u64::MAX);
        assert_eq!(draws.hash(7), hash32(3, 4, 5, u64::MAX, 7));
        let mut seen = [0; 5];
        for block in 0..500 {
            seen[draws.below(5, block) as usize] += 1;
            assert!((0.0..1.0).contains(&draws.unit(block)));
        }
        assert!(seen.iter().all(|n| (70..130).contains(n)), "{seen:?}");
    }
}
