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

// What no pixel is, in place of one that was not finished; whoever reads the image back looks for it.
const UNFINISHED = vec4f(-LARGEST);

fn store(id: vec3u, color: vec3f, transmittance: f32) {
    let texel = vec4f(finite(color), transmittance);
    resolved[id.y * frame.size.x + id.x] = select(texel, UNFINISHED, is_cut_short());
}

// The same where the background's share is one per channel.
fn store_colored(id: vec3u, color: vec3f, transmittance: vec3f) {
    let place = 2u * (id.y * frame.size.x + id.x);
    resolved[place] = vec4f(finite(color), 0.0);
    resolved[place + 1u] = select(vec4f(transmittance, 0.0), UNFINISHED, is_cut_short());
}
