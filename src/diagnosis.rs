//! What can go wrong with a pixel's numbers, and what did.

use crate::format::Format;

/// A way for numbers to go wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fault {
    /// Fragments whose blend or node made a number infinite.
    Overflow,
    /// Fragments that left a number which is not 0 below the smallest normal one: subnormal, or flushed to 0.
    Underflow,
    /// Fragments that a stored number did not take notice of: it was too large for what they add or take away.
    Stagnation,
    /// Fragments whose blend or node met the end of a format that has no infinity.
    Saturation,
    /// Bits that a difference of numbers about as large has lost, at most those that the format has.
    Cancellation,
    /// Stored numbers that were infinite or NaN when they were read; the largest number stands in for them.
    NonFinite,
    /// Whether the moments' matrix, as biased as the params say, was not positive definite beyond rounding.
    HankelFailures,
    /// How often the moments' bias had to be raised, tenfold each time.
    BiasRetries,
    /// Fragments that see a transmittance outside of [0, 1], which is clamped, or one that rises with depth.
    ClampedRinging,
}

impl Fault {
    /// All there are.
    pub const ALL: [Self; 9] = [
        Self::Overflow,
        Self::Underflow,
        Self::Stagnation,
        Self::Saturation,
        Self::Cancellation,
        Self::NonFinite,
        Self::HankelFailures,
        Self::BiasRetries,
        Self::ClampedRinging,
    ];

    /// The name users read.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Overflow => "overflow",
            Self::Underflow => "underflow",
            Self::Stagnation => "stagnation",
            Self::Saturation => "saturation",
            Self::Cancellation => "cancellation",
            Self::NonFinite => "non_finite",
            Self::HankelFailures => "hankel_failures",
            Self::BiasRetries => "bias_retries",
            Self::ClampedRinging => "clamped_ringing",
        }
    }

    /// Whether its amount is a number of things; else it is a number of bits.
    pub const fn is_count(self) -> bool {
        !matches!(self, Self::Cancellation)
    }
}

/// The faults that a technique can have.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Faults(u16);

impl Faults {
    /// None that are looked for.
    pub const NONE: Self = Self(0);

    /// These.
    pub const fn of(faults: &[Fault]) -> Self {
        Self::NONE.and(faults)
    }
    /// These besides.
    pub const fn and(self, faults: &[Fault]) -> Self {
        let (mut bits, mut i) = (self.0, 0);
        while i < faults.len() {
            bits |= 1 << faults[i] as u16;
            i += 1;
        }
        Self(bits)
    }
    /// All of both.
    pub const fn union(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
    /// Whether it is one of them.
    pub const fn has(self, fault: Fault) -> bool {
        self.0 >> fault as u16 & 1 == 1
    }
    /// One by one.
    pub fn iter(self) -> impl Iterator<Item = Fault> {
        Fault::ALL.into_iter().filter(move |fault| self.has(*fault))
    }

    /// Those of numbers that are rounded to `format` once they are stored.
    pub fn of_format(format: Format) -> Self {
        if format.has_infinity() {
            Self::of(&[Fault::Overflow, Fault::Underflow, Fault::NonFinite])
        } else {
            Self::of(&[Fault::Saturation, Fault::Underflow])
        }
    }
}

/// How often, or by how much, each fault has befallen a pixel.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Diagnosis {
    amounts: [f32; Fault::ALL.len()],
}

impl Diagnosis {
    /// Nothing went wrong.
    pub const CLEAR: Self = Self { amounts: [0.0; Fault::ALL.len()] };

    /// How much of it there is.
    pub fn amount(&self, fault: Fault) -> f32 {
        self.amounts[fault as usize]
    }
    /// Once more.
    pub fn count(&mut self, fault: Fault) {
        self.amounts[fault as usize] += 1.0;
    }
    /// Once more for each of these.
    pub fn count_all(&mut self, faults: Faults) {
        faults.iter().for_each(|fault| self.count(fault));
    }
    /// At least so much.
    pub fn at_least(&mut self, fault: Fault, amount: f32) {
        let old = &mut self.amounts[fault as usize];
        *old = old.max(amount);
    }

    /// With what befell another of the pixel's targets: counts add up, of bits the most are lost.
    #[must_use]
    pub fn and(mut self, other: &Self) -> Self {
        for fault in Fault::ALL {
            match fault {
                Fault::Cancellation => self.at_least(fault, other.amount(fault)),
                _ => self.amounts[fault as usize] += other.amount(fault),
            }
        }
        self
    }

    /// The bits that the difference of two positive numbers loses when it is stored in, or read from, `format`.
    #[expect(clippy::cast_possible_truncation, reason = "a number of bits")]
    pub fn cancel(&mut self, minuend: f64, subtrahend: f64, format: Format) {
        let all = -format.unit_roundoff().log2();
        let lost = ((minuend + subtrahend) / (minuend - subtrahend).abs()).log2();
        self.at_least(Fault::Cancellation, if lost < all { lost.max(0.0) } else { all } as f32);
    }
}

/// What rounding `exact` to `stored`, a number of `format`, has done.
pub fn rounding(format: Format, exact: f64, stored: f64) -> Faults {
    let mut faults = Faults::NONE;
    if !stored.is_finite() {
        faults = faults.and(&[Fault::Overflow]);
    }
    if exact != 0.0 && stored.abs() < format.smallest_normal() {
        faults = faults.and(&[Fault::Underflow]);
    }
    if !format.has_infinity() && exact.abs() > format.max_finite(0) {
        faults = faults.and(&[Fault::Saturation]);
    }
    faults
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sets_hold_what_they_were_given() {
        let set = Faults::of(&[Fault::Overflow, Fault::Cancellation]);
        assert_eq!(set.iter().collect::<Vec<_>>(), [Fault::Overflow, Fault::Cancellation]);
        assert!(set.union(Faults::of(&[Fault::Underflow])).has(Fault::Underflow));
        assert_eq!(Faults::NONE.iter().count(), 0);
    }

    #[test]
    fn rounding_by_hand() {
        let found = |format: Format, x: f64| rounding(format, x, format.round(x)).iter().collect::<Vec<_>>();
        assert_eq!(found(Format::F16, 65_520.0), [Fault::Overflow]);
        assert_eq!(found(Format::F16, 65_519.0), []);
        // 2^-14 is the smallest normal half
        assert_eq!(found(Format::F16, 6.2e-5), []);
        assert_eq!(found(Format::F16, 6e-5), [Fault::Underflow]);
        assert_eq!(found(Format::F16, 1e-9), [Fault::Underflow]);
        assert_eq!(found(Format::Unorm8, 1.25), [Fault::Saturation]);
        assert_eq!(found(Format::Unorm8, 1.0 / 511.0), [Fault::Underflow]);
        assert_eq!(found(Format::Unorm8, 0.0), []);
    }

    #[test]
    fn differences_lose_at_most_what_there_is() {
        let lost = |a, b, format| {
            let mut diagnosis = Diagnosis::CLEAR;
            diagnosis.cancel(a, b, format);
            diagnosis.amount(Fault::Cancellation)
        };
        // (1 + 3/4) / (1/4) = 7
        assert!((lost(1.0, 0.75, Format::F32) - 7.0_f32.log2()).abs() < 1e-6);
        assert_eq!(lost(1.0, 1.0, Format::F32), 24.0);
        assert_eq!(lost(1.0, 1.0, Format::F16), 11.0);
        assert_eq!(lost(1.0, 0.0, Format::F16), 0.0);
        assert_eq!(lost(0.0, 0.0, Format::F16), 11.0);
    }
}
