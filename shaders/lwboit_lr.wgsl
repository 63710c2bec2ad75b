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

// A fragment on its way into bins.
struct Part {
    own: i32,
    // how far behind the centre of its own bin, in bin widths
    x: f32,
    // weighted
    color: vec4f,
    alpha: f32,
    absorbance: f32,
    // of all bins that there are
    shares: f32,
}

// How much of a fragment a bin gets whose centre is x bin widths away.
fn faded(x: f32) -> f32 {
    if params.fading == 1u {
        return exp_minus(4.0 * LN_2 * x * x);
    }
    return max(0.0, 1.0 - abs(x));
}

fn share_of(part: Part, bin: i32) -> f32 {
    if bin < 0 || bin >= i32(params.bins) || abs(bin - part.own) > REACH {
        return 0.0;
    }
    if params.fading == 0u {
        return select(0.0, 1.0, bin == part.own);
    }
    return faded(part.x - f32(bin - part.own));
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
    let weight = weight_of(params.weight, place.seen, fragment.alpha);
    let color = weight * vec4f(fragment.color, fragment.alpha);
    let x = (position.x - own) + position.y - 0.5;
    var part = Part(i32(own), x, color, fragment.alpha, absorbance(fragment.alpha, params.s_max), 0.0);
    for (var bin = part.own - REACH; bin <= part.own + REACH; bin++) {
        part.shares += share_of(part, bin);
    }
    return part;
}

// How much of a fragment's colour a bin gets, and how much of the bin's background that covers.
fn blended_into(part: Part, bin: i32) -> vec2f {
    let share = share_of(part, bin);
    if params.by_absorbance == 0u {
        return vec2f(share, share * part.alpha);
    }
    let beta = share / part.shares;
    let covered = one_minus_exp_minus(beta * part.absorbance);
    return vec2f(select(beta, covered / part.alpha, part.alpha > 0.0), covered);
}

// The bins' layers, then their channels, then what all leave.
fn output(part: Part, index: u32) -> vec4f {
    let bins = i32(params.bins);
    let at = i32(index);
    if at < bins {
        return blended_into(part, at).x * part.color;
    }
    let first = 4 * (at - bins);
    if first < bins {
        return vec4f(
            blended_into(part, first).y,
            blended_into(part, first + 1).y,
            blended_into(part, first + 2).y,
            blended_into(part, first + 3).y,
        );
    }
    return vec4f(part.alpha);
}

const OUTPUTS = 8u;

// Whether anything of a fragment goes into the attachments at hand.
fn goes_there(part: Part) -> bool {
    let bins = i32(params.bins);
    let first = i32(first_output);
    let last = first + i32(OUTPUTS) - 1;
    let into_sums = first <= part.own + REACH && last >= part.own - REACH;
    // a channel of bins before the first would be one of the layers
    let into_shares = first <= bins + (part.own + REACH) / 4 && last >= bins + max(part.own - REACH, 0) / 4;
    return into_sums || into_shares || last >= bins + (bins + 3) / 4;
}

@fragment
fn blend_into_bins(placed: Placed) -> Outputs {
    let part = part_of(fragment_of(placed));
    if !goes_there(part) {
        discard;
    }
    return Outputs(
        output(part, first_output),
        output(part, first_output + 1u),
        output(part, first_output + 2u),
        output(part, first_output + 3u),
        output(part, first_output + 4u),
        output(part, first_output + 5u),
        output(part, first_output + 6u),
        output(part, first_output + 7u),
    );
}

// FEE21 eq. 4, and section 3.3 to normalise.
@compute @workgroup_size(8, 8)
fn resolve(@builtin(global_invocation_id) id: vec3u) {
    if is_outside(id) {
        return;
    }
    let background = background_at(pixel_of(id));
    var color = vec3f(0.0);
    var covered = 0.0;
    var left = 1.0;
    for (var bin = 0u; bin < params.bins; bin++) {
        let sums = min(textureLoad(sums_target, id.xy, bin, 0), vec4f(params.largest));
        let share = textureLoad(shares_target, id.xy, bin / 4u, 0)[bin % 4u];
        if sums.a > 0.0 {
            let part = left * (1.0 - share);
            color += part * (sums.rgb / sums.a);
            covered += part;
        }
        left *= share;
    }
    if params.normalize == 0u {
        store(id, color + left * background, left);
        return;
    }
    let net = textureLoad(net_target, id.xy, 0).x;
    if covered <= 0.0 {
        store(id, background, 1.0);
        return;
    }
    store(id, color * ((1.0 - net) / covered) + net * background, net);
}
