// From a snapped primitive to its fragments: coverage, depth, colour and occlusion as the CPU backend defines them.

struct Primitive {
    // corners on the screen in sub-pixels, of which a pixel has 256; the fourth pair is the anchor, in pixels
    corners: array<vec2i, 3>,
    anchor: vec2i,
    // the depth function at the anchor, and its steps to the next pixel, in parts as `linear` adds them
    depth_at: vec3f,
    id: u32,
    depth_x: vec3f,
    // where the outline begins, if it is that of a polygon ...
    outline: u32,
    depth_y: vec3f,
    // ... and how many corners it has; a triangle has none
    outline_count: u32,
    // premultiplied, if it is the same everywhere
    color: vec4f,
    depth_range: vec2f,
    // where to look for colours that vary
    varying_color: u32,
}

struct VaryingColor {
    // value at the anchor and steps, of each corner's weight
    weights: array<vec4f, 3>,
    // premultiplied
    corners: array<vec4f, 3>,
    // alphas at the corners and the least that passes; below zero, all pass
    mask: vec4f,
}

@group(1) @binding(0) var<storage, read> primitives: array<Primitive>;
@group(1) @binding(1) var<storage, read> varying_colors: array<VaryingColor>;
@group(1) @binding(2) var<storage, read> outlines: array<vec2i>;

// Depth functions are those of the inverse depth.
override perspective: bool = true;
// Fragments that neither cover nor emit are fragments, too.
override shows_zero_fragments: bool = false;
// Depths are those of the CPU to the bit, not only to a unit or two in the last place.
override exact_depths: bool = true;
// What primitives of the scene may have. Devices that run both sides of a branch pay for what there is none of.
override has_outlines: bool = true;
override has_slopes: bool = true;
override has_varying_colors: bool = true;
override has_zero_fragments: bool = true;

// The first of the parts that a pass is drawn in, or the only one.
var<private> is_first_part: bool = true;

const NO_VARYING_COLOR = 0xffffffffu;
const CENTER = 128;

struct Placed {
    @builtin(position) position: vec4f,
    // the depth function; beside its parts the nearest depth, and the furthest
    @location(0) @interpolate(flat, either) depth_at: vec4f,
    @location(1) @interpolate(flat, either) depth_x: vec4f,
    @location(2) @interpolate(flat, either) depth_y: vec3f,
    @location(3) @interpolate(flat, either) color: vec4f,
    // id, varying colour, outline and its number of corners
    @location(4) @interpolate(flat, either) meta_data: vec4u,
    // in pixels, and the first attachment of a pass that draws its targets in parts
    @location(5) @interpolate(flat, either) anchor: vec3i,
}

struct Fragment {
    pixel: vec2u,
    depth: f32,
    color: vec3f,
    alpha: f32,
    primitive: u32,
}

// Corners keep all their bits: the viewport's size is a power of two.
@vertex
fn place(@builtin(vertex_index) index: u32, @builtin(instance_index) first_output: u32) -> Placed {
    let offset = vec2f(primitives[index / 3u].corners[index % 3u] - frame.viewport_center);
    let position = offset / (256.0 * frame.half_viewport);
    return placed_at(index / 3u, vec4f(position.x, -position.y, 0.5, 1.0), first_output);
}

// Around the whole pixels that a primitive covers; `is_inside` says which these are.
@vertex
fn place_around(@builtin(vertex_index) index: u32, @builtin(instance_index) first_output: u32) -> Placed {
    let primitive = index / 3u;
    let corners = primitives[primitive].corners;
    let least = (min(min(corners[0], corners[1]), corners[2]) >> vec2u(8u)) - 1;
    let most = (max(max(corners[0], corners[1]), corners[2]) >> vec2u(8u)) + 2;
    // a right angle, the legs twice as long as the bounds
    let corner = least + select(vec2i(0), 2 * (most - least), vec2u(index % 3u) == vec2u(1u, 2u));
    let offset = vec2f(256 * corner - frame.viewport_center);
    let position = offset / (256.0 * frame.half_viewport);
    var placed = placed_at(primitive, vec4f(position.x, -position.y, 0.5, 1.0), first_output);
    if placed.meta_data.w == 0u {
        placed.meta_data.z = primitive;
    }
    return placed;
}

// Whether the triangle of what is drawn around has a pixel's centre inside; `is_seen` looks at other outlines.
fn is_inside(placed: Placed, pixel: vec2u) -> bool {
    if placed.meta_data.w > 0u {
        return true;
    }
    let corners = primitives[placed.meta_data.z].corners;
    let center = vec2i(pixel) * 256 + CENTER;
    let is_right = vec3<bool>(
        is_right_of(corners[0], corners[1], center),
        is_right_of(corners[1], corners[2], center),
        is_right_of(corners[2], corners[0], center),
    );
    return (is_right.x != is_right.y) != is_right.z;
}

fn placed_at(index: u32, position: vec4f, first_output: u32) -> Placed {
    let primitive = &primitives[index];
    var placed: Placed;
    placed.position = position;
    placed.depth_at = vec4f((*primitive).depth_at, (*primitive).depth_range.x);
    placed.depth_x = vec4f((*primitive).depth_x, (*primitive).depth_range.y);
    placed.depth_y = (*primitive).depth_y;
    if !exact_depths {
        // in two parts, of which the second may be rounded
        placed.depth_at.y += placed.depth_at.z;
        placed.depth_x.y += placed.depth_x.z;
        placed.depth_y.y += placed.depth_y.z;
    }
    placed.color = (*primitive).color;
    placed.meta_data = vec4u(
        (*primitive).id,
        (*primitive).varying_color,
        (*primitive).outline,
        (*primitive).outline_count,
    );
    placed.anchor = vec3i((*primitive).anchor, i32(first_output));
    return placed;
}

// a b as upper and lower half.
fn wide_product(a: u32, b: u32) -> vec2u {
    let low = (a & 0xffffu) * (b & 0xffffu);
    let middle = (a >> 16u) * (b & 0xffffu) + (low >> 16u);
    let other = (a & 0xffffu) * (b >> 16u) + (middle & 0xffffu);
    return vec2u((a >> 16u) * (b >> 16u) + (middle >> 16u) + (other >> 16u), (other << 16u) | (low & 0xffffu));
}

// a b <= c d, for a and d that are not negative.
fn product_is_at_most(a: i32, b: i32, c: i32, d: i32) -> bool {
    let left = wide_product(u32(a), u32(abs(b)));
    let right = wide_product(u32(abs(c)), u32(d));
    let left_is_less = left.x < right.x || (left.x == right.x && left.y < right.y);
    let are_equal = left.x == right.x && left.y == right.y;
    let left_is_negative = b < 0 && (left.x != 0u || left.y != 0u);
    let right_is_negative = c < 0 && (right.x != 0u || right.y != 0u);
    if left_is_negative != right_is_negative {
        return left_is_negative;
    }
    return are_equal || left_is_less != left_is_negative;
}

// Whether a point is to the right of an edge, or on it, which has its top in and its bottom out.
fn is_right_of(a: vec2i, b: vec2i, point: vec2i) -> bool {
    let upward = b.y < a.y;
    let top = select(a, b, upward);
    let bottom = select(b, a, upward);
    if point.y < top.y || point.y >= bottom.y {
        return false;
    }
    let edge = bottom - top;
    let from_top = point - top;
    return product_is_at_most(from_top.y, edge.x, from_top.x, edge.y);
}

// Whether a pixel's centre is to the right of an odd number of the outline's edges.
fn outline_covers(first: u32, count: u32, pixel: vec2u) -> bool {
    let center = vec2i(pixel) * 256 + CENTER;
    var inside = false;
    for (var i = 0u; i < count; i++) {
        if is_right_of(outlines[first + i], outlines[first + (i + 1u) % count], center) {
            inside = !inside;
        }
    }
    return inside;
}

fn depth_of(placed: Placed, d: vec2f) -> f32 {
    let nearest = placed.depth_at.w;
    let farthest = placed.depth_x.w;
    if !has_slopes {
        return nearest;
    }
    // in perspective, the function is that of a power of two over the depth
    let unit = bitcast<f32>(bitcast<u32>(farthest) & 0x7f800000u);
    var depth: f32;
    if exact_depths {
        let value = linear(placed.depth_at.xyz, placed.depth_x.xyz, placed.depth_y, d);
        depth = value.x;
        if perspective {
            depth = unit * reciprocal(value);
        }
    } else {
        let parts = placed.depth_at.xy + (placed.depth_x.xy * d.x + placed.depth_y.xy * d.y);
        depth = parts.x + parts.y;
        if perspective {
            depth = unit / depth;
        }
    }
    // comparisons that a number which is none does not pass; where the range is one depth, that is left
    depth = select(nearest, depth, depth > nearest);
    return select(farthest, depth, depth < farthest);
}

// The weighted mean of three colours, never outside their range.
fn mean_color(colors: array<vec4f, 3>, weights: vec3f) -> vec4f {
    let mean = weights.x * colors[0] + weights.y * colors[1] + weights.z * colors[2];
    let least = min(min(colors[0], colors[1]), colors[2]);
    return clamp(mean, least, max(max(colors[0], colors[1]), colors[2]));
}

// A colour that varies; none where the mask leaves the primitive out.
fn varying_color_at(index: u32, d: vec2f, color: ptr<function, vec4f>) -> bool {
    let colors_of = varying_colors[index];
    var weights: vec3f;
    for (var i = 0; i < 3; i++) {
        let weight = colors_of.weights[i];
        weights[i] = max(weight.x + weight.y * d.x + weight.z * d.y, 0.0);
    }
    let sum = weights.x + weights.y + weights.z;
    weights = select(vec3f(1.0 / 3.0), weights / sum, sum > 0.0);
    if colors_of.mask.w >= 0.0 {
        let alphas = colors_of.mask.xyz;
        let least = min(min(alphas.x, alphas.y), alphas.z);
        let alpha = clamp(dot(weights, alphas), least, max(max(alphas.x, alphas.y), alphas.z));
        if alpha < colors_of.mask.w {
            return false;
        }
    }
    *color = mean_color(colors_of.corners, weights);
    return true;
}

// Whether there is anything to be seen of a primitive in a pixel where its triangle is, and what.
fn is_seen(placed: Placed, pixel: vec2u, fragment: ptr<function, Fragment>) -> bool {
    if has_outlines && placed.meta_data.w > 0u {
        if !outline_covers(placed.meta_data.z, placed.meta_data.w, pixel) {
            return false;
        }
    }
    let d = vec2f(vec2i(pixel) - placed.anchor.xy);
    let depth = depth_of(placed, d);
    if has_opaque && frame.has_opaque != 0u && depth > textureLoad(opaque_depth, pixel, 0).x {
        return false;
    }
    var color = placed.color;
    if has_varying_colors && placed.meta_data.y != NO_VARYING_COLOR {
        if !varying_color_at(placed.meta_data.y, d, &color) {
            return false;
        }
    }
    if has_zero_fragments && !shows_zero_fragments && all(color == vec4f(0.0)) {
        return false;
    }
    *fragment = Fragment(pixel, depth, color.rgb, color.a, placed.meta_data.x);
    return true;
}

fn first_output_of(placed: Placed) -> u32 {
    return u32(placed.anchor.z);
}

// What is to be seen of a primitive in a pixel; nothing of what is not.
fn fragment_of(placed: Placed) -> Fragment {
    var fragment: Fragment;
    is_first_part = first_output_of(placed) == 0u;
    if !is_seen(placed, pixel_at(placed.position), &fragment) {
        discard;
    }
    return fragment;
}

// Premultiplied.
fn rgba(fragment: Fragment) -> vec4f {
    return vec4f(fragment.color, fragment.alpha);
}

// Keys: the bits of the depth, which ascend with it, and the primitive. Adding zero makes -0 the 0 that it equals.
fn key_of(fragment: Fragment) -> vec2u {
    return vec2u(bitcast<u32>(fragment.depth + 0.0), fragment.primitive);
}

// The bits of a depth as a depth buffer has it; what is less than 2^-126 of the far plane is 0 there.
fn window_bits(depth: f32, exponent: u32) -> u32 {
    let bits = bitcast<i32>(depth + 0.0) - bitcast<i32>(exponent);
    return u32(select(0, bits, bits >= LEAST_NORMAL));
}
const LEAST_NORMAL = 0x00800000;

fn comes_before_by_depth(a: vec2u, b: vec2u) -> bool {
    return a.x < b.x || (a.x == b.x && a.y < b.y);
}
