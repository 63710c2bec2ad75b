// Puts the background into a render target.

@vertex
fn cover_all(@builtin(vertex_index) index: u32) -> @builtin(position) vec4f {
    return vec4f(f32(index & 1u) * 4.0 - 1.0, f32(index >> 1u) * 4.0 - 1.0, 0.5, 1.0);
}

@fragment
fn show_background(@builtin(position) position: vec4f) -> @location(0) vec4f {
    return vec4f(background_at(pixel_at(position)), 1.0);
}
