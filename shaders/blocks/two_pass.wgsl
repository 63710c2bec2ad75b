// The two-pass template: a map of each pixel's transmittance, to which fragments add in any order, then every fragment once
// more, seen through it. A technique has `Params` with a `two_pass`, and says what a fragment adds to a texel of the map
// (`Term`, `term_of`, `map_texel`), what lies in front of it (`in_front_of`), and what gets through all (`total_at`).

struct TwoPass {
    // depths are told apart between these, each a sum of two ...
    near: vec2f,
    far: vec2f,
    // ... or between those of the pixel
    range_of_pixel: u32,
    // the largest absorbance of a fragment
    s_max: f32,
    // the background gets 0: what the map lets through, 1: its exact share; 2: colours are scaled to cover the rest
    composite: u32,
    // the largest finite numbers of the accumulation, of the map, and of what has a format of its own
    largest: f32,
    largest_of_map: f32,
    largest_total: f32,
    unused_0: u32,
    unused_1: u32,
}

// (-nearest, farthest)
@group(2) @binding(0) var bounds_target: texture_2d<f32>;
@group(2) @binding(1) var map_target: texture_2d_array<f32>;
// what of the map has a format of its own, if anything
@group(2) @binding(2) var total_target: texture_2d<f32>;
@group(2) @binding(3) var accumulation_target: texture_2d<f32>;
@group(2) @binding(4) var revealage_target: texture_2d<f32>;

// Weights are at least this, so that where all are less the average is that of blended OIT.
const FLOOR = 1e-30;

fn bounds_at(texel: vec2u) -> Interval {
    let bounds = textureLoad(bounds_target, texel, 0).xy;
    return Interval(vec2f(-bounds.x, 0.0), vec2f(bounds.y, 0.0));
}

fn interval_at(texel: vec2u) -> Interval {
    if params.two_pass.range_of_pixel != 0u {
        return bounds_at(texel);
    }
    return Interval(params.two_pass.near, params.two_pass.far);
}

fn map_at(texel: vec2u, layer: u32) -> vec4f {
    let largest = vec4f(params.two_pass.largest_of_map);
    return clamp(textureLoad(map_target, texel, layer, 0), -largest, largest);
}

fn absorbance_of(fragment: Fragment) -> f32 {
    return absorbance(fragment.alpha, params.two_pass.s_max);
}

@fragment
fn find_bounds(placed: Placed) -> @location(0) vec4f {
    let fragment = fragment_of(placed);
    return vec4f(-fragment.depth, fragment.depth, 0.0, 0.0);
}

@fragment
fn add_to_map(placed: Placed) -> Outputs {
    let term = term_of(fragment_of(placed));
    let first = first_output_of(placed);
    return Outputs(
        map_texel(term, first),
        map_texel(term, first + 1u),
        map_texel(term, first + 2u),
        map_texel(term, first + 3u),
        map_texel(term, first + 4u),
        map_texel(term, first + 5u),
        map_texel(term, first + 6u),
        map_texel(term, first + 7u),
    );
}

struct Sums {
    @location(0) accumulation: vec4f,
    @location(1) revealage: vec4f,
}

@fragment
fn look_through(placed: Placed) -> Sums {
    let fragment = fragment_of(placed);
    let least = select(0.0, FLOOR, params.two_pass.composite == 2u);
    let weight = max(in_front_of(fragment), least);
    return Sums(weight * vec4f(fragment.color, fragment.alpha), vec4f(fragment.alpha));
}

@fragment
fn resolve(@builtin(position) position: vec4f) -> @location(0) vec4f {
    let texel = vec2u(position.xy);
    let background = background_at(pixel_at(position));
    let sums = min(textureLoad(accumulation_target, texel, 0), vec4f(params.two_pass.largest));
    let share = textureLoad(revealage_target, texel, 0).x;
    switch params.two_pass.composite {
        case 0u: {
            let total = total_at(texel);
            return image_texel(sums.rgb + total * background, total);
        }
        case 1u: {
            return image_texel(sums.rgb + share * background, share);
        }
        default: {
            let average = select(vec3f(0.0), sums.rgb * ((1.0 - share) / sums.a), sums.a > 0.0);
            return image_texel(average + share * background, share);
        }
    }
}
