// Depth weights (McGuire & Bavoil 2013, and the I3D 2016 shaders of the phenomenological model): `WEIGHT_FORMULA` says which.

struct Weight {
    k: f32,
    // weights see scale z + shift
    scale: f32,
    shift: f32,
    // near far / (far - near) and 1 / far
    window_scale: f32,
    inverse_far: f32,
    unused_0: u32,
    unused_1: u32,
    unused_2: u32,
}

// 1 - d(z) with d of MB13 eq. 11.
fn one_minus_window_depth(weight: Weight, z: f32) -> f32 {
    return clamp(weight.window_scale * (1.0 / z - weight.inverse_far), 0.0, 1.0);
}

// z^-k; by multiplication where k is a small whole number, since powers are inexact on many devices.
fn inverse_power(z: f32, k: f32) -> f32 {
    if k <= 16.0 && k == floor(k) {
        var power = 1.0;
        for (var i = 0u; i < u32(k); i++) {
            power *= 1.0 / z;
        }
        return power;
    }
    return pow(z, -k);
}

fn limit_mb(x: f32) -> f32 {
    return clamp(x, 1e-2, 3e3);
}

fn formula_of(weight: Weight, z: f32, a: f32) -> f32 {
    // times an inverse, not divided by: the same to an ulp, and much faster where it is the processor that divides
    let far = z * (1.0 / 200.0);
    let far_2 = far * far;
    let far_6 = far_2 * far_2 * far_2;
    switch WEIGHT_FORMULA {
        case 0u: {
            return 1.0;
        }
        // MB13 eq. 7
        case 1u: {
            let x = z * (1.0 / 5.0);
            return a * limit_mb(10.0 / (1e-5 + x * x + far_6));
        }
        // eq. 8
        case 2u: {
            let x = z * (1.0 / 10.0);
            return a * limit_mb(10.0 / (1e-5 + x * x * x + far_6));
        }
        // eq. 9
        case 3u: {
            return a * limit_mb(0.03 / (1e-5 + far_2 * far_2));
        }
        // eq. 10
        case 4u: {
            let near = one_minus_window_depth(weight, z);
            return a * max(3e3 * near * near * near, 1e-2);
        }
        case 5u: {
            return inverse_power(z, weight.k);
        }
        case 6u: {
            return exp(-weight.k * z);
        }
        // figure 1
        case 7u: {
            return 1.0 / ((z + 5.0) * (z + 5.0));
        }
        // figure 6
        case 8u: {
            let x = a / (z * z * z);
            return x * x;
        }
        // figure 10
        case 9u: {
            let x = weight.k * z;
            return 10.0 / (1.0 + 10.0 * x * x * x * x * x);
        }
        // the phenomenological model's
        default: {
            let x = 0.01 + 0.99 * one_minus_window_depth(weight, z);
            return clamp(1e3 * a * x * x * x, 1e-2, 30.0);
        }
    }
}

fn weight_of(weight: Weight, depth: f32, alpha: f32) -> f32 {
    let seen = max(weight.scale * depth + weight.shift, LEAST_DEPTH);
    return clamp(formula_of(weight, seen, alpha), LEAST_WEIGHT, MOST_WEIGHT);
}
