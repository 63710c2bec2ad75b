// Stochastic layered alpha blending (Wyman 2016, section 4): the k nearest of the fragments that a random mask would show.
// Fragments come front to back, so that what is stored stays, and what is in front of a fragment is what was stored before it.

struct Params {
    masking: Masking,
    layers: u32,
    // a layer keeps its mask, rather than its alpha
    keeps_masks: u32,
    // 0: the layers' own colours; 1: all fragments, as far as the layers let them be seen; 2: the layers' colours, and behind
    // them the average of all others
    accumulate: u32,
    composite: u32,
}

@group(0) @binding(3) var<uniform> params: Params;

// the layers so far, their colour, and what they let through
var<private> stored: u32;
var<private> color: vec3f;
var<private> shown: f32;
// samples that no layer covers
var<private> open: u32;
// of what is not stored, or of all fragments
var<private> sums: Sums;

fn store_mask(fragment: Fragment) -> bool {
    draw_mask(params.masking, fragment.pixel, fragment.primitive, fragment.alpha);
    let visible = count_visible();
    if fragment.alpha <= 0.0 || visible == 0u {
        return false;
    }
    cover_drawn();
    open -= visible;
    let bits = f32(params.masking.bits);
    color += f32(visible) / bits * unmultiplied(rgba(fragment));
    shown = f32(open) / bits;
    return true;
}

fn store_alpha(fragment: Fragment) -> bool {
    if !shows_by_chance(params.masking, fragment.pixel, fragment.primitive, shown, fragment.alpha) {
        return false;
    }
    color += shown * fragment.color;
    shown *= 1.0 - fragment.alpha;
    return true;
}

// Whether a fragment becomes a layer.
fn store_layer(fragment: Fragment) -> bool {
    if stored >= params.layers {
        return false;
    }
    if params.keeps_masks != 0u {
        return store_mask(fragment);
    }
    return store_alpha(fragment);
}

fn begin(pixel: vec2u) {
    stored = 0u;
    color = vec3f(0.0);
    shown = 1.0;
    open = params.masking.bits;
    covered = Mask();
    sums = NO_SUMS;
}

fn take(fragment: Fragment) {
    let seen = shown;
    let is_stored = store_layer(fragment);
    stored += u32(is_stored);
    if params.accumulate == 1u {
        sums = with_fragment(sums, weight_seen(params.composite, seen), rgba(fragment));
    } else if !is_stored {
        sums = with_fragment(sums, 1.0, rgba(fragment));
    }
    is_done = stored >= params.layers && params.accumulate == 0u;
}

fn finish(id: vec3u) {
    let background = background_at(pixel_of(id));
    if params.accumulate == 1u {
        let all = composite_sums(params.composite, sums, shown, background);
        store(id, all.rgb, all.a);
        return;
    }
    var behind = vec4f(background, 1.0);
    if params.accumulate == 2u {
        behind = over_background(sums, background);
    }
    store(id, color + shown * behind.rgb, shown * behind.a);
}
