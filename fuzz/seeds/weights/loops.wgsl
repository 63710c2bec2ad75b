const far = 200.0;
struct Pair { a: f32, b: vec2f }
fn grow(p: ptr<function, f32>, by: f32) { if by < 0.0 { return; } *p += by; }
fn weight(z: f32, k: f32, a: f32) -> f32 {
    var sum = 0.0;
    for (var i = 0; i < i32(z); i++) {
        if i == 2 { continue; }
        switch i { case 3, 4: { break; } case 5: { return a; } default: { grow(&sum, k); } }
        if sum > far { break; }
    }
    loop { sum *= 2.0; continuing { break if sum > 8.0 || sum == 0.0; } }
    let pair = Pair(sum, vec2(z, a).yx);
    return select(pair.b.x, dot(pair.b, vec2f(k)), all(pair.b > vec2f(0.5))) / (1.0 + z * z);
}
