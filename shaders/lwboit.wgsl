// Layered weighted blended OIT (Friederichs, Eisemann & Eisemann 2021), the form with lists: depth is divided into bins,
// fragments of a bin blend by weight, bins composite front to back. Lists come sorted, so that a window of five bins, as far as
// a fragment reaches, is all that is kept.

struct Params {
    weight: Weight,
    bins: u32,
    // 0: a fragment is in one bin; 1: it fades over others like a bell, 2: like a tent
    fading: u32,
    normalize: u32,
    // bins are measured from each pixel's first surface, which lies so many bins behind the first one's near edge
    shaped: u32,
    anchor: f32,
    // the depth range is the pixel's own
    range_of_pixel: u32,
    nearest: f32,
    farthest: f32,
}

@group(0) @binding(3) var<uniform> params: Params;

const REACH = 2;
const WINDOW = 5;

// sums of weighted colours and alphas of the bins around `own_bin`, and what each covers and leaves
var<private> bin_sums: array<vec4f, WINDOW>;
var<private> bin_shares: array<vec2f, WINDOW>;
var<private> own_bin: i32;
// bins that have been composited
var<private> color: vec3f;
var<private> shares: vec2f;

fn clear_bin(i: i32) {
    bin_sums[i] = vec4f(0.0);
    bin_shares[i] = vec2f(0.0, 1.0);
}

// What two layers cover together, and what they leave.
fn behind(front: vec2f, coverage: f32) -> vec2f {
    return vec2f(front.x + front.y * coverage, front.y * (1.0 - coverage));
}

// FEE21 eq. 4, one bin at a time.
fn composite_bin(i: i32) {
    let bin = own_bin - REACH + i;
    if bin < 0 || bin >= i32(params.bins) {
        return;
    }
    if bin_sums[i].a > 0.0 {
        let share = shares.y * bin_shares[i].x;
        color += share * (bin_sums[i].rgb / bin_sums[i].a);
        shares.x += share;
    }
    shares.y *= bin_shares[i].y;
}

// Moves the window to another bin of its own; bins that it leaves are done.
fn move_to(bin: i32) {
    for (var left = min(bin - own_bin, WINDOW); left > 0; left--) {
        composite_bin(0);
        for (var i = 1; i < WINDOW; i++) {
            bin_sums[i - 1] = bin_sums[i];
            bin_shares[i - 1] = bin_shares[i];
        }
        clear_bin(WINDOW - 1);
        own_bin++;
    }
    own_bin = bin;
}

// How much of a fragment a bin gets whose centre is x bin widths away.
fn faded(x: f32) -> f32 {
    if params.fading == 1u {
        return exp2(-4.0 * x * x);
    }
    return max(0.0, 1.0 - abs(x));
}

fn blend_into(i: i32, share: f32, weight: f32, fragment: vec4f) {
    bin_sums[i] += share * weight * fragment;
    bin_shares[i] = behind(bin_shares[i], share * fragment.a);
}

// The places of a list's first and last fragment that do anything; none where there are none.
fn bounds_of(list: vec2u) -> vec2u {
    var first = list.x;
    var end = list.x + list.y;
    while first < end && all(colors[first] == vec4f(0.0)) {
        first++;
    }
    while first < end && all(colors[end - 1u] == vec4f(0.0)) {
        end--;
    }
    return vec2u(first, end);
}

@compute @workgroup_size(8, 8)
fn resolve(@builtin(global_invocation_id) id: vec3u) {
    if is_outside(id) {
        return;
    }
    let background = background_at(pixel_of(id));
    let bounds = bounds_of(list_of(pixel_of(id)));
    if bounds.x == bounds.y {
        store(id, background, 1.0);
        return;
    }
    let first_depth = bitcast<f32>(keys[bounds.x].x);
    var nearest = params.nearest;
    var farthest = params.farthest;
    if params.range_of_pixel != 0u {
        nearest = first_depth;
        farthest = bitcast<f32>(keys[bounds.y - 1u].x);
    }
    let count = f32(params.bins);
    let width = select(1.0, (farthest - nearest) / count, farthest > nearest);
    let origin = select(nearest, first_depth, params.shaped != 0u);
    let offset = select(0.0, params.anchor * width, params.shaped != 0u);
    for (var i = 0; i < WINDOW; i++) {
        clear_bin(i);
    }
    color = vec3f(0.0);
    shares = vec2f(0.0, 1.0);
    own_bin = 0;
    var net = vec2f(0.0, 1.0);
    for (var place = bounds.x; place < bounds.y; place++) {
        let fragment = colors[place];
        let depth = bitcast<f32>(keys[place].x);
        let shifted = depth - origin + offset;
        let position = clamp(shifted / width, 0.0, count);
        let own = min(i32(position), i32(params.bins) - 1);
        move_to(own);
        let weight = weight_of(params.weight, select(depth, shifted, params.shaped != 0u), fragment.a);
        if params.fading == 0u {
            blend_into(REACH, 1.0, weight, fragment);
        } else {
            let x = position - f32(own) - 0.5;
            for (var i = 0; i < WINDOW; i++) {
                blend_into(i, faded(x - f32(i - REACH)), weight, fragment);
            }
        }
        net = behind(net, fragment.a);
    }
    move_to(own_bin + WINDOW);
    if params.normalize == 0u {
        store(id, color + shares.y * background, shares.y);
        return;
    }
    // FEE21 section 3.3
    let scale = select(0.0, net.x / shares.x, shares.x > 0.0);
    store(id, scale * color + net.y * background, net.y);
}
