// Moment-based OIT with trigonometric moments (Muenstermann et al. 2018). The map holds sums of s e^(i k phi), k = 1 .. m, real
// and imaginary parts one after the other, with phi the depth on a logarithmic scale, wound round the circle but for a zone.

struct Params {
    two_pass: TwoPass,
    // m
    count: u32,
    overestimation: f32,
    bias: f32,
    // half of what moments are rounded by, relative
    guard: f32,
    // turns from the near end to the middle, a sum of two, and the zone in turns
    half_range: vec2f,
    zone: f32,
    unused: u32,
}

@group(0) @binding(3) var<uniform> params: Params;

const MOST = 5u;
const TURN = 6.2831855;

struct Term {
    s: f32,
    turns: vec2f,
}

fn turns_of(fragment: Fragment) -> vec2f {
    let d = warped(interval_at(texel_of(fragment.pixel)), fragment.depth);
    return product_of(params.half_range, two_sum(d, 1.0));
}

fn term_of(fragment: Fragment) -> Term {
    return Term(absorbance_of(fragment), turns_of(fragment));
}

// The layers of moments, and behind them total absorbance.
fn map_texel(term: Term, layer: u32) -> vec4f {
    if layer >= (params.count + 1u) / 2u {
        return vec4f(term.s);
    }
    let k = f32(2u * layer);
    return term.s * vec4f(unit_at(times(term.turns, k + 1.0)), unit_at(times(term.turns, k + 2.0)));
}

// Complex numbers.
fn product(a: vec2f, b: vec2f) -> vec2f {
    return vec2f(a.x * b.x - a.y * b.y, a.x * b.y + a.y * b.x);
}

fn conjugate(a: vec2f) -> vec2f {
    return vec2f(a.x, -a.y);
}

// Moments from the zeroth on, biased, and the factors of their Toeplitz matrix M = L D L^H.
var<private> moments: array<vec2f, MOST>;
var<private> lower: array<array<vec2f, MOST>, MOST>;
var<private> pivots: array<f32, MOST>;

// Whether every pivot is more than what rounding alone may leave.
fn factor(guard: f32) -> bool {
    for (var j = 0u; j <= params.count; j++) {
        for (var i = j; i <= params.count; i++) {
            var entry = moments[i - j];
            for (var k = 0u; k < j; k++) {
                entry -= pivots[k] * product(lower[i][k], conjugate(lower[j][k]));
            }
            if i > j {
                lower[i][j] = entry / pivots[j];
                continue;
            }
            if !(entry.x > guard) {
                return false;
            }
            pivots[j] = entry.x;
        }
    }
    return true;
}

// The moments of a pixel, mixed with those of even mass, all of which but the zeroth are 0; the more, the closer to the border
// of what moments can be.
fn prepare(means: array<vec4f, 2>) -> bool {
    var all = means;
    var bias = min(params.bias, 1.0);
    for (var attempt = 0u; attempt < 16u; attempt++) {
        moments[0] = vec2f(1.0, 0.0);
        for (var k = 0u; k < params.count; k++) {
            let pair = all[k / 2u];
            moments[k + 1u] = (1.0 - bias) * select(pair.xy, pair.zw, k % 2u == 1u);
        }
        if factor(select(0.0, params.guard, bias < 1.0)) {
            return true;
        }
        bias = clamp(10.0 * bias, 2.0 * params.guard, 1.0);
    }
    return false;
}

// q_j in K(zeta, zeta w) = sum of q_j w^j, of the kernel K(zeta, x) = v(zeta)^H M^-1 v(x).
fn kernel_around(turns: vec2f) -> array<vec2f, MOST> {
    var c: array<vec2f, MOST>;
    for (var i = 0u; i <= params.count; i++) {
        c[i] = unit_at(times(turns, f32(i)));
        for (var k = 0u; k < i; k++) {
            c[i] -= product(lower[i][k], c[k]);
        }
    }
    for (var i = params.count + 1u; i > 0u; i--) {
        c[i - 1u] /= pivots[i - 1u];
        for (var k = i; k <= params.count; k++) {
            c[i - 1u] -= product(conjugate(lower[k][i - 1u]), c[k]);
        }
    }
    for (var i = 0u; i <= params.count; i++) {
        c[i] = product(conjugate(c[i]), unit_at(times(turns, f32(i))));
    }
    return c;
}

// With w = -(1 + i t) / (1 - i t), zeros w on the circle are real zeros t, and w = 1 is infinitely far away: i^m (1 - i t)^m K is
// a real polynomial in t with K(zeta, zeta) > 0 for its leading coefficient. This is that polynomial, made monic.
fn polynomial_of(q: array<vec2f, MOST>) -> array<f32, MOST_ROOTS> {
    var kernel = q;
    // Horner's scheme in (1 + i t) / (1 - i t), a power of 1 - i t beside it
    var sum: array<vec2f, MOST>;
    var power: array<vec2f, MOST>;
    let m = params.count;
    sum[0] = select(kernel[m], -kernel[m], m % 2u == 1u);
    power[0] = vec2f(1.0, 0.0);
    for (var j = m; j > 0u; j--) {
        for (var k = m; k > 0u; k--) {
            sum[k] += vec2f(-sum[k - 1u].y, sum[k - 1u].x);
            power[k] += vec2f(power[k - 1u].y, -power[k - 1u].x);
        }
        let factor = select(kernel[j - 1u], -kernel[j - 1u], (j - 1u) % 2u == 1u);
        for (var k = 0u; k <= m; k++) {
            sum[k] += product(factor, power[k]);
        }
    }
    var p: array<f32, MOST_ROOTS>;
    let leading = real_part_of(sum[m]);
    for (var k = 0u; k < m; k++) {
        p[k] = real_part_of(sum[k]) / leading;
    }
    return p;
}

// Of i^m z for m = 2, 3, 4.
fn real_part_of(z: vec2f) -> f32 {
    if params.count == 3u {
        return z.y;
    }
    return select(z.x, -z.x, params.count == 2u);
}

// How much of a point counts as in front: none of what is behind, all beyond the end of the circle, in the zone the more the
// closer to that.
fn counts(t: f32, turns: vec2f) -> f32 {
    // 2 atan t is the angle from opposite zeta; at either end no rounding decides
    let half = unit_at(0.5 * turns);
    if t * abs(half.y) >= half.x {
        return 1.0;
    }
    if params.zone == 0.0 {
        return 0.0;
    }
    let beyond = TURN * (turns.x - 0.5) + 2.0 * arctangent(t);
    return clamp(1.0 + beyond / (TURN * params.zone), 0.0, 1.0);
}

// The share of all absorbance in front of zeta in the canonical distribution with a point there.
fn share_in_front(turns: vec2f) -> f32 {
    var roots = real_roots(polynomial_of(kernel_around(turns)), params.count);
    let zeta = unit_at(turns);
    var nodes: array<vec2f, MOST>;
    var differences: array<vec2f, MOST>;
    nodes[0] = zeta;
    differences[0] = vec2f(params.overestimation, 0.0);
    for (var k = 0u; k < params.count; k++) {
        let t = roots[k];
        // -(1 + i t) / (1 - i t), where t^2 may be too large
        let scale = max(1.0, abs(t));
        let u = 1.0 / scale;
        let v = t / scale;
        nodes[k + 1u] = product(zeta, vec2f(v * v - u * u, -2.0 * u * v) / (u * u + v * v));
        differences[k + 1u] = vec2f(counts(t, turns), 0.0);
    }
    // Newton's divided differences; nodes that coincide count once
    for (var order = 1u; order <= params.count; order++) {
        for (var i = params.count; i >= order; i--) {
            let distance = nodes[i] - nodes[i - order];
            let square = dot(distance, distance);
            let difference = product(differences[i] - differences[i - 1u], conjugate(distance));
            differences[i] = select(difference / square, vec2f(0.0), square == 0.0);
        }
    }
    return mean_of(nodes, differences);
}

// The mean value of a polynomial in Newton's form.
fn mean_of(nodes: array<vec2f, MOST>, differences: array<vec2f, MOST>) -> f32 {
    var at = nodes;
    var from_newton = differences;
    var p: array<vec2f, MOST>;
    for (var i = params.count + 1u; i > 0u; i--) {
        for (var k = params.count + 1u - i; k > 0u; k--) {
            p[k] = p[k - 1u] - product(at[i - 1u], p[k]);
        }
        p[0] = from_newton[i - 1u] - product(at[i - 1u], p[0]);
    }
    var mean = 0.0;
    for (var k = 0u; k <= params.count; k++) {
        mean += product(p[k], moments[k]).x;
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
    for (var layer = 0u; layer < (params.count + 1u) / 2u; layer++) {
        means[layer] = map_at(texel, layer) / total;
    }
    if !prepare(means) {
        return 1.0;
    }
    return transmittance(total * share_in_front(turns_of(fragment)));
}
