// The two-pass template: a map of each pixel's transmittance, to which fragments add in any order, then every fragment once
// more, seen through it. A technique has `Params` with a `two_pass`, and says what a fragment adds to a texel of the map
// (`Term`, `term_of`, `map_texel`), what lies in front of it (`in_front_of`), and what gets through all (`total_at`). Where map
// and sums are is said elsewhere: in targets, or in registers.

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

// Weights are at least this, so that where all are less the average is that of blended OIT.
const FLOOR = 1e-30;

fn bounds_at(texel: vec2u) -> Interval {
    let bounds = bounds_texel(texel);
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
    return clamp(map_sums(texel, layer), -largest, largest);
}

fn absorbance_of(fragment: Fragment) -> f32 {
    return absorbance(fragment.alpha, params.two_pass.s_max);
}

// As much of a fragment as is seen.
fn weighted(fragment: Fragment) -> vec4f {
    let least = select(0.0, FLOOR, params.two_pass.composite == 2u);
    return max(in_front_of(fragment), least) * rgba(fragment);
}

// From what all fragments show, and the share of the background that all leave, to the image: colour, and the background's share.
fn composited(pixel: vec2u, all: vec4f, share: f32) -> vec4f {
    let background = background_at(pixel);
    let sums = min(all, vec4f(params.two_pass.largest));
    switch params.two_pass.composite {
        case 0u: {
            let total = total_at(texel_of(pixel));
            return vec4f(sums.rgb + total * background, total);
        }
        case 1u: {
            return vec4f(sums.rgb + share * background, share);
        }
        default: {
            let average = select(vec3f(0.0), sums.rgb * ((1.0 - share) / sums.a), sums.a > 0.0);
            return vec4f(average + share * background, share);
        }
    }
}
