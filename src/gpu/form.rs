//! What a technique is on a GPU, as data: its shader, its render targets and how the blend unit works on them, or that
//! it wants every fragment. Forms know no device, so the registry can say what has one in any build.

use crate::error::{Error, Result};
use crate::format::{Format, Formats, Target};
use crate::params::{Params, View};

mod streams;
mod targets;
pub mod tiled;

pub use streams::{Capacity, ListReader, Sampling, Sorting, Streaming, submission};
pub use targets::{Blend, BlendTarget, Blending, Draw, Registers, SHARES, SUMS, target_format};

/// A technique's entry in the registry: makes its form under params, or refuses params that have none.
pub type MakeForm = fn(&Params, &View) -> Result<Form>;

/// A technique on a GPU, with its params bound.
#[derive(Debug, Clone, PartialEq)]
pub struct Form {
    /// The technique's shader: its file under `shaders/`, without the shared blocks.
    pub shader: &'static str,
    /// The members of the shader's `Params`, in order.
    pub numbers: Vec<Number>,
    /// How it gets its fragments.
    pub path: Path,
    /// The depth weight, where there is one.
    pub weight: Option<WeightModule>,
    /// Whether fragments that neither cover nor emit are shown to it.
    pub shows_zero_fragments: bool,
    /// Whether the background's share is one per channel.
    pub colored_transmittance: bool,
}

/// The part of a shader that weighs fragments: `Weight` and `weight_of`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct WeightModule {
    /// Its text.
    pub text: String,
    /// Whether it may give what is no weight, and counts that.
    pub counts_invalid: bool,
}

impl WeightModule {
    /// A published weight, by its number in `weight.wgsl`.
    pub fn published(formula: u32) -> Self {
        let text = format!("const WEIGHT_FORMULA = {formula}u;\n{WEIGHT}");
        Self { text, counts_invalid: false }
    }

    /// The same beside other functions, of which one may give what is none.
    pub fn with(mut self, text: &str, counts_invalid: bool) -> Self {
        self.text.push_str(text);
        self.counts_invalid |= counts_invalid;
        self
    }

    /// One of somebody's own, whose text has what `own_weight.wgsl` calls.
    pub fn own(text: &str) -> Self {
        Self { text: [text, OWN_WEIGHT].join("\n"), counts_invalid: true }
    }
}

/// A member of a shader's uniform block.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Number {
    /// An `f32`.
    Float(f32),
    /// A `u32`.
    Whole(u32),
}

impl Number {
    /// The bits that the shader reads.
    pub fn bits(self) -> u32 {
        match self {
            Self::Float(x) => x.to_bits(),
            Self::Whole(n) => n,
        }
    }

    /// A number of things; more than 2^32 are as many as there are.
    pub fn size(count: usize) -> Self {
        Self::Whole(u32::try_from(count).unwrap_or(u32::MAX))
    }

    /// A double as a sum of two of the shader's floats.
    pub fn in_two(x: f64) -> [Self; 2] {
        let Self::Float(first) = Self::float(x) else { unreachable!("it is a float") };
        [Self::Float(first), Self::float(x - f64::from(first))]
    }

    /// A double as the shader's float.
    pub fn float(x: f64) -> Self {
        Self::Float(nearest(x))
    }

    /// The largest float that is not more: floats are more than it if they are more than the double.
    pub fn below(x: f64) -> Self {
        let near = nearest(x);
        Self::Float(if f64::from(near) > x { near.next_down().max(f32::MIN) } else { near })
    }

    /// The smallest float that is not less: floats are less than it if they are less than the double.
    pub fn above(x: f64) -> Self {
        let near = nearest(x);
        Self::Float(if f64::from(near) < x { near.next_up().min(f32::MAX) } else { near })
    }
}

#[expect(clippy::cast_possible_truncation, reason = "shaders compute in f32")]
fn nearest(x: f64) -> f32 {
    x.clamp(f64::from(f32::MIN), f64::from(f32::MAX)) as f32
}

/// How a technique gets its fragments.
#[derive(Debug, Clone, PartialEq)]
pub enum Path {
    /// Through the blend unit, in submission order.
    Blended(Blending),
    /// As lists, of which a compute shader makes the image.
    Listed(Listing),
    /// One by one, into what the technique keeps of a pixel: its shader's `begin`, `take` and `finish`.
    Streamed(Streaming),
    /// Layer by layer, in as many passes over the geometry as there are.
    Peeled(Peeling),
    /// Into samples of a multisampled depth buffer, by masks.
    Sampled(Sampling),
}

/// Passes over the geometry, each of which sees what the last one has left: the frontier.
#[derive(Debug, Clone, PartialEq)]
pub struct Peeling {
    /// What a pass peels.
    pub ends: Ends,
    /// The fragment shader's entry point.
    pub peel: &'static str,
    /// That of the pass over the image which composites what was peeled, and says whether there was anything.
    pub composite: &'static str,
    /// That of the one that makes the image.
    pub resolve: &'static str,
    /// What layers in front are composited in, and those behind.
    pub sums: Vec<BlendTarget>,
    /// Passes, if they are limited.
    pub passes: Option<usize>,
}

/// The layers of a pixel that a pass peels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ends {
    /// The nearest one by (depth, primitive), which a depth buffer finds; the frontier is its key.
    Nearest,
    /// All at the nearest and at the furthest depth that are left, which MAX blending of (-depth, depth) has found in the
    /// last pass.
    Both,
}

/// What takes the bits of depths up to the far plane to those of window depths below 1: a power of two, as a difference of
/// exponents. Whatever is less than 2^-126 of the far plane is at depth 0.
pub fn window_exponent(view: &View) -> Number {
    let Number::Float(far) = Number::float(view.far) else { unreachable!("it is a float") };
    let exponent = far.to_bits() >> 23;
    Number::Whole(exponent.wrapping_sub(126) << 23)
}

/// Every fragment in its pixel's list, and one pass over the image.
#[derive(Debug, Clone, PartialEq)]
pub struct Listing {
    /// The compute shader's entry point.
    pub resolve: &'static str,
    /// How lists are sorted.
    pub sorted: Sorting,
    /// How many layers a pixel keeps, for shaders that keep `LAYERS`.
    pub layers: Option<u32>,
    /// Other sizes of what a pixel keeps, which the shader has as constants of these names.
    pub sizes: Vec<(&'static str, u32)>,
}

/// Layers that a shader keeps per pixel, at most: they are in registers, where there is little room.
pub const MOST_LAYERS: u32 = 32;

/// The number of layers that a shader keeps.
///
/// # Errors
/// `Error::Param` if they are too many.
pub fn layers(params: &Params) -> Result<u32> {
    at_most(params, "layers", MOST_LAYERS)
}

/// The size that the param `name` asks for.
///
/// # Errors
/// `Error::Param` if it is more than `most`.
pub fn at_most(params: &Params, name: &str, most: u32) -> Result<u32> {
    let size = params.size(name);
    u32::try_from(size).ok().filter(|size| *size <= most).ok_or_else(|| {
        let problem = format!("{name}={size} has no form on the backend \"gpu\"");
        params.error(problem, format!("there {name} is at most {most}"))
    })
}

/// The seed, as shaders have it: its lower half and its upper half.
#[expect(clippy::cast_possible_truncation, reason = "both halves are used")]
pub fn seed(params: &Params) -> [Number; 2] {
    let seed = params.size("seed") as u64;
    [Number::Whole(seed as u32), Number::Whole((seed >> 32) as u32)]
}

/// A shared part of the shaders.
const FRAME: &str = include_str!("../../shaders/blocks/frame.wgsl");
const DOUBLE: &str = include_str!("../../shaders/blocks/double.wgsl");
const FRAGMENT: &str = include_str!("../../shaders/blocks/fragment.wgsl");
const WEIGHT_BOUNDS: &str = include_str!("../../shaders/blocks/weight_bounds.wgsl");
const WEIGHT: &str = include_str!("../../shaders/blocks/weight.wgsl");
const INVALID: &str = include_str!("../../shaders/blocks/invalid.wgsl");
const OWN_WEIGHT: &str = include_str!("../../shaders/blocks/own_weight.wgsl");
const RESOLVE: &str = include_str!("../../shaders/blocks/resolve.wgsl");
const LISTS: &str = include_str!("../../shaders/blocks/lists.wgsl");
const LINK: &str = include_str!("../../shaders/blocks/link.wgsl");
const UNLINK: &str = include_str!("../../shaders/blocks/unlink.wgsl");
const LAYERS: &str = include_str!("../../shaders/blocks/layers.wgsl");
const RANDOM: &str = include_str!("../../shaders/blocks/random.wgsl");
const CHANCE: &str = include_str!("../../shaders/blocks/chance.wgsl");
const ABSORBANCE: &str = include_str!("../../shaders/blocks/absorbance.wgsl");
const SUMS_OF_LISTS: &str = include_str!("../../shaders/blocks/sums.wgsl");
const MASKS: &str = include_str!("../../shaders/blocks/masks.wgsl");
const SHARES_OF_LAYERS: &str = include_str!("../../shaders/blocks/shares.wgsl");
/// Blocks that forms ask for.
pub mod blocks {
    /// Logarithms and the like of a known precision.
    pub const FUNCTIONS: &str = include_str!("../../shaders/blocks/functions.wgsl");
    /// Places in depth intervals.
    pub const INTERVAL: &str = include_str!("../../shaders/blocks/interval.wgsl");
    /// What a pass gives that is drawn in parts.
    pub const OUTPUTS: &str = include_str!("../../shaders/blocks/outputs.wgsl");
    /// A map of transmittance, and all fragments seen through it.
    pub const TWO_PASS: &str = include_str!("../../shaders/blocks/two_pass.wgsl");
    /// ... in render targets, ...
    pub const TWO_PASS_TARGETS: &str = include_str!("../../shaders/blocks/two_pass_targets.wgsl");
    /// ... or in registers.
    pub const TWO_PASS_STREAM: &str = include_str!("../../shaders/blocks/two_pass_stream.wgsl");
    /// A map of coefficients.
    pub const COEFFICIENTS: &str = include_str!("../../shaders/blocks/coefficients.wgsl");
    /// A map of moments.
    pub const MOMENTS: &str = include_str!("../../shaders/blocks/moments.wgsl");
    /// A map of bins.
    pub const BINS: &str = include_str!("../../shaders/blocks/bins.wgsl");
}
const STREAM: &str = include_str!("../../shaders/blocks/stream.wgsl");
const WALKS: &str = include_str!("../../shaders/blocks/walks.wgsl");
/// In place of a technique's own `again`.
const ONE_WALK: &str = "fn again() -> bool { return false; }";
const TILE_BINS: &str = include_str!("../../shaders/blocks/tile_bins.wgsl");
const TILE_LISTS: &str = include_str!("../../shaders/blocks/tile_lists.wgsl");
const TILE_STREAM: &str = include_str!("../../shaders/blocks/tile_stream.wgsl");
const TILE_WINDOW: &str = include_str!("../../shaders/blocks/tile_window.wgsl");
const TILES: &str = include_str!("../../shaders/blocks/tiles.wgsl");
const BACKGROUND: &str = include_str!("../../shaders/blocks/background.wgsl");

/// The module that counts, stores and sorts fragments, and the one that puts the background into a target: no
/// technique's own.
pub fn list_module() -> String {
    [FRAME, DOUBLE, FRAGMENT, LISTS].join("\n")
}

/// The module that puts fragments into linked lists, and the one that takes the links out.
pub fn link_module() -> String {
    [FRAME, DOUBLE, FRAGMENT, LINK].join("\n")
}

/// See [`link_module`].
pub fn unlink_module() -> String {
    [FRAME, DOUBLE, FRAGMENT, LISTS, UNLINK].join("\n")
}

/// The module that copies a buffer.
pub fn copy_module() -> String {
    include_str!("../../shaders/blocks/copy.wgsl").to_owned()
}

/// See [`list_module`].
pub fn background_module() -> String {
    [FRAME, BACKGROUND].join("\n")
}

/// The name of the number of words in a mask, for shaders that have masks.
pub const MASK_WORDS: &str = "MASK_WORDS";
/// Bits that a mask has at most: two masks of them take a kilobyte per pixel.
const MOST_BITS: u32 = 4096;

/// The size of masks of so many bits, which the param `name` asks for; those of none take a word, too.
///
/// # Errors
/// `Error::Param` if they are too many.
pub fn mask_size(params: &Params, name: &str) -> Result<(&'static str, u32)> {
    let bits = at_most(params, name, MOST_BITS)?;
    Ok((MASK_WORDS, bits.div_ceil(32).max(1)))
}

/// A number of which more make no difference.
pub fn saturated(size: usize) -> Number {
    Number::Whole(u32::try_from(size).unwrap_or(u32::MAX))
}

/// The members of `Masking` in `shaders/blocks/random.wgsl`, where the param `name` is the number of bits.
pub fn masking(params: &Params, name: &str, stratified: bool) -> [Number; 4] {
    let [low, high] = seed(params);
    [saturated(params.size(name)), Number::Whole(stratified.into()), low, high]
}

/// What a shader keeps, as its constants.
fn constants(layers: Option<u32>, sizes: &[(&'static str, u32)]) -> String {
    let layers = layers.map(|count| ("LAYERS", count));
    let all = layers.iter().chain(sizes);
    all.map(|(name, size)| format!("const {name} = {size}u;\n")).collect::<Vec<_>>().concat()
}

/// The blocks that lists and streams may use, some of which want such constants.
fn blocks_of_fragments(layers: Option<u32>, sizes: &[(&'static str, u32)]) -> Vec<&'static str> {
    let mut blocks = vec![RANDOM, CHANCE, ABSORBANCE, SUMS_OF_LISTS];
    if layers.is_some() {
        blocks.push(LAYERS);
    }
    if sizes.iter().any(|(name, _)| *name == MASK_WORDS) {
        blocks.push(MASKS);
    }
    blocks
}

impl Form {
    /// Whether its weight may give what is none, or fragments may be dropped.
    pub fn counts(&self) -> bool {
        self.weight.as_ref().is_some_and(|weight| weight.counts_invalid) || self.capacity().is_some()
    }

    /// How many fragments of a pixel there may be, if there is a limit.
    pub fn capacity(&self) -> Option<Capacity> {
        match &self.path {
            Path::Streamed(stream) => stream.capacity,
            _ => None,
        }
    }

    /// How it reads lists, if it is made of lists.
    pub fn list_reader(&self) -> Option<ListReader> {
        match &self.path {
            Path::Listed(listing) => {
                Some(ListReader { point: listing.resolve, sorted: listing.sorted, constants: Vec::new() })
            }
            Path::Streamed(stream) => {
                let flag = |is_set: bool| f64::from(u8::from(is_set));
                let constants = vec![
                    ("backwards", flag(stream.backwards)),
                    ("shows_zero_fragments", flag(self.shows_zero_fragments)),
                ];
                Some(ListReader { point: "resolve_stream", sorted: stream.sorted, constants })
            }
            _ => None,
        }
    }

    fn weight_parts(&self) -> Vec<&str> {
        self.weight.iter().flat_map(|weight| [INVALID, weight.text.as_str()]).collect()
    }

    /// The same by sample masks.
    ///
    /// # Errors
    /// `Error::Argument` for what has no such form.
    pub fn by_samples(self) -> Result<Self> {
        if let Path::Streamed(Streaming { by_samples: Some(sampling), .. }) = self.path {
            return Ok(Self { shader: sampling.shader, path: Path::Sampled(sampling), ..self });
        }
        let problem = "what has no masks of samples has no form for \"samples\"; path=\"hardware\" has one";
        Err(Error::argument("path", problem))
    }

    /// Refuses what is not made of lists.
    ///
    /// # Errors
    /// `Error::Argument` saying so.
    pub fn check_lists(&self) -> Result<()> {
        if self.list_reader().is_some() {
            return Ok(());
        }
        let problem =
            "what keeps no lists of fragments has no form for \"linked_lists\"; path=\"hardware\" has one";
        Err(Error::argument("path", problem))
    }

    /// The shader with the blocks that it may use.
    pub fn module(&self) -> String {
        let mut parts = vec![FRAME, DOUBLE, FRAGMENT, WEIGHT_BOUNDS];
        parts.extend(self.weight_parts());
        parts.extend([SHARES_OF_LAYERS, RESOLVE]);
        let sized;
        match &self.path {
            Path::Blended(blending) => {
                parts.push(BACKGROUND);
                parts.extend(blending.blocks);
                parts.push(blending.targets_block);
            }
            Path::Listed(Listing { layers, sizes, .. }) => {
                sized = constants(*layers, sizes);
                parts.extend([LISTS, &sized]);
                parts.extend(blocks_of_fragments(*layers, sizes));
            }
            Path::Streamed(stream) => {
                sized = constants(stream.layers, &stream.sizes);
                parts.extend([LISTS, &sized]);
                parts.extend(stream.blocks());
                parts.push(STREAM);
            }
            Path::Sampled(sampling) => {
                sized = constants(None, &sampling.sizes);
                parts.extend([BACKGROUND, &sized]);
                parts.extend(blocks_of_fragments(None, &sampling.sizes));
            }
            // params may ask for a stream instead, which is in the same file
            Path::Peeled(_) => parts.extend([BACKGROUND, LISTS, WALKS]),
        }
        parts.push(self.shader);
        parts.join("\n")
    }
}

/// Refuses what no form does.
///
/// # Errors
/// `Error::Param` saying that param `name` has to be `only`.
pub fn only(params: &Params, name: &str, only: &str) -> Result<()> {
    let given = params.text(name);
    if given == only {
        return Ok(());
    }
    let problem = format!("{name}={given:?} has no form on the backend \"gpu\"");
    Err(params.error(problem, format!("there {name} is {only:?}")))
}

/// Refuses nodes that are not in f32.
///
/// # Errors
/// `Error::Param` saying so.
pub fn only_default_formats(params: &Params, targets: &'static [Target]) -> Result<()> {
    if Formats::from_params(targets, params).are_default() {
        return Ok(());
    }
    let problem = "nodes of other formats than f32 have no form on the backend \"gpu\"";
    Err(params.error(problem, "there format and the formats of all targets are \"f32\""))
}

/// Refuses nodes and sums that are not in f32 on a device; what the CPU keeps in double precision by default stands for f32.
///
/// # Errors
/// `Error::Param` naming the param.
pub fn only_single_formats(params: &Params, targets: &'static [Target]) -> Result<()> {
    let formats = Formats::from_params(targets, params);
    for target in targets.iter().filter(|target| formats.find(target.name).is_some()) {
        target_format(params, &formats, target.name, target.param, &[Format::F32])?;
    }
    Ok(())
}

#[cfg(test)]
mod tests;
