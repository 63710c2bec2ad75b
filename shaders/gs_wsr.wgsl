// Weighted sum rendering (Hou et al. 2025): the average of all fragments and of the background, weighted by depth. The blend
// unit adds up; where a weight depends on the mean depth of its pixel, lists are walked twice.

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
        return min(whole_power(z, u32(gamma)), LARGEST);
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

fn store_average(id: vec3u, sums: vec4f) {
    let background = background_at(pixel_of(id));
    let total = min(params.background_weight + sums.a, LARGEST);
    if total == 0.0 {
        store(id, background, 1.0);
        return;
    }
    let share = params.background_weight / total;
    store(id, sums.rgb / total + share * background, share);
}

@fragment
fn accumulate(placed: Placed) -> @location(0) vec4f {
    let fragment = fragment_of(placed);
    return weight_at(fragment.depth, params.sigma) * vec4f(fragment.color, fragment.alpha);
}

@group(2) @binding(0) var accumulation: texture_2d<f32>;

@compute @workgroup_size(8, 8)
fn resolve(@builtin(global_invocation_id) id: vec3u) {
    if is_outside(id) {
        return;
    }
    store_average(id, min(textureLoad(accumulation, pixel_of(id), 0), vec4f(params.largest)));
}

// With twice the mean depth of the pixel for sigma.
@compute @workgroup_size(8, 8)
fn resolve_lists(@builtin(global_invocation_id) id: vec3u) {
    if is_outside(id) {
        return;
    }
    let list = list_of(pixel_of(id));
    var count = 0.0;
    var depths = 0.0;
    for (var place = list.x; place < list.x + list.y; place++) {
        if any(colors[place] != vec4f(0.0)) {
            count += 1.0;
            depths += bitcast<f32>(keys[place].x);
        }
    }
    let sigma = 2.0 * (depths / max(count, 1.0));
    var sums = vec4f(0.0);
    for (var place = list.x; place < list.x + list.y; place++) {
        sums += weight_at(bitcast<f32>(keys[place].x), sigma) * colors[place];
    }
    store_average(id, min(sums, vec4f(LARGEST)));
}
