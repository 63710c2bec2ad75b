// Wavelet transparency (Aizenshtein, Smal & McGuire 2022): the absorbance in front of each depth in the Haar basis. The map
// holds the scale, then node k of level p at 2^p + k.

struct Params {
    two_pass: TwoPass,
    levels: u32,
    self_correct: u32,
}

@group(0) @binding(3) var<uniform> params: Params;

struct Term {
    s: f32,
    leaf: u32,
    // how far inside
    fraction: f32,
}

// The position at d = 1 is the near edge of the last leaf.
fn place_of_fragment(fragment: Fragment) -> Cell {
    let last = (1u << params.levels) - 1u;
    return cell_in(interval_at(texel_of(fragment.pixel)), fragment.depth, f32(last), last);
}

fn term_of(fragment: Fragment) -> Term {
    let place = place_of_fragment(fragment);
    return Term(absorbance_of(fragment), place.index, place.fraction);
}

// The level of a node: nodes of level p begin at 2^p.
fn level_of(node: u32) -> u32 {
    return firstLeadingBit(node);
}

// 2^(p / 2).
fn height_of(level: u32) -> f32 {
    return f32(1u << (level / 2u)) * select(1.0, 1.4142136, level % 2u == 1u);
}

fn written(term: Term, index: u32) -> f32 {
    let leaves = f32(1u << params.levels);
    if index == 0u {
        return term.s * (1.0 - (f32(term.leaf) + term.fraction) / leaves);
    }
    if index >= 1u << params.levels {
        return 0.0;
    }
    let level = level_of(index);
    let below = params.levels - level;
    // leaves in front of the node
    let first = (index << below) - (1u << params.levels);
    if term.leaf >> below != first >> below {
        return 0.0;
    }
    let inside = f32(term.leaf - first) + term.fraction;
    return term.s * height_of(level) * (min(inside, f32(1u << below) - inside) / leaves);
}

fn map_texel(term: Term, layer: u32) -> vec4f {
    let first = 4u * layer;
    return vec4f(written(term, first), written(term, first + 1u), written(term, first + 2u), written(term, first + 3u));
}

// The mean of the absorbance over a leaf.
fn leaf_at(texel: vec2u, leaf: u32) -> f32 {
    var value = coefficient(texel, 0u);
    for (var level = 0u; level < params.levels; level++) {
        let below = params.levels - level;
        let half = height_of(level) * coefficient(texel, (1u << level) + (leaf >> below));
        let is_left = (leaf >> (below - 1u) & 1u) == 0u;
        value += select(half, -half, is_left);
    }
    return value;
}

fn in_front_of(fragment: Fragment) -> f32 {
    let texel = texel_of(fragment.pixel);
    let place = place_of_fragment(fragment);
    let f = place.fraction;
    var before = 0.0;
    if place.index > 0u {
        before = leaf_at(texel, place.index - 1u);
    }
    let own = select(0.0, absorbance_of(fragment), params.self_correct != 0u);
    // of its own leaf a step is (1 - f)
    return transmittance((1.0 - f) * before + f * (leaf_at(texel, place.index) - own * (1.0 - f)));
}

fn total_at(texel: vec2u) -> f32 {
    return transmittance(leaf_at(texel, (1u << params.levels) - 1u));
}
