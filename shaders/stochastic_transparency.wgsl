// Stochastic transparency (Enderton et al. 2010): every fragment covers a random mask of a pixel's samples, each of which keeps
// the nearest fragment that covers it. Front to back these are the samples of a mask that are still open.

struct Params {
    masking: Masking,
    // the exact coverage of all fragments, rather than that of the samples
    corrected: u32,
}

@group(0) @binding(3) var<uniform> params: Params;

// How many of the open samples a fragment takes.
fn take_samples(pixel: vec2u, place: u32) -> u32 {
    draw_mask(params.masking, pixel, keys[place].y, colors[place].a);
    let visible = count_visible();
    cover_drawn();
    return visible;
}

fn share_of(samples: u32) -> f32 {
    return f32(samples) / f32(params.masking.bits);
}

// Samples keep colours: over a list that is sorted already.
@compute @workgroup_size(8, 8)
fn resolve_colors(@builtin(global_invocation_id) id: vec3u) {
    if is_outside(id) {
        return;
    }
    let pixel = pixel_of(id);
    let list = list_of(pixel);
    covered = Mask();
    var open = params.masking.bits;
    var color = vec3f(0.0);
    var net = NO_SUMS;
    for (var place = list.x; place < list.x + list.y; place++) {
        let fragment = colors[place];
        net = with_fragment(net, 1.0, fragment);
        if open > 0u && fragment.a > 0.0 {
            let visible = take_samples(pixel, place);
            open -= visible;
            color += share_of(visible) * unmultiplied(fragment);
        }
    }
    let background = background_at(pixel);
    if params.corrected == 0u {
        store(id, color + share_of(open) * background, share_of(open));
        return;
    }
    // where no sample is covered, the layers' share stays black
    let average = average_of(vec4f(color, share_of(params.masking.bits - open)));
    store(id, net.coverage * average + net.transmittance * background, net.transmittance);
}

// Samples keep depths: a fragment is seen as far as samples in front of it are open.
@compute @workgroup_size(8, 8)
fn resolve_depths(@builtin(global_invocation_id) id: vec3u) {
    if is_outside(id) {
        return;
    }
    let pixel = pixel_of(id);
    let list = list_of(pixel);
    let composite = select(EXACT_BACKGROUND, NORMALIZED, params.corrected != 0u);
    covered = Mask();
    var open = params.masking.bits;
    var sums = NO_SUMS;
    for (var place = list.x; place < list.x + list.y; place++) {
        let fragment = colors[place];
        sums = with_fragment(sums, weight_seen(composite, share_of(open)), fragment);
        if open > 0u && fragment.a > 0.0 {
            open -= take_samples(pixel, place);
        }
    }
    let all = composite_sums(composite, sums, share_of(open), background_at(pixel));
    store(id, all.rgb, all.a);
}
