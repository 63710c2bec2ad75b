// Occupancy maps (Sintorn & Assarsson 2009): a bit per depth slice that holds something, and the absorbance of slabs of slices.

struct Params {
    two_pass: TwoPass,
    bits: u32,
    slabs: u32,
}

@group(0) @binding(3) var<uniform> params: Params;

fn word_count() -> u32 {
    return (params.bits + 31u) / 32u;
}

fn bit_of(fragment: Fragment) -> u32 {
    let interval = interval_at(texel_of(fragment.pixel));
    return cell_in(interval, fragment.depth, f32(params.bits), params.bits - 1u).index;
}

// Occupies the fragment's slice, too; once more changes nothing.
fn term_of(fragment: Fragment) -> Term {
    let bit = bit_of(fragment);
    set_bits(texel_of(fragment.pixel), word_count(), bit / 32u, 1u << (bit % 32u));
    return Term(bit / (params.bits / params.slabs), absorbance_of(fragment));
}

// How many slices from `first` up to `end` hold something.
fn occupied(texel: vec2u, first: u32, end: u32) -> f32 {
    var count = 0u;
    for (var word = first / 32u; 32u * word < end; word++) {
        var mask = word_at(texel, word_count(), word);
        if 32u * word < first {
            mask &= 0xffffffffu << (first % 32u);
        }
        if end - 32u * word < 32u {
            mask &= (1u << (end % 32u)) - 1u;
        }
        count += countOneBits(mask);
    }
    return f32(count);
}

// Of the fragment's own slab the share of the slices in front of it, as if all of them absorbed alike.
fn in_front_of(fragment: Fragment) -> f32 {
    let texel = texel_of(fragment.pixel);
    let bit = bit_of(fragment);
    let size = params.bits / params.slabs;
    let slab = bit / size;
    let share = occupied(texel, slab * size, bit) / occupied(texel, slab * size, (slab + 1u) * size);
    return transmittance(tau_at(texel, Cell(slab, share), 0.0));
}

fn total_at(texel: vec2u) -> f32 {
    return transmittance(tau_of_all(texel, params.slabs));
}
