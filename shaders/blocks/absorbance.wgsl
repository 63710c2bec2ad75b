// Absorbance: the logarithm of transmittance, in which layers add up.

// -ln(1 - alpha), at most s_max; precise for faint fragments, too, of which 1 - alpha has lost most digits.
fn absorbance_of(alpha: f32, s_max: f32) -> f32 {
    if alpha > 0.5 {
        return min(select(s_max, -log(1.0 - alpha), alpha < 1.0), s_max);
    }
    // 2 artanh x
    let x = alpha / (2.0 - alpha);
    let square = x * x;
    var series = 0.0;
    for (var n = 13.0; n > 0.0; n -= 2.0) {
        series = series * square + 1.0 / n;
    }
    return min(2.0 * x * series, s_max);
}

fn seen_through(absorbance: f32) -> f32 {
    return exp(-max(absorbance, 0.0));
}
