// A map of coefficients, four to a texel.

fn coefficient(texel: vec2u, index: u32) -> f32 {
    return map_at(texel, index / 4u)[index % 4u];
}
