//! Coverage masks: opacity as a set of samples, and the random masks that have an alpha's share of them on
//! average (sheet 0.5).

use crate::random::Draws;
use std::fmt::Debug;

/// What a mask's bits are kept in: one or two machine words for narrow masks, so that the loops over words
/// unroll, and a vector for any width.
pub trait Words:
    AsRef<[u64]> + AsMut<[u64]> + Clone + Default + Debug + PartialEq + Send + Sync + 'static
{
    /// Makes it `words` words, all zero.
    fn reset(&mut self, words: usize);
}

/// Masks of up to 64 bits.
pub type OneWord = [u64; 1];
/// Masks of up to 128 bits.
pub type TwoWords = [u64; 2];
/// Masks of any width.
pub type ManyWords = Vec<u64>;

impl Words for OneWord {
    fn reset(&mut self, words: usize) {
        debug_assert!(words <= 1);
        *self = [0];
    }
}

impl Words for TwoWords {
    fn reset(&mut self, words: usize) {
        debug_assert!(words <= 2);
        *self = [0; 2];
    }
}

impl Words for ManyWords {
    fn reset(&mut self, words: usize) {
        self.clear();
        self.resize(words, 0);
    }
}

const BITS: usize = u64::BITS as usize;

/// The number of words that `bits` bits take.
pub const fn words(bits: usize) -> usize {
    bits.div_ceil(BITS)
}

/// A set of samples.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Mask<W> {
    words: W,
}

impl<W: Words> Mask<W> {
    /// No sample out of `bits`.
    pub fn empty(bits: usize) -> Self {
        let mut mask = Self::default();
        mask.reset(bits);
        mask
    }
    /// Forgets every sample; there are `bits` now.
    pub fn reset(&mut self, bits: usize) {
        self.words.reset(words(bits));
    }
    fn pairs<'a>(&'a self, other: &'a Self) -> impl Iterator<Item = (u64, u64)> + 'a {
        self.words.as_ref().iter().copied().zip(other.words.as_ref().iter().copied())
    }
    fn zip(&mut self, other: &Self, combine: impl Fn(u64, u64) -> u64) {
        for (a, b) in self.words.as_mut().iter_mut().zip(other.words.as_ref()) {
            *a = combine(*a, *b);
        }
    }
    /// Whether sample `i` is in it.
    pub fn has(&self, i: usize) -> bool {
        self.words.as_ref()[i / BITS] >> (i % BITS) & 1 == 1
    }
    /// Puts sample `i` in.
    pub fn insert(&mut self, i: usize) {
        self.words.as_mut()[i / BITS] |= 1 << (i % BITS);
    }
    /// Puts the samples of `other` in.
    pub fn unite(&mut self, other: &Self) {
        self.zip(other, |a, b| a | b);
    }
    /// Takes the samples of `other` out.
    pub fn subtract(&mut self, other: &Self) {
        self.zip(other, |a, b| a & !b);
    }
    /// Whether no sample is in it.
    pub fn is_empty(&self) -> bool {
        self.words.as_ref().iter().all(|w| *w == 0)
    }
    /// How many samples are in it.
    pub fn count(&self) -> usize {
        self.words.as_ref().iter().map(|w| w.count_ones() as usize).sum()
    }
    /// How many of its samples are not in `other`.
    pub fn count_outside(&self, other: &Self) -> usize {
        self.pairs(other).map(|(a, b)| (a & !b).count_ones() as usize).sum()
    }
    /// Whether all its samples are in `other`.
    pub fn is_within(&self, other: &Self) -> bool {
        self.pairs(other).all(|(a, b)| a & !b == 0)
    }
    /// Keeps the samples below `bits` of the complement.
    fn invert(&mut self, bits: usize) {
        for (w, word) in self.words.as_mut().iter_mut().enumerate() {
            *word = !*word & lanes(w, bits);
        }
    }
}

/// The bits of word `w` that belong to a mask of `bits`.
fn lanes(w: usize, bits: usize) -> u64 {
    match bits.saturating_sub(w * BITS) {
        0 => 0,
        rest if rest < BITS => (1 << rest) - 1,
        _ => u64::MAX,
    }
}

/// Block of the draw that rounds a number of samples; positions follow.
const ROUNDING: u32 = 0;
const POSITIONS: u32 = 1;

/// How an alpha becomes a random mask. The mask depends on the pixel, the fragment's primitive and the seed,
/// never on when the fragment arrives; fragments of one primitive in a pixel share their random
/// numbers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RandomMasks {
    /// Width of the masks.
    pub bits: usize,
    /// Whether the number of samples is ⌊a b⌋ or ⌈a b⌉ (Laine & Karras 2011) rather than left to chance.
    pub stratified: bool,
    /// Picks the masks.
    pub seed: u64,
}

impl RandomMasks {
    /// The mask of a fragment of `primitive` in pixel (`x`, `y`). Every sample is in it with probability
    /// `alpha`.
    pub fn draw<W: Words>(&self, x: u32, y: u32, primitive: u32, alpha: f32, mask: &mut Mask<W>) {
        let draws = Draws::new(x, y, primitive, self.seed);
        mask.reset(self.bits);
        if self.stratified {
            #[expect(clippy::cast_possible_truncation, reason = "masks have fewer than 2^32 bits")]
            let samples = rounded(alpha, self.bits as u32, draws) as usize;
            choose(samples, self.bits, draws, mask);
        } else {
            toss(alpha, self.bits, draws, mask);
        }
    }
}

/// a L, rounded up with the probability of its fraction.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0 <= a L <= L")]
pub fn rounded(alpha: f32, levels: u32, draws: Draws) -> u32 {
    let exact = f64::from(alpha) * f64::from(levels);
    exact as u32 + u32::from(draws.unit(ROUNDING) < exact.fract())
}

/// Adds `m` of `bits` samples to an empty mask, every choice as likely as another: what the first m entries of
/// a random permutation are, in m draws and without the permutation (Bentley & Floyd 1987).
#[expect(clippy::cast_possible_truncation, reason = "masks have fewer than 2^32 bits")]
fn choose<W: Words>(m: usize, bits: usize, draws: Draws, mask: &mut Mask<W>) {
    for last in bits - m.min(bits - m)..bits {
        let candidate = draws.below(last as u32 + 1, POSITIONS + last as u32) as usize;
        mask.insert(if mask.has(candidate) { last } else { candidate });
    }
    if m > bits - m {
        mask.invert(bits);
    }
}

/// Adds each of `bits` samples to an empty mask with probability `alpha`.
fn toss<W: Words>(alpha: f32, bits: usize, draws: Draws, mask: &mut Mask<W>) {
    for (w, word) in mask.words.as_mut().iter_mut().enumerate() {
        *word = below_alpha(alpha, lanes(w, bits), w, draws);
    }
}

/// Which of 64 random numbers are less than `alpha`: their binary digits are drawn from the front, for all of
/// them at once, until each differs from alpha's.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_precision_loss,
    clippy::cast_sign_loss,
    reason = "alpha is in [0, 1]; a mask has fewer than 2^26 words"
)]
fn below_alpha(alpha: f32, mut undecided: u64, w: usize, draws: Draws) -> u64 {
    const DIGITS: u32 = 32;
    let threshold = (f64::from(alpha) * (1_u64 << DIGITS) as f64) as u64;
    if threshold >> DIGITS == 1 {
        return undecided;
    }
    let mut less = 0;
    for digit in (0..DIGITS).rev() {
        if undecided == 0 {
            break;
        }
        let block = POSITIONS + 2 * (w as u32 * DIGITS + digit);
        let random = u64::from(draws.hash(block)) << 32 | u64::from(draws.hash(block + 1));
        if threshold >> digit & 1 == 1 {
            less |= undecided & !random;
            undecided &= random;
        } else {
            undecided &= !random;
        }
    }
    less
}

#[cfg(test)]
mod tests {
    #![expect(clippy::cast_precision_loss, reason = "small counts")]

    use super::*;

    fn mask<W: Words>(bits: usize, samples: &[usize]) -> Mask<W> {
        let mut mask = Mask::empty(bits);
        samples.iter().for_each(|&i| mask.insert(i));
        mask
    }

    fn draw<W: Words>(bits: usize, stratified: bool, alpha: f32, seed: u64) -> Mask<W> {
        let mut mask = Mask::default();
        RandomMasks { bits, stratified, seed }.draw(3, 5, 7, alpha, &mut mask);
        mask
    }

    fn algebra<W: Words>(bits: usize) {
        let last = bits - 1;
        let (a, b) = (mask::<W>(bits, &[0, 2, last]), mask::<W>(bits, &[2, 3]));
        assert_eq!((a.count(), b.count(), a.count_outside(&b)), (3, 2, 2));
        let (mut both, mut rest) = (a.clone(), a.clone());
        both.unite(&b);
        rest.subtract(&b);
        assert_eq!((both, &rest), (mask(bits, &[0, 2, 3, last]), &mask(bits, &[0, last])));
        assert!(rest.is_within(&a) && !b.is_within(&a) && a.has(last) && !a.has(3));
        let mut all = Mask::<W>::empty(bits);
        all.invert(bits);
        assert_eq!(all.count(), bits);
    }

    #[test]
    fn sets_of_any_width() {
        [5, 8, 63, 64].into_iter().for_each(algebra::<OneWord>);
        [65, 96, 128].into_iter().for_each(algebra::<TwoWords>);
        [5, 64, 129, 4096].into_iter().for_each(algebra::<ManyWords>);
    }

    #[test]
    fn a_masks_bits_do_not_depend_on_what_they_are_kept_in() {
        for seed in 0..200 {
            for (stratified, alpha) in [(true, 0.3), (false, 0.7)] {
                let one = draw::<OneWord>(37, stratified, alpha, seed);
                let many = draw::<ManyWords>(37, stratified, alpha, seed);
                assert_eq!(one.words.as_slice(), many.words.as_slice());
            }
        }
    }

    #[test]
    fn stratified_masks_have_the_floor_or_the_ceiling_of_their_share() {
        for (bits, alpha) in [(1, 0.5), (8, 0.3), (37, 0.99), (64, 0.01), (200, 0.123), (4096, 0.77)] {
            let share = f64::from(alpha) * bits as f64;
            for seed in 0..100 {
                let count = draw::<ManyWords>(bits, true, alpha, seed).count() as f64;
                assert!(count == share.floor() || count == share.ceil(), "{bits} {alpha}: {count}");
            }
        }
    }

    #[test]
    fn nothing_and_everything_are_certain() {
        for bits in [1, 8, 64, 100, 4096] {
            for stratified in [false, true] {
                assert_eq!(draw::<ManyWords>(bits, stratified, 0.0, 1).count(), 0);
                assert_eq!(draw::<ManyWords>(bits, stratified, 1.0, 1).count(), bits);
            }
        }
    }

    /// Bonferroni over the bits: |z| beyond 5.5 has probability 4e-8.
    const FAR_OUT: f64 = 5.5;
    const SEEDS: u32 = 4096;

    /// Standard score of a binomial count.
    fn z(hits: u32, p: f64) -> f64 {
        let n = f64::from(SEEDS);
        (f64::from(hits) - n * p) / (n * p * (1.0 - p)).sqrt()
    }

    #[test]
    fn every_bit_is_set_as_often_as_alpha_says() {
        for (bits, alpha) in [(5, 0.3), (32, 0.05), (64, 0.71), (130, 0.4)] {
            for stratified in [false, true] {
                let mut hits = vec![0; bits];
                for seed in 0..SEEDS {
                    let mask = draw::<ManyWords>(bits, stratified, alpha, seed.into());
                    (0..bits).filter(|&i| mask.has(i)).for_each(|i| hits[i] += 1);
                }
                let worst = hits.iter().map(|&h| z(h, alpha.into()).abs()).fold(0.0, f64::max);
                assert!(worst < FAR_OUT, "{bits} {alpha} {stratified}: {worst} in {hits:?}");
            }
        }
    }

    #[test]
    fn every_choice_of_two_in_five_is_as_likely() {
        let mut hits = [[0; 5]; 5];
        for seed in 0..SEEDS {
            let mask = draw::<OneWord>(5, true, 0.4, seed.into());
            let set: Vec<_> = (0..5).filter(|&i| mask.has(i)).collect();
            hits[set[0]][set[1]] += 1;
        }
        for (i, j) in (0..5).flat_map(|i| (i + 1..5).map(move |j| (i, j))) {
            assert!(z(hits[i][j], 0.1).abs() < FAR_OUT, "{hits:?}");
        }
    }

    /// Var of the count: a (1 − a) b for independent bits, f (1 − f) with f = frac(a b) for stratified ones.
    #[test]
    fn stratification_takes_the_variance_out_of_the_count() {
        let (bits, alpha) = (10, 0.25);
        for (stratified, variance) in [(false, 1.875), (true, 0.25)] {
            let mut sum = 0.0;
            for seed in 0..SEEDS {
                let count = draw::<OneWord>(bits, stratified, alpha, seed.into()).count();
                sum += (count as f64 - 2.5).powi(2);
            }
            let measured = sum / f64::from(SEEDS);
            // standard error of a variance over n samples is about sqrt(2 / n) of it
            assert!((measured / variance - 1.0).abs() < FAR_OUT * (2.0 / f64::from(SEEDS)).sqrt());
        }
    }

    #[test]
    fn masks_of_different_fragments_pixels_and_seeds_are_independent() {
        let masks = |seed| RandomMasks { bits: 64, stratified: true, seed };
        let draw = |x, y, key, seed| {
            let mut mask = Mask::<OneWord>::default();
            masks(seed).draw(x, y, key, 0.5, &mut mask);
            mask
        };
        let mut overlap = [0; 4];
        for i in 0..SEEDS {
            let mask = draw(i, 2, 3, 4);
            let others = [draw(i + 1, 2, 3, 4), draw(i, 3, 3, 4), draw(i, 2, 4, 4), draw(i, 2, 3, 5)];
            for (sum, other) in overlap.iter_mut().zip(&others) {
                *sum += mask.count() - mask.count_outside(other);
            }
        }
        // hypergeometric: mean 16, variance 64 / 16 · 64 / 63
        let error = (4.0 * 64.0 / 63.0 / f64::from(SEEDS)).sqrt();
        for sum in overlap {
            assert!((sum as f64 / f64::from(SEEDS) - 16.0).abs() < FAR_OUT * error, "{overlap:?}");
        }
    }
}
