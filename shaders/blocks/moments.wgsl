// What both bases of moments share (Muenstermann et al. 2018): the warp, and roots of polynomials all of whose roots are real.

// Pixels of less absorbance count as empty: their moments are made of rounding.
const EMPTY = 1.0005e-3;

const MOST_ROOTS = 4u;

// ln(z / low) / ln(high / low) from -1 to 1; a depth of 0 is moved in front of the rest.
fn warped(interval: Interval, depth: f32) -> f32 {
    var low = interval.near;
    if low.x < 1e-6 * interval.far.x {
        low = vec2f(1e-6 * interval.far.x, 0.0);
    }
    let inside = Interval(low, interval.far);
    let length = length_of(inside);
    if length.x <= 0.0 {
        return 0.0;
    }
    let offset = max(sum_of(vec2f(depth, 0.0), -low).x, 0.0);
    let position = ln_one_plus(offset / low.x) / ln_one_plus(length.x / low.x);
    return clamp(2.0 * position - 1.0, -1.0, 1.0);
}

fn total_absorbance(texel: vec2u) -> f32 {
    return min(total_sum(texel), params.two_pass.largest_total);
}

fn total_at(texel: vec2u) -> f32 {
    let total = total_absorbance(texel);
    return select(1.0, transmittance(total), total >= EMPTY);
}

// The roots of x^2 + b x + c; a negative discriminant counts as 0, and neither root cancels.
fn roots_of_quadratic(c: f32, b: f32) -> vec2f {
    let root = sqrt(max(b * b - 4.0 * c, 0.0));
    let large = -0.5 * (b + select(-root, root, b >= 0.0));
    let small = select(c / large, 0.0, large == 0.0);
    return vec2f(min(large, small), max(large, small));
}

// The value of a monic polynomial of degree n, and its slope.
fn evaluated(p: array<f32, MOST_ROOTS>, n: u32, x: f32) -> vec2f {
    var q = p;
    var value = vec2f(1.0, 0.0);
    for (var k = n; k > 0u; k--) {
        value = vec2f(value.x * x + q[k - 1u], value.y * x + value.x);
    }
    return value;
}

const STEPS = 48u;
// after a step of Newton's method so small, relative, what is left is its square
const LAST_STEP = 1e-4;

// The root between two numbers, by Newton's method with bisection to fall back on; where there is none, since rounding has
// lifted a double root off the axis, the end that is nearer to it.
fn root_between(p: array<f32, MOST_ROOTS>, n: u32, first: f32, last: f32) -> f32 {
    var low = first;
    var high = last;
    let at_low = evaluated(p, n, low).x;
    let at_high = evaluated(p, n, high).x;
    if (at_low < 0.0) == (at_high < 0.0) {
        return select(high, low, abs(at_low) < abs(at_high));
    }
    var x = 0.5 * (low + high);
    for (var step = 0u; step < STEPS; step++) {
        let value = evaluated(p, n, x);
        if value.x == 0.0 {
            return x;
        }
        if (value.x < 0.0) == (at_low < 0.0) {
            low = x;
        } else {
            high = x;
        }
        let newton = x - value.x / value.y;
        if low < newton && newton < high {
            if abs(newton - x) <= LAST_STEP * abs(x) {
                return newton;
            }
            x = newton;
        } else {
            let middle = 0.5 * (low + high);
            if middle == x {
                return x;
            }
            x = middle;
        }
    }
    return x;
}

// Between which numbers all roots lie (Laguerre, Samuelson), a little wider.
fn bounds_of_roots(p: array<f32, MOST_ROOTS>, n: u32) -> vec2f {
    var q = p;
    let degree = f32(n);
    let a = q[n - 1u];
    let spread = sqrt(max(a * a - 2.0 * degree / (degree - 1.0) * q[n - 2u], 0.0)) * (degree - 1.0);
    let middle = -a / degree;
    let radius = spread / degree * (1.0 + 1e-5) + 1e-6 * abs(middle);
    return vec2f(middle - radius, middle + radius);
}

// One root lies between neighbouring turns each, and beyond the outer ones.
fn roots_between(p: array<f32, MOST_ROOTS>, n: u32, turns: array<f32, MOST_ROOTS>) -> array<f32, MOST_ROOTS> {
    var at = turns;
    var roots: array<f32, MOST_ROOTS>;
    let bounds = bounds_of_roots(p, n);
    var low = min(bounds.x, at[0]);
    for (var i = 0u; i < n; i++) {
        var high = max(bounds.y, low);
        if i + 1u < n {
            high = at[i];
        }
        roots[i] = root_between(p, n, low, high);
        low = high;
    }
    return roots;
}

// The roots of a monic polynomial of degree 2, 3 or 4, coefficients ascending without the leading one.
fn real_roots(p: array<f32, MOST_ROOTS>, n: u32) -> array<f32, MOST_ROOTS> {
    var turns: array<f32, MOST_ROOTS>;
    if n == 2u {
        let two = roots_of_quadratic(p[0], p[1]);
        turns[0] = two.x;
        turns[1] = two.y;
        return turns;
    }
    var slope = p;
    if n == 4u {
        slope = array<f32, MOST_ROOTS>(p[1] / 4.0, p[2] / 2.0, 0.75 * p[3], 0.0);
    }
    let two = roots_of_quadratic(slope[1] / 3.0, 2.0 / 3.0 * slope[2]);
    turns[0] = two.x;
    turns[1] = two.y;
    turns = roots_between(slope, 3u, turns);
    if n == 4u {
        turns = roots_between(p, 4u, turns);
    }
    return turns;
}
