//! Render targets, and what blend units do with them.

use super::Streaming;
use crate::error::Result;
use crate::format::{Format, Formats};
use crate::params::Params;
use std::ops::Range;

/// Passes over the geometry into render targets, and one over the image that reads them.
#[derive(Debug, Clone, PartialEq)]
pub struct Blending {
    /// What is drawn into. A shader finds target i at binding i of group 2; one that nobody draws into is a placeholder.
    pub targets: Vec<BlendTarget>,
    /// The passes over the geometry.
    pub draws: Vec<Draw>,
    /// The entry point of the fragment shader that makes the image of them.
    pub resolve: &'static str,
    /// Whether the first target holds the background when drawing begins.
    pub over_background: bool,
    /// Shared parts of the shader beside those that all have.
    pub blocks: &'static [&'static str],
    /// One that render targets alone want.
    pub targets_block: &'static str,
    /// In tiles, fragments come by depth, not as they are drawn: the furthest first, or the nearest.
    pub by_depth: Option<bool>,
    /// What stands for targets that are drawn into one after the other, where a pixel's are in registers.
    pub in_registers: Option<Registers>,
    /// Whether nothing is decided by depths but what opaque surfaces hide, and what is made of them is as precise with a unit or
    /// two in the last place more or less.
    pub near_depths: bool,
    /// Words per pixel of a buffer that all shaders read and write, 0 at first; its binding follows those of the targets.
    pub words: u32,
}

/// Targets in registers: the technique as a stream.
#[derive(Debug, Clone, PartialEq)]
pub struct Registers {
    /// The part of the shader in place of that of render targets: `begin`, `take`, `again` and `finish`.
    pub block: &'static str,
    /// What it wants of fragments.
    pub stream: Streaming,
}

/// A pass over the geometry.
#[derive(Debug, Clone, PartialEq)]
pub struct Draw {
    /// The fragment shader's entry point.
    pub shader: &'static str,
    /// The targets that it draws into. It may read those before them.
    pub targets: Range<usize>,
    /// Whether it draws in parts where the device takes fewer attachments at a time: the shader gives those from
    /// `first_output_of` on.
    pub in_parts: bool,
}

impl Blending {
    /// One pass into all targets.
    pub fn once(draw: &'static str, resolve: &'static str, targets: Vec<BlendTarget>) -> Self {
        let draws = vec![Draw { shader: draw, targets: 0..targets.len(), in_parts: false }];
        Self {
            targets,
            draws,
            resolve,
            over_background: false,
            blocks: &[],
            targets_block: "",
            by_depth: None,
            in_registers: None,
            near_depths: false,
            words: 0,
        }
    }
}

/// A render target.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BlendTarget {
    /// The param that chooses its format.
    pub param: &'static str,
    /// The format.
    pub format: Format,
    /// Numbers per texel.
    pub channels: u32,
    /// The param that chooses how many layers it has, and their number, if it is an array of them.
    pub layers: Option<(&'static str, u32)>,
    /// What its texels are at first.
    pub clear: [f64; 4],
    /// What becomes of the colour channels ...
    pub color: Blend,
    /// ... and of alpha.
    pub alpha: Blend,
}

/// What a blend unit makes of a source and what is there.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Blend {
    /// source + there.
    Add,
    /// source + (1 − source alpha) there.
    Over,
    /// (1 − source) there, channel by channel.
    Attenuate,
    /// source there, channel by channel.
    Multiply,
    /// alpha there × source + there.
    Under,
    /// source + source alpha × there, where alphas are what shows through.
    Cover,
    /// The larger one, channel by channel.
    Max,
}

/// What a device's blend units may have of floats and of numbers up to one.
pub const SUMS: &[Format] = &[Format::F32, Format::F16];
/// See [`SUMS`].
pub const SHARES: &[Format] = &[Format::F32, Format::F16, Format::Unorm8, Format::Unorm16];

impl BlendTarget {
    /// Sums that begin with zero.
    pub fn sums(param: &'static str, format: Format, channels: u32) -> Self {
        Self { param, format, channels, layers: None, clear: [0.0; 4], color: Blend::Add, alpha: Blend::Add }
    }

    /// A product of 1 − source, or of sources, that begins with one.
    pub fn product(param: &'static str, format: Format, channels: u32, blend: Blend) -> Self {
        Self { clear: [1.0; 4], color: blend, alpha: blend, ..Self::sums(param, format, channels) }
    }

    /// The bounds of a pixel's depths, (−nearest, farthest), chosen by a param of ranges.
    pub fn bounds(param: &'static str) -> Self {
        let least = [f64::from(f32::MIN); 4];
        let all = Self::sums(param, Format::F32, 2);
        Self { clear: least, color: Blend::Max, alpha: Blend::Max, ..all }
    }

    /// An array of so many of them, chosen by that param.
    pub fn array(self, param: &'static str, layers: u32) -> Self {
        Self { layers: Some((param, layers)), ..self }
    }

    /// Layers that are put under what is there, with what shows through in the alpha channel.
    pub fn front(param: &'static str, format: Format) -> Self {
        Self { color: Blend::Under, ..Self::sums(param, format, 4).with_share() }
    }

    /// Layers, with what shows through in the alpha channel, that are put over what is there.
    pub fn back(param: &'static str, format: Format) -> Self {
        Self { color: Blend::Cover, alpha: Blend::Multiply, ..Self::sums(param, format, 4).with_share() }
    }

    /// The same with a product of 1 − alpha in the alpha channel.
    pub fn with_share(mut self) -> Self {
        self.clear[3] = 1.0;
        self.alpha = Blend::Attenuate;
        self
    }
}

/// The format that a target named `name` has on a device. What the CPU keeps in double precision by default stands for
/// an f32 target.
///
/// # Errors
/// `Error::Param` naming the param, if no device blends that format.
pub fn target_format(
    params: &Params,
    formats: &Formats,
    name: &str,
    param: &'static str,
    accepted: &[Format],
) -> Result<Format> {
    let format = formats.on_device(name);
    if accepted.contains(&format) {
        return Ok(format);
    }
    let names: Vec<_> = accepted.iter().map(|format| format!("{:?}", format.name())).collect();
    let problem = format!("{param}={:?} has no form on the backend \"gpu\"", format.name());
    Err(params.error(problem, format!("there it is one of {}", names.join(", "))))
}
