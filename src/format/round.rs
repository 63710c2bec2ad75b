//! Rounding to the formats, written without branches on the numbers so that loops over them vectorise.
#![expect(clippy::inline_always, reason = "these take on their caller's instruction set")]

use super::Format;
use half::slice::HalfFloatSliceExt;
use half::{bf16, f16};
use multiversion::multiversion;
use std::sync::LazyLock;

/// A binary float: bits of the significand, the leading one included, and the exponents of normal numbers.
#[derive(Debug, Clone, Copy)]
pub(super) struct Float {
    digits: i32,
    least: i32,
    most: i32,
}

impl Float {
    pub const fn new(digits: i32, least: i32, most: i32) -> Self {
        Self { digits, least, most }
    }
    pub fn largest(self) -> f64 {
        (2.0 - 2.0_f64.powi(1 - self.digits)) * 2.0_f64.powi(self.most)
    }
    pub fn smallest_normal(self) -> f64 {
        2.0_f64.powi(self.least)
    }
    pub fn smallest_positive(self) -> f64 {
        self.smallest_normal() * 2.0_f64.powi(1 - self.digits)
    }
    pub fn unit_roundoff(self) -> f64 {
        2.0_f64.powi(-self.digits)
    }
    fn rounder(self) -> Rounder {
        Rounder {
            least: self.smallest_normal(),
            beyond: 2.0_f64.powi(self.most) * 2.0,
            shift: 1.5 * 2.0_f64.powi(53 - self.digits),
            largest: self.largest(),
        }
    }
}

/// What rounding to a float of at most 24 digits takes.
#[derive(Debug, Clone, Copy)]
struct Rounder {
    least: f64,
    /// The power of two above the largest number.
    beyond: f64,
    shift: f64,
    largest: f64,
}

impl Rounder {
    /// To nearest even: adding 1.5 · 2^52 quanta leaves whole quanta.
    #[inline(always)]
    fn round(self, x: f64) -> f64 {
        const EXPONENT: u64 = 0x7ff0_0000_0000_0000;
        let size = x.abs();
        let size = if size > self.least { size } else { self.least };
        let size = if size < self.beyond { size } else { self.beyond };
        let magic = f64::from_bits(size.to_bits() & EXPONENT) * self.shift;
        let rounded = ((x + magic) - magic).copysign(x);
        if rounded.abs() > self.largest { f64::INFINITY.copysign(x) } else { rounded }
    }
}

/// `x steps` to the nearest whole number, ties to even, as if the product were exact.
#[inline(always)]
fn nearest_step(x: f64, steps: f64) -> f64 {
    const LOW: u64 = (1 << 27) - 1;
    const ROUND: f64 = 6_755_399_441_055_744.0; // 1.5 · 2^52
    let high = f64::from_bits(x.to_bits() & !LOW);
    let (high, low) = (high * steps, (x - high) * steps);
    let product = high + low;
    let error = (high - product) + low;
    let nearest = (product + ROUND) - ROUND;
    let off = product - nearest;
    // half a step off, and the exact product is on the other side of the middle
    let wrong = off.abs() == 0.5 && error * off > 0.0;
    if wrong { nearest + 2.0 * off } else { nearest }
}

/// The nearest of the equal steps from `least` to 1; NaN is 0.
#[inline(always)]
fn normalized(x: f64, least: f64, steps: f64) -> f64 {
    let x = if x.is_nan() { 0.0 } else { x };
    let x = if x > least { x } else { least };
    let x = if x < 1.0 { x } else { 1.0 };
    nearest_step(x, steps) / steps
}

/// A number without sign: below zero there is nothing, NaN stays.
#[inline(always)]
fn unsigned(x: f64) -> f64 {
    if x <= 0.0 { 0.0 } else { x }
}

/// The 256 numbers of [`Format::Srgb8`].
pub(super) fn srgb8_steps() -> &'static [f64; 256] {
    static STEPS: LazyLock<[f64; 256]> = LazyLock::new(|| std::array::from_fn(|k| decode_srgb(k, 0.0)));
    &STEPS
}

/// The linear value of code `k + part` (IEC 61966-2-1).
#[expect(clippy::cast_precision_loss, reason = "k < 256")]
fn decode_srgb(k: usize, part: f64) -> f64 {
    let encoded = (k as f64 + part) / 255.0;
    if encoded <= 0.040_45 { encoded / 12.92 } else { ((encoded + 0.055) / 1.055).powf(2.4) }
}

/// The step whose encoding is nearest to that of `x`.
fn srgb8(x: f64) -> f64 {
    static MIDDLES: LazyLock<[f64; 255]> = LazyLock::new(|| std::array::from_fn(|k| decode_srgb(k, 0.5)));
    srgb8_steps()[MIDDLES.partition_point(|middle| *middle <= x)]
}

/// The largest number of [`Format::Rgb9e5`].
pub(super) const RGB9E5_MAX: f64 = 65_408.0;

/// Three numbers with one exponent, as `EXT_texture_shared_exponent` has it: ties go up.
fn rgb9e5(rgb: &mut [f64]) {
    let clamped = |x: f64| if x > 0.0 { x.min(RGB9E5_MAX) } else { 0.0 };
    let largest = rgb.iter().fold(0.0, |largest: f64, x| largest.max(clamped(*x)));
    let up = |x: f64| x.floor() + f64::from(u8::from(x - x.floor() >= 0.5));
    let exponent = exponent(largest).max(-16) + 1;
    let exponent = if up(largest * 2.0_f64.powi(9 - exponent)) > 511.0 { exponent + 1 } else { exponent };
    let quantum = 2.0_f64.powi(exponent - 9);
    rgb.iter_mut().for_each(|x| *x = up(clamped(*x) / quantum) * quantum);
}

/// The exponent of a normal number's leading bit.
fn exponent(x: f64) -> i32 {
    (x.to_bits() >> 52 & 0x7ff) as i32 - 1023
}

impl Format {
    /// `x` as one channel of a texel keeps it; [`Format::Rgb9e5`] shares its exponent with nothing then.
    pub fn round_channel(self, x: f64, channel: usize) -> f64 {
        match (self, self.float(channel), self.steps()) {
            (Self::F64, ..) => x,
            #[expect(clippy::cast_possible_truncation, reason = "that is what it is for")]
            (Self::F32, ..) => f64::from(x as f32),
            (Self::R11g11b10f, Some(float), _) if channel < 3 => float.rounder().round(unsigned(x)),
            (_, Some(float), _) => float.rounder().round(x),
            (Self::Snorm8, _, Some(steps)) => normalized(x, -1.0, steps),
            (_, _, Some(steps)) => normalized(x, 0.0, steps),
            (Self::Rgb9e5, ..) => {
                let mut alone = [x];
                rgb9e5(&mut alone);
                alone[0]
            }
            _ => srgb8(x),
        }
    }

    /// `x` as a one-channel texel keeps it.
    pub fn round(self, x: f64) -> f64 {
        self.round_channel(x, 0)
    }

    /// A texel of up to four channels as it is kept.
    pub fn round_texel(self, texel: &mut [f64]) {
        match self {
            Self::Rgb9e5 => {
                let (rgb, alpha) = texel.split_at_mut(texel.len().min(3));
                rgb9e5(rgb);
                alpha.iter_mut().for_each(|x| *x = self.round_channel(*x, 3));
            }
            Self::R11g11b10f => {
                texel.iter_mut().enumerate().for_each(|(channel, x)| *x = self.round_channel(*x, channel));
            }
            _ => texel.iter_mut().for_each(|x| *x = self.round_channel(*x, 0)),
        }
    }

    /// [`Format::round`] of each number.
    pub fn round_all(self, numbers: &mut [f64]) {
        match (self, self.steps(), self.float(0)) {
            (Self::F64, ..) => {}
            (Self::F32, ..) => round_to_f32(numbers),
            (Self::R11g11b10f, _, Some(float)) => {
                numbers.iter_mut().for_each(|x| *x = unsigned(*x));
                round_to_float(numbers, float.rounder());
            }
            (_, _, Some(float)) => round_to_float(numbers, float.rounder()),
            (Self::Snorm8, Some(steps), _) => round_to_steps(numbers, -1.0, steps),
            (_, Some(steps), _) => round_to_steps(numbers, 0.0, steps),
            (Self::Rgb9e5, ..) => numbers.iter_mut().for_each(|x| rgb9e5(std::slice::from_mut(x))),
            _ => numbers.iter_mut().for_each(|x| *x = srgb8(*x)),
        }
    }

    /// [`Format::round`] of each number; half precision by the processor's own conversion, which rounds once.
    pub fn round_all_f32(self, numbers: &mut [f32]) {
        match self {
            Self::F64 | Self::F32 => {}
            Self::F16 => round_by_half(numbers, [f16::ZERO; CHUNK]),
            Self::Bf16 => round_by_half(numbers, [bf16::ZERO; CHUNK]),
            #[expect(clippy::cast_possible_truncation, reason = "steps are read as f32")]
            _ => numbers.iter_mut().for_each(|x| *x = self.round(f64::from(*x)) as f32),
        }
    }
}

/// Numbers that are converted together.
const CHUNK: usize = 64;

fn round_by_half<T>(numbers: &mut [f32], mut stored: [T; CHUNK])
where
    [T]: HalfFloatSliceExt,
{
    for numbers in numbers.chunks_mut(CHUNK) {
        let stored = &mut stored[..numbers.len()];
        stored.convert_from_f32_slice(numbers);
        stored.convert_to_f32_slice(numbers);
    }
}

#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"))]
fn round_to_float(numbers: &mut [f64], rounder: Rounder) {
    numbers.iter_mut().for_each(|x| *x = rounder.round(*x));
}

#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"))]
#[expect(clippy::cast_possible_truncation, reason = "that is what it is for")]
fn round_to_f32(numbers: &mut [f64]) {
    numbers.iter_mut().for_each(|x| *x = f64::from(*x as f32));
}

#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"))]
fn round_to_steps(numbers: &mut [f64], least: f64, steps: f64) {
    numbers.iter_mut().for_each(|x| *x = normalized(*x, least, steps));
}
