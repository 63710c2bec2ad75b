// Adaptive volumetric shadow maps (Salvi et al. 2010): the transmittance as a polyline of at most LAYERS vertices, and every
// fragment seen through it.

struct Params {
    composite: u32,
    // depth over which a fragment's absorption is spread, in two parts
    thickness: f32,
    thickness_rest: f32,
}

@group(0) @binding(3) var<uniform> params: Params;

// what reaches each vertex, nearest first, and which face of which fragment the vertex is; a fragment brings two of them
var<private> faces: array<vec2u, LAYERS + 2u>;
var<private> reaching: array<f32, LAYERS + 2u>;
var<private> vertex_count: u32;

// A face of a fragment, in the order in which a ray meets faces: by depth, which is not negative, then by primitive, a front
// before a back.
fn face_of(depth: f32, primitive: u32, back: u32) -> vec2u {
    return vec2u((bitcast<u32>(depth) << 1u) | (primitive >> 31u), (primitive << 1u) | back);
}

fn depth_of_face(face: vec2u) -> f32 {
    return bitcast<f32>(face.x >> 1u);
}

// Where a fragment ends, rounded once; what is beyond all depths is the largest.
fn end_of(depth: f32) -> f32 {
    if depth >= LARGEST - params.thickness {
        return LARGEST;
    }
    let sum = two_sum(depth, params.thickness);
    return sum.x + (sum.y + params.thickness_rest);
}

// How many vertices are not behind a face.
fn vertices_up_to(face: vec2u) -> u32 {
    var count = vertex_count;
    while count > 0u && comes_before_by_depth(face, faces[count - 1u]) {
        count--;
    }
    return count;
}

// What reaches a face, given how many vertices are not behind it. On a vertical edge, it is what reaches the vertex in
// front of it there, or else the one behind.
fn reaching_face(face: vec2u, in_front: u32) -> f32 {
    if in_front == 0u {
        return 1.0;
    }
    let depth = depth_of_face(face);
    let near = depth_of_face(faces[in_front - 1u]);
    let at_near = reaching[in_front - 1u];
    if near == depth || in_front == vertex_count {
        return at_near;
    }
    let far = depth_of_face(faces[in_front]);
    let at_far = reaching[in_front];
    if far == depth {
        return at_far;
    }
    return clamp(at_near + (depth - near) / (far - near) * (at_far - at_near), 0.0, 1.0);
}

// Puts a fragment into the polyline: its two faces; what is inside lets through less the deeper it is, what is behind,
// as little as the whole fragment.
fn add_fragment(key: vec2u, alpha: f32) {
    let depth = bitcast<f32>(key.x);
    let end = end_of(depth);
    let front = face_of(depth, key.y, 0u);
    let back = face_of(end, key.y, 1u);
    let first = vertices_up_to(front);
    let last = vertices_up_to(back);
    let at_front = reaching_face(front, first);
    let at_back = (1.0 - alpha) * reaching_face(back, last);
    // from behind, since faces move by two places there and by one inside
    for (var i = vertex_count; i > last; i--) {
        faces[i + 1u] = faces[i - 1u];
        reaching[i + 1u] = (1.0 - alpha) * reaching[i - 1u];
    }
    for (var i = last; i > first; i--) {
        let inside = select(0.0, (depth_of_face(faces[i - 1u]) - depth) / (end - depth), end > depth);
        faces[i] = faces[i - 1u];
        reaching[i] = (1.0 - inside * alpha) * reaching[i - 1u];
    }
    faces[first] = front;
    reaching[first] = at_front;
    faces[last + 1u] = back;
    reaching[last + 1u] = at_back;
    vertex_count += 2u;
}

// Twice the area of the triangle of a vertex and its neighbours, which its removal would add or take. Products that are equal
// cancel, also where a device could do one of them together with the difference.
fn area_at(i: u32) -> f32 {
    let depth = depth_of_face(faces[i]);
    let left = vec2f(depth - depth_of_face(faces[i - 1u]), reaching[i] - reaching[i - 1u]);
    let right = vec2f(depth_of_face(faces[i + 1u]) - depth, reaching[i + 1u] - reaching[i]);
    return abs(unseen(left.x * right.y) - unseen(right.x * left.y));
}

// Removes the inner vertex of the smallest area, the nearest of several.
fn remove_least() {
    var least = LARGEST;
    var found = 1u;
    for (var i = 1u; i + 1u < vertex_count; i++) {
        let area = area_at(i);
        if area < least {
            least = area;
            found = i;
        }
    }
    vertex_count--;
    for (var i = found; i < vertex_count; i++) {
        faces[i] = faces[i + 1u];
        reaching[i] = reaching[i + 1u];
    }
}

// what of all fragments is seen through the polyline
var<private> sums: Sums;

fn begin(pixel: vec2u) {
    vertex_count = 0u;
    sums = NO_SUMS;
}

// The first walk makes the polyline, and the second looks through it.
fn take(fragment: Fragment) {
    let key = key_of(fragment);
    if walk == 0u {
        add_fragment(key, fragment.alpha);
        while vertex_count > LAYERS {
            remove_least();
        }
        return;
    }
    let front = face_of(fragment.depth, key.y, 0u);
    let seen = reaching_face(front, vertices_up_to(front));
    sums = with_fragment(sums, weight_seen(params.composite, seen), rgba(fragment));
}

fn again() -> bool {
    return walk == 0u;
}

fn finish(id: vec3u) {
    var total = 1.0;
    if vertex_count > 0u {
        total = reaching[vertex_count - 1u];
    }
    let texel = composite_sums(params.composite, sums, total, background_at(pixel_of(id)));
    store(id, texel.rgb, texel.a);
}
