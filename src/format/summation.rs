//! How sums of weighted colours are kept in a format.

use crate::params::{Kind, ParamSpec, Value};

/// How sums are kept. All but [`Summation::Plain`] need a blend unit that can be programmed, or atomics.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Summation {
    /// Each addition is rounded to the format.
    Plain,
    /// The rounding errors are summed up beside, in a second target of the same format, or of halves where that knows no
    /// sign (Neumaier 1974). That one rounds as well: halves then reach 4096 ones rather than 2048.
    Compensated,
    /// In two's complement integers of twice the format's bits, half of which count what is below 1: the same bits in
    /// any order. They saturate.
    Fixed,
    /// As multiples of a power of two per pixel, which follows the largest sum, as a streaming log-sum-exp does; weights
    /// come as logarithms, so that nothing overflows or underflows.
    Scaled,
    /// Scaled, and held in two numbers of the format, the second a half where that knows no sign.
    ScaledDouble,
}

/// The param that asks for it.
pub const SUMMATION: ParamSpec = ParamSpec::new(
    "summation",
    Kind::Choice(&["plain", "compensated", "fixed", "scaled", "scaled_double"]),
    Value::Text("plain"),
    "how sums are kept: rounded to the format at each addition; with the rounding errors summed beside; in integers of \
     twice the bits, which saturate (counted as dropped, one per pixel) and are the same in any order (of pass B where there are two); by multiples of a \
     power of two that follows the largest sum, from logarithms of weights; the same in two numbers",
);

impl Summation {
    /// The choice of [`SUMMATION`].
    pub fn from_name(name: &str) -> Self {
        match name {
            "compensated" => Self::Compensated,
            "fixed" => Self::Fixed,
            "scaled" => Self::Scaled,
            "scaled_double" => Self::ScaledDouble,
            _ => Self::Plain,
        }
    }

    /// Whether weights are wanted as logarithms.
    pub fn is_scaled(self) -> bool {
        matches!(self, Self::Scaled | Self::ScaledDouble)
    }
}
