// Layered weighted blended OIT (Friederichs, Eisemann & Eisemann 2021), layered rendering: every bin of depth has a layer of
// weighted sums and a channel of what it leaves of its background; the blend unit fills them, as many at a time as it takes.

struct Params {
    weight: Weight,
    // the range that bins divide, each end a sum of two, or that of the pixel
    near: vec2f,
    far: vec2f,
    range_of_pixel: u32,
    bins: u32,
    // 0: a fragment is in one bin; 1: it fades over others like a bell, 2: like a tent
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
}

@group(0) @binding(3) var<uniform> params: Params;

// (-nearest, farthest)
@group(2) @binding(0) var bounds_target: texture_2d<f32>;
// a layer per bin
@group(2) @binding(1) var sums_target: texture_2d_array<f32>;
// a channel per bin
@group(2) @binding(2) var shares_target: texture_2d_array<f32>;
// what all fragments together leave
@group(2) @binding(3) var net_target: texture_2d<f32>;

@fragment
fn find_bounds(placed: Placed) -> @location(0) vec4f {
    let fragment = fragment_of(placed);
    return vec4f(-fragment.depth, fragment.depth, 0.0, 0.0);
}

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
    if params.fading == 1u {
        return exp_minus(4.0 * LN_2 * x * x);
    }
    return max(0.0, 1.0 - abs(x));
}

// Shares out a fragment that is x bin widths behind the centre of its own bin.
fn share_out(own: i32, x: f32, alpha: f32) {
    var sum = 0.0;
    for (var i = 0; i < REACHED; i++) {
        let bin = own + i - REACH;
        var share = select(0.0, 1.0, i == REACH);
        if params.fading != 0u {
            share = faded(x - f32(i - REACH));
        }
        color_shares[i] = select(0.0, share, bin >= 0 && bin < i32(params.bins));
        coverages[i] = color_shares[i] * alpha;
        sum += color_shares[i];
    }
    if params.by_absorbance == 0u {
        return;
    }
    let s = absorbance(alpha, params.s_max);
    for (var i = 0; i < REACHED; i++) {
        let beta = color_shares[i] / sum;
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
        let texel = textureLoad(bounds_target, texel_of(fragment.pixel), 0).xy;
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

fn is_reached(part: Part, bin: i32) -> bool {
    return abs(bin - part.own) <= REACH;
}

fn covered_of(part: Part, bin: i32) -> f32 {
    return select(0.0, coverages[clamp(bin - part.own + REACH, 0, REACHED - 1)], is_reached(part, bin));
}

// The bins' layers, then their channels, then what all leave.
fn output(part: Part, index: u32) -> vec4f {
    let bins = i32(params.bins);
    let at = i32(index);
    if at < bins {
        let share = color_shares[clamp(at - part.own + REACH, 0, REACHED - 1)];
        return select(vec4f(0.0), share * part.color, is_reached(part, at));
    }
    let first = 4 * (at - bins);
    if first < bins {
        return vec4f(
            covered_of(part, first),
            covered_of(part, first + 1),
            covered_of(part, first + 2),
            covered_of(part, first + 3),
        );
    }
    return vec4f(part.alpha);
}

const OUTPUTS = 8u;

// Whether anything of a fragment goes into the attachments at hand.
fn goes_there(part: Part, first: i32) -> bool {
    let bins = i32(params.bins);
    let last = first + i32(OUTPUTS) - 1;
    let into_sums = first <= part.own + REACH && last >= part.own - REACH;
    let into_shares = first <= bins + (part.own + REACH) / 4 && last >= bins + max(part.own - REACH, 0) / 4;
    return into_sums || into_shares || last >= bins + (bins + 3) / 4;
}

@fragment
fn blend_into_bins(placed: Placed) -> Outputs {
    let part = part_of(fragment_of(placed));
    let first = first_output_of(placed);
    if !goes_there(part, i32(first)) {
        discard;
    }
    return Outputs(
        output(part, first),
        output(part, first + 1u),
        output(part, first + 2u),
        output(part, first + 3u),
        output(part, first + 4u),
        output(part, first + 5u),
        output(part, first + 6u),
        output(part, first + 7u),
    );
}

// FEE21 eq. 4, and section 3.3 to normalise.
@fragment
fn resolve(@builtin(position) position: vec4f) -> @location(0) vec4f {
    let texel = vec2u(position.xy);
    let background = background_at(pixel_at(position));
    var color = vec3f(0.0);
    var covered = 0.0;
    var left = 1.0;
    for (var bin = 0u; bin < params.bins; bin++) {
        let sums = min(textureLoad(sums_target, texel, bin, 0), vec4f(params.largest));
        let share = textureLoad(shares_target, texel, bin / 4u, 0)[bin % 4u];
        if sums.a > 0.0 {
            let part = left * (1.0 - share);
            color += part * (sums.rgb / sums.a);
            covered += part;
        }
        left *= share;
    }
    if params.normalize == 0u {
        return image_texel(color + left * background, left);
    }
    let net = textureLoad(net_target, texel, 0).x;
    if covered <= 0.0 {
        return image_texel(background, 1.0);
    }
    return image_texel(color * ((1.0 - net) / covered) + net * background, net);
}
