// Layers of the continuum: fragments stream into them as they are submitted.

struct Layer {
    key: vec2u,
    // premultiplied, or that of samples
    color: vec3f,
    // what it covers and lets through of what reaches it; of samples, how many it covers
    share: vec2f,
    // where its mask is
    slot: u32,
}

// one more than are kept, and one that has been flushed to the front
var<private> layers: array<Layer, LAYERS + 2u>;
var<private> layer_count: u32;
// the samples that show each layer: no sample is in two. Masks stay in their slots, since wide ones are long to move; those behind
// the last layer are free
var<private> layer_masks: array<u32, (LAYERS + 2u) * MASK_WORDS>;

fn word_of(i: u32, w: u32) -> u32 {
    return layers[i].slot * MASK_WORDS + w;
}

// What shows through nothing, in the unit that layers count in.
fn clear_share() -> f32 {
    return select(1.0, f32(params.masking.bits), params.covers_samples != 0u);
}

// What shows behind a layer of which `shown` shows in front.
fn behind_layer(shown: f32, i: u32) -> f32 {
    return select(shown * layers[i].share.y, shown - layers[i].share.x, params.covers_samples != 0u);
}

// The share that shows behind the first layers.
fn shown_behind(count: u32) -> f32 {
    var shown = clear_share();
    for (var i = 0u; i < count; i++) {
        shown = behind_layer(shown, i);
    }
    return shown / clear_share();
}

// Whether the mask that was drawn has a sample that no layer in front of a place has.
fn shows_behind(at: u32) -> bool {
    var visible = 0u;
    for (var w = 0u; w < words_of(params.masking); w++) {
        var rest = drawn[w];
        for (var i = 0u; i < at; i++) {
            rest &= ~layer_masks[word_of(i, w)];
        }
        visible |= rest;
    }
    return visible != 0u;
}

// Whether a fragment enters the list between those in front of it and the others.
fn enters(at: u32, key: vec2u, alpha: f32) -> bool {
    switch params.insertion {
        case THRESHOLD: {
            return alpha > params.threshold;
        }
        case NEAREST: {
            return is_among_nearest(key);
        }
        case STOCHASTIC: {
            if params.covers_samples != 0u {
                return shows_behind(at);
            }
            return shows_by_chance(params.masking, pixel, key.y, shown_behind(at), alpha);
        }
        default: {
            return true;
        }
    }
}

// Layer j + 1 goes under the one in front of it.
fn merge_layers(j: u32) {
    let front = layers[j];
    let behind = layers[j + 1u];
    if params.covers_samples != 0u {
        let sum = front.share.x + behind.share.x;
        if sum > 0.0 {
            let mean = front.share.x / sum * front.color + behind.share.x / sum * behind.color;
            layers[j].color = min(mean, vec3f(LARGEST));
        }
        layers[j].share.x = sum;
        for (var w = 0u; w < words_of(params.masking); w++) {
            layer_masks[word_of(j, w)] |= layer_masks[word_of(j + 1u, w)];
        }
    } else {
        layers[j].color = min(front.color + front.share.y * behind.color, vec3f(LARGEST));
        layers[j].share = under(front.share, behind.share);
    }
    layer_count--;
    for (var i = j + 1u; i < layer_count; i++) {
        layers[i] = layers[i + 1u];
    }
    layers[layer_count] = behind;
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
    var shown = behind_layer(clear_share(), 0u);
    for (var j = 1u; j < layer_count; j++) {
        let covers = layers[j].share.x;
        let drop = select(shown * covers, covers, params.covers_samples != 0u);
        let error = (depth_in(layers[j].key) - depth_in(layers[j - 1u].key)) * drop;
        if error < least {
            found = j;
            least = error;
        }
        shown = behind_layer(shown, j);
    }
    return found;
}

// Removes the layer that is one too many.
fn make_room(newcomer: u32) {
    // where a layer takes the next one under itself
    var j = layer_count - 2u;
    switch params.merge {
        case DISCARD_FURTHEST: {
            layer_count--;
            return;
        }
        case OVER_NEAREST: {
            j = 0u;
        }
        case OVER_CLOSEST: {
            j = closest_pair();
        }
        case SMALLEST_ERROR: {
            j = least_step() - 1u;
        }
        case OVER_ARRIVAL: {
            if newcomer == 1u {
                let other = layers[0];
                layers[0] = layers[1];
                layers[1] = other;
            }
        }
        default: {}
    }
    merge_layers(j);
}

fn samples_of(i: u32) -> f32 {
    var count = 0u;
    for (var w = 0u; w < words_of(params.masking); w++) {
        count += countOneBits(layer_masks[word_of(i, w)]);
    }
    return f32(count);
}

// A layer gets the mask that was drawn: it covers what nothing in front of it does, and takes that from what is behind.
fn occlude(at: u32) {
    for (var w = 0u; w < words_of(params.masking); w++) {
        var own = drawn[w];
        for (var i = 0u; i < at; i++) {
            own &= ~layer_masks[word_of(i, w)];
        }
        layer_masks[word_of(at, w)] = own;
        for (var i = at + 1u; i < layer_count; i++) {
            layer_masks[word_of(i, w)] &= ~own;
        }
    }
    for (var i = at; i < layer_count; i++) {
        layers[i].share.x = samples_of(i);
    }
}

fn insert_layer(at: u32, key: vec2u, color: vec3f, alpha: f32) {
    let slot = layers[layer_count].slot;
    for (var i = layer_count; i > at; i--) {
        layers[i] = layers[i - 1u];
    }
    layers[at] = Layer(key, color, vec2f(alpha, 1.0 - alpha), slot);
    layer_count++;
}

fn receive(key: vec2u, fragment: vec4f, flushed: u32) {
    var at = layer_count;
    while at > flushed && comes_before_by_depth(key, layers[at - 1u].key) {
        at--;
    }
    if params.merge == DISCARD_FURTHEST && at >= LAYERS {
        return;
    }
    let covers_samples = params.covers_samples != 0u;
    let stored = as_stored(fragment);
    if covers_samples {
        draw_mask(params.masking, pixel, key.y, stored.a);
    }
    // what covers no sample has no colour of its own
    if !enters(at, key, fragment.a) || (covers_samples && fragment.a <= 0.0) {
        return;
    }
    if covers_samples {
        insert_layer(at, key, unmultiplied(stored), stored.a);
        occlude(at);
    } else {
        insert_layer(at, key, stored.rgb, stored.a);
    }
    if layer_count > LAYERS + flushed {
        make_room(at);
    }
}

// Composites the layers front to back.
fn composite_layers() {
    if params.covers_samples == 0u {
        for (var i = 0u; i < layer_count; i++) {
            core_color += core.y * layers[i].color;
            core = under(core, layers[i].share);
        }
        return;
    }
    var samples = 0.0;
    for (var i = 0u; i < layer_count; i++) {
        core_color += layers[i].share.x / clear_share() * layers[i].color;
        samples += layers[i].share.x;
    }
    core = vec2f(samples, clear_share() - samples) / clear_share();
}

// What has been flushed to the front counts as a layer, too.
fn flushed_layers() -> u32 {
    return u32(params.merge == OVER_NEAREST);
}

fn begin(at: vec2u) {
    pixel = at;
    nearest_count = 0u;
    for (var i = 0u; i < LAYERS + 2u; i++) {
        layers[i].slot = i;
    }
    // nothing, in front of everything
    layers[0] = Layer(vec2u(0u), vec3f(0.0), vec2f(0.0, 1.0), 0u);
    layer_count = flushed_layers();
    begin_core();
}

// The first walk fills the layers; the second adds up what they let be seen.
fn take(fragment: Fragment) {
    if walk == 0u {
        receive(key_of(fragment), rgba(fragment), flushed_layers());
        return;
    }
    let key = key_of(fragment);
    var in_front = 0u;
    while in_front < layer_count && comes_before_by_depth(layers[in_front].key, key) {
        in_front++;
    }
    let is_stored = in_front < layer_count && all(layers[in_front].key == key);
    add_fragment(rgba(fragment), fragment.depth, shown_behind(in_front), is_stored);
}

fn again() -> bool {
    return walk == 0u && (params.second_pass != 0u || params.normalize != 0u);
}

fn finish(id: vec3u) {
    composite_layers();
    store_core(id, false);
}
