// Multi-layer coverage blending (Wyman 2016, section 5): multi-layer alpha blending with masks of samples for opacity.

struct Params {
    masking: Masking,
    backwards: u32,
    // steps of an alpha, where layers keep alphas of few bits (section 5.4)
    levels: u32,
}

@group(0) @binding(3) var<uniform> params: Params;

// the layers, nearest first: their places, their colours, not premultiplied, and the words of their masks of samples, one
// mask after the other; no sample is in two masks
var<private> layer_keys: array<vec2u, LAYERS + 1u>;
var<private> layer_colors: array<vec3f, LAYERS + 1u>;
var<private> layer_words: array<u32, (LAYERS + 1u) * MASK_WORDS>;
var<private> layer_count: u32;

fn samples_of(i: u32) -> f32 {
    var count = 0u;
    for (var w = 0u; w < words_of(params.masking); w++) {
        count += countOneBits(layer_words[i * MASK_WORDS + w]);
    }
    return f32(count);
}

fn move_layer(to: u32, origin: u32) {
    layer_keys[to] = layer_keys[origin];
    layer_colors[to] = layer_colors[origin];
    for (var w = 0u; w < words_of(params.masking); w++) {
        layer_words[to * MASK_WORDS + w] = layer_words[origin * MASK_WORDS + w];
    }
}

// Inserts the mask that was drawn: a fragment covers what nothing in front of it does, and takes that from what is behind
// (eq. 11 and its other half).
fn insert_layer(key: vec2u, color: vec3f) {
    var place = layer_count;
    while place > 0u && comes_before_by_depth(key, layer_keys[place - 1u]) {
        move_layer(place, place - 1u);
        place--;
    }
    layer_keys[place] = key;
    layer_colors[place] = color;
    layer_count++;
    for (var w = 0u; w < words_of(params.masking); w++) {
        var word = drawn[w];
        for (var i = 0u; i < place; i++) {
            word &= ~layer_words[i * MASK_WORDS + w];
        }
        layer_words[place * MASK_WORDS + w] = word;
        for (var i = place + 1u; i < layer_count; i++) {
            layer_words[i * MASK_WORDS + w] &= ~word;
        }
    }
}

// The two furthest layers become one; their colours weigh as much as their samples (eq. 12 and 13).
fn merge_furthest_layers() {
    layer_count--;
    let near = layer_count - 1u;
    let far = layer_count;
    let samples = vec2f(samples_of(near), samples_of(far));
    let sum = samples.x + samples.y;
    if sum == 0.0 {
        return;
    }
    let color = samples.x / sum * layer_colors[near] + samples.y / sum * layer_colors[far];
    layer_colors[near] = min(color, vec3f(LARGEST));
    for (var w = 0u; w < words_of(params.masking); w++) {
        layer_words[near * MASK_WORDS + w] |= layer_words[far * MASK_WORDS + w];
    }
}

@compute @workgroup_size(8, 8)
fn resolve_masks(@builtin(global_invocation_id) id: vec3u) {
    if is_outside(id) {
        return;
    }
    let pixel = pixel_of(id);
    let list = list_of(pixel);
    layer_count = 0u;
    for (var i = 0u; i < list.y; i++) {
        let place = place_in(list, i, params.backwards);
        // what covers nothing has no colour of its own
        if colors[place].a == 0.0 {
            continue;
        }
        draw_mask(params.masking, pixel, keys[place].y, colors[place].a);
        insert_layer(keys[place], unmultiplied(colors[place]));
        if layer_count > LAYERS {
            merge_furthest_layers();
        }
    }
    // eq. 15
    let all = f32(params.masking.bits);
    var color = vec3f(0.0);
    var open = all;
    for (var i = 0u; i < layer_count; i++) {
        let samples = samples_of(i);
        color += samples / all * layer_colors[i];
        open -= samples;
    }
    store(id, color + open / all * background_at(pixel), open / all);
}

// The fragment with its alpha in steps, rounded at random.
fn in_steps(pixel: vec2u, primitive: u32, fragment: vec4f) -> vec4f {
    let random = mixed(draws_of(pixel, primitive, params.masking.seed), ROUNDING);
    let exact = exactly(fragment.a, params.levels);
    let steps = exact.whole + u32(is_within_fraction(random, exact));
    let alpha = f32(steps) / f32(params.levels);
    return vec4f(alpha * unmultiplied(fragment), alpha);
}

@compute @workgroup_size(8, 8)
fn resolve_alphas(@builtin(global_invocation_id) id: vec3u) {
    if is_outside(id) {
        return;
    }
    let pixel = pixel_of(id);
    let list = list_of(pixel);
    node_count = 0u;
    for (var i = 0u; i < list.y; i++) {
        let place = place_in(list, i, params.backwards);
        if colors[place].a == 0.0 {
            continue;
        }
        insert_node(keys[place], in_steps(pixel, keys[place].y, colors[place]));
        if node_count > LAYERS {
            merge_furthest();
        }
    }
    let all = composite_nodes(CLEAR);
    store(id, all.color + all.transmittance * background_at(pixel), all.transmittance);
}
