// Deep opacity maps (Yuksel & Keyser 2008): opacity layers that begin at each pixel's first surface.

struct Params {
    two_pass: TwoPass,
    layers: u32,
    // each layer is twice as deep as the one in front of it
    doubling: u32,
    self_correct: u32,
    unused: u32,
}

@group(0) @binding(3) var<uniform> params: Params;

fn place_of_fragment(fragment: Fragment) -> Cell {
    let bounds = bounds_at(texel_of(fragment.pixel));
    var extent = length_of(interval_at(texel_of(fragment.pixel)));
    if extent.x <= 0.0 {
        extent = vec2f(1.0, 0.0);
    }
    let behind = Interval(bounds.near, sum_of(bounds.near, extent));
    if params.doubling == 0u {
        return cell_in(behind, fragment.depth, f32(params.layers), params.layers - 1u);
    }
    return doubling_layer(position_in(behind, fragment.depth));
}

// Of L layers boundary k is at (2^k - 1) / (2^L - 1): 1 + x (2^L - 1) is between 2^k and 2^(k + 1) in layer k.
fn doubling_layer(x: vec2f) -> Cell {
    let largest = bitcast<f32>((params.layers + 127u) << 23u);
    let scaled = vec2f(largest * x.x, largest * x.y);
    let value = sum_of(vec2f(1.0, 0.0), sum_of(scaled, -x));
    var layer = (bitcast<u32>(value.x) >> 23u) - 127u;
    if is_less(value, vec2f(bitcast<f32>((layer + 127u) << 23u), 0.0)) {
        layer -= 1u;
    }
    layer = min(layer, params.layers - 1u);
    let width = bitcast<f32>((layer + 127u) << 23u);
    return Cell(layer, clamp(sum_of(value, vec2f(-width, 0.0)).x / width, 0.0, 1.0));
}

fn term_of(fragment: Fragment) -> Term {
    return Term(place_of_fragment(fragment).index, absorbance_of(fragment));
}

fn in_front_of(fragment: Fragment) -> f32 {
    let own = select(0.0, absorbance_of(fragment), params.self_correct != 0u);
    return transmittance(tau_at(texel_of(fragment.pixel), place_of_fragment(fragment), own));
}

fn total_at(texel: vec2u) -> f32 {
    return transmittance(tau_of_all(texel, params.layers));
}
