fn fade(x: f32) -> f32 { return 1.0 - smoothstep(0.0, 1.5, abs(x)); }
fn bin(x: f32, s: f32) -> f32 { var y = x * s; while y > 1.0 { y -= 1.0; } return fade(y); }
