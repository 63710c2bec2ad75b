// Fourier opacity maps (Jansen & Bavoil 2010): absorbance along the ray as a Fourier series. The map holds half of a_0, then
// halves of a_k and b_k one after the other.

struct Params {
    two_pass: TwoPass,
    // what is left free at either end of the period, and what that leaves, each a sum of two
    margin: vec2f,
    scale: vec2f,
    frequencies: u32,
    self_correct: u32,
    lanczos: u32,
    unused: u32,
}

@group(0) @binding(3) var<uniform> params: Params;

const PI = 3.1415927;

struct Term {
    s: f32,
    // in periods
    d: vec2f,
}

fn phase_of(fragment: Fragment) -> vec2f {
    let position = position_in(interval_at(texel_of(fragment.pixel)), fragment.depth);
    return sum_of(params.margin, product_of(params.scale, position));
}

fn term_of(fragment: Fragment) -> Term {
    return Term(absorbance_of(fragment), phase_of(fragment));
}

// (b_k, a_k+1, b_k+1, a_k+2) for an even k.
fn map_texel(term: Term, layer: u32) -> vec4f {
    let k = f32(2u * layer);
    let a = unit_at(times(term.d, k));
    let b = unit_at(times(term.d, k + 1.0));
    let c = unit_at(times(term.d, k + 2.0));
    return term.s * vec4f(select(a.y, 1.0, layer == 0u), b, c.x);
}

// What integration makes of a term, s_k / (pi k).
fn weight_of_term(k: f32) -> f32 {
    let x = k / (f32(params.frequencies) + 1.0);
    let sigma = select(1.0, unit_at(vec2f(0.5 * x, 0.0)).y / (PI * x), params.lanczos != 0u);
    return sigma / (PI * k);
}

fn in_front_of(fragment: Fragment) -> f32 {
    let texel = texel_of(fragment.pixel);
    let d = phase_of(fragment);
    let own = select(0.0, absorbance_of(fragment), params.self_correct != 0u);
    var tau = (coefficient(texel, 0u) - own) * d.x;
    for (var k = 1u; k <= params.frequencies; k++) {
        let unit = unit_at(times(d, f32(k)));
        let a = coefficient(texel, 2u * k - 1u) - own;
        let b = coefficient(texel, 2u * k);
        tau += weight_of_term(f32(k)) * (a * unit.y + b * (1.0 - unit.x));
    }
    return transmittance(tau);
}

fn total_at(texel: vec2u) -> f32 {
    return transmittance(coefficient(texel, 0u));
}
