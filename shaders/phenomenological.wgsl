// The phenomenological model (McGuire & Mara 2016): weighted blended OIT whose fragments transmit the background in
// colour. The blend unit multiplies the background's share channel by channel.

struct Params {
    weight: Weight,
    transmission: vec3f,
    // the accumulation's largest finite number
    largest: f32,
    divisor_floor: f32,
}

@group(0) @binding(3) var<uniform> params: Params;

struct Targets {
    @location(0) accumulation: vec4f,
    @location(1) modulation: vec4f,
}

fn accumulate_texels(fragment: Fragment) -> array<vec4f, 2> {
    let tau = params.transmission;
    let alpha = fragment.alpha * (1.0 - (tau.x + tau.y + tau.z) / 3.0);
    let weight = weight_of(params.weight, fragment.depth, alpha);
    let share = vec3f(1.0) - fragment.alpha * (vec3f(1.0) - tau);
    return array(weight * vec4f(fragment.color, alpha), vec4f(share, 1.0));
}

@fragment
fn accumulate(placed: Placed) -> Targets {
    let texels = accumulate_texels(fragment_of(placed));
    return Targets(texels[0], texels[1]);
}

@group(2) @binding(0) var accumulation: texture_2d<f32>;
@group(2) @binding(1) var modulation: texture_2d<f32>;

@fragment
fn resolve(@builtin(position) position: vec4f) -> ImageTexels {
    let pixel = pixel_at(position);
    let sums = load_sums(accumulation, pixel, params.largest);
    let share = load(modulation, pixel).rgb;
    var average = vec3f(0.0);
    if sums.a > 0.0 {
        average = sums.rgb / max(sums.a, params.divisor_floor);
    }
    return image_texels((vec3f(1.0) - share) * average + share * background_at(pixel), share);
}
