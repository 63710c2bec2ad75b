// Absorbance in bins, four to a texel of the map.

struct Term {
    bin: u32,
    s: f32,
}

const LANES = vec4u(0u, 1u, 2u, 3u);

fn map_texel(term: Term, layer: u32) -> vec4f {
    return select(vec4f(0.0), vec4f(term.s), LANES + 4u * layer == vec4u(term.bin));
}

// What is in front of a place in a bin, if that is filled evenly but for some absorbance of the place's own.
fn tau_at(texel: vec2u, place: Cell, own: f32) -> f32 {
    var before = vec4f(0.0);
    for (var layer = 0u; layer < place.index / 4u; layer++) {
        before += map_at(texel, layer);
    }
    let last = map_at(texel, place.index / 4u);
    before += select(vec4f(0.0), last, LANES < vec4u(place.index % 4u));
    return dot(before, vec4f(1.0)) + place.fraction * (last[place.index % 4u] - own);
}

fn tau_of_all(texel: vec2u, bins: u32) -> f32 {
    var sum = vec4f(0.0);
    for (var layer = 0u; layer < (bins + 3u) / 4u; layer++) {
        sum += map_at(texel, layer);
    }
    return dot(sum, vec4f(1.0));
}
