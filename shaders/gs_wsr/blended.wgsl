
// The blend unit adds up.

fn accumulate_texels(fragment: Fragment) -> array<vec4f, 1> {
    return array<vec4f, 1>(weight_at(fragment.depth, params.sigma) * rgba(fragment));
}

@fragment
fn accumulate(placed: Placed) -> @location(0) vec4f {
    return accumulate_texels(fragment_of(placed))[0];
}

@group(2) @binding(0) var accumulation: texture_2d<f32>;

@fragment
fn resolve(@builtin(position) position: vec4f) -> @location(0) vec4f {
    let pixel = pixel_at(position);
    let average = average_at(pixel, load_sums(accumulation, pixel, params.largest));
    return image_texel(average.rgb, average.a);
}
