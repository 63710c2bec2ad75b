// A tile's fragments as a stream in the order of depth, without lists: each walk over the tile finds the next few, as peeling
// does, and then hands them over.

struct InWindow {
    key: vec2u,
    color: vec4f,
}

const WINDOW_SIZE = 16u;

// the next ones so far, and one that is pushed out
var<private> window: array<InWindow, WINDOW_SIZE + 1u>;
var<private> window_count: u32;
// the last one that was handed over, if any was
var<private> last_handed_over: vec2u;
var<private> is_behind_last: bool;
var<private> pixel_at_hand: vec2u;

// So many of a pixel's fragments that do something are kept, the first that are drawn.
override capacity: u32 = 0xffffffff;
var<private> met_count: u32;
var<private> has_counted: bool;

fn comes_first(a: vec2u, b: vec2u) -> bool {
    return select(comes_before_by_depth(a, b), comes_before_by_depth(b, a), backwards);
}

fn meet(fragment: Fragment) {
    met_count++;
    if met_count > capacity {
        return;
    }
    let key = key_of(fragment);
    if is_behind_last && !comes_first(last_handed_over, key) {
        return;
    }
    pixel_at_hand = fragment.pixel;
    var place = window_count;
    while place > 0u && comes_first(key, window[place - 1u].key) {
        window[place] = window[place - 1u];
        place--;
    }
    window[place] = InWindow(key, vec4f(fragment.color, fragment.alpha));
    window_count = min(window_count + 1u, WINDOW_SIZE);
}

// The end of a walk: every fragment has been met.
fn end_of_walk() {
    if met_count > capacity && !has_counted {
        atomicAdd(&counters[DROPPED], met_count - capacity);
        has_counted = true;
    }
    met_count = 0u;
}

// At the end of a walk over the tile: whether the pixel wants another.
fn wants_more() -> bool {
    end_of_walk();
    for (var i = 0u; i < window_count && !is_done; i++) {
        let seen = window[i];
        take(Fragment(pixel_at_hand, bitcast<f32>(seen.key.x), seen.color.rgb, seen.color.a, seen.key.y));
    }
    if window_count == WINDOW_SIZE && !is_done {
        last_handed_over = window[WINDOW_SIZE - 1u].key;
        is_behind_last = true;
        window_count = 0u;
        return true;
    }
    is_behind_last = false;
    window_count = 0u;
    is_done = false;
    let wants = again();
    walk++;
    return wants;
}
