// Layered weighted blended OIT (Friederichs, Eisemann & Eisemann 2021), the form without layers: depth is divided into bins,
// fragments of a bin blend by weight, bins composite front to back. Fragments come nearest first, so that a window of five bins,
// as far as a fragment reaches, is all that is kept. FINDS_BOUNDS, a constant that the form sets, says that a first walk finds
// the pixel's bounds.

const WINDOW = REACHED;

// (-nearest, farthest)
var<private> bounds_at_hand: vec2f;

fn bounds_texel(texel: vec2u) -> vec2f {
    return bounds_at_hand;
}

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

// what all fragments together cover and leave
var<private> net: vec2f;

fn begin(pixel: vec2u) {
    bounds_at_hand = vec2f(-LARGEST);
    for (var i = 0; i < WINDOW; i++) {
        clear_bin(i);
    }
    color = vec3f(0.0);
    shares = vec2f(0.0, 1.0);
    own_bin = 0;
    net = vec2f(0.0, 1.0);
}

fn take(fragment: Fragment) {
    if walk < FINDS_BOUNDS {
        bounds_at_hand = max(bounds_at_hand, vec2f(-fragment.depth, fragment.depth));
        return;
    }
    let part = part_of(fragment);
    move_to(part.own);
    for (var i = 0; i < WINDOW; i++) {
        bin_sums[i] += color_shares[i] * part.color;
        bin_shares[i] = behind(bin_shares[i], coverages[i]);
    }
    net = behind(net, fragment.alpha);
}

fn again() -> bool {
    return walk < FINDS_BOUNDS;
}

fn finish(id: vec3u) {
    let background = background_at(pixel_of(id));
    move_to(own_bin + WINDOW);
    if params.normalize == 0u {
        store(id, color + shares.y * background, shares.y);
        return;
    }
    if shares.x <= 0.0 {
        store(id, background, 1.0);
        return;
    }
    // FEE21 section 3.3
    store(id, net.x / shares.x * color + net.y * background, net.y);
}
