// Extinction transmittance maps (Gautron et al. 2011): a cosine series of extinction. The map holds c_0, then halves of c_k.

struct Params {
    two_pass: TwoPass,
    frequencies: u32,
    self_correct: u32,
}

@group(0) @binding(3) var<uniform> params: Params;

const PI = 3.1415927;

struct Term {
    s: f32,
    d: vec2f,
}

fn place_of_fragment(fragment: Fragment) -> vec2f {
    return position_in(interval_at(texel_of(fragment.pixel)), fragment.depth);
}

// (cos, sin) of pi k d.
fn half_turns(d: vec2f, k: f32) -> vec2f {
    return unit_at(times(0.5 * d, k));
}

fn term_of(fragment: Fragment) -> Term {
    return Term(absorbance_of(fragment), place_of_fragment(fragment));
}

fn map_texel(term: Term, layer: u32) -> vec4f {
    let k = f32(4u * layer);
    return term.s * vec4f(
        half_turns(term.d, k).x,
        half_turns(term.d, k + 1.0).x,
        half_turns(term.d, k + 2.0).x,
        half_turns(term.d, k + 3.0).x,
    );
}

fn in_front_of(fragment: Fragment) -> f32 {
    let texel = texel_of(fragment.pixel);
    let d = place_of_fragment(fragment);
    let own = select(0.0, absorbance_of(fragment), params.self_correct != 0u);
    var tau = (coefficient(texel, 0u) - own) * d.x;
    for (var k = 1u; k <= params.frequencies; k++) {
        let unit = half_turns(d, f32(k));
        // half of a step's own c_k is the cosine at its place
        let c = coefficient(texel, k) - own * unit.x;
        tau += 2.0 * c * unit.y / (PI * f32(k));
    }
    return transmittance(tau);
}

fn total_at(texel: vec2u) -> f32 {
    return transmittance(coefficient(texel, 0u));
}
