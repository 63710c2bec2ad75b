// Moment-based OIT with power moments (Muenstermann et al. 2018). The map holds sums of s d^k, k = 1 .. m, with d the depth on a
// logarithmic scale from -1 to 1; total absorbance has a target of its own.

struct Params {
    two_pass: TwoPass,
    // m / 2
    points: u32,
    overestimation: f32,
    bias: f32,
    // half of what moments are rounded by, relative
    guard: f32,
    // the moments that are mixed in
    spread: array<vec4f, 2>,
}

@group(0) @binding(3) var<uniform> params: Params;

const MOST = 5u;

struct Term {
    s: f32,
    d: f32,
}

fn term_of(fragment: Fragment) -> Term {
    let d = warped(interval_at(texel_of(fragment.pixel)), fragment.depth);
    return Term(absorbance_of(fragment), d);
}

// The layers of moments, and behind them total absorbance.
fn map_texel(term: Term, layer: u32) -> vec4f {
    let d = term.d;
    let low = vec4f(d, d * d, d * d * d, (d * d) * (d * d));
    if layer >= (params.points + 1u) / 2u {
        return vec4f(term.s);
    }
    return term.s * select(low * low.w, low, layer == 0u);
}

// Moments from the zeroth on, biased, and the factors of their Hankel matrix H = L D L^T.
var<private> moments: array<f32, 9>;
var<private> lower: array<array<f32, MOST>, MOST>;
var<private> pivots: array<f32, MOST>;

fn mix_moments(means: array<vec4f, 2>, bias: f32) {
    var all = means;
    moments[0] = 1.0;
    for (var k = 0u; k < 2u * params.points; k++) {
        moments[k + 1u] = (1.0 - bias) * all[k / 4u][k % 4u] + bias * params.spread[k / 4u][k % 4u];
    }
}

// Whether every pivot is more than what rounding alone may leave.
fn factor(guard: f32) -> bool {
    for (var j = 0u; j <= params.points; j++) {
        for (var i = j; i <= params.points; i++) {
            var entry = moments[i + j];
            for (var k = 0u; k < j; k++) {
                entry -= lower[i][k] * lower[j][k] * pivots[k];
            }
            if i > j {
                lower[i][j] = entry / pivots[j];
                continue;
            }
            if !(entry > guard * moments[2u * j]) {
                return false;
            }
            pivots[j] = entry;
        }
    }
    return true;
}

// The moments of a pixel, of which ten times as much is replaced until they are those of a distribution.
fn prepare(means: array<vec4f, 2>) -> bool {
    var bias = min(params.bias, 1.0);
    for (var attempt = 0u; attempt < 16u; attempt++) {
        mix_moments(means, bias);
        if factor(select(0.0, params.guard, bias < 1.0)) {
            return true;
        }
        bias = clamp(10.0 * bias, 2.0 * params.guard, 1.0);
    }
    return false;
}

// The kernel polynomial K(d, d + y) = v(d)^T H^-1 v(d + y), ascending in y.
fn kernel_around(d: f32) -> array<f32, MOST> {
    var z: array<f32, MOST>;
    var power = 1.0;
    var at_d = 0.0;
    for (var i = 0u; i <= params.points; i++) {
        z[i] = power;
        for (var k = 0u; k < i; k++) {
            z[i] -= lower[i][k] * z[k];
        }
        at_d += z[i] * z[i] / pivots[i];
        power *= d;
    }
    for (var i = params.points + 1u; i > 0u; i--) {
        z[i - 1u] /= pivots[i - 1u];
        for (var k = i; k <= params.points; k++) {
            z[i - 1u] -= lower[k][i - 1u] * z[k];
        }
    }
    for (var first = 0u; first < params.points; first++) {
        for (var k = params.points; k > first; k--) {
            z[k - 1u] += d * z[k];
        }
    }
    // a sum of squares, where the others cancel
    z[0] = at_d;
    return z;
}

// Points farther away than this many half ranges are left out: theirs is less than its power of -m.
const FAR = 300.0;

// The share of all absorbance in front of d in the canonical distribution with a point there: points x are the zeros of the
// kernel, and 1 / (x - d) those of its reverse, whose leading coefficient is K(d, d) > 0.
fn share_in_front(d: f32) -> f32 {
    var kernel = kernel_around(d);
    var p: array<f32, MOST_ROOTS>;
    for (var k = 0u; k < params.points; k++) {
        p[k] = kernel[params.points - k] / kernel[0];
    }
    var inverses = real_roots(p, params.points);
    var nodes: array<f32, MOST>;
    var differences: array<f32, MOST>;
    nodes[0] = d;
    differences[0] = params.overestimation;
    var count = 1u;
    for (var k = 0u; k < params.points; k++) {
        if abs(inverses[k]) * FAR >= 1.0 {
            nodes[count] = d + 1.0 / inverses[k];
            differences[count] = select(0.0, 1.0, inverses[k] < 0.0);
            count++;
        }
    }
    // Newton's divided differences; nodes that coincide count once
    for (var order = 1u; order < count; order++) {
        for (var i = count - 1u; i >= order; i--) {
            let distance = nodes[i] - nodes[i - order];
            let difference = differences[i] - differences[i - 1u];
            differences[i] = select(difference / distance, 0.0, distance == 0.0);
        }
    }
    return mean_of(nodes, differences, count);
}

// The mean value of a polynomial in Newton's form.
fn mean_of(nodes: array<f32, MOST>, differences: array<f32, MOST>, count: u32) -> f32 {
    var at = nodes;
    var from_newton = differences;
    var p: array<f32, MOST>;
    for (var i = count; i > 0u; i--) {
        for (var k = count - i; k > 0u; k--) {
            p[k] = p[k - 1u] - at[i - 1u] * p[k];
        }
        p[0] = from_newton[i - 1u] - at[i - 1u] * p[0];
    }
    var mean = 0.0;
    for (var k = 0u; k < count; k++) {
        mean += p[k] * moments[k];
    }
    return mean;
}

fn in_front_of(fragment: Fragment) -> f32 {
    let texel = texel_of(fragment.pixel);
    let total = total_absorbance(texel);
    if total < EMPTY {
        return 1.0;
    }
    var means: array<vec4f, 2>;
    for (var layer = 0u; layer < (params.points + 1u) / 2u; layer++) {
        means[layer] = map_at(texel, layer) / total;
    }
    if !prepare(means) {
        return 1.0;
    }
    return transmittance(total * share_in_front(warped(interval_at(texel), fragment.depth)));
}
