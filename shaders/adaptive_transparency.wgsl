// Adaptive transparency (Salvi, Montgomery & Lefohn 2011): the transmittance as at most LAYERS steps, and every fragment seen
// through it.

struct Params {
    // so many of the first steps are never removed, one at least
    kept_in_front: u32,
    composite: u32,
}

@group(0) @binding(3) var<uniform> params: Params;

// where each step is, nearest first ...
var<private> step_keys: array<vec2u, LAYERS + 1u>;
// ... and what it covers and leaves of what reaches it: the drop of T is the product of two numbers that lose no digits.
// Once all steps are there, T behind them takes the second one's place
var<private> step_shares: array<vec2f, LAYERS + 1u>;
var<private> step_count: u32;

fn insert_step(key: vec2u, alpha: f32) {
    var place = step_count;
    while place > 0u && comes_before_by_depth(key, step_keys[place - 1u]) {
        step_keys[place] = step_keys[place - 1u];
        step_shares[place] = step_shares[place - 1u];
        place--;
    }
    step_keys[place] = key;
    step_shares[place] = vec2f(alpha, 1.0 - alpha);
    step_count++;
}

// The step whose removal takes the smallest rectangle (z_j - z_j-1) (T_j-1 - T_j) from under the function, the first of
// several.
fn least_step() -> u32 {
    var in_front = 1.0;
    for (var j = 0u; j < params.kept_in_front; j++) {
        in_front *= step_shares[j].y;
    }
    var least = LARGEST;
    var found = params.kept_in_front;
    for (var j = params.kept_in_front; j < step_count; j++) {
        let gap = bitcast<f32>(step_keys[j].x) - bitcast<f32>(step_keys[j - 1u].x);
        let error = gap * (in_front * step_shares[j].x);
        if error < least {
            least = error;
            found = j;
        }
        in_front *= step_shares[j].y;
    }
    return found;
}

// The step in front takes over what a step covers, so that T is never too large.
fn remove_step(j: u32) {
    step_shares[j - 1u] = under(step_shares[j - 1u], step_shares[j]);
    step_count--;
    for (var i = j; i < step_count; i++) {
        step_keys[i] = step_keys[i + 1u];
        step_shares[i] = step_shares[i + 1u];
    }
}

// T behind all steps; they have T behind themselves from now on.
fn add_up_steps() -> f32 {
    var transmittance = 1.0;
    for (var j = 0u; j < step_count; j++) {
        transmittance *= step_shares[j].y;
        step_shares[j].y = transmittance;
    }
    return transmittance;
}

// T behind the last step in front of a fragment.
fn transmittance_at(key: vec2u) -> f32 {
    var transmittance = 1.0;
    for (var j = 0u; j < step_count && comes_before_by_depth(step_keys[j], key); j++) {
        transmittance = step_shares[j].y;
    }
    return transmittance;
}

// T behind all steps, and what of all fragments is seen through them
var<private> total: f32;
var<private> sums: Sums;

fn begin(pixel: vec2u) {
    step_count = 0u;
    sums = NO_SUMS;
}

// The first walk makes the steps, and the second looks through them.
fn take(fragment: Fragment) {
    let key = key_of(fragment);
    if walk == 0u {
        insert_step(key, fragment.alpha);
        if step_count > LAYERS {
            remove_step(least_step());
        }
        return;
    }
    sums = with_fragment(sums, weight_seen(params.composite, transmittance_at(key)), rgba(fragment));
}

fn again() -> bool {
    if walk > 0u {
        return false;
    }
    total = add_up_steps();
    return true;
}

fn finish(id: vec3u) {
    let texel = composite_sums(params.composite, sums, total, background_at(pixel_of(id)));
    store(id, texel.rgb, texel.a);
}
