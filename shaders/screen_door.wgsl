// Screen-door transparency (Fuchs et al. 1985): a fragment covers those of a pixel's samples whose threshold (s + 1/2) / S its
// alpha exceeds. Masks are nested, so front to back it shows in as many as it covers more than what is in front of it.

struct Params {
    samples: u32,
}

@group(0) @binding(3) var<uniform> params: Params;

// How many thresholds an alpha exceeds.
fn coverage_of(alpha: f32) -> u32 {
    let share = exactly(alpha, params.samples);
    let half = 0x80000000u;
    return share.whole + select(0u, 1u, share.fraction > half || (share.fraction == half && share.more));
}

// samples that are covered, and their colours
var<private> covered: u32;
var<private> color: vec3f;

fn begin(pixel: vec2u) {
    covered = 0u;
    color = vec3f(0.0);
}

// Nearest first.
fn take(fragment: Fragment) {
    let coverage = coverage_of(fragment.alpha);
    if coverage > covered {
        color += f32(coverage - covered) / f32(params.samples) * unmultiplied(rgba(fragment));
        covered = coverage;
    }
    is_done = covered >= params.samples;
}

fn finish(id: vec3u) {
    let open = f32(params.samples - covered) / f32(params.samples);
    store(id, color + open * background_at(pixel_of(id)), open);
}
