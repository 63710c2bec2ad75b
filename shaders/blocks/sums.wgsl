// Weighted sums of fragments, and what meets the background then.

struct Sums {
    // of w C and w a
    weighted: vec4f,
    // what all fragments cover together, and what they leave: each is precise where it is small
    coverage: f32,
    transmittance: f32,
}

const NO_SUMS = Sums(vec4f(0.0), 0.0, 1.0);

fn with_fragment(sums: Sums, weight: f32, fragment: vec4f) -> Sums {
    let coverage = sums.coverage + sums.transmittance * fragment.a;
    return Sums(sums.weighted + weight * fragment, coverage, sums.transmittance * (1.0 - fragment.a));
}

// The average colour where there is one.
fn average_of(weighted: vec4f) -> vec3f {
    let sums = min(weighted, vec4f(LARGEST));
    return select(vec3f(0.0), min(sums.rgb / sums.a, vec3f(LARGEST)), sums.a > 0.0);
}

// The average covers what all fragments cover of the background (MB13 eq. 6): colour, and the background's share.
fn over_background(sums: Sums, background: vec3f) -> vec4f {
    let color = sums.coverage * average_of(sums.weighted) + sums.transmittance * background;
    return vec4f(color, sums.transmittance);
}

// Weights of second passes where the average counts, so that a stack behind which nothing can be seen still has a colour.
const LEAST_SEEN = 1e-30;

const AS_SEEN = 0u;
const EXACT_BACKGROUND = 1u;
const NORMALIZED = 2u;

// The weight of a fragment of which `seen` is to be seen, for a composite of that kind.
fn weight_seen(composite: u32, seen: f32) -> f32 {
    return select(seen, max(seen, LEAST_SEEN), composite == NORMALIZED);
}

// The sums of a second pass over the background, of which `total` is to be seen.
fn composite_sums(composite: u32, sums: Sums, total: f32, background: vec3f) -> vec4f {
    if composite == NORMALIZED {
        return over_background(sums, background);
    }
    let share = select(total, sums.transmittance, composite == EXACT_BACKGROUND);
    return vec4f(min(sums.weighted.rgb, vec3f(LARGEST)) + share * background, share);
}

// The colour of a fragment that covers something.
fn unmultiplied(fragment: vec4f) -> vec3f {
    return min(fragment.rgb / fragment.a, vec3f(LARGEST));
}
