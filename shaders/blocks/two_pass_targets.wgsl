// The two-pass template in render targets: passes over the geometry.

// (-nearest, farthest)
@group(2) @binding(0) var bounds_target: texture_2d<f32>;
@group(2) @binding(1) var map_target: texture_2d_array<f32>;
// what of the map has a format of its own, if anything
@group(2) @binding(2) var total_target: texture_2d<f32>;
@group(2) @binding(3) var accumulation_target: texture_2d<f32>;
@group(2) @binding(4) var revealage_target: texture_2d<f32>;
// 32 bits each, pixel by pixel, if there are any
@group(2) @binding(5) var<storage, read_write> words: array<atomic<u32>>;

fn bounds_texel(texel: vec2u) -> vec2f {
    return textureLoad(bounds_target, texel, 0).xy;
}

fn map_sums(texel: vec2u, layer: u32) -> vec4f {
    return textureLoad(map_target, texel, layer, 0);
}

fn total_sum(texel: vec2u) -> f32 {
    return textureLoad(total_target, texel, 0).x;
}

// Word `at` of a pixel that has `count` of them.
fn word_at(texel: vec2u, count: u32, at: u32) -> u32 {
    return atomicLoad(&words[(texel.y * frame.size.x + texel.x) * count + at]);
}

fn set_bits(texel: vec2u, count: u32, at: u32, bits: u32) {
    atomicOr(&words[(texel.y * frame.size.x + texel.x) * count + at], bits);
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
    return Sums(weighted(fragment), vec4f(fragment.alpha));
}

@fragment
fn resolve(@builtin(position) position: vec4f) -> @location(0) vec4f {
    let pixel = pixel_at(position);
    let all = composited(pixel, load(accumulation_target, pixel), load(revealage_target, pixel).x);
    return image_texel(all.rgb, all.a);
}
