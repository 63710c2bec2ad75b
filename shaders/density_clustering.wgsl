// Density clustering (Mertens et al. 2004): k-means along the ray; the absorbance of each cluster is spread evenly over a depth
// interval of its mean and variance. CLUSTERS is a constant that the form sets.

struct Params {
    iterations: u32,
    s_max: f32,
    composite: u32,
}

@group(0) @binding(3) var<uniform> params: Params;

// A cluster narrower than this part of the pixel's depths is a step; as far behind it lies what it hides.
const SLACK = 1e-4;

// nearest first: intervals of the ray keep their order when their centres move to their means
var<private> centers: array<f32, CLUSTERS>;
var<private> means: array<f32, CLUSTERS>;
var<private> absorbed: array<f32, CLUSTERS>;
// of s (d - mean)^2; then the interval's width, 0 for a step
var<private> widths: array<f32, CLUSTERS>;

// the pixel's nearest depth, and the distance from there to the farthest
var<private> nearest: f32;
var<private> extent: f32;

// Where a fragment is among the pixel's.
fn position_of(place: u32) -> f32 {
    let behind = bitcast<f32>(keys[place].x) - nearest;
    return select(behind / extent, 0.0, behind == 0.0);
}

// The cluster with the nearest centre, the nearer to the eye of two, where `behind` centres are in front of the position.
fn nearest_of(behind: u32, d: f32) -> u32 {
    let before = max(behind, 1u) - 1u;
    let after = min(behind, CLUSTERS - 1u);
    return select(after, before, abs(centers[before] - d) <= abs(centers[after] - d));
}

// How many centres are in front of a position, if `behind` are in front of one before it.
fn count_in_front(behind: u32, d: f32) -> u32 {
    var count = behind;
    while count < CLUSTERS && centers[count] < d {
        count++;
    }
    return count;
}

// One pass: every fragment to its cluster. The list is sorted.
fn gather(ends: vec2u) {
    for (var j = 0u; j < CLUSTERS; j++) {
        absorbed[j] = 0.0;
        means[j] = 0.0;
    }
    var behind = 0u;
    for (var place = ends.x; place < ends.y; place++) {
        let d = position_of(place);
        behind = count_in_front(behind, d);
        let own = nearest_of(behind, d);
        let s = absorbance_of(colors[place].a, params.s_max);
        absorbed[own] += s;
        means[own] += s * d;
    }
    for (var j = 0u; j < CLUSTERS; j++) {
        means[j] = select(centers[j], means[j] / absorbed[j], absorbed[j] > 0.0);
    }
}

// The intervals, of which the centres are those that gathered: variances about the means do not cancel.
fn spread(ends: vec2u) {
    for (var j = 0u; j < CLUSTERS; j++) {
        widths[j] = 0.0;
    }
    var behind = 0u;
    for (var place = ends.x; place < ends.y; place++) {
        let d = position_of(place);
        behind = count_in_front(behind, d);
        let own = nearest_of(behind, d);
        let off = d - means[own];
        widths[own] += absorbance_of(colors[place].a, params.s_max) * off * off;
    }
    for (var j = 0u; j < CLUSTERS; j++) {
        var deviation = 0.0;
        if absorbed[j] > 0.0 {
            deviation = sqrt(widths[j] / absorbed[j]);
        }
        widths[j] = select(0.0, 2.0 * sqrt(3.0) * deviation, deviation >= SLACK);
    }
}

fn cluster(ends: vec2u) {
    for (var j = 0u; j < CLUSTERS; j++) {
        centers[j] = (f32(j) + 0.5) / f32(CLUSTERS);
    }
    for (var i = 1u; ; i++) {
        gather(ends);
        var moved = false;
        for (var j = 0u; j < CLUSTERS; j++) {
            moved = moved || means[j] != centers[j];
        }
        if i >= params.iterations || !moved {
            break;
        }
        centers = means;
    }
    spread(ends);
}

// What is to be seen of a position.
fn seen_at(d: f32) -> f32 {
    var tau = 0.0;
    for (var j = 0u; j < CLUSTERS; j++) {
        let off = d - means[j];
        if widths[j] > 0.0 {
            tau += absorbed[j] * clamp(off / widths[j] + 0.5, 0.0, 1.0);
        } else if off > SLACK {
            tau += absorbed[j];
        }
    }
    return seen_through(tau);
}

@compute @workgroup_size(8, 8)
fn resolve(@builtin(global_invocation_id) id: vec3u) {
    if is_outside(id) {
        return;
    }
    let background = background_at(pixel_of(id));
    let ends = ends_of(list_of(pixel_of(id)));
    if ends.x == ends.y {
        store(id, background, 1.0);
        return;
    }
    nearest = bitcast<f32>(keys[ends.x].x);
    extent = bitcast<f32>(keys[ends.y - 1u].x) - nearest;
    cluster(ends);
    var tau = 0.0;
    for (var j = 0u; j < CLUSTERS; j++) {
        tau += absorbed[j];
    }
    var sums = NO_SUMS;
    for (var place = ends.x; place < ends.y; place++) {
        let seen = seen_at(position_of(place));
        sums = with_fragment(sums, weight_seen(params.composite, seen), colors[place]);
    }
    let all = composite_sums(params.composite, sums, seen_through(tau), background);
    store(id, all.rgb, all.a);
}
