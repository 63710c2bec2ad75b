// Sort-independent alpha blending (Meshkin 2007; MB13 eq. 3 and Listing 1).

fn accumulate_texels(fragment: Fragment) -> array<vec4f, 1> {
    return array(vec4f(fragment.color, fragment.alpha));
}

@fragment
fn accumulate(placed: Placed) -> @location(0) vec4f {
    return accumulate_texels(fragment_of(placed))[0];
}

struct Params {
    // the accumulation's largest finite number
    largest: f32,
}

@group(0) @binding(3) var<uniform> params: Params;
@group(2) @binding(0) var accumulation: texture_2d<f32>;

@fragment
fn resolve(@builtin(position) position: vec4f) -> @location(0) vec4f {
    let pixel = pixel_at(position);
    let sums = load_sums(accumulation, pixel, params.largest);
    let transmittance = 1.0 - sums.a;
    return image_texel(sums.rgb + transmittance * background_at(pixel), transmittance);
}
