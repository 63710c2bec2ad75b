// What every shader knows of the image at hand, and what lies behind its transparent fragments.

struct Frame {
    // pixels
    size: vec2u,
    // the rows that are being worked on
    first_row: u32,
    rows: u32,
    // the centre of the viewport, in sub-pixels, and half its size
    viewport_center: vec2i,
    half_viewport: f32,
    has_opaque: u32,
    background: vec3f,
    // 0, which no compiler knows
    zero: u32,
}

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var opaque_depth: texture_2d<f32>;
@group(0) @binding(2) var opaque_color: texture_2d<f32>;

// Fragments of which a function of the user's own gave what is none, and those that were dropped.
@group(0) @binding(4) var<storage, read_write> counters: array<atomic<u32>, 2>;
const INVALID = 0u;
const DROPPED = 1u;

// Whether the image has opaque surfaces, as far as a pipeline knows.
override has_opaque: bool = true;

const LARGEST = 3.4028234e38;

// The opaque colour behind a pixel.
fn background_at(pixel: vec2u) -> vec3f {
    if !has_opaque || frame.has_opaque == 0u {
        return frame.background;
    }
    return textureLoad(opaque_color, pixel, 0).rgb;
}

// Targets have all rows of the image, not only those at hand.
override targets_are_whole: bool = false;

// A pixel's place in the targets.
fn texel_of(pixel: vec2u) -> vec2u {
    if targets_are_whole {
        return pixel;
    }
    return vec2u(pixel.x, pixel.y - frame.first_row);
}

// The pixel of a place in them.
fn pixel_at(position: vec4f) -> vec2u {
    return vec2u(u32(position.x), u32(position.y) + frame.first_row);
}

// whether a pass before this one was cut short in this pixel
var<private> was_cut_short: bool;

// Some drivers end all loops of an invocation once they have taken so many steps together. Then this one ends early, too.
fn is_cut_short() -> bool {
    var steps = 0u;
    for (var i = frame.zero; i < 2u; i++) {
        steps++;
    }
    return steps != 2u || was_cut_short;
}

// Where a pixel's numbers are among those of the rows at hand.
fn place_of(pixel: vec2u) -> u32 {
    return (pixel.y - frame.first_row) * frame.size.x + pixel.x;
}
