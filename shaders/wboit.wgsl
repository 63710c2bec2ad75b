// Weighted blended OIT (McGuire & Bavoil 2013, eq. 6), in the target layouts of its listings.

struct Params {
    weight: Weight,
    // the largest finite numbers of the targets of sums
    largest: f32,
    largest_weights: f32,
    // the sum of weights is clamped as Listing 3 is printed
    listing3_clamp: u32,
}

@group(0) @binding(3) var<uniform> params: Params;

struct Listing3 {
    @location(0) accumulation: vec4f,
    @location(1) revealage: vec4f,
}

fn accumulate_listing3_texels(fragment: Fragment) -> array<vec4f, 2> {
    let weight = weight_of(params.weight, fragment.depth, fragment.alpha);
    return array(weight * vec4f(fragment.color, fragment.alpha), vec4f(fragment.alpha));
}

@fragment
fn accumulate_listing3(placed: Placed) -> Listing3 {
    let texels = accumulate_listing3_texels(fragment_of(placed));
    return Listing3(texels[0], texels[1]);
}

struct Listing4 {
    // (w C, R): the blend unit multiplies R by 1 - alpha
    @location(0) accumulation: vec4f,
    @location(1) weights: vec4f,
}

fn accumulate_listing4_texels(fragment: Fragment) -> array<vec4f, 2> {
    let weight = weight_of(params.weight, fragment.depth, fragment.alpha);
    return array(vec4f(weight * fragment.color, fragment.alpha), vec4f(weight * fragment.alpha));
}

@fragment
fn accumulate_listing4(placed: Placed) -> Listing4 {
    let texels = accumulate_listing4_texels(fragment_of(placed));
    return Listing4(texels[0], texels[1]);
}

// (w luminance, w alpha, 0, R): MB13 section 3.4.
fn accumulate_monochrome_texels(fragment: Fragment) -> array<vec4f, 1> {
    let weight = weight_of(params.weight, fragment.depth, fragment.alpha);
    let luminance = dot(fragment.color, vec3f(0.2126, 0.7152, 0.0722));
    return array(vec4f(weight * luminance, weight * fragment.alpha, 0.0, fragment.alpha));
}

@fragment
fn accumulate_monochrome(placed: Placed) -> @location(0) vec4f {
    return accumulate_monochrome_texels(fragment_of(placed))[0];
}

@group(2) @binding(0) var accumulation: texture_2d<f32>;
// R, or the sum of weighted alphas
@group(2) @binding(1) var second: texture_2d<f32>;

fn covered(pixel: vec2u, color: vec3f, weights: f32, r: f32) -> vec4f {
    var share = 0.0;
    if params.listing3_clamp != 0u {
        share = (1.0 - r) / clamp(weights, 1e-4, 5e4);
    } else if weights > 0.0 {
        share = (1.0 - r) / weights;
    }
    return image_texel(color * share + r * background_at(pixel), r);
}

@fragment
fn resolve_listing3(@builtin(position) position: vec4f) -> @location(0) vec4f {
    let pixel = pixel_at(position);
    let sums = load_sums(accumulation, pixel, params.largest);
    return covered(pixel, sums.rgb, sums.a, load(second, pixel).x);
}

@fragment
fn resolve_listing4(@builtin(position) position: vec4f) -> @location(0) vec4f {
    let pixel = pixel_at(position);
    let texel = load(accumulation, pixel);
    let weights = min(load(second, pixel).x, params.largest_weights);
    return covered(pixel, min(texel.rgb, vec3f(params.largest)), weights, texel.a);
}

@fragment
fn resolve_monochrome(@builtin(position) position: vec4f) -> @location(0) vec4f {
    let pixel = pixel_at(position);
    let texel = load(accumulation, pixel);
    let sums = min(texel.xy, vec2f(params.largest));
    return covered(pixel, vec3f(sums.x), sums.y, texel.a);
}
