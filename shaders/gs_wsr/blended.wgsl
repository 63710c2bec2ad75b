
// The blend unit adds up.

fn accumulate_texels(fragment: Fragment) -> array<vec4f, 1> {
    return array<vec4f, 1>(weight_at(fragment.depth, params.sigma) * rgba(fragment));
}

@fragment
fn accumulate(placed: Placed) -> @location(0) vec4f {
    return accumulate_texels(fragment_of(placed))[0];
}

@group(2) @binding(0) var accumulation: texture_2d<f32>;

@compute @workgroup_size(8, 8)
fn resolve(@builtin(global_invocation_id) id: vec3u) {
    if is_outside(id) {
        return;
    }
    store_average(id, min(textureLoad(accumulation, texel_of(pixel_of(id)), 0), vec4f(params.largest)));
}
