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

// Over a list that is sorted already.
@compute @workgroup_size(8, 8)
fn resolve(@builtin(global_invocation_id) id: vec3u) {
    if is_outside(id) {
        return;
    }
    let list = list_of(pixel_of(id));
    let samples = f32(params.samples);
    var color = vec3f(0.0);
    var covered = 0u;
    for (var i = 0u; i < list.y && covered < params.samples; i++) {
        let fragment = colors[list.x + i];
        let coverage = coverage_of(fragment.a);
        if coverage > covered {
            color += f32(coverage - covered) / samples * unmultiplied(fragment);
            covered = coverage;
        }
    }
    let open = f32(params.samples - covered) / samples;
    store(id, color + open * background_at(pixel_of(id)), open);
}
