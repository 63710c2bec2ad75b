// Blended OIT (McGuire & Bavoil 2013, eq. 5): the average colour at the exact coverage.

struct Targets {
    @location(0) accumulation: vec4f,
    @location(1) revealage: vec4f,
}

fn accumulate_texels(fragment: Fragment) -> array<vec4f, 2> {
    return array(vec4f(fragment.color, fragment.alpha), vec4f(fragment.alpha));
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
@group(2) @binding(1) var revealage: texture_2d<f32>;

@fragment
fn resolve(@builtin(position) position: vec4f) -> @location(0) vec4f {
    let pixel = pixel_at(position);
    let sums = load_sums(accumulation, pixel, params.largest);
    let r = load(revealage, pixel).x;
    let average = select(vec3f(0.0), sums.rgb * ((1.0 - r) / sums.a), sums.a > 0.0);
    return image_texel(average + r * background_at(pixel), r);
}
