// Stochastic transparency (Enderton et al. 2010) as published: fragments cover samples of a multisampled depth buffer by masks, and
// the depth test keeps the nearest of each; then all fragments once more, which find what of them the samples show. A pixel that a
// primitive covers has all of its samples there, and at the depth of its centre: what a mask says is not changed by where a device
// has its samples.

struct Params {
    masking: Masking,
    corrected: u32,
    keeps_depths: u32,
    // a difference of exponents: what takes depths to window depths
    window_exponent: u32,
}

@group(0) @binding(3) var<uniform> params: Params;

// Of a pixel's samples a pass does so many.
override samples_at_a_time: u32 = 4;

@group(2) @binding(0) var sample_depths: texture_depth_multisampled_2d;
// the primitive that each sample shows + 1, in two halves; 0 where it shows none
@group(2) @binding(1) var sample_owners: texture_multisampled_2d<u32>;

struct Covered {
    @builtin(frag_depth) depth: f32,
    @builtin(sample_mask) samples: u32,
    @location(0) owner: vec4u,
}

// What samples are left in this pass: bits of the fragment's mask.
fn bits_of_pass(first: u32) -> u32 {
    var bits = 0u;
    for (var i = 0u; i < samples_at_a_time; i++) {
        let sample = first + i;
        if sample < params.masking.bits {
            bits |= ((drawn[sample / 32u] >> (sample % 32u)) & 1u) << i;
        }
    }
    return bits;
}

@fragment
fn cover_samples(placed: Placed) -> Covered {
    let pixel = pixel_at(placed.position);
    var fragment: Fragment;
    if !is_inside(placed, pixel) || !is_seen(placed, pixel, &fragment) || fragment.alpha <= 0.0 {
        discard;
    }
    draw_mask(params.masking, pixel, fragment.primitive, fragment.alpha);
    let bits = bits_of_pass(first_output_of(placed) * samples_at_a_time);
    if bits == 0u {
        discard;
    }
    let owner = fragment.primitive + 1u;
    let depth = bitcast<f32>(window_bits(fragment.depth, params.window_exponent));
    return Covered(depth, bits, vec4u(owner & 0xffffu, owner >> 16u, 0u, 0u));
}

// How many of the samples at hand show a fragment; where they keep depths, how many it is not behind.
fn count_showing(fragment: Fragment, first: u32) -> u32 {
    let own = vec2u(window_bits(fragment.depth, params.window_exponent), fragment.primitive + 1u);
    let texel = texel_of(fragment.pixel);
    let there = min(params.masking.bits - first, samples_at_a_time);
    var count = 0u;
    for (var i = 0u; i < there; i++) {
        let halves = textureLoad(sample_owners, texel, i).xy;
        let owner = halves.x | (halves.y << 16u);
        if params.keeps_depths == 0u {
            count += u32(owner == own.y);
        } else {
            let key = vec2u(bitcast<u32>(textureLoad(sample_depths, texel, i)), owner);
            count += u32(owner == 0u || !comes_before_by_depth(key, own));
        }
    }
    return count;
}

struct Shown {
    @location(0) accumulation: vec4f,
    @location(1) revealage: vec4f,
}

// Sums over samples; what has nothing to do with samples counts once.
@fragment
fn add_showing(placed: Placed) -> Shown {
    let fragment = fragment_of(placed);
    let showing = f32(count_showing(fragment, first_output_of(placed) * samples_at_a_time));
    let share = select(0.0, fragment.alpha, is_first_part);
    if params.keeps_depths == 0u {
        let color = select(vec3f(0.0), unmultiplied(rgba(fragment)), fragment.alpha > 0.0);
        return Shown(showing * vec4f(color, 1.0), vec4f(share));
    }
    let least = select(0.0, LEAST_SEEN, is_first_part && params.corrected != 0u);
    return Shown((showing / f32(params.masking.bits) + least) * rgba(fragment), vec4f(share));
}

@group(2) @binding(0) var accumulation_target: texture_2d<f32>;
@group(2) @binding(1) var revealage_target: texture_2d<f32>;

@fragment
fn resolve(@builtin(position) position: vec4f) -> @location(0) vec4f {
    let pixel = pixel_at(position);
    let background = background_at(pixel);
    let weighted = load(accumulation_target, pixel);
    let transmittance = load(revealage_target, pixel).x;
    let sums = Sums(weighted, 1.0 - transmittance, transmittance);
    if params.corrected != 0u {
        // where no sample shows anything, the layers' share stays black
        let texel = over_background(sums, background);
        return image_texel(texel.rgb, texel.a);
    }
    if params.keeps_depths != 0u {
        return image_texel(min(weighted.rgb, vec3f(LARGEST)) + transmittance * background, transmittance);
    }
    let all = f32(params.masking.bits);
    let open = (all - weighted.a) / all;
    return image_texel(min(weighted.rgb, vec3f(LARGEST)) / all + open * background, open);
}
