//! Storage formats: what a render target or a node keeps of a number.
//!
//! Every format rounds once, to nearest even (rgb9e5 to nearest, ties up, as its specification says), from an exact number or from one that was [rounded to odd](blend):
//! going through f32 first would round some numbers twice. A float that overflows becomes infinite, normalised
//! integers saturate. Packed and normalised formats are those of the Vulkan specification (chapters "Fixed-Point Data
//! Conversion" and "Floating-Point Format Conversions") and of `EXT_packed_float` and `EXT_texture_shared_exponent`.

pub mod blend;
mod round;
pub mod summation;
pub mod target;
#[cfg(test)]
mod tests;

pub use summation::{SUMMATION, Summation};
pub use target::{FormatSet, Formats, Target};

use round::{Float, srgb8_steps};

/// How a number is stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Format {
    /// IEEE 754 binary64: no storage error to speak of.
    F64,
    /// IEEE 754 binary32.
    F32,
    /// IEEE 754 binary16.
    F16,
    /// The upper half of an f32.
    Bf16,
    /// Three unsigned floats in 32 bits: 6, 6 and 5 bits of mantissa, 5 of exponent, no sign.
    R11g11b10f,
    /// Three mantissas of 9 bits that share one exponent of 5 bits.
    Rgb9e5,
    /// `k / 255`.
    Unorm8,
    /// `k / 65535`.
    Unorm16,
    /// `k / 127`, signed.
    Snorm8,
    /// `k / (2^24 − 1)`: window depth.
    D24,
    /// The sRGB encoding of `k / 255`; blended in linear light, as hardware does.
    Srgb8,
}

impl Format {
    /// Every format, the widest first.
    pub const ALL: [Self; 11] = [
        Self::F64,
        Self::F32,
        Self::F16,
        Self::Bf16,
        Self::R11g11b10f,
        Self::Rgb9e5,
        Self::Unorm8,
        Self::Unorm16,
        Self::Snorm8,
        Self::D24,
        Self::Srgb8,
    ];

    /// The name users write.
    pub const fn name(self) -> &'static str {
        match self {
            Self::F64 => "f64",
            Self::F32 => "f32",
            Self::F16 => "f16",
            Self::Bf16 => "bf16",
            Self::R11g11b10f => "r11g11b10f",
            Self::Rgb9e5 => "rgb9e5",
            Self::Unorm8 => "unorm8",
            Self::Unorm16 => "unorm16",
            Self::Snorm8 => "snorm8",
            Self::D24 => "d24",
            Self::Srgb8 => "srgb8",
        }
    }

    /// The format of that name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|format| format.name() == name)
    }

    /// Bits of a texel with so many channels. Render targets have no three channels of a whole number of bytes: they
    /// take the room of four. The packed formats have no fourth channel: it is an f16 of its own.
    pub const fn bits(self, channels: u32) -> u32 {
        let padded = if channels == 3 { 4 } else { channels };
        match self {
            Self::F64 => 64 * padded,
            Self::F32 => 32 * padded,
            Self::F16 | Self::Bf16 | Self::Unorm16 => 16 * padded,
            Self::R11g11b10f | Self::Rgb9e5 => 32 + 16 * channels.saturating_sub(3),
            Self::Unorm8 | Self::Snorm8 | Self::Srgb8 => 8 * padded,
            Self::D24 => 24 * padded,
        }
    }

    /// Bytes of a texel with so many channels.
    pub fn bytes(self, channels: u32) -> f64 {
        f64::from(self.bits(channels)) / 8.0
    }

    /// The format of a texel's fourth channel.
    pub const fn of_alpha(self) -> Self {
        match self {
            Self::R11g11b10f | Self::Rgb9e5 => Self::F16,
            _ => self,
        }
    }

    /// The format of one channel of a texel as a float; none where it is not one by itself.
    const fn float(self, channel: usize) -> Option<Float> {
        match (self, channel) {
            (Self::F64, _) => Some(Float::new(53, -1022, 1023)),
            (Self::F32, _) => Some(Float::new(24, -126, 127)),
            (Self::F16, _) | (Self::R11g11b10f | Self::Rgb9e5, 3) => Some(Float::new(11, -14, 15)),
            (Self::Bf16, _) => Some(Float::new(8, -126, 127)),
            (Self::R11g11b10f, 2) => Some(Float::new(6, -14, 15)),
            (Self::R11g11b10f, _) => Some(Float::new(7, -14, 15)),
            _ => None,
        }
    }

    /// The number of steps between 0 and 1, where they are equal.
    const fn steps(self) -> Option<f64> {
        match self {
            Self::Unorm8 => Some(255.0),
            Self::Unorm16 => Some(65_535.0),
            Self::Snorm8 => Some(127.0),
            Self::D24 => Some(16_777_215.0),
            _ => None,
        }
    }

    /// The largest finite number of a texel's channel.
    pub fn max_finite(self, channel: usize) -> f64 {
        match (self, self.float(channel)) {
            (_, Some(float)) => float.largest(),
            (Self::Rgb9e5, _) => round::RGB9E5_MAX,
            _ => 1.0,
        }
    }

    /// The smallest number of full relative precision; of formats with equal steps, the smallest but 0.
    pub fn smallest_normal(self) -> f64 {
        match (self, self.float(0)) {
            (_, Some(float)) => float.smallest_normal(),
            // the leading bit of the mantissa with the smallest exponent
            (Self::Rgb9e5, _) => 2.0_f64.powi(-16),
            _ => self.smallest_positive(),
        }
    }

    /// The smallest number above 0.
    pub fn smallest_positive(self) -> f64 {
        match (self, self.float(0), self.steps()) {
            (_, Some(float), _) => float.smallest_positive(),
            (_, _, Some(steps)) => steps.recip(),
            (Self::Rgb9e5, ..) => 2.0_f64.powi(-24),
            _ => srgb8_steps()[1],
        }
    }

    /// The largest rounding error: relative for floats (of the shared exponent's largest channel), absolute for
    /// formats that end at 1.
    pub fn unit_roundoff(self) -> f64 {
        match (self, self.float(0), self.steps()) {
            (_, Some(float), _) => float.unit_roundoff(),
            (_, _, Some(steps)) => 0.5 / steps,
            (Self::Rgb9e5, ..) => 2.0_f64.powi(-9),
            _ => 0.5 * (1.0 - srgb8_steps()[254]),
        }
    }

    /// Whether numbers beyond the largest one become infinite; the others saturate.
    pub fn has_infinity(self) -> bool {
        self.float(0).is_some()
    }

    /// Whether numbers end at 1; blend units clamp what they are given to the same range first.
    pub fn is_normalized(self) -> bool {
        !self.has_infinity() && self != Self::Rgb9e5
    }
}
