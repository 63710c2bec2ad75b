// Deep shadow maps (Lokovic & Veach 2000): a pixel's transmittance is a curve of two vertices per fragment, its front and its
// back; it is compressed to a polyline, through which the fragments are seen. Lists come sorted, so that a vertex is known by
// its fragment's place, and the polyline need not be kept: what lies in front of a vertex is looked at when it is found.

struct Params {
    // vertices that are kept; 0: as many as keep within eps of the curve
    vertices: u32,
    eps: f32,
    composite: u32,
}

@group(0) @binding(3) var<uniform> params: Params;

struct Vertex {
    // twice its fragment's place, one more for the back
    label: u32,
    depth: f32,
    transmittance: f32,
}

// the last vertex of the polyline, and the place of the first fragment that is not in front of it
var<private> last: Vertex;
var<private> next: u32;
// what has been seen so far
var<private> sums: Sums;

fn depth_of_place(place: u32) -> f32 {
    return bitcast<f32>(keys[place].x);
}

fn is_nothing(place: u32) -> bool {
    return all(colors[place] == vec4f(0.0));
}

fn look_at_next(seen: f32) {
    sums = with_fragment(sums, weight_seen(params.composite, clamp(seen, 0.0, 1.0)), colors[next]);
    next++;
}

// Puts a vertex at the polyline's end; transmittance does not rise, whatever compression made of it.
fn put_vertex(vertex: Vertex) {
    let end = Vertex(vertex.label, vertex.depth, min(last.transmittance, vertex.transmittance));
    while 2u * next < end.label {
        let z = depth_of_place(next);
        var seen = end.transmittance;
        if z == last.depth {
            seen = last.transmittance;
        } else if z < end.depth {
            seen = mix(last.transmittance, end.transmittance, (z - last.depth) / (end.depth - last.depth));
        }
        look_at_next(seen);
    }
    last = end;
}

// a segment under construction: where it begins, and the least and greatest slope that keep it within eps of the curve
var<private> origin: Vertex;
var<private> slopes: vec2f;

const STEEPEST = 1e30;

fn begin_segment(vertex: Vertex) {
    origin = vertex;
    slopes = vec2f(-STEEPEST, STEEPEST);
}

// Goes on to a vertex of the curve, if that keeps the segment within eps.
fn extend_to(vertex: Vertex) -> bool {
    let step = vertex.transmittance - origin.transmittance;
    let length = vertex.depth - origin.depth;
    if length == 0.0 {
        return abs(step) <= params.eps;
    }
    let narrowed = vec2f(max(slopes.x, (step - params.eps) / length), min(slopes.y, (step + params.eps) / length));
    if narrowed.x > narrowed.y {
        return false;
    }
    slopes = narrowed;
    return true;
}

// Ends the segment at a face, with the middle slope; there is none without length.
fn end_segment(label: u32, depth: f32) {
    let length = depth - origin.depth;
    if length > 0.0 {
        let middle = 0.5 * (slopes.x + slopes.y);
        let end = Vertex(label, depth, origin.transmittance + middle * length);
        put_vertex(end);
        begin_segment(end);
    }
}

// The greedy compressor, one vertex of the curve at a time; `before` is the one before it.
fn compress(before: Vertex, vertex: Vertex) {
    if extend_to(vertex) {
        return;
    }
    end_segment(before.label, before.depth);
    if !extend_to(vertex) {
        put_vertex(vertex);
        begin_segment(vertex);
    }
}

fn keep_within_eps(ends: vec2u) {
    var before = last;
    begin_segment(before);
    for (var place = ends.x; place < ends.y; place++) {
        if is_nothing(place) {
            continue;
        }
        let front = Vertex(2u * place, depth_of_place(place), before.transmittance);
        let back = Vertex(front.label + 1u, front.depth, front.transmittance * (1.0 - colors[place].a));
        compress(before, front);
        compress(front, back);
        before = back;
    }
    end_segment(before.label, before.depth);
}

// Twice the area of the triangle of three neighbours: what removing the middle one changes.
fn triangle(a: Vertex, b: Vertex, c: Vertex) -> f32 {
    let to_c = vec2f(c.depth - a.depth, c.transmittance - a.transmittance);
    let from_b = vec2f(c.depth - b.depth, c.transmittance - b.transmittance);
    return abs(to_c.x * from_b.y - from_b.x * to_c.y);
}

// Primitives are not asked for any more: bit 0 of theirs says that the fragment's front is gone, bit 1 that its back is.

// the last two vertices of a walk along what is left of the curve, how many it has passed, and the vertex of the smallest triangle
var<private> before_last: Vertex;
var<private> last_left: Vertex;
var<private> passed: u32;
var<private> least: u32;
var<private> least_area: f32;

fn pass_vertex(vertex: Vertex) {
    if passed >= 2u {
        let area = triangle(before_last, last_left, vertex);
        if area < least_area {
            least_area = area;
            least = last_left.label;
        }
    }
    before_last = last_left;
    last_left = vertex;
    passed++;
}

// Removes the vertex of the smallest triangle, the nearest of several; the curve's ends stay.
fn remove_least(ends: vec2u) {
    passed = 0u;
    least_area = LARGEST;
    var transmittance = 1.0;
    for (var place = ends.x; place < ends.y; place++) {
        let gone = keys[place].y;
        let depth = depth_of_place(place);
        if (gone & 1u) == 0u {
            pass_vertex(Vertex(2u * place, depth, transmittance));
        }
        transmittance *= 1.0 - colors[place].a;
        if (gone & 2u) == 0u {
            pass_vertex(Vertex(2u * place + 1u, depth, transmittance));
        }
    }
    keys[least / 2u].y |= 1u << (least % 2u);
}

fn keep_so_many(ends: vec2u) {
    var count = 0u;
    for (var place = ends.x; place < ends.y; place++) {
        let nothing = is_nothing(place);
        keys[place].y = select(0u, 3u, nothing);
        count += select(2u, 0u, nothing);
    }
    for (; count > params.vertices; count--) {
        remove_least(ends);
    }
    var transmittance = 1.0;
    for (var place = ends.x; place < ends.y; place++) {
        let gone = keys[place].y;
        let depth = depth_of_place(place);
        if (gone & 1u) == 0u {
            put_vertex(Vertex(2u * place, depth, transmittance));
        }
        transmittance *= 1.0 - colors[place].a;
        if (gone & 2u) == 0u {
            put_vertex(Vertex(2u * place + 1u, depth, transmittance));
        }
    }
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
    sums = NO_SUMS;
    next = ends.x;
    // the first fragment's front
    last = Vertex(2u * ends.x, depth_of_place(ends.x), 1.0);
    if params.vertices == 0u {
        keep_within_eps(ends);
    } else {
        keep_so_many(ends);
    }
    while next < ends.y {
        look_at_next(last.transmittance);
    }
    let all = composite_sums(params.composite, sums, max(last.transmittance, 0.0), background);
    store(id, all.rgb, all.a);
}
