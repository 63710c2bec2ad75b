// What the device's memory does at best: every number is read once and written once.

@group(0) @binding(0) var<storage, read_write> source: array<vec4f>;
@group(0) @binding(1) var<storage, read_write> copied: array<vec4f>;

const THREADS = 256u;

@compute @workgroup_size(THREADS)
fn copy(@builtin(global_invocation_id) id: vec3u, @builtin(num_workgroups) groups: vec3u) {
    let place = id.y * groups.x * THREADS + id.x;
    if place < arrayLength(&copied) {
        copied[place] = source[place];
    }
}
