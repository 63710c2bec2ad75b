// Lists, samples and bins of the continuum: fragments that are not stored are marked, in the order of submission; then all are
// sorted, those that are stored first, and looked at front to back.

const LOST = 0x80000000u;

fn is_lost(place: u32) -> bool {
    return (keys[place].x & LOST) != 0u;
}

// the depths that bins divide
var<private> range: vec2f;

fn bin_of(key: vec2u) -> u32 {
    if range.y <= range.x {
        return 0u;
    }
    let position = clamp((depth_in(key) - range.x) / (range.y - range.x), 0.0, 1.0);
    return min(u32(position * f32(params.bins)), params.bins - 1u);
}

fn find_range(list: vec2u) {
    range = vec2f(params.nearest, params.farthest);
    if params.range_of_pixel == 0u {
        return;
    }
    range = vec2f(LARGEST, 0.0);
    for (var place = list.x; place < list.x + list.y; place++) {
        if !is_nothing(colors[place]) {
            let depth = depth_in(keys[place]);
            range = vec2f(min(range.x, depth), max(range.y, depth));
        }
    }
}

// Whether one of two fragments hides the other: by its place, or by its bin where bins are merged.
fn hides(front: u32, behind: u32) -> bool {
    if params.merge == SUM || params.merge == AVERAGE {
        return bin_of(keys[front]) < bin_of(keys[behind]);
    }
    return comes_before_by_depth(keys[front], keys[behind]);
}

// Whether chance lets the i-th fragment of a list in, given those before.
fn shows_behind_stored(list: vec2u, i: u32, place: u32) -> bool {
    if params.covers_samples == 0u && params.masking.bits == 0u {
        return true;
    }
    var shown = 1.0;
    covered = Mask();
    for (var j = 0u; j < i; j++) {
        let other = place_in(list, j, params.backwards);
        if is_lost(other) || !hides(other, place) {
            continue;
        }
        if params.covers_samples != 0u {
            draw_mask(params.masking, pixel, keys[other].y, colors[other].a);
            cover_drawn();
        } else {
            shown *= 1.0 - colors[other].a;
        }
    }
    if params.covers_samples != 0u {
        draw_mask(params.masking, pixel, keys[place].y, colors[place].a);
        return count_visible() > 0u;
    }
    return shows_by_chance(params.masking, pixel, keys[place].y, shown, colors[place].a);
}

fn passes(list: vec2u, i: u32, place: u32) -> bool {
    switch params.insertion {
        case THRESHOLD: {
            return colors[place].a > params.threshold;
        }
        case NEAREST: {
            return is_among_nearest(keys[place]);
        }
        case STOCHASTIC: {
            // samples take any fragment, and the depth test decides
            return params.merge == DISCARD_OCCLUDED || shows_behind_stored(list, i, place);
        }
        default: {
            return true;
        }
    }
}

// Of two fragments in a bin the further one is lost.
fn keep_nearer(list: vec2u, i: u32, place: u32) {
    for (var j = 0u; j < i; j++) {
        let other = place_in(list, j, params.backwards);
        if !is_lost(other) && bin_of(keys[other]) == bin_of(keys[place]) {
            let further = select(place, other, comes_before_by_depth(keys[place], keys[other]));
            keys[further].x |= LOST;
            return;
        }
    }
}

// Decides for each fragment, in the order of submission, whether it is stored.
fn sort_out(list: vec2u) {
    find_range(list);
    nearest_count = 0u;
    for (var i = 0u; i < list.y; i++) {
        let place = place_in(list, i, params.backwards);
        let nothing = is_nothing(colors[place]);
        let covers_nothing = params.covers_samples != 0u && colors[place].a <= 0.0;
        if nothing || !passes(list, i, place) || covers_nothing {
            keys[place].x |= LOST;
        } else if params.merge == DISCARD_OCCUPIED && params.insertion == STOCHASTIC {
            // what is lost hides nobody any more; where that makes no difference, it shows when lists are sorted
            keep_nearer(list, i, place);
        }
    }
    if list.y <= FEW {
        insertion_sort(list.x, list.y);
    } else {
        heap_sort(list.x, list.y);
    }
}

// How many of a list are stored.
fn count_stored(list: vec2u) -> u32 {
    var count = 0u;
    while count < list.y && !is_lost(list.x + count) {
        count++;
    }
    return count;
}

fn unmarked_key(place: u32) -> vec2u {
    return vec2u(keys[place].x & ~LOST, keys[place].y);
}

// samples that nothing covers
var<private> open: u32;

// How many thresholds (s + 1/2) / S an alpha exceeds.
fn thresholds_below(alpha: f32) -> u32 {
    let share = exactly(alpha, params.samples);
    let half = 0x80000000u;
    return share.whole + u32(share.fraction > half || (share.fraction == half && share.more));
}

// How many open samples a fragment takes: those of its random mask, or of nested ones.
fn take_samples(place: u32, alpha: f32) -> u32 {
    if params.insertion == STOCHASTIC || params.merge != DISCARD_OCCLUDED {
        draw_mask(params.masking, pixel, keys[place].y, alpha);
        let visible = count_visible();
        cover_drawn();
        return visible;
    }
    let taken = params.samples - open;
    return max(thresholds_below(alpha), taken) - taken;
}

// Puts a stored fragment behind those before it, and says whether it shows.
fn put_behind(place: u32) -> bool {
    let fragment = as_stored(colors[place]);
    if params.covers_samples == 0u {
        core_color += core.y * fragment.rgb;
        core = under(core, vec2f(fragment.a, 1.0 - fragment.a));
        return true;
    }
    let visible = take_samples(place, fragment.a);
    open -= visible;
    let all = f32(params.samples);
    core_color += f32(visible) / all * unmultiplied(fragment);
    core = vec2f(f32(params.samples - open), f32(open)) / all;
    return visible > 0u;
}

@compute @workgroup_size(8, 8)
fn resolve_lists(@builtin(global_invocation_id) id: vec3u) {
    if is_outside(id) {
        return;
    }
    let list = begin_pixel(id);
    sort_out(list);
    begin_core();
    covered = Mask();
    open = params.samples;
    let is_samples = params.merge == DISCARD_OCCLUDED;
    // one behind the last fragment's bin
    var occupied = 0u;
    let end = list.x + list.y;
    var stored = list.x;
    let lost_first = list.x + count_stored(list);
    var lost = lost_first;
    // both are in the order of depth
    while stored < lost_first || lost < end {
        let seen = core.y;
        if lost == end || (stored < lost_first && comes_before_by_depth(keys[stored], unmarked_key(lost))) {
            let bin = bin_of(keys[stored]) + 1u;
            let is_kept = params.merge != DISCARD_OCCUPIED || bin != occupied;
            occupied = bin;
            let shows = is_kept && put_behind(stored);
            add_fragment(colors[stored], depth_in(keys[stored]), seen, is_kept && (shows || !is_samples));
            stored++;
        } else {
            add_fragment(colors[lost], depth_in(unmarked_key(lost)), seen, false);
            lost++;
        }
    }
    store_core(id, is_samples);
}
