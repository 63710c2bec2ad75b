// Opacity shadow maps (Kim & Neumann 2001): absorbance in bins of a depth range.

struct Params {
    two_pass: TwoPass,
    bins: u32,
    // what of its own bin hides a fragment: 0 nothing, 1 what is in front of it, 2 the same but for its own share
    interpolation: u32,
}

@group(0) @binding(3) var<uniform> params: Params;

fn place_of_fragment(fragment: Fragment) -> Cell {
    let interval = interval_at(texel_of(fragment.pixel));
    return cell_in(interval, fragment.depth, f32(params.bins), params.bins - 1u);
}

fn term_of(fragment: Fragment) -> Term {
    return Term(place_of_fragment(fragment).index, absorbance_of(fragment));
}

fn in_front_of(fragment: Fragment) -> f32 {
    var place = place_of_fragment(fragment);
    if params.interpolation == 0u {
        place.fraction = 0.0;
    }
    let own = select(0.0, absorbance_of(fragment), params.interpolation == 2u);
    return transmittance(tau_at(texel_of(fragment.pixel), place, own));
}

fn total_at(texel: vec2u) -> f32 {
    return transmittance(tau_of_all(texel, params.bins));
}
