
// The blend unit adds up.

@fragment
fn accumulate(placed: Placed) -> @location(0) vec4f {
    let fragment = fragment_of(placed);
    return weight_at(fragment.depth, params.sigma) * vec4f(fragment.color, fragment.alpha);
}

@group(2) @binding(0) var accumulation: texture_2d<f32>;

@fragment
fn resolve(@builtin(position) position: vec4f) -> @location(0) vec4f {
    let pixel = pixel_at(position);
    let average = average_at(pixel, min(textureLoad(accumulation, texel_of(pixel), 0), vec4f(params.largest)));
    return image_texel(average.rgb, average.a);
}
