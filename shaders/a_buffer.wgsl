// The A-buffer (Carpenter 1984): every fragment, sorted, front to back.

var<private> color: vec3f;
var<private> transmittance: f32;

fn begin(pixel: vec2u) {
    color = vec3f(0.0);
    transmittance = 1.0;
}

// Nearest first.
fn take(fragment: Fragment) {
    color += transmittance * fragment.color;
    transmittance *= 1.0 - fragment.alpha;
}

fn finish(id: vec3u) {
    store(id, color + transmittance * background_at(pixel_of(id)), transmittance);
}
