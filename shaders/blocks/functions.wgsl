// Functions of a known precision: what devices promise of their own logarithms, sines and powers is less than f32 holds.

const LN_2 = 0.6931472;

// ln(1 + x) for x > -1, to some 2^-23 of it.
fn ln_one_plus(x: f32) -> f32 {
    var exponent = 0.0;
    var y = x;
    if abs(x) > 0.25 {
        // a power of two times something near 1, and what rounding took away
        let sum = two_sum(1.0, x);
        let bits = bitcast<u32>(sum.x);
        let shifted = (bits + 0x004afb0du) & 0xff800000u;
        exponent = f32(i32(shifted >> 23u) - 127);
        y = (bitcast<f32>(bits - (shifted - 0x3f800000u)) - 1.0) + sum.y * bitcast<f32>(0x7f000000u - shifted);
    }
    // 2 atanh(f) with f = y / (2 + y), |f| < 0.18
    let f = y / (2.0 + y);
    let g = f * f;
    let series = 1.0 + g * (1.0 / 3.0 + g * (0.2 + g * (1.0 / 7.0 + g * (1.0 / 9.0 + g * (1.0 / 11.0)))));
    return exponent * LN_2 + 2.0 * f * series;
}

// exp(-x) for x >= 0, to some 2^-22 of it; 0 where it is less than f32 has.
fn exp_minus(x: f32) -> f32 {
    if !(x < 87.0) {
        return 0.0;
    }
    let halvings = round(x / LN_2);
    // ln 2 in two parts, the first of few digits
    let y = (x - halvings * 0.693359375) + halvings * 2.1219444e-4;
    let series = 1.0 - y * (1.0 - y * (1.0 / 2.0) * (1.0 - y * (1.0 / 3.0) * (1.0 - y * (1.0 / 4.0) * (1.0 - y * (1.0 / 5.0) * (1.0 - y * (1.0 / 6.0) * (1.0 - y * (1.0 / 7.0)))))));
    return bitcast<f32>((127u - u32(halvings)) << 23u) * series;
}

// 1 - exp(-x) for x >= 0.
fn one_minus_exp_minus(x: f32) -> f32 {
    if x > 0.35 {
        return 1.0 - exp_minus(x);
    }
    return x * (1.0 - x * (1.0 / 2.0) * (1.0 - x * (1.0 / 3.0) * (1.0 - x * (1.0 / 4.0) * (1.0 - x * (1.0 / 5.0) * (1.0 - x * (1.0 / 6.0) * (1.0 - x * (1.0 / 7.0)))))));
}

// (cos, sin) of so many turns, a sum of two, to some 2^-24.
fn unit_at(turns: vec2f) -> vec2f {
    let part = (turns.x - round(turns.x)) + turns.y;
    let quarters = round(4.0 * part);
    let x = 6.2831855 * (part - 0.25 * quarters);
    let y = x * x;
    let sin_x = x * (1.0 - y * (1.0 / 6.0) * (1.0 - y * (1.0 / 20.0) * (1.0 - y * (1.0 / 42.0) * (1.0 - y * (1.0 / 72.0)))));
    let cos_x = 1.0 - y * (1.0 / 2.0) * (1.0 - y * (1.0 / 12.0) * (1.0 - y * (1.0 / 30.0) * (1.0 - y * (1.0 / 56.0) * (1.0 - y * (1.0 / 90.0)))));
    switch (i32(quarters) + 4) & 3 {
        case 0: {
            return vec2f(cos_x, sin_x);
        }
        case 1: {
            return vec2f(-sin_x, cos_x);
        }
        case 2: {
            return vec2f(-cos_x, -sin_x);
        }
        default: {
            return vec2f(sin_x, -cos_x);
        }
    }
}

// -ln(1 - alpha), at most s_max.
fn absorbance(alpha: f32, s_max: f32) -> f32 {
    if alpha >= 1.0 {
        return s_max;
    }
    return min(-ln_one_plus(-alpha), s_max);
}

// What absorbance lets through; series ring below zero, and nothing brightens.
fn transmittance(tau: f32) -> f32 {
    // a comparison that a number which is none does not pass
    return exp_minus(select(0.0, tau, tau > 0.0));
}

// The angle whose tangent is x, to some 2^-23.
fn arctangent(x: f32) -> f32 {
    let size = abs(x);
    let is_large = size > 1.0;
    let ratio = select(size, 1.0 / size, is_large);
    // half of a right angle, and what is left of at most a quarter
    let is_steep = ratio > 0.41421357;
    let y = select(ratio, (ratio - 1.0) / (ratio + 1.0), is_steep);
    let z = y * y;
    let series = 1.0 - z * (1.0 / 3.0 - z * (0.2 - z * (1.0 / 7.0 - z * (1.0 / 9.0 - z * (1.0 / 11.0 - z * (1.0 / 13.0))))));
    let angle = y * series + select(0.0, 0.7853982, is_steep);
    let whole = select(angle, 1.5707964 - angle, is_large);
    return select(whole, -whole, x < 0.0);
}
