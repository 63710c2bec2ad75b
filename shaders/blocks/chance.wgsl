// The probability that a random mask shows behind others (W16 section 4), for techniques that keep no masks.
// Of no bits it is certain.

// Eq. 4: that i samples of b are all among o others, o! (b - i)! / (b! (o - i)!). It is the same with b - o in place of i and
// b - i in place of o, so the product has the fewer factors of both.
fn hidden_among(b: u32, o: u32, i: u32) -> f32 {
    let few = min(i, b - o);
    let most = b - max(i, b - o);
    if few > most {
        return 0.0;
    }
    var hidden = 1.0;
    for (var q = 0u; q < few; q++) {
        hidden *= f32(most - q) / f32(b - q);
    }
    return hidden;
}

// x^n by squaring, since powers are inexact on many devices.
fn whole_power(x: f32, n: u32) -> f32 {
    var power = 1.0;
    var square = x;
    for (var rest = n; rest > 0u; rest >>= 1u) {
        if (rest & 1u) != 0u {
            power *= square;
        }
        square *= square;
    }
    return power;
}

// That a fragment is hidden by o samples of others: alpha b samples, between whole numbers of them in proportion.
fn hidden_by(masking: Masking, o: u32, alpha: f32) -> f32 {
    if masking.stratified == 0u {
        return whole_power(1.0 - alpha, masking.bits - o);
    }
    let x = alpha * f32(masking.bits);
    let i = min(u32(x), masking.bits);
    let hidden = hidden_among(masking.bits, o, i);
    if i == masking.bits {
        return hidden;
    }
    return mix(hidden, hidden_among(masking.bits, o, i + 1u), fract(x));
}

// That a fragment shows behind layers that together let `transmittance` through.
fn chance_to_show(masking: Masking, transmittance: f32, alpha: f32) -> f32 {
    if masking.bits == 0u {
        return 1.0;
    }
    let x = (1.0 - transmittance) * f32(masking.bits);
    let o = min(u32(x), masking.bits);
    var hidden = hidden_by(masking, o, alpha);
    if o < masking.bits && fract(x) > 0.0 {
        hidden = mix(hidden, hidden_by(masking, o + 1u, alpha), fract(x));
    }
    return 1.0 - hidden;
}

// Keeps these draws apart from those of masks.
const INSERTION = 0x494e5345u;

fn shows_by_chance(masking: Masking, pixel: vec2u, primitive: u32, transmittance: f32, alpha: f32) -> bool {
    let random = mixed(draws_of(pixel, primitive, masking.seed), INSERTION);
    return happens(random, chance_to_show(masking, transmittance, alpha));
}
