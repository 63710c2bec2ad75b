//! WGSL's functions of numbers, lane by lane. Those that cost most have no branches and no calls, so that loops over them
//! vectorise; all are rounded once, from f64 where f32 does not hold them.
#![expect(clippy::inline_always, reason = "these take on their caller's instruction set")]
#![expect(clippy::cast_possible_truncation, reason = "rounding to f32 is the point")]

use crate::continuum::functions;
use std::f64::consts::{LN_2, LOG2_E};

/// What [`functions::exp`] takes at most.
const LARGEST: f64 = 709.0;

/// e^x; NaN stays.
#[inline(always)]
fn exp_f64(x: f64) -> f64 {
    let inside = if x < LARGEST { x } else { LARGEST };
    let power = functions::exp(inside);
    if x.is_nan() { x } else { power }
}

/// e^x.
#[inline(always)]
pub fn exp(x: f32) -> f32 {
    exp_f64(x.into()) as f32
}

/// 2^x.
#[inline(always)]
pub fn exp2(x: f32) -> f32 {
    exp_f64(f64::from(x) * LN_2) as f32
}

/// ln x: minus infinity at 0, NaN below.
#[inline(always)]
fn ln_f64(x: f32) -> f64 {
    let ln = functions::ln(f64::from(x));
    let outside = if x == 0.0 { f64::NEG_INFINITY } else { f64::NAN };
    let ln = if x > 0.0 { ln } else { outside };
    if x == f32::INFINITY { f64::INFINITY } else { ln }
}

/// ln x.
#[inline(always)]
pub fn log(x: f32) -> f32 {
    ln_f64(x) as f32
}

/// log2 x.
#[inline(always)]
pub fn log2(x: f32) -> f32 {
    (ln_f64(x) * LOG2_E) as f32
}

/// x^y: NaN where x is negative and y is not whole.
#[inline(always)]
pub fn pow(x: f32, y: f32) -> f32 {
    let power = exp_f64(f64::from(y) * ln_f64(x.abs())) as f32;
    let half = 0.5 * y;
    let is_odd = half.floor() != half;
    let signed = if is_odd { -power } else { power };
    let below = if y.floor() == y { signed } else { f32::NAN };
    let power = if x < 0.0 { below } else { power };
    if y == 0.0 || x == 1.0 { 1.0 } else { power }
}

/// x^n for a small whole n, by multiplication: in f32 up to the fourth power, rounded once beyond.
#[inline(always)]
pub fn power(x: f32, n: i32) -> f32 {
    let square = x * x;
    match n {
        0 => 1.0,
        1 => x,
        2 => square,
        3 => square * x,
        4 => square * square,
        _ => {
            let (mut result, mut factor, mut left) = (1.0, f64::from(x), n.unsigned_abs());
            while left > 0 {
                if left & 1 == 1 {
                    result *= factor;
                }
                factor *= factor;
                left >>= 1;
            }
            (if n < 0 { 1.0 / result } else { result }) as f32
        }
    }
}

/// The remainder that has the sign of x, as WGSL defines it.
#[inline(always)]
pub fn remainder(x: f32, y: f32) -> f32 {
    x - y * (x / y).trunc()
}

/// b where b is less, else a: NaN stays if it comes first.
#[inline(always)]
pub fn min(a: f32, b: f32) -> f32 {
    if b < a { b } else { a }
}

/// b where a is less, else a: NaN stays if it comes first.
#[inline(always)]
pub fn max(a: f32, b: f32) -> f32 {
    if a < b { b } else { a }
}

/// −1, 0 or 1; NaN stays.
#[inline(always)]
pub fn sign(x: f32) -> f32 {
    let below = if x < 0.0 { -1.0 } else { x };
    if x > 0.0 { 1.0 } else { below }
}

/// x 2^n.
#[inline(always)]
#[expect(clippy::cast_sign_loss, reason = "the exponent is positive")]
pub fn ldexp(x: f32, n: i32) -> f32 {
    let scale = f64::from_bits(((n.clamp(-400, 400) + 1023) as u64) << 52);
    (f64::from(x) * scale) as f32
}

/// Quotients by nothing are the dividend (WGSL 8.7).
#[inline(always)]
pub fn divide_i32(a: i32, b: i32) -> i32 {
    if b == 0 { a } else { a.wrapping_div(b) }
}

/// Remainders by nothing are 0.
#[inline(always)]
pub fn remainder_i32(a: i32, b: i32) -> i32 {
    if b == 0 { 0 } else { a.wrapping_rem(b) }
}

/// The place of the highest bit that differs from the sign; −1 without.
#[inline(always)]
pub fn first_leading_bit_i32(x: i32) -> u32 {
    first_leading_bit_u32((if x < 0 { !x } else { x }).cast_unsigned())
}

/// The place of the highest 1; −1 without.
#[inline(always)]
pub fn first_leading_bit_u32(x: u32) -> u32 {
    31_u32.wrapping_sub(x.leading_zeros())
}

/// The place of the lowest 1; −1 without.
#[inline(always)]
pub fn first_trailing_bit(x: u32) -> u32 {
    if x == 0 { u32::MAX } else { x.trailing_zeros() }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Units in the last place of f32 between two numbers.
    fn ulps(got: f32, exact: f64) -> f64 {
        let expected = exact as f32;
        if got == expected || (got.is_nan() && expected.is_nan()) {
            return 0.0;
        }
        let step = (f64::from(expected.abs()) * f64::from(f32::EPSILON)).max(f64::from(f32::from_bits(1)));
        (f64::from(got) - exact).abs() / step
    }

    #[test]
    fn functions_are_those_of_the_standard_library() {
        let special = [0.0, 1.0, -1.0, 2.0, 0.5, -3.0, 1e-40, 88.8, -110.0, 1e30, f32::INFINITY, f32::NAN];
        let some = (0..400_u16).map(|i| f32::from(i) * 0.371 - 60.0);
        for x in some.chain(special) {
            let wide = f64::from(x);
            for (got, exact) in
                [(exp(x), wide.exp()), (exp2(x), wide.exp2()), (log(x), wide.ln()), (log2(x), wide.log2())]
            {
                assert!(ulps(got, exact) <= 1.0, "{x}: {got} for {exact}");
            }
            for y in [0.0, 0.5, 1.0, 2.0, 3.0, -1.0, -2.5, 7.0, 40.0, f32::NAN] {
                assert!(ulps(pow(x, y), wide.powf(y.into())) <= 1.0, "{x}^{y}: {}", pow(x, y));
            }
            for n in -12..=12 {
                assert!(ulps(power(x, n), wide.powi(n)) <= 2.0, "{x}^{n}: {}", power(x, n));
            }
        }
    }

    #[test]
    fn edges_are_wgsls() {
        assert_eq!(remainder(-7.5, 2.0), -1.5);
        assert!(min(f32::NAN, 1.0).is_nan() && max(f32::NAN, 1.0).is_nan() && sign(f32::NAN).is_nan());
        assert_eq!((divide_i32(7, 0), remainder_i32(7, 0)), (7, 0));
        assert_eq!((divide_i32(i32::MIN, -1), remainder_i32(i32::MIN, -1)), (i32::MIN, 0));
        assert_eq!(
            (ldexp(1.5, 3), ldexp(1.0, -149), ldexp(1.0, 1000)),
            (12.0, f32::from_bits(1), f32::INFINITY)
        );
        assert_eq!(first_leading_bit_i32(-1), u32::MAX);
        assert_eq!((first_leading_bit_u32(9), first_leading_bit_i32(-9), first_trailing_bit(8)), (3, 3, 3));
    }
}
