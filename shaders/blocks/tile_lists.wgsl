// Lists as tiles fill them, in place of a technique's stream: a pixel's fragments in the order in which they are drawn. One pass
// counts them, and another stores each where there is room. The buffers are those of lists, which have them in group 2.

@group(3) @binding(0) var<storage, read_write> list_counts: array<u32>;
@group(3) @binding(1) var<storage, read_write> list_places: array<u32>;
@group(3) @binding(4) var<storage, read_write> list_keys: array<vec2u>;
@group(3) @binding(5) var<storage, read_write> list_colors: array<vec4f>;

// What is added to the count of a list whose pass was cut short.
const UNFINISHED_LIST = 0x80000000u;

override stores: bool = false;

// where the next fragment goes; of those that are only counted, how many there are
var<private> next_place: u32;

fn begin(pixel: vec2u) {
    next_place = 0u;
    if stores {
        next_place = list_places[place_of(pixel)];
    }
}

fn take(fragment: Fragment) {
    if stores && next_place < arrayLength(&list_keys) {
        list_keys[next_place] = key_of(fragment);
        list_colors[next_place] = vec4f(fragment.color, fragment.alpha);
    }
    next_place++;
}

fn finish(id: vec3u) {
    let place = place_of(pixel_of(id));
    if stores {
        list_places[place] = next_place;
    } else {
        list_counts[place] = next_place;
    }
    if is_cut_short() {
        list_counts[place] |= UNFINISHED_LIST;
    }
}
