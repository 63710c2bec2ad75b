//! Forms for the raster in compute, which hands a pixel's fragments one by one to what it keeps in registers.

use super::{
    BACKGROUND, Blend, BlendTarget, Blending, DOUBLE, FRAGMENT, FRAME, Form, LISTS, ONE_WALK, Path, RESOLVE,
    Registers, SHARES_OF_LAYERS, Sorting, TILE_BINS, TILE_LISTS, TILE_STREAM, TILE_WINDOW, TILES, WALKS,
    WEIGHT_BOUNDS, constants,
};
use crate::error::{Error, Result};
use crate::format::Format;
use std::fmt::Write;

/// Words of a pixel's map that are in registers, at most: they take four kilobytes.
const MOST_WORDS: u32 = 1024;

/// Which raster draws the primitives.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum RasterPath {
    /// The device's own, with its blend units or with lists.
    #[default]
    Hardware,
    /// Tiles in compute, with what a pixel keeps in registers.
    Compute,
    /// The device's own, into samples of a pixel by masks.
    Samples,
    /// The device's own, into linked lists.
    LinkedLists,
}

impl RasterPath {
    /// The one of that name.
    ///
    /// # Errors
    /// [`Error::Argument`] if there is none.
    pub fn from_name(name: &str) -> Result<Self> {
        match name {
            "hardware" => Ok(Self::Hardware),
            "compute" => Ok(Self::Compute),
            "samples" => Ok(Self::Samples),
            "linked_lists" => Ok(Self::LinkedLists),
            other => {
                let problem =
                    format!("{other:?}; known: \"hardware\", \"compute\", \"samples\", \"linked_lists\"");
                Err(Error::argument("path", problem))
            }
        }
    }
}

/// Tiles have no order of depth, which takes walks of its own.
fn order_in_tiles(sorted: Sorting) -> &'static str {
    if sorted == Sorting::Depth { TILE_WINDOW } else { TILE_STREAM }
}

fn refused<T>(what: &str) -> Result<T> {
    let problem = format!("{what} has no form for \"compute\"; path=\"hardware\" has one");
    Err(Error::argument("path", problem))
}

/// Refuses targets in formats that registers do not stand for.
fn only_single(targets: &[BlendTarget]) -> Result<()> {
    match targets.iter().find(|target| target.format != Format::F32) {
        Some(target) => {
            let name = target.format.name();
            refused(&format!("{}={name:?}, which registers are not in,", target.param))
        }
        None => Ok(()),
    }
}

impl Form {
    /// Whether tiles hand over the furthest fragment first, if they do so by depth.
    pub fn is_backwards_in_tiles(&self) -> bool {
        match &self.path {
            Path::Streamed(stream) => stream.backwards,
            Path::Blended(blending) => blending.by_depth == Some(true),
            _ => false,
        }
    }

    /// Whether tiles fill lists for it: it looks at all fragments of a pixel at once, or keeps some by depth.
    pub fn is_listed_in_tiles(&self) -> bool {
        let drops_by_depth = self.capacity().is_some_and(|capacity| capacity.sorted == Sorting::Depth);
        matches!(self.path, Path::Listed(_)) || drops_by_depth
    }

    /// The shader whose `draw_tiles` is the technique's or, if that looks at lists, fills them.
    ///
    /// # Errors
    /// [`Error::Argument`] for samples, and for targets that registers do not stand for.
    pub fn tiled_module(&self) -> Result<String> {
        if self.is_listed_in_tiles() {
            return Ok(lists_module());
        }
        let (sized, state);
        let mut parts = vec![FRAME, DOUBLE, FRAGMENT, WEIGHT_BOUNDS];
        parts.extend(self.weight_parts());
        parts.extend([SHARES_OF_LAYERS, RESOLVE]);
        match &self.path {
            Path::Listed(_) => unreachable!("tiles fill lists for it"),
            // what tiles do to sort is peeling
            Path::Peeled(peeling) => {
                only_single(&peeling.sums)?;
                parts.extend([BACKGROUND, LISTS, WALKS, TILE_WINDOW]);
            }
            Path::Sampled(_) => return refused("a buffer of samples"),
            Path::Streamed(stream) => {
                sized = constants(stream.layers, &stream.sizes);
                // a shader may have an entry point for lists, too
                parts.extend([LISTS, &sized]);
                parts.extend(stream.blocks());
                parts.push(order_in_tiles(stream.sorted));
            }
            Path::Blended(blending) => {
                only_single(&blending.targets)?;
                parts.push(WALKS);
                if let Some(Registers { block, stream }) = &blending.in_registers {
                    let words = stream.words;
                    if words > MOST_WORDS {
                        return refused(&format!(
                            "what keeps {words} numbers of a pixel, more than {MOST_WORDS},"
                        ));
                    }
                    sized = constants(stream.layers, &stream.sizes);
                    parts.push(&sized);
                    parts.extend(blending.blocks);
                    parts.extend([block, order_in_tiles(stream.sorted)]);
                } else {
                    // the fragment shader's texels as a function of a fragment
                    let texels = format!("fn {}_texels(", blending.draws[0].shader);
                    if blending.draws.len() > 1 || !self.shader.contains(&texels) {
                        return refused("this technique");
                    }
                    state = registers(blending);
                    let sorted = blending.by_depth.map_or(Sorting::Submission, |_| Sorting::Depth);
                    parts.extend([ONE_WALK, &state, order_in_tiles(sorted)]);
                }
            }
        }
        parts.extend([self.shader, TILE_BINS, TILES]);
        Ok(parts.join("\n"))
    }
}

/// The module that sorts primitives into tiles: no technique's own.
pub fn bins_module() -> String {
    [FRAME, DOUBLE, FRAGMENT, TILE_BINS].join("\n")
}

/// The module of tiles that fill lists: no technique's own.
fn lists_module() -> String {
    let stream = [WALKS, ONE_WALK, TILE_LISTS, TILE_STREAM];
    [&[FRAME, DOUBLE, FRAGMENT, RESOLVE], &stream[..], &[TILE_BINS, TILES]].concat().join("\n")
}

/// The storage format of a target that stands for a texture.
fn storage_format(target: &BlendTarget) -> &'static str {
    if target.channels == 1 { "r32float" } else { "rgba32float" }
}

/// What render targets and blend units are where there are none: variables that go to textures in the end.
fn registers(blending: &Blending) -> String {
    let mut text = String::new();
    let [mut begin, mut take, mut finish] = [const { String::new() }; 3];
    for (i, target) in blending.targets.iter().enumerate() {
        let binding = 7 + i;
        let format = storage_format(target);
        let [r, g, b, a] = target.clear.map(|x| format!("{x:?}"));
        let over_background = i == 0 && blending.over_background;
        let first = if over_background {
            "vec4f(background_at(pixel), 1.0)".to_owned()
        } else {
            format!("vec4f({r}, {g}, {b}, {a})")
        };
        let (color, alpha) = (blend(target.color, i, "rgb"), blend(target.alpha, i, "a"));
        // writing to a string does not fail
        let _ = writeln!(
            text,
            "@group(2) @binding({binding}) var target_{i}: texture_storage_2d<{format}, write>;\n\
             var<private> state_{i}: vec4f;"
        );
        let _ = writeln!(begin, "    state_{i} = {first};");
        let _ = writeln!(take, "    state_{i} = vec4f({color}, {alpha});");
        let _ = writeln!(finish, "    textureStore(target_{i}, pixel_of(id), state_{i});");
    }
    finish.push_str("    tell_if_cut_short();\n");
    format!(
        "{text}\
         fn begin(pixel: vec2u) {{\n{begin}}}\n\
         fn take(fragment: Fragment) {{\n    let texels = {draw}_texels(fragment);\n{take}}}\n\
         fn finish(id: vec3u) {{\n{finish}}}",
        draw = blending.draws[0].shader
    )
}

/// What a blend unit makes of some channels of a texel and of the state.
fn blend(blend: Blend, i: usize, channels: &str) -> String {
    let (source, there) = (format!("texels[{i}].{channels}"), format!("state_{i}.{channels}"));
    let largest = if channels == "rgb" { "vec3f(LARGEST)" } else { "LARGEST" };
    match blend {
        Blend::Add => format!("{source} + {there}"),
        // what overflows can still be hidden
        Blend::Over => format!("min({source} + (1.0 - texels[{i}].a) * {there}, {largest})"),
        Blend::Attenuate => format!("(1.0 - {source}) * {there}"),
        Blend::Multiply => format!("{source} * {there}"),
        Blend::Under => format!("state_{i}.a * {source} + {there}"),
        Blend::Cover => format!("min({source} + texels[{i}].a * {there}, {largest})"),
        Blend::Max => format!("max({source}, {there})"),
    }
}
