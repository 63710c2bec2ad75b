// Layered weighted blended OIT (Friederichs, Eisemann & Eisemann 2021): what of a fragment goes to which bins of depth. Where a
// pixel's bounds are is said elsewhere (`bounds_texel`), and so is the function of distance if it is the user's own: `bin_value`,
// `bin_is_lost` and `bin_UNIFORMS`.

struct Params {
    weight: Weight,
    // the range that bins divide, each end a sum of two, or that of the pixel
    near: vec2f,
    far: vec2f,
    range_of_pixel: u32,
    bins: u32,
    // 0: a fragment is in one bin; else it fades over others
    fading: u32,
    // bins share a fragment's absorbance, not its coverage ...
    by_absorbance: u32,
    // ... which is at most this
    s_max: f32,
    normalize: u32,
    // bins are measured from each pixel's first surface, which lies so many bins behind the first one's near edge
    shaped: u32,
    anchor: f32,
    // the sums' largest finite number
    largest: f32,
    unused_0: u32,
    unused_1: u32,
    unused_2: u32,
    bin_uniforms: array<vec4f, bin_UNIFORMS>,
}

@group(0) @binding(3) var<uniform> params: Params;

// Fading.
const BELL = 1u;
const TENT = 2u;
const OWN = 3u;

const REACH = 2;

const REACHED = 5;

// A fragment on its way into bins.
struct Part {
    own: i32,
    // weighted
    color: vec4f,
    alpha: f32,
}

// Of the bins around its own: how much of its colour they get, and how much of their backgrounds that covers.
var<private> color_shares: array<f32, REACHED>;
var<private> coverages: array<f32, REACHED>;

// How much of a fragment a bin gets whose centre is x bin widths away.
fn faded(x: f32) -> f32 {
    switch params.fading {
        case BELL: {
            return exp_minus(4.0 * LN_2 * x * x);
        }
        case TENT: {
            return max(0.0, 1.0 - abs(x));
        }
        default: {
            return bin_value(x);
        }
    }
}

// What a function of the user's own gives as shares: numbers that are none are nothing, and more than all of the coverage is
// all. A fragment of such numbers is reported, and one that is in no bin.
fn check_shares() {
    var is_invalid = bin_is_lost();
    var is_in_none = true;
    for (var i = 0; i < REACHED; i++) {
        // by its bits, since compilers may assume that there is no NaN: negative, infinite or none
        let bits = bitcast<u32>(color_shares[i]);
        if bits >= 0x7f800000u && bits != 0x80000000u {
            is_invalid = true;
            color_shares[i] = 0.0;
        } else if params.by_absorbance == 0u {
            color_shares[i] = min(color_shares[i], 1.0);
        }
        is_in_none = is_in_none && color_shares[i] == 0.0;
    }
    if is_invalid || is_in_none {
        report_invalid();
    }
}

// Shares out a fragment that is x bin widths behind the centre of its own bin.
fn share_out(own: i32, x: f32, alpha: f32) {
    for (var i = 0; i < REACHED; i++) {
        var share = select(0.0, 1.0, i == REACH);
        if params.fading != 0u {
            share = faded(x - f32(i - REACH));
        }
        color_shares[i] = share;
    }
    if params.fading == OWN {
        check_shares();
    }
    var largest = 0.0;
    for (var i = 0; i < REACHED; i++) {
        let bin = own + i - REACH;
        color_shares[i] = select(0.0, color_shares[i], bin >= 0 && bin < i32(params.bins));
        coverages[i] = color_shares[i] * alpha;
        largest = max(largest, color_shares[i]);
    }
    if params.by_absorbance == 0u || largest == 0.0 {
        return;
    }
    // sums of what is at most 1 do not overflow
    var sum = 0.0;
    for (var i = 0; i < REACHED; i++) {
        sum += color_shares[i] / largest;
    }
    let s = absorbance(alpha, params.s_max);
    for (var i = 0; i < REACHED; i++) {
        let beta = color_shares[i] / largest / sum;
        coverages[i] = one_minus_exp_minus(beta * s);
        color_shares[i] = select(beta, coverages[i] / alpha, alpha > 0.0);
    }
}

// Its place in bins, from the near edge of the first one, and the depth that weights see.
struct Place {
    position: vec2f,
    seen: f32,
}

fn place_in_bins(fragment: Fragment) -> Place {
    var range = Interval(params.near, params.far);
    var bounds = range;
    if params.range_of_pixel != 0u || params.shaped != 0u {
        let texel = bounds_texel(texel_of(fragment.pixel));
        bounds = Interval(vec2f(-texel.x, 0.0), vec2f(texel.y, 0.0));
    }
    if params.range_of_pixel != 0u {
        range = bounds;
    }
    let origin = select(range.near, bounds.near, params.shaped != 0u);
    let offset = sum_of(vec2f(fragment.depth, 0.0), -origin);
    var extent = length_of(range);
    if extent.x <= 0.0 {
        extent = vec2f(f32(params.bins), 0.0);
    }
    let anchor = select(0.0, params.anchor, params.shaped != 0u);
    let position = quotient(times(UNIT * offset, f32(params.bins)), UNIT * extent);
    let seen = select(fragment.depth, offset.x + anchor * (extent.x / f32(params.bins)), params.shaped != 0u);
    return Place(sum_of(position, vec2f(anchor, 0.0)), seen);
}

fn part_of(fragment: Fragment) -> Part {
    let place = place_in_bins(fragment);
    let count = f32(params.bins);
    var position = place.position;
    if position.x < 0.0 {
        position = vec2f(0.0);
    } else if position.x >= count {
        position = vec2f(count, 0.0);
    }
    var own = floor(position.x);
    if position.x == own && position.y < 0.0 {
        own -= 1.0;
    }
    own = clamp(own, 0.0, count - 1.0);
    share_out(i32(own), (position.x - own) + position.y - 0.5, fragment.alpha);
    let weight = weight_of(params.weight, place.seen, fragment.alpha);
    return Part(i32(own), weight * vec4f(fragment.color, fragment.alpha), fragment.alpha);
}
