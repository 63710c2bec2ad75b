// The two-pass template in registers: walks over a pixel's fragments. FINDS_BOUNDS, MAP_LAYERS, HAS_TOTAL, which says
// that something follows them, and MAP_WORDS are constants that the form sets.

// (-nearest, farthest)
var<private> bounds_at_hand: vec2f;
var<private> map_at_hand: array<vec4f, MAP_LAYERS>;
var<private> total_at_hand: f32;
var<private> words_at_hand: array<u32, MAP_WORDS>;
var<private> sums_at_hand: vec4f;
var<private> share_at_hand: f32;

fn bounds_texel(texel: vec2u) -> vec2f {
    return bounds_at_hand;
}

fn map_sums(texel: vec2u, layer: u32) -> vec4f {
    return map_at_hand[layer];
}

fn total_sum(texel: vec2u) -> f32 {
    return total_at_hand;
}

fn word_at(texel: vec2u, count: u32, at: u32) -> u32 {
    return words_at_hand[at];
}

fn set_bits(texel: vec2u, count: u32, at: u32, bits: u32) {
    words_at_hand[at] |= bits;
}

fn begin(pixel: vec2u) {
    bounds_at_hand = vec2f(-LARGEST);
    map_at_hand = array<vec4f, MAP_LAYERS>();
    total_at_hand = 0.0;
    words_at_hand = array<u32, MAP_WORDS>();
    sums_at_hand = vec4f(0.0);
    share_at_hand = 1.0;
}

fn add_to_map_at_hand(fragment: Fragment) {
    let term = term_of(fragment);
    for (var layer = 0u; layer < MAP_LAYERS; layer++) {
        map_at_hand[layer] += map_texel(term, layer);
    }
    if HAS_TOTAL != 0u {
        total_at_hand += map_texel(term, MAP_LAYERS).x;
    }
}

fn take(fragment: Fragment) {
    if walk < FINDS_BOUNDS {
        bounds_at_hand = max(bounds_at_hand, vec2f(-fragment.depth, fragment.depth));
    } else if walk == FINDS_BOUNDS {
        add_to_map_at_hand(fragment);
    } else {
        sums_at_hand += weighted(fragment);
        share_at_hand *= 1.0 - fragment.alpha;
    }
}

fn again() -> bool {
    return walk <= FINDS_BOUNDS;
}

fn finish(id: vec3u) {
    let all = composited(pixel_of(id), sums_at_hand, share_at_hand);
    store(id, all.rgb, all.a);
}
