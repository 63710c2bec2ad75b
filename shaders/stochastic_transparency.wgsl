// Stochastic transparency (Enderton et al. 2010): every fragment covers a random mask of a pixel's samples, each of which keeps
// the nearest fragment that covers it. Fragments come nearest first, so these are the samples of a mask that are still open.

struct Params {
    masking: Masking,
    // the exact coverage of all fragments, rather than that of the samples
    corrected: u32,
    // samples keep depths: a fragment is seen as far as samples in front of it are open; or else they keep colours
    keeps_depths: u32,
    // of the form by sample masks
    window_exponent: u32,
}

@group(0) @binding(3) var<uniform> params: Params;

// samples that nothing covers
var<private> open: u32;
// the samples' colours
var<private> color: vec3f;
// of all fragments, as far as they are seen where samples keep depths
var<private> sums: Sums;

// How many of the open samples a fragment takes.
fn take_samples(fragment: Fragment) -> u32 {
    if open == 0u || fragment.alpha <= 0.0 {
        return 0u;
    }
    draw_mask(params.masking, fragment.pixel, fragment.primitive, fragment.alpha);
    let visible = count_visible();
    cover_drawn();
    open -= visible;
    return visible;
}

fn share_of(samples: u32) -> f32 {
    return f32(samples) / f32(params.masking.bits);
}

fn composite_kind() -> u32 {
    return select(EXACT_BACKGROUND, NORMALIZED, params.corrected != 0u);
}

fn begin(pixel: vec2u) {
    covered = Mask();
    open = params.masking.bits;
    color = vec3f(0.0);
    sums = NO_SUMS;
}

fn take(fragment: Fragment) {
    if params.keeps_depths != 0u {
        sums = with_fragment(sums, weight_seen(composite_kind(), share_of(open)), rgba(fragment));
        take_samples(fragment);
        return;
    }
    sums = with_fragment(sums, 1.0, rgba(fragment));
    let visible = take_samples(fragment);
    if visible > 0u {
        color += share_of(visible) * unmultiplied(rgba(fragment));
    }
    is_done = open == 0u && params.corrected == 0u;
}

fn finish(id: vec3u) {
    let background = background_at(pixel_of(id));
    if params.keeps_depths != 0u {
        let all = composite_sums(composite_kind(), sums, share_of(open), background);
        store(id, all.rgb, all.a);
    } else if params.corrected == 0u {
        store(id, color + share_of(open) * background, share_of(open));
    } else {
        // where no sample is covered, the layers' share stays black
        let average = average_of(vec4f(color, share_of(params.masking.bits - open)));
        store(id, sums.coverage * average + sums.transmittance * background, sums.transmittance);
    }
}
