// From what a technique stored to pixels of the image.

// (colour, the background's share) of each pixel of the rows at hand, or colour and share one after the other
@group(3) @binding(0) var<storage, read_write> resolved: array<vec4f>;

// The pixel of an invocation; none where there is none left.
fn is_outside(id: vec3u) -> bool {
    return id.x >= frame.size.x || id.y >= frame.rows;
}

fn pixel_of(id: vec3u) -> vec2u {
    return vec2u(id.x, frame.first_row + id.y);
}

fn finite(x: vec3f) -> vec3f {
    return clamp(x, vec3f(-LARGEST), vec3f(LARGEST));
}

// What a render target has of a pixel, ...
fn load(from_target: texture_2d<f32>, pixel: vec2u) -> vec4f {
    return textureLoad(from_target, texel_of(pixel), 0);
}

// ... and sums, of which some may be more than its format's largest finite number.
fn load_sums(from_target: texture_2d<f32>, pixel: vec2u, largest: f32) -> vec4f {
    return min(load(from_target, pixel), vec4f(largest));
}

// A pixel as a pass over render targets gives it. Its loops are over layers, few enough for any driver.
fn image_texel(color: vec3f, transmittance: f32) -> vec4f {
    return vec4f(finite(color), transmittance);
}

// The same where the background's share is one per channel.
struct ImageTexels {
    @location(0) color: vec4f,
    @location(1) transmittance: vec4f,
}

fn image_texels(color: vec3f, transmittance: vec3f) -> ImageTexels {
    return ImageTexels(vec4f(finite(color), 0.0), vec4f(transmittance, 0.0));
}

// What no pixel is, in place of one that was not finished; whoever reads the image back looks for it.
const UNFINISHED = vec4f(-LARGEST);

// A pixel as an invocation of a compute shader writes it.
fn store(id: vec3u, color: vec3f, transmittance: f32) {
    resolved[id.y * frame.size.x + id.x] = select(image_texel(color, transmittance), UNFINISHED, is_cut_short());
}
