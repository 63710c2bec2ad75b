// Layers of the continuum: fragments stream into them as they are submitted.

struct Layer {
    key: vec2u,
    // premultiplied, or that of samples
    color: vec3f,
    // coverage and transmittance
    share: vec2f,
    // the samples that show it: no sample is in two layers
    mask: Mask,
}

// one more than are kept, and one that has been flushed to the front
var<private> layers: array<Layer, LAYERS + 2u>;
var<private> layer_count: u32;

fn samples_of(i: u32) -> f32 {
    var count = 0u;
    for (var w = 0u; w < MASK_WORDS; w++) {
        count += countOneBits(layers[i].mask[w]);
    }
    return f32(count);
}

// What a layer covers of what reaches it; of samples, their share of all.
fn covered_by(i: u32) -> f32 {
    if params.covers_samples != 0u {
        return samples_of(i) / f32(params.masking.bits);
    }
    return layers[i].share.x;
}

// What shows behind a layer of which `shown` shows in front.
fn behind_layer(shown: f32, i: u32) -> f32 {
    if params.covers_samples != 0u {
        return shown - covered_by(i);
    }
    return shown * layers[i].share.y;
}

fn shown_behind(count: u32) -> f32 {
    var shown = 1.0;
    for (var i = 0u; i < count; i++) {
        shown = behind_layer(shown, i);
    }
    return shown;
}

fn hide_layer(i: u32, front: u32) {
    for (var w = 0u; w < MASK_WORDS; w++) {
        layers[i].mask[w] &= ~layers[front].mask[w];
    }
}

// Whether the mask that was drawn has a sample that no layer in front of a place has.
fn shows_behind(at: u32) -> bool {
    var visible = 0u;
    for (var w = 0u; w < MASK_WORDS; w++) {
        var rest = drawn[w];
        for (var i = 0u; i < at; i++) {
            rest &= ~layers[i].mask[w];
        }
        visible |= rest;
    }
    return visible != 0u;
}

// Whether a fragment enters the list between those in front of it and the others.
fn enters(at: u32, key: vec2u, fragment: vec4f) -> bool {
    switch params.insertion {
        case THRESHOLD: {
            return fragment.a > params.threshold;
        }
        case NEAREST: {
            return is_among_nearest(key);
        }
        case STOCHASTIC: {
            if params.covers_samples != 0u {
                return shows_behind(at);
            }
            return shows_by_chance(params.masking, pixel, key.y, shown_behind(at), fragment.a);
        }
        default: {
            return true;
        }
    }
}

// Layer j + 1 goes under the one in front of it.
fn merge_layers(j: u32) {
    if params.covers_samples != 0u {
        let samples = vec2f(samples_of(j), samples_of(j + 1u));
        let sum = samples.x + samples.y;
        if sum > 0.0 {
            let mean = samples.x / sum * layers[j].color + samples.y / sum * layers[j + 1u].color;
            layers[j].color = min(mean, vec3f(LARGEST));
        }
        for (var w = 0u; w < MASK_WORDS; w++) {
            layers[j].mask[w] |= layers[j + 1u].mask[w];
        }
    } else {
        layers[j].color = min(layers[j].color + layers[j].share.y * layers[j + 1u].color, vec3f(LARGEST));
        layers[j].share = under(layers[j].share, layers[j + 1u].share);
    }
    layer_count--;
    for (var i = j + 1u; i < layer_count; i++) {
        layers[i] = layers[i + 1u];
    }
}

// The nearest of the pairs that are closest, by exact distances.
fn closest_pair() -> u32 {
    var closest = 0u;
    var least = vec2f(LARGEST, 0.0);
    for (var j = 0u; j + 1u < layer_count; j++) {
        let gap = two_sum(depth_in(layers[j + 1u].key), -depth_in(layers[j].key));
        if gap.x < least.x || (gap.x == least.x && gap.y < least.y) {
            closest = j;
            least = gap;
        }
    }
    return closest;
}

// The step that changes the area under the transmittance function least if the one in front takes it over.
fn least_step() -> u32 {
    var found = 1u;
    var least = LARGEST;
    var shown = behind_layer(1.0, 0u);
    for (var j = 1u; j < layer_count; j++) {
        let behind = behind_layer(shown, j);
        let drop = select(shown * layers[j].share.x, covered_by(j), params.covers_samples != 0u);
        let error = (depth_in(layers[j].key) - depth_in(layers[j - 1u].key)) * drop;
        if error < least {
            found = j;
            least = error;
        }
        shown = behind;
    }
    return found;
}

// Removes the layer that is one too many.
fn make_room(newcomer: u32) {
    switch params.merge {
        case DISCARD_FURTHEST: {
            layer_count--;
        }
        case OVER_NEAREST: {
            merge_layers(0u);
        }
        case OVER_CLOSEST: {
            merge_layers(closest_pair());
        }
        case SMALLEST_ERROR: {
            merge_layers(least_step() - 1u);
        }
        case OVER_ARRIVAL: {
            if newcomer == 1u {
                let other = layers[0];
                layers[0] = layers[1];
                layers[1] = other;
            }
            merge_layers(0u);
        }
        default: {
            merge_layers(layer_count - 2u);
        }
    }
}

fn insert_layer(at: u32, layer: Layer) {
    for (var i = layer_count; i > at; i--) {
        layers[i] = layers[i - 1u];
    }
    layers[at] = layer;
    layer_count++;
    if params.covers_samples == 0u {
        return;
    }
    for (var i = 0u; i < at; i++) {
        hide_layer(at, i);
    }
    for (var i = at + 1u; i < layer_count; i++) {
        hide_layer(i, at);
    }
}

fn receive(place: u32, flushed: u32) {
    let key = keys[place];
    var at = layer_count;
    while at > flushed && comes_before_by_depth(key, layers[at - 1u].key) {
        at--;
    }
    if params.merge == DISCARD_FURTHEST && at >= LAYERS {
        return;
    }
    let fragment = colors[place];
    let covers_samples = params.covers_samples != 0u;
    let stored = as_stored(fragment);
    if covers_samples {
        draw_mask(params.masking, pixel, key.y, stored.a);
    }
    // what covers no sample has no colour of its own
    if !enters(at, key, fragment) || (covers_samples && fragment.a <= 0.0) {
        return;
    }
    let color = select(stored.rgb, unmultiplied(stored), covers_samples);
    insert_layer(at, Layer(key, color, vec2f(stored.a, 1.0 - stored.a), drawn));
    if layer_count > LAYERS + flushed {
        make_room(at);
    }
}

// Puts a layer behind what is composited already.
fn put_layer_behind(i: u32) {
    if params.covers_samples != 0u {
        let share = covered_by(i);
        core_color += share * layers[i].color;
        core = vec2f(core.x + share, core.y - share);
    } else {
        core_color += core.y * layers[i].color;
        core = under(core, layers[i].share);
    }
}

@compute @workgroup_size(8, 8)
fn resolve_layers(@builtin(global_invocation_id) id: vec3u) {
    if is_outside(id) {
        return;
    }
    let list = begin_pixel(id);
    nearest_count = 0u;
    let flushed = u32(params.merge == OVER_NEAREST);
    layers[0] = Layer(vec2u(0u), vec3f(0.0), vec2f(0.0, 1.0), Mask());
    layer_count = flushed;
    for (var i = 0u; i < list.y; i++) {
        let place = place_in(list, i, params.backwards);
        if !is_nothing(colors[place]) {
            receive(place, flushed);
        }
    }
    begin_core();
    if params.second_pass != 0u || params.normalize != 0u {
        for (var place = list.x; place < list.x + list.y; place++) {
            var in_front = 0u;
            while in_front < layer_count && comes_before_by_depth(layers[in_front].key, keys[place]) {
                in_front++;
            }
            let is_stored = in_front < layer_count && all(layers[in_front].key == keys[place]);
            let seen = select(0.0, shown_behind(in_front), params.second_pass != 0u);
            add_fragment(place, depth_in(keys[place]), seen, is_stored);
        }
    }
    for (var i = 0u; i < layer_count; i++) {
        put_layer_behind(i);
    }
    store_core(id, false);
}
