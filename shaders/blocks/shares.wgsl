// What layers cover together, and what they leave: each is precise where it is small.

// `count` layers of the same coverage: layers are doubled, which is exact for faint ones, too, where powers of
// 1 - coverage are not.
fn repeated(coverage: f32, count: u32) -> vec2f {
    var layers = vec2f(coverage, 1.0 - coverage);
    var all = vec2f(0.0, 1.0);
    for (var rest = count; rest > 0u; rest >>= 1u) {
        if (rest & 1u) == 1u {
            all = under(all, layers);
        }
        layers = vec2f(layers.x * (1.0 + layers.y), layers.y * layers.y);
    }
    return all;
}

// Layers under others.
fn under(front: vec2f, back: vec2f) -> vec2f {
    return vec2f(front.x + front.y * back.x, front.y * back.y);
}
