// A weight of the user's own, in the place of weight.wgsl: `own_value`, `own_is_lost` and `own_UNIFORMS` come with it.

struct Weight {
    // weights see scale z + shift
    scale: f32,
    shift: f32,
    // near far / (far - near) and 1 / far
    window_scale: f32,
    inverse_far: f32,
    uniforms: array<vec4f, own_UNIFORMS>,
}

fn weight_of(weight: Weight, depth: f32, alpha: f32) -> f32 {
    let z = max(weight.scale * depth + weight.shift, LEAST_DEPTH);
    let d = 1.0 - clamp(weight.window_scale * (1.0 / z - weight.inverse_far), 0.0, 1.0);
    let w = own_value(weight, z, alpha, d);
    // by its bits, since compilers may assume that there is no NaN: 0, negative, infinite or none
    let bits = bitcast<u32>(w);
    if own_is_lost() || bits == 0u || bits >= 0x7f800000u {
        report_invalid();
        return LEAST_WEIGHT;
    }
    return clamp(w, LEAST_WEIGHT, MOST_WEIGHT);
}
