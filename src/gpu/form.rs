//! What a technique is on a GPU, as data: its shader, its render targets and how the blend unit works on them, or that
//! it wants every fragment. Forms know no device, so the registry can say what has one in any build.

use crate::error::Result;
use crate::format::{Format, Formats, Target};
use crate::params::{Params, View};
use std::ops::Range;

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
    /// Whether fragments that neither cover nor emit are shown to it.
    pub shows_zero_fragments: bool,
    /// Whether the background's share is one per channel.
    pub colored_transmittance: bool,
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
    #[expect(clippy::cast_possible_truncation, reason = "shaders compute in f32")]
    pub fn float(x: f64) -> Self {
        Self::Float(x.clamp(f64::from(f32::MIN), f64::from(f32::MAX)) as f32)
    }
}

/// How a technique gets its fragments.
#[derive(Debug, Clone, PartialEq)]
pub enum Path {
    /// Through the blend unit, in submission order.
    Blended(Blending),
    /// As lists, of which a compute shader makes the image.
    Listed(Listing),
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
}

/// An order of lists.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sorting {
    /// By (depth, primitive), nearest first.
    Depth,
    /// As the fragments were submitted.
    Submission,
}

/// The order in which a technique is handed a pixel's fragments: how lists are sorted for it, and whether they are read from
/// their end.
///
/// # Errors
/// `Error::Param` for orders that lists are not sorted in.
pub fn submission(params: &Params) -> Result<(Sorting, Number)> {
    match params.text("submission_order") {
        "as_is" => Ok((Sorting::Submission, Number::Whole(0))),
        "reversed" => Ok((Sorting::Submission, Number::Whole(1))),
        "sorted" => Ok((Sorting::Depth, Number::Whole(0))),
        "back_to_front" => Ok((Sorting::Depth, Number::Whole(1))),
        other => {
            let problem = format!("submission_order={other:?} has no form on the backend \"gpu\" for lists");
            Err(params
                .error(problem, "there it is one of \"as_is\", \"reversed\", \"sorted\", \"back_to_front\""))
        }
    }
}

/// Layers that a shader keeps per pixel, at most: they are in registers, where there is little room.
const MOST_LAYERS: usize = 32;

/// The number of layers that a shader keeps.
///
/// # Errors
/// `Error::Param` if they are too many.
pub fn layers(params: &Params) -> Result<u32> {
    let layers = params.size("layers");
    match u32::try_from(layers) {
        Ok(fit) if layers <= MOST_LAYERS => Ok(fit),
        _ => {
            let problem = format!("layers={layers} has no form on the backend \"gpu\"");
            Err(params.error(problem, format!("there layers is at most {MOST_LAYERS}")))
        }
    }
}

/// Passes over the geometry into render targets, and one over the image that reads them.
#[derive(Debug, Clone, PartialEq)]
pub struct Blending {
    /// What is drawn into. A shader finds target i at binding i of group 2; one that nobody draws into is a placeholder.
    pub targets: Vec<BlendTarget>,
    /// The passes over the geometry.
    pub draws: Vec<Draw>,
    /// The compute shader's entry point.
    pub resolve: &'static str,
    /// Whether the first target holds the background when drawing begins.
    pub over_background: bool,
    /// Shared parts of the shader beside those that all have.
    pub blocks: &'static [&'static str],
    /// Words per pixel of a buffer that all shaders read and write, 0 at first; its binding follows those of the targets.
    pub words: u32,
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
        Self { targets, draws, resolve, over_background: false, blocks: &[], words: 0 }
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
    /// The larger one, channel by channel.
    Max,
}

/// A shared part of the shaders.
const FRAME: &str = include_str!("../../shaders/blocks/frame.wgsl");
const DOUBLE: &str = include_str!("../../shaders/blocks/double.wgsl");
const FRAGMENT: &str = include_str!("../../shaders/blocks/fragment.wgsl");
const WEIGHT: &str = include_str!("../../shaders/blocks/weight.wgsl");
const RESOLVE: &str = include_str!("../../shaders/blocks/resolve.wgsl");
const LISTS: &str = include_str!("../../shaders/blocks/lists.wgsl");
const LAYERS: &str = include_str!("../../shaders/blocks/layers.wgsl");
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
    /// A map of coefficients.
    pub const COEFFICIENTS: &str = include_str!("../../shaders/blocks/coefficients.wgsl");
    /// A map of moments.
    pub const MOMENTS: &str = include_str!("../../shaders/blocks/moments.wgsl");
    /// A map of bins.
    pub const BINS: &str = include_str!("../../shaders/blocks/bins.wgsl");
}

const BACKGROUND: &str = include_str!("../../shaders/blocks/background.wgsl");

/// The module that counts, stores and sorts fragments, and the one that puts the background into a target: no
/// technique's own.
pub fn list_module() -> String {
    [FRAME, DOUBLE, FRAGMENT, LISTS].join("\n")
}

/// See [`list_module`].
pub fn background_module() -> String {
    [FRAME, BACKGROUND].join("\n")
}

impl Form {
    /// The shader with the blocks that it may use.
    pub fn module(&self) -> String {
        let mut parts = vec![FRAME, DOUBLE, FRAGMENT, WEIGHT, RESOLVE];
        let layers;
        if let Path::Blended(blending) = &self.path {
            parts.extend(blending.blocks);
        }
        if let Path::Listed(listing) = &self.path {
            parts.push(LISTS);
            if let Some(count) = listing.layers {
                layers = format!("const LAYERS = {count}u;");
                parts.extend([layers.as_str(), LAYERS]);
            }
        }
        parts.push(self.shader);
        parts.join("\n")
    }
}

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

/// What a device's blend units may have of floats and of numbers up to one.
pub const SUMS: &[Format] = &[Format::F32, Format::F16];
/// See [`SUMS`].
pub const SHARES: &[Format] = &[Format::F32, Format::F16, Format::Unorm8, Format::Unorm16];

#[cfg(test)]
mod tests {
    use super::*;
    use crate::params::{Input, check};
    use crate::technique::Info;
    use crate::techniques::REGISTRY;
    use naga::valid::{Capabilities, ValidationFlags, Validator};

    fn validated(name: &str, source: &str) -> naga::Module {
        let module = naga::front::wgsl::parse_str(source)
            .unwrap_or_else(|error| panic!("{name}: {}", error.emit_to_string(source)));
        let validated = Validator::new(ValidationFlags::all(), Capabilities::empty()).validate(&module);
        validated.unwrap_or_else(|error| panic!("{name}: {}", error.emit_to_string(source)));
        module
    }

    fn form(info: &Info, given: &[(&str, &str)]) -> Result<Form> {
        let table = info.param_table();
        let owned = |(name, value): &(&str, &str)| ((*name).to_owned(), Input::Text((*value).to_owned()));
        let checked = check(info.id, &table, &given.iter().map(owned).collect::<Vec<_>>())?;
        let make = info.gpu.unwrap_or_else(|| panic!("{} has no form", info.id));
        make(&checked.resolve(&table, &View::ORDINARY), &View::ORDINARY)
    }

    /// The bytes of the uniform block `Params`, and of all entry points the names.
    fn interface(module: &naga::Module) -> (Option<u32>, Vec<&str>) {
        let uniform = module.global_variables.iter().find(|(_, v)| v.name.as_deref() == Some("params"));
        let size = uniform.map(|(_, v)| module.types[v.ty].inner.size(module.to_ctx()));
        (size, module.entry_points.iter().map(|e| e.name.as_str()).collect())
    }

    #[test]
    fn every_form_is_a_valid_shader_with_the_entry_points_and_params_it_names() {
        let forms: Vec<_> = REGISTRY.iter().filter(|info| info.gpu.is_some()).collect();
        assert!(forms.len() >= 8, "{}", forms.len());
        let others = [("lwboit", ("storage", "ll")), ("tfm", ("project", "transmittance"))];
        let others = others.map(|(id, given)| (crate::techniques::find(id).unwrap(), vec![given]));
        for (info, given) in forms.into_iter().map(|info| (*info, vec![])).chain(others) {
            let form = form(info, &given).unwrap();
            let module = validated(info.id, &form.module());
            let (size, names) = interface(&module);
            let needed = match &form.path {
                Path::Blended(blending) => {
                    let draws = blending.draws.iter().map(|draw| draw.shader);
                    ["place", blending.resolve].into_iter().chain(draws).collect()
                }
                Path::Listed(listing) => vec!["place", "count_fragment", "sort_lists", listing.resolve],
            };
            if let Path::Blended(blending) = &form.path {
                assert!(blending.draws.iter().all(|draw| draw.targets.end <= blending.targets.len()));
            }
            assert!(needed.iter().all(|name| names.contains(name)), "{}: {names:?}", info.id);
            let bytes = u32::try_from(4 * form.numbers.len()).unwrap();
            // a block may end in padding
            assert_eq!(size.unwrap_or(0).next_multiple_of(16), bytes.next_multiple_of(16), "{}", info.id);
        }
    }

    #[test]
    fn shared_modules_are_valid() {
        let lists = list_module();
        let names = interface(&validated("lists", &lists)).1.join(" ");
        for name in ["place", "count_fragment", "store_fragment", "sum_rows", "shift_rows", "sort_lists"] {
            assert!(names.contains(name), "{names}");
        }
        validated("background", &background_module());
    }

    #[test]
    fn every_layout_of_wboit_has_its_entry_points() {
        let wboit = crate::techniques::find("wboit").unwrap();
        for layout in ["listing3", "listing4", "monochrome"] {
            let form = form(wboit, &[("layout", layout)]).unwrap();
            let Path::Blended(blending) = &form.path else { panic!("{form:?}") };
            let module = validated(layout, &form.module());
            let names = interface(&module).1;
            assert!(names.contains(&blending.draws[0].shader), "{names:?}");
            assert!(names.contains(&blending.resolve), "{names:?}");
        }
    }

    #[test]
    fn what_no_device_does_is_refused_by_name() {
        let refused = |id: &str, given: &[(&str, &str)]| {
            form(crate::techniques::find(id).unwrap(), given).unwrap_err().to_string()
        };
        let message = refused("wboit", &[("summation", "fixed")]);
        assert!(
            message.contains("wboit: summation=\"fixed\"") && message.contains("is \"plain\""),
            "{message}"
        );
        let message = refused("blended_oit", &[("accumulation_format", "bf16")]);
        assert!(message.contains("accumulation_format=\"bf16\"") && message.contains("\"f16\""), "{message}");
        let message = refused("blended_oit", &[("accumulation_format", "f64")]);
        assert!(message.contains("accumulation_format=\"f64\""), "{message}");
        let message = refused("wboit", &[("format", "f16"), ("revealage_format", "f64")]);
        assert!(message.contains("revealage_format=\"f64\""), "{message}");
        assert!(refused("a_buffer", &[("format", "f16")]).contains("nodes of other formats"));
        assert!(refused("a_buffer", &[("overflow", "drop")]).contains("overflow=\"drop\""));
    }
}
