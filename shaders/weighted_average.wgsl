// Weighted average (Bavoil & Myers 2008; MB13 eq. 4 and Listing 2): as many copies of the mean fragment as there are
// fragments.

struct Targets {
    @location(0) accumulation: vec4f,
    @location(1) count: vec4f,
}

fn accumulate_texels(fragment: Fragment) -> array<vec4f, 2> {
    return array(vec4f(fragment.color, fragment.alpha), vec4f(1.0));
}

@fragment
fn accumulate(placed: Placed) -> Targets {
    let texels = accumulate_texels(fragment_of(placed));
    return Targets(texels[0], texels[1]);
}

struct Params {
    // the accumulation's largest finite number
    largest: f32,
}

@group(0) @binding(3) var<uniform> params: Params;
@group(2) @binding(0) var accumulation: texture_2d<f32>;
@group(2) @binding(1) var count_target: texture_2d<f32>;

@fragment
fn resolve(@builtin(position) position: vec4f) -> @location(0) vec4f {
    let pixel = pixel_at(position);
    let background = background_at(pixel);
    let sums = load_sums(accumulation, pixel, params.largest);
    if sums.a <= 0.0 {
        return image_texel(background, 1.0);
    }
    let count = max(load(count_target, pixel).x, 1.0);
    let shares = repeated(min(sums.a / count, 1.0), u32(count));
    // what they cover is at most the sum of alphas: the other way round, bright colours would leave f32
    return image_texel((shares.x / sums.a) * sums.rgb + shares.y * background, shares.y);
}
