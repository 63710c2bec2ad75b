// Alpha compositing (Porter & Duff 1984): the blend unit does it all.

// With the background's share in the alpha channel, and the background added afterwards.
fn composite_texels(fragment: Fragment) -> array<vec4f, 1> {
    return array(vec4f(fragment.color, fragment.alpha));
}

@fragment
fn composite(placed: Placed) -> @location(0) vec4f {
    return composite_texels(fragment_of(placed))[0];
}

struct Framebuffer {
    @location(0) color: vec4f,
    @location(1) transmittance: vec4f,
}

// Over the background, which the framebuffer holds already.
@fragment
fn composite_over_background(placed: Placed) -> Framebuffer {
    let fragment = fragment_of(placed);
    return Framebuffer(vec4f(fragment.color, fragment.alpha), vec4f(fragment.alpha));
}

@group(2) @binding(0) var color_target: texture_2d<f32>;
@group(2) @binding(1) var transmittance_target: texture_2d<f32>;

@fragment
fn add_background(@builtin(position) position: vec4f) -> @location(0) vec4f {
    let pixel = pixel_at(position);
    let target_ = load(color_target, pixel);
    return image_texel(min(target_.rgb, vec3f(LARGEST)) + target_.a * background_at(pixel), target_.a);
}

@fragment
fn read_framebuffer(@builtin(position) position: vec4f) -> @location(0) vec4f {
    let pixel = pixel_at(position);
    return image_texel(load(color_target, pixel).rgb, load(transmittance_target, pixel).x);
}
