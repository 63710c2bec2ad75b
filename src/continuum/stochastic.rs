//! The axis *insertion*, stochastic: a fragment enters a list if a random mask of its alpha would show some
//! sample behind the masks in front (W16 section 4.2).

use super::coverage::{Coverage, Samples};
use super::insertion::{Arrival, Insertion};
use super::masks::Words;
use super::opacity::{Alpha, Layer, Opacity};
use super::stored_layers::{Kept, StoredAlpha, StoredLayer};
use crate::fragments::Fragment;
use crate::random::Draws;
use crate::technique::Pixel;

/// With masks: a fragment enters if it has a sample of its own.
#[derive(Debug, Clone, Copy)]
pub struct VisibleSamples;

impl<W: Words> Insertion<Coverage<W>> for VisibleSamples {
    type State = ();

    fn admit(&self, arrival: &Arrival<'_, Coverage<W>>, (): &mut ()) -> Option<Samples<W>> {
        visible(arrival)
    }
}

impl<W: Words> Insertion<Kept<Coverage<W>>> for VisibleSamples {
    type State = ();

    fn admit(&self, arrival: &Arrival<'_, Kept<Coverage<W>>>, (): &mut ()) -> Option<Samples<W>> {
        visible(arrival)
    }
}

/// The samples that nothing in front has.
fn visible<W: Words, O: Opacity<Paint = Samples<W>>>(arrival: &Arrival<'_, O>) -> Option<Samples<W>> {
    let mut paint = arrival.paint()?;
    for node in arrival.in_front {
        paint.mask.subtract(&node.paint.mask);
    }
    (!paint.mask.is_empty()).then_some(paint)
}

/// With continuous alpha: a fragment enters with the probability that its mask would show, had it one.
#[derive(Debug, Clone)]
pub struct VisibleByChance {
    /// P(o, i) of W16.
    pub probability: Visibility,
    /// Picks the draws.
    pub seed: u64,
}

/// Keeps these draws apart from those of masks.
const INSERTION: u32 = 0x494E_5345;

impl VisibleByChance {
    /// Whether the fragment enters, if what is stored in front of it covers `occlusion`.
    pub fn shows(&self, pixel: &Pixel<'_>, fragment: &Fragment, occlusion: impl FnOnce() -> f64) -> bool {
        let draws = Draws::new(pixel.x, pixel.y, fragment.primitive, self.seed);
        draws.unit(INSERTION) < self.probability.of(occlusion, fragment.alpha.into())
    }

    fn admit_paint<O: Opacity>(&self, arrival: &Arrival<'_, O>) -> Option<O::Paint> {
        let occlusion = || 1.0 - arrival.opacity.transmittance(arrival.in_front);
        if self.shows(arrival.pixel, arrival.fragment, occlusion) { arrival.paint() } else { None }
    }
}

impl Insertion<Alpha> for VisibleByChance {
    type State = ();

    fn admit(&self, arrival: &Arrival<'_, Alpha>, (): &mut ()) -> Option<Layer> {
        self.admit_paint(arrival)
    }
}

impl Insertion<StoredAlpha> for VisibleByChance {
    type State = ();

    fn admit(&self, arrival: &Arrival<'_, StoredAlpha>, (): &mut ()) -> Option<StoredLayer> {
        self.admit_paint(arrival)
    }
}

/// The probability `P_b(o, i)` that a mask of b bits shows behind others.
#[derive(Debug, Clone)]
pub enum Visibility {
    /// b → ∞: whatever covers something shows.
    Certain,
    /// Every bit is set with probability alpha (W16 eq. 3).
    Random {
        /// b.
        bits: usize,
    },
    /// Masks have alpha b bits (W16 eq. 4).
    Stratified {
        /// b.
        bits: usize,
        /// 1 − P.
        hidden: Hidden,
    },
}

impl Visibility {
    /// Of masks of `bits` bits; none is without limit.
    pub fn new(bits: usize, stratified: bool) -> Self {
        match (bits, stratified) {
            (0, _) => Self::Certain,
            (_, false) => Self::Random { bits },
            (_, true) => Self::Stratified { bits, hidden: Hidden::new(bits) },
        }
    }

    /// `P_b` of a fragment of `alpha` behind layers that together cover `occlusion`.
    #[expect(clippy::cast_precision_loss, reason = "at most 4096 bits")]
    pub fn of(&self, occlusion: impl FnOnce() -> f64, alpha: f64) -> f64 {
        match self {
            Self::Certain => 1.0,
            Self::Random { bits } => {
                // eq. 10: exact in alpha, so only o is interpolated
                let hidden = |o: usize| (1.0 - alpha).powf((bits - o) as f64);
                1.0 - between(occlusion() * *bits as f64, *bits, hidden)
            }
            Self::Stratified { bits, hidden } => {
                // section 4.5: bilinear in o = α_occ b and i = α_i b
                let (b, o) = (*bits as f64, occlusion());
                1.0 - between(o * b, *bits, |o| between(alpha * b, *bits, |i| hidden.of(o, i)))
            }
        }
    }
}

/// Probability that i bits of b at random are all among o given ones: the ratio of falling factorials
/// o! (b − i)! / (b! (o − i)!) in W16 eq. 4.
#[derive(Debug, Clone)]
pub enum Hidden {
    /// For every o and i, row by row of o.
    Table {
        /// b + 1.
        width: usize,
        /// The probabilities.
        hidden: Vec<f64>,
    },
    /// From ln n! for every n up to b.
    LogFactorials(Vec<f64>),
}

/// Wider masks than these are not tabulated: (b + 1)² numbers take half a megabyte here.
const TABULATED: usize = 256;

#[expect(clippy::cast_precision_loss, reason = "at most 4096 bits")]
impl Hidden {
    fn new(bits: usize) -> Self {
        if bits <= TABULATED {
            return Self::Table { width: bits + 1, hidden: table(bits) };
        }
        let sum = |sum: &mut f64, n: usize| {
            *sum += (n.max(1) as f64).ln();
            Some(*sum)
        };
        Self::LogFactorials((0..=bits).scan(0.0, sum).collect())
    }

    fn of(&self, o: usize, i: usize) -> f64 {
        match self {
            Self::Table { width, hidden } => hidden[o * width + i],
            Self::LogFactorials(_) if o < i => 0.0,
            Self::LogFactorials(ln) => {
                // so paired, the differences are exactly zero where the result is exactly one
                let b = ln.len() - 1;
                ((ln[o] - ln[b]) + (ln[b - i] - ln[o - i])).exp()
            }
        }
    }
}

/// The product of (o − q) / (b − q) over q < i, for every o and i.
#[expect(clippy::cast_precision_loss, reason = "at most 4096 bits")]
fn table(bits: usize) -> Vec<f64> {
    let mut table = Vec::with_capacity((bits + 1) * (bits + 1));
    for o in 0..=bits {
        let mut hidden = 1.0;
        for i in 0..=bits {
            table.push(hidden);
            hidden *= o.saturating_sub(i) as f64 / (bits - i).max(1) as f64;
        }
    }
    table
}

/// Linear interpolation of a function of 0..=`end` at `x`.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0 <= x <= 4096")]
fn between(x: f64, end: usize, function: impl Fn(usize) -> f64) -> f64 {
    let (floor, fraction) = ((x as usize).min(end), x.fract());
    let value = function(floor);
    if fraction == 0.0 || floor == end {
        return value;
    }
    value + fraction * (function(floor + 1) - value)
}

#[cfg(test)]
mod tests {
    #![expect(clippy::cast_precision_loss, reason = "small counts")]

    use super::*;

    /// Products of up to 4096 quotients in f64.
    const ROUNDING: f64 = 1e-12;

    fn stratified(bits: usize, o: usize, i: usize) -> f64 {
        let b = bits as f64;
        Visibility::new(bits, true).of(|| o as f64 / b, i as f64 / b)
    }

    /// All masks of i bits in front of one of o bits, for b = 4 and 6.
    #[test]
    fn equation_4_counts_masks() {
        for bits in [4_usize, 6] {
            for (o, i) in (0..=bits).flat_map(|o| (0..=bits).map(move |i| (o, i))) {
                let occluder = (1_u32 << o) - 1;
                let masks = (0..1_u32 << bits).filter(|m| m.count_ones() as usize == i);
                let (visible, all) = masks
                    .fold((0, 0), |(visible, all), m| (visible + u32::from(m & !occluder != 0), all + 1));
                let expected = f64::from(visible) / f64::from(all);
                assert!((stratified(bits, o, i) - expected).abs() < ROUNDING, "{bits} {o} {i}");
            }
        }
    }

    /// Each bit set with probability 1/b · i, over all masks.
    #[test]
    fn equation_3_counts_masks() {
        let bits = 4;
        for (o, i) in (0..=bits).flat_map(|o| (0..=bits).map(move |i| (o, i))) {
            let (b, alpha) = (bits as f64, i as f64 / bits as f64);
            let weight = |m: u32| {
                let n = f64::from(m.count_ones());
                alpha.powf(n) * (1.0 - alpha).powf(b - n)
            };
            let visible = |m: &u32| m & !((1_u32 << o) - 1) != 0;
            let expected: f64 = (0..1_u32 << bits).filter(visible).map(weight).sum();
            let got = Visibility::new(bits, false).of(|| o as f64 / b, alpha);
            assert!((got - expected).abs() < ROUNDING, "{o} {i}");
        }
    }

    #[test]
    fn edges_are_certain() {
        for bits in [1, 4, 32, 256, 257, 4096] {
            for i in [1, bits / 2, bits] {
                assert_eq!(stratified(bits, bits, i), 0.0);
                assert_eq!(stratified(bits, 0, i.max(1)), 1.0);
            }
            assert_eq!([0, bits / 2, bits].map(|o| stratified(bits, o, 0)), [0.0; 3]);
            for stratify in [false, true] {
                let visibility = Visibility::new(bits, stratify);
                assert_eq!([0.0, 0.3, 1.0].map(|alpha| visibility.of(|| 1.0, alpha)), [0.0; 3]);
                let almost = 1.0 - 1.0 / bits as f64;
                assert_eq!([0.0, almost].map(|o| visibility.of(|| o, 1.0)), [1.0; 2]);
            }
        }
        assert_eq!(Visibility::new(0, true).of(|| 1.0, 0.0), 1.0);
    }

    /// Sums of logarithms up to 4096 ln 4096 lose that much to rounding.
    const LOGARITHMS: f64 = 1e-10;

    #[test]
    fn factorials_and_products_agree() {
        for (bits, o, i) in [(300, 100, 3), (300, 299, 200), (300, 300, 5), (4096, 4000, 30), (4096, 13, 14)]
        {
            let hidden = (0..i).map(|q| (o as f64 - q as f64).max(0.0) / (bits - q) as f64).product::<f64>();
            assert!((stratified(bits, o, i) - (1.0 - hidden)).abs() < LOGARITHMS, "{bits} {o} {i}");
        }
    }

    /// Sheet R17: a = .05 behind `α_occ` = .9.
    #[test]
    fn probability_tends_to_one_slowly() {
        for (bits, expected, printed) in
            [(20, 0.10, 5e-3), (40, 0.19, 5e-3), (200, 0.66, 5e-3), (1000, 0.9955, 5e-5)]
        {
            let got = Visibility::new(bits, true).of(|| 0.9, 0.05);
            assert!((got - expected).abs() < printed, "{bits}: {got}");
        }
    }

    /// Interpolating in alpha is the expectation over rounding the number of bits.
    #[test]
    fn between_the_grid_it_is_bilinear() {
        let visibility = Visibility::new(4, true);
        let corner = |o, i| stratified(4, o, i);
        let (a, b) = (0.25, 0.75);
        let expected = (1.0 - a) * ((1.0 - b) * corner(2, 1) + b * corner(2, 2))
            + a * ((1.0 - b) * corner(3, 1) + b * corner(3, 2));
        let got = visibility.of(|| (2.0 + a) / 4.0, (1.0 + b) / 4.0);
        assert!((got - expected).abs() < ROUNDING, "{got} {expected}");
    }
}
