// Hybrid transparency (Maule et al. 2013): the nearest fragments exactly, the others as one average behind them.

struct Params {
    // the tail is so many of its mean fragments, as common implementations have it; also those that are not there count
    counted: u32,
    // core and tail are scaled together to what all fragments cover (W16 eq. 9)
    global: u32,
}

@group(0) @binding(3) var<uniform> params: Params;

// the core, nearest first
var<private> core_keys: array<vec2u, LAYERS + 1u>;
var<private> core_colors: array<vec4f, LAYERS + 1u>;
var<private> core_count: u32;
// the tail, and its number of fragments
var<private> tail: Sums;
var<private> tail_count: u32;

// Inserts a fragment among the nearest. Whatever there is no room for goes into the tail.
fn receive(key: vec2u, color: vec4f) {
    var place = core_count;
    while place > 0u && comes_before_by_depth(key, core_keys[place - 1u]) {
        core_keys[place] = core_keys[place - 1u];
        core_colors[place] = core_colors[place - 1u];
        place--;
    }
    core_keys[place] = key;
    core_colors[place] = color;
    if core_count < LAYERS {
        core_count++;
        return;
    }
    tail = with_fragment(tail, 1.0, core_colors[LAYERS]);
    tail_count++;
}

// What the tail covers and leaves.
fn shares_of_tail() -> vec2f {
    if params.counted == 0u {
        return vec2f(tail.coverage, tail.transmittance);
    }
    return repeated(min(tail.weighted.a / max(f32(tail_count), 1.0), 1.0), tail_count);
}

// What core and tail show together, and their shares: the tail's average is behind the core, or all of it is scaled.
fn composite(core: vec3f, core_shares: vec2f) -> vec4f {
    let behind = shares_of_tail();
    let all = under(core_shares, behind);
    let sums = min(tail.weighted, vec4f(LARGEST));
    if params.global != 0u {
        let covered = core_shares.x + core_shares.y * sums.a;
        let sum = min(core + core_shares.y * sums.rgb, vec3f(LARGEST));
        return vec4f(select(vec3f(0.0), all.x / covered * sum, covered > 0.0), all.y);
    }
    let average = select(vec3f(0.0), behind.x / sums.a * sums.rgb, sums.a > 0.0);
    return vec4f(core + core_shares.y * average, all.y);
}

fn begin(pixel: vec2u) {
    core_count = 0u;
    tail = NO_SUMS;
    tail_count = 0u;
}

fn take(fragment: Fragment) {
    receive(key_of(fragment), rgba(fragment));
}

fn finish(id: vec3u) {
    var core = vec3f(0.0);
    var shares = vec2f(0.0, 1.0);
    for (var i = 0u; i < core_count; i++) {
        core += shares.y * core_colors[i].rgb;
        shares = under(shares, vec2f(core_colors[i].a, 1.0 - core_colors[i].a));
    }
    let all = composite(min(core, vec3f(LARGEST)), shares);
    store(id, all.rgb + all.a * background_at(pixel_of(id)), all.a);
}
