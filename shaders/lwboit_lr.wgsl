// Layered weighted blended OIT (Friederichs, Eisemann & Eisemann 2021), layered rendering: every bin of depth has a layer of
// weighted sums and a channel of what it leaves of its background; the blend unit fills them, as many at a time as it takes.

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

fn bounds_texel(texel: vec2u) -> vec2f {
    return textureLoad(bounds_target, texel, 0).xy;
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
    let pixel = pixel_at(position);
    let texel = texel_of(pixel);
    let background = background_at(pixel);
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
    let net = load(net_target, pixel).x;
    if covered <= 0.0 {
        return image_texel(background, 1.0);
    }
    return image_texel(color * ((1.0 - net) / covered) + net * background, net);
}
