//! Numbers m * 2^e with whole m of any size: every `f64` is one, and so are their sums and products.

use num_bigint::{BigInt, Sign};
use std::ops::{Add, Mul, Neg, Sub};

/// `mantissa * 2^exponent`, exactly.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Dyadic {
    mantissa: BigInt,
    exponent: i64,
}

impl From<f64> for Dyadic {
    fn from(x: f64) -> Self {
        assert!(x.is_finite(), "{x}");
        let bits = x.to_bits();
        let (biased, fraction) = ((bits >> 52) & 0x7ff, bits & ((1 << 52) - 1));
        let whole = if biased == 0 { fraction } else { fraction | 1 << 52 };
        let sign = if x < 0.0 { -1 } else { 1 };
        Self { mantissa: BigInt::from(whole) * sign, exponent: biased.max(1).cast_signed() - 1075 }
    }
}

impl From<i64> for Dyadic {
    fn from(n: i64) -> Self {
        Self { mantissa: n.into(), exponent: 0 }
    }
}

impl From<i32> for Dyadic {
    fn from(n: i32) -> Self {
        i64::from(n).into()
    }
}

impl Dyadic {
    /// -1, 0 or 1.
    pub fn sign(&self) -> i32 {
        match self.mantissa.sign() {
            Sign::Minus => -1,
            Sign::NoSign => 0,
            Sign::Plus => 1,
        }
    }

    /// The magnitude.
    pub fn abs(self) -> Self {
        if self.sign() < 0 { -self } else { self }
    }

    /// The number with an exponent no larger than its own.
    fn mantissa_at(&self, exponent: i64) -> BigInt {
        &self.mantissa << (self.exponent - exponent)
    }

    /// `self / other` for nonnegative numbers, to within 2^-60 of itself.
    pub fn ratio(&self, other: &Self) -> f64 {
        if self.sign() == 0 {
            return 0.0;
        }
        let bits = |n: &BigInt| n.bits().cast_signed();
        let shift = 100 + bits(&other.mantissa) - bits(&self.mantissa);
        let shifted =
            if shift >= 0 { &self.mantissa << shift } else { &self.mantissa >> shift.unsigned_abs() };
        let quotient = u128::try_from(&(shifted / &other.mantissa)).expect("some hundred bits");
        quotient as f64 * ((self.exponent - other.exponent - shift) as f64).exp2()
    }
}

impl Add for &Dyadic {
    type Output = Dyadic;
    fn add(self, other: Self) -> Dyadic {
        let exponent = self.exponent.min(other.exponent);
        Dyadic { mantissa: self.mantissa_at(exponent) + other.mantissa_at(exponent), exponent }
    }
}

impl Sub for &Dyadic {
    type Output = Dyadic;
    fn sub(self, other: Self) -> Dyadic {
        self + &-other.clone()
    }
}

impl Mul for &Dyadic {
    type Output = Dyadic;
    fn mul(self, other: Self) -> Dyadic {
        Dyadic { mantissa: &self.mantissa * &other.mantissa, exponent: self.exponent + other.exponent }
    }
}

impl Neg for Dyadic {
    type Output = Self;
    fn neg(self) -> Self {
        Self { mantissa: -self.mantissa, exponent: self.exponent }
    }
}
