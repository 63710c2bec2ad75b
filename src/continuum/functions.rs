//! Elementary functions without branches and calls, so that loops over them vectorise: exp, ln, sin and cos to an
//! ulp or two. Reductions and coefficients are fdlibm's (Sun Microsystems 1993), whose error bounds hold here too:
//! every operation is rounded by itself, whatever the instruction set.
#![expect(clippy::inline_always, reason = "these take on their caller's instruction set")]
#![expect(clippy::excessive_precision, reason = "coefficients as published")]

use std::f64::consts::{LOG2_E, TAU};

/// Adding and subtracting this rounds to an integer, and leaves it in the low bits in between.
const ROUND: f64 = 6_755_399_441_055_744.0; // 1.5 · 2^52

/// ln 2, the upper part short enough to be multiplied exactly by an exponent.
const LN_2: (f64, f64) = (6.931_471_803_691_238_164_90e-1, 1.908_214_929_270_587_700_02e-10);

/// The smallest exponent of e that [`exp`] takes for one: its result is still a normal number.
const LEAST: f64 = -708.0;

/// The polynomial with these coefficients, ascending.
#[inline(always)]
fn polynomial<const N: usize>(x: f64, coefficients: [f64; N]) -> f64 {
    coefficients.into_iter().rev().fold(0.0, |sum, c| sum * x + c)
}

/// e^x for x up to 709; 0 below −708.
#[inline(always)]
pub fn exp(x: f64) -> f64 {
    const P: [f64; 5] = [
        1.666_666_666_666_660_190_37e-1,
        -2.777_777_777_701_559_338_42e-3,
        6.613_756_321_437_934_361_17e-5,
        -1.653_390_220_546_525_153_90e-6,
        4.138_136_797_057_238_460_39e-8,
    ];
    let inside = if x > LEAST { x } else { LEAST };
    let rounded = inside * LOG2_E + ROUND;
    let k = rounded - ROUND;
    let (high, low) = (inside - k * LN_2.0, k * LN_2.1);
    let r = high - low;
    let t = r * r;
    let c = r - t * polynomial(t, P);
    let power = 1.0 - ((low - r * c / (2.0 - c)) - high);
    let scale = f64::from_bits(rounded.to_bits().wrapping_add(1023) << 52);
    if x > LEAST { power * scale } else { 0.0 }
}

/// ln x for normal x.
#[inline(always)]
pub fn ln(x: f64) -> f64 {
    let (k, m) = split(x);
    ln_scaled(k, m - 1.0)
}

/// ln(1 − a) for an f32 a in [0, 1]; a large negative number where a is 1.
#[inline(always)]
pub fn ln_one_minus(a: f32) -> f64 {
    const NEARLY_ZERO: f64 = 1e-300;
    let a = f64::from(a);
    let rest = 1.0 - a;
    let (k, m) = split(if rest > NEARLY_ZERO { rest } else { NEARLY_ZERO });
    // where the exponent is 0 the difference to 1 is a, to its last bit; elsewhere 1 − a is exact
    ln_scaled(k, if k == 0.0 { -a } else { m - 1.0 })
}

/// The exponent k and m in [√½, √2) such that x = m 2^k.
#[inline(always)]
fn split(x: f64) -> (f64, f64) {
    const SQRT_HALF: u64 = 0x3fe6_a09e_0000_0000;
    const ONE: u64 = 0x3ff0_0000_0000_0000;
    const TWO_TO_52: u64 = 0x4330_0000_0000_0000;
    // the exponent, biased, of x / √½
    let biased = x.to_bits().wrapping_add(ONE - SQRT_HALF) >> 52;
    let m = f64::from_bits(x.to_bits().wrapping_sub(biased << 52).wrapping_add(ONE));
    (f64::from_bits(TWO_TO_52 | biased) - (4_503_599_627_370_496.0 + 1023.0), m)
}

/// ln((1 + f) 2^k).
#[inline(always)]
fn ln_scaled(k: f64, f: f64) -> f64 {
    const P: [f64; 7] = [
        6.666_666_666_666_735_130e-1,
        3.999_999_999_940_941_908e-1,
        2.857_142_874_366_239_149e-1,
        2.222_219_843_214_978_396e-1,
        1.818_357_216_161_805_012e-1,
        1.531_383_769_920_937_332e-1,
        1.479_819_860_511_658_591e-1,
    ];
    let s = f / (2.0 + f);
    let z = s * s;
    let half_square = 0.5 * f * f;
    let rest = s * (half_square + z * polynomial(z, P));
    k * LN_2.0 - ((half_square - (rest + k * LN_2.1)) - f)
}

/// The sine and cosine of so many turns.
#[inline(always)]
pub fn sin_cos_of_turns(turns: f64) -> (f64, f64) {
    let rounded = 4.0 * turns + ROUND;
    let (sin, cos) = sin_cos_kernel((turns - 0.25 * (rounded - ROUND)) * TAU);
    let quadrant = rounded.to_bits();
    let (a, b) = if quadrant & 1 == 1 { (cos, sin) } else { (sin, cos) };
    let negated = |x: f64, quadrant: u64| f64::from_bits(x.to_bits() ^ (quadrant & 2) << 62);
    (negated(a, quadrant), negated(b, quadrant.wrapping_add(1)))
}

/// Sine and cosine of an angle of at most an eighth of a turn.
#[inline(always)]
fn sin_cos_kernel(x: f64) -> (f64, f64) {
    const S: [f64; 6] = [
        -1.666_666_666_666_663_243_48e-1,
        8.333_333_333_322_489_461_24e-3,
        -1.984_126_982_985_794_931_34e-4,
        2.755_731_370_707_006_767_89e-6,
        -2.505_076_025_340_686_341_95e-8,
        1.589_690_995_211_550_102_21e-10,
    ];
    const C: [f64; 6] = [
        4.166_666_666_666_660_190_37e-2,
        -1.388_888_888_887_410_957_49e-3,
        2.480_158_728_947_672_941_78e-5,
        -2.755_731_435_139_066_330_35e-7,
        2.087_572_321_298_174_827_90e-9,
        -1.135_964_755_778_819_482_65e-11,
    ];
    let z = x * x;
    let sin = x + x * z * polynomial(z, S);
    let half = 0.5 * z;
    let w = 1.0 - half;
    (sin, w + ((1.0 - w) - half + z * z * polynomial(z, C)))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Half an ulp of the reference and one and a half of ours.
    const TWO_ULP: f64 = 4.5e-16;

    /// The largest error relative to `scale`.
    fn worst(xs: impl Iterator<Item = f64>, error: impl Fn(f64) -> f64) -> f64 {
        xs.map(|x| error(x).abs()).fold(0.0, |a, b| if b > a || b.is_nan() { b } else { a })
    }

    fn steps(from: f64, to: f64) -> impl Iterator<Item = f64> {
        (0..=100_000_u32).map(move |i| from + (to - from) * (f64::from(i) / 1e5))
    }

    #[test]
    fn exp_is_that_of_the_library() {
        for (from, to) in [(-1.0, 1.0), (-60.0, 60.0), (LEAST + 0.01, 709.0), (-1e-9, 1e-9)] {
            let far = worst(steps(from, to), |x| exp(x) / x.exp() - 1.0);
            assert!(far < TWO_ULP, "{from} {to}: {far:e}");
        }
        assert_eq!([0.0, -0.0, LEAST, -1e300, f64::NEG_INFINITY].map(exp), [1.0, 1.0, 0.0, 0.0, 0.0]);
    }

    #[test]
    fn ln_is_that_of_the_library() {
        for (from, to) in [(0.5, 2.0), (0.99, 1.01), (1e-51, 1e-45), (1e-6, 1e6), (1e30, 1e38)] {
            let far = worst(steps(from, to).filter(|x| *x != 1.0), |x| ln(x) / x.ln() - 1.0);
            assert!(far < TWO_ULP, "{from} {to}: {far:e}");
        }
        assert_eq!(ln(1.0), 0.0);
    }

    #[test]
    #[expect(clippy::cast_possible_truncation, reason = "alphas are f32")]
    fn ln_one_minus_is_that_of_the_library() {
        for (from, to) in [(0.0, 1.0), (0.25, 0.35), (0.0, 1e-6), (0.0, 1e-30), (0.999_99, 1.0)] {
            let alphas = steps(from, to).map(|a| f64::from(a as f32)).filter(|a| *a > 0.0 && *a < 1.0);
            let far = worst(alphas, |a| ln_one_minus(a as f32) / (-a).ln_1p() - 1.0);
            assert!(far < TWO_ULP, "{from} {to}: {far:e}");
        }
        assert_eq!(ln_one_minus(0.0), 0.0);
        assert!(ln_one_minus(1.0) < -600.0);
    }

    /// The reference rounds an angle of up to half a turn, twice.
    const ROUNDED_ANGLE: f64 = 3.5e-16;

    #[test]
    fn sine_and_cosine_are_those_of_the_library() {
        for (from, to) in [(0.0, 1.0), (-2.0, 2.0), (-1e-9, 1e-9)] {
            let far = worst(steps(from, to), |t| {
                let ((sin, cos), (s, c)) = (sin_cos_of_turns(t), (TAU * (t - t.round())).sin_cos());
                (sin - s).abs().max((cos - c).abs())
            });
            assert!(far < TWO_ULP + ROUNDED_ANGLE, "{from} {to}: {far:e}");
        }
        let quarters = [0.0, 0.25, 0.5, 0.75, 1.0, -0.25].map(sin_cos_of_turns);
        assert_eq!(quarters, [(0.0, 1.0), (1.0, 0.0), (0.0, -1.0), (-1.0, 0.0), (0.0, 1.0), (-1.0, 0.0)]);
    }
}
