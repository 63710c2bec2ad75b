//! Numbers far beyond f64's range: a mantissa and a power of two.

/// `mantissa 2^exponent`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Power {
    /// In [1, 2), or 0.
    pub mantissa: f64,
    /// Of 2.
    pub exponent: i64,
}

/// Exponents stay within this: weights so different have nothing to do with each other, and differences of exponents do
/// not overflow.
const LARGEST: f64 = 1e15;

impl Power {
    /// `2^log2`.
    #[expect(clippy::cast_possible_truncation, reason = "clamped")]
    pub fn exp2(log2: f64) -> Self {
        if log2 == f64::NEG_INFINITY {
            return Self { mantissa: 0.0, exponent: 0 };
        }
        let log2 = log2.clamp(-LARGEST, LARGEST);
        Self { mantissa: (log2 - log2.floor()).exp2(), exponent: log2.floor() as i64 }
    }

    /// 2 to a whole number.
    pub const fn of_two(exponent: i64) -> Self {
        Self { mantissa: 1.0, exponent }
    }

    /// As a double.
    pub fn as_f64(self) -> f64 {
        times_power(self.mantissa, self.exponent)
    }
}

/// `x 2^exponent`, rounded once; 0 where that is below f64's range.
#[expect(clippy::cast_possible_truncation, reason = "clamped")]
pub fn times_power(x: f64, exponent: i64) -> f64 {
    // in two steps, so that neither factor is beyond the range of normal numbers; the first is exact where it matters
    let exponent = exponent.clamp(-2040, 2040) as i32;
    let first = exponent.clamp(-1020, 1020);
    x * 2.0_f64.powi(first) * 2.0_f64.powi(exponent - first)
}

/// The exponent of a normal number's leading bit.
#[expect(clippy::cast_possible_wrap, reason = "eleven bits")]
pub fn exponent_of(x: f64) -> i64 {
    (x.to_bits() >> 52 & 0x7ff) as i64 - 1023
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn powers_are_taken_apart_and_put_together() {
        assert_eq!(Power::exp2(3.0), Power { mantissa: 1.0, exponent: 3 });
        assert_eq!(Power::exp2(-1.5), Power { mantissa: 0.5_f64.exp2(), exponent: -2 });
        assert_eq!(Power::exp2(-1e12).exponent, -1_000_000_000_000);
        assert_eq!(Power::exp2(f64::NEG_INFINITY).as_f64(), 0.0);
        assert_eq!([times_power(1.5, -1070), times_power(1.5, 2000)], [f64::from_bits(24), f64::INFINITY]);
        assert_eq!(times_power(2.0_f64.powi(-1000), 1500), 2.0_f64.powi(500));
        assert_eq!([1.0, 1.99, 0.5, 65_504.0].map(exponent_of), [0, 0, -1, 15]);
    }
}
