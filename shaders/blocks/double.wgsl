// Sums of two f32, for what one f32 cannot hold. Compilers take (a + b) - a for b, which it is not here: what they must not look
// through goes by `unseen`. Contracting a product and a sum into one operation changes nothing, since the products are exact.

fn unseen(x: f32) -> f32 {
    return bitcast<f32>(bitcast<u32>(x) ^ frame.zero);
}

// a + b, and what rounding took away from it (Knuth 1969).
fn two_sum(a: f32, b: f32) -> vec2f {
    let sum = unseen(a + b);
    let part = unseen(sum - a);
    return vec2f(sum, unseen(a - unseen(sum - part)) + unseen(b - part));
}

// The same where b is small beside a, or has digits that nobody will miss.
fn quick_two_sum(a: f32, b: f32) -> vec2f {
    let sum = unseen(a + b);
    return vec2f(sum, b - unseen(sum - a));
}

// The first half of a number's digits: products of halves are exact.
fn upper_half(x: f32) -> f32 {
    return bitcast<f32>(bitcast<u32>(x) & 0xfffff000u);
}

// at + x d.x + y d.y for whole d. Numbers come in three parts, of which the first two are whole multiples of a step: one for
// each part, of which no sum has 2^24, so that none is rounded.
fn linear(at: vec3f, x: vec3f, y: vec3f, d: vec2f) -> vec2f {
    let parts = at + (x * d.x + y * d.y);
    let sum = two_sum(parts.x, parts.y);
    return quick_two_sum(sum.x, sum.y + parts.z);
}

// 1 / x, rounded once but for one time in thousands.
fn reciprocal(x: vec2f) -> f32 {
    let q = unseen(1.0 / x.x);
    let q_upper = upper_half(q);
    let q_lower = unseen(q - q_upper);
    let x_upper = upper_half(x.x);
    let x_lower = unseen(x.x - x_upper);
    var residual = unseen(1.0 - q_upper * x_upper);
    residual = unseen(residual - q_upper * x_lower);
    residual = unseen(residual - q_lower * x_upper);
    residual = unseen(residual - q_lower * x_lower);
    return q + q * unseen(residual - q * x.y);
}

// a b, and what rounding took away from it (Dekker 1971).
fn two_product(a: f32, b: f32) -> vec2f {
    let product = unseen(a * b);
    let a_upper = upper_half(a);
    let a_lower = unseen(a - a_upper);
    let b_upper = upper_half(b);
    let b_lower = unseen(b - b_upper);
    let upper = unseen(unseen(a_upper * b_upper) - product);
    let middle = unseen(unseen(upper + unseen(a_upper * b_lower)) + unseen(a_lower * b_upper));
    return vec2f(product, unseen(middle + unseen(a_lower * b_lower)));
}

fn sum_of(a: vec2f, b: vec2f) -> vec2f {
    let sum = two_sum(a.x, b.x);
    return two_sum(sum.x, sum.y + (a.y + b.y));
}

// a k, for a k of one part.
fn times(a: vec2f, k: f32) -> vec2f {
    let product = two_product(a.x, k);
    return two_sum(product.x, product.y + a.y * k);
}

// a / b.
fn quotient(a: vec2f, b: vec2f) -> vec2f {
    let first = unseen(a.x / b.x);
    let rest = sum_of(a, -times(b, first));
    return two_sum(first, rest.x / b.x);
}

fn is_less(a: vec2f, b: vec2f) -> bool {
    return a.x < b.x || (a.x == b.x && a.y < b.y);
}

fn product_of(a: vec2f, b: vec2f) -> vec2f {
    let product = two_product(a.x, b.x);
    return two_sum(product.x, product.y + (a.x * b.y + a.y * b.x));
}
