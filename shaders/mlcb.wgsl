// Multi-layer coverage blending (Wyman 2016, section 5): multi-layer alpha blending with masks of samples for opacity.

struct Params {
    masking: Masking,
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

// The fragment with its alpha in steps, rounded at random.
fn in_steps(fragment: Fragment) -> vec4f {
    let random = mixed(draws_of(fragment.pixel, fragment.primitive, params.masking.seed), ROUNDING);
    let exact = exactly(fragment.alpha, params.levels);
    let steps = exact.whole + u32(is_within_fraction(random, exact));
    let alpha = f32(steps) / f32(params.levels);
    return vec4f(alpha * unmultiplied(rgba(fragment)), alpha);
}

// KEEPS_ALPHAS is a constant that the form sets: layers are those of multi-layer alpha blending, with such alphas.
fn begin(pixel: vec2u) {
    layer_count = 0u;
    node_count = 0u;
}

fn take(fragment: Fragment) {
    // what covers nothing has no colour of its own
    if fragment.alpha == 0.0 {
        return;
    }
    if KEEPS_ALPHAS != 0u {
        insert_node(key_of(fragment), in_steps(fragment));
        if node_count > LAYERS {
            merge_furthest();
        }
        return;
    }
    draw_mask(params.masking, fragment.pixel, fragment.primitive, fragment.alpha);
    insert_layer(key_of(fragment), unmultiplied(rgba(fragment)));
    if layer_count > LAYERS {
        merge_furthest_layers();
    }
}

fn finish(id: vec3u) {
    if KEEPS_ALPHAS != 0u {
        store_nodes(id, CLEAR);
        return;
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
    store(id, color + open / all * background_at(pixel_of(id)), open / all);
}
