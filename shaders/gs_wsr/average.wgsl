// Weighted sum rendering (Hou et al. 2025): the average of all fragments and of the background, weighted by depth. This part
// has the weights and the average; beside it is a part for the blend unit, and one for walks.

struct Params {
    // 0: every fragment weighs 1; 1: exp(-sigma z^gamma); 2: max(0, 1 - z / sigma) gain
    variant: u32,
    sigma: f32,
    gamma: f32,
    gain: f32,
    background_weight: f32,
    // the accumulation's largest finite number
    largest: f32,
}

@group(0) @binding(3) var<uniform> params: Params;

const MOST = 1e30;

// z^gamma; by multiplication where gamma is a small whole number, since powers are inexact on many devices.
fn power_of_depth(z: f32) -> f32 {
    let gamma = params.gamma;
    if z <= 0.0 {
        return 0.0;
    }
    if gamma <= 16.0 && gamma == floor(gamma) {
        var power = 1.0;
        for (var i = 0u; i < u32(gamma); i++) {
            power *= z;
        }
        return min(power, LARGEST);
    }
    return min(pow(z, gamma), LARGEST);
}

fn weight_at(z: f32, sigma: f32) -> f32 {
    switch params.variant {
        case 0u: {
            return 1.0;
        }
        case 1u: {
            return exp(-sigma * power_of_depth(z));
        }
        default: {
            // where every depth is 0, so is their mean
            if sigma == 0.0 {
                return min(params.gain, MOST);
            }
            return min(max(0.0, 1.0 - z / sigma) * params.gain, MOST);
        }
    }
}

// The average, and the background's share of it.
fn average_at(pixel: vec2u, sums: vec4f) -> vec4f {
    let background = background_at(pixel);
    let total = min(params.background_weight + sums.a, LARGEST);
    if total == 0.0 {
        return vec4f(background, 1.0);
    }
    let share = params.background_weight / total;
    return vec4f(sums.rgb / total + share * background, share);
}
