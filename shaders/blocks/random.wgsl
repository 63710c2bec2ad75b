// Random numbers that depend on what is drawn, never on when: a counter-based hash of pixel, primitive, seed and block.

fn mixed(state: u32, word: u32) -> u32 {
    var h = (state ^ word) * 0x9e3779b1u;
    h ^= h >> 16u;
    h *= 0x85ebca6bu;
    h ^= h >> 13u;
    h *= 0xc2b2ae35u;
    return h ^ (h >> 16u);
}

// What the draws of a primitive in a pixel have in common; that of a block is `mixed(draws, block)`. The seed has 64 bits, the
// lower ones first.
fn draws_of(pixel: vec2u, primitive: u32, seed: vec2u) -> u32 {
    let place = mixed(mixed(0x6a09e667u, pixel.x), pixel.y);
    return mixed(mixed(mixed(place, primitive), seed.x), seed.y);
}

// a b in 64 bits, the lower ones first.
fn whole_product(a: u32, b: u32) -> vec2u {
    let a_low = a & 0xffffu;
    let a_high = a >> 16u;
    let b_low = b & 0xffffu;
    let b_high = b >> 16u;
    let low = a_low * b_low;
    let middle = a_high * b_low + (low >> 16u);
    let other = a_low * b_high + (middle & 0xffffu);
    return vec2u((other << 16u) | (low & 0xffffu), a_high * b_high + (middle >> 16u) + (other >> 16u));
}

// A whole number less than `bound`, as even as 32 bits allow.
fn below(bound: u32, random: u32) -> u32 {
    return whole_product(random, bound).y;
}

// A number that is not negative, exactly: what it is beyond a whole number is `fraction` 2^-32 and perhaps a bit more.
struct Fixed {
    whole: u32,
    fraction: u32,
    more: bool,
}

// x n for x in [0, 1], without rounding: of masks the number of samples must not depend on a product's last bit.
fn exactly(x: f32, n: u32) -> Fixed {
    let bits = bitcast<u32>(x);
    let is_normal = bits >= 0x800000u;
    let exponent = max(bits >> 23u, 1u);
    let p = whole_product((bits & 0x7fffffu) | select(0u, 0x800000u, is_normal), n);
    // p 2^(exponent - 150), in units of 2^-32
    if exponent >= 118u {
        let left = exponent - 118u;
        let carried = select(p.x >> (32u - left), 0u, left == 0u);
        return Fixed((p.y << left) | carried, p.x << left, false);
    }
    let right = 118u - exponent;
    if right < 32u {
        let back = 32u - right;
        return Fixed(p.y >> right, (p.x >> right) | (p.y << back), (p.x << back) != 0u);
    }
    if right < 64u {
        let rest = right - 32u;
        let lost = select(p.y << (32u - rest), 0u, rest == 0u);
        return Fixed(0u, p.y >> rest, (p.x | lost) != 0u);
    }
    return Fixed(0u, 0u, any(p != vec2u(0u)));
}

// Whether a random number in [0, 1) is less than what a number is beyond a whole one.
fn is_within_fraction(random: u32, x: Fixed) -> bool {
    return random < x.fraction || (random == x.fraction && x.more);
}

// Whether it is less than p.
fn happens(random: u32, p: f32) -> bool {
    return p >= 1.0 || (p > 0.0 && is_within_fraction(random, exactly(p, 1u)));
}

// How an alpha becomes a random mask.
struct Masking {
    bits: u32,
    // it has alpha times bits samples, up to rounding, rather than each with probability alpha
    stratified: u32,
    seed: vec2u,
}
