// Replaces some primitives, and clears Adam's moments of them.

// Ten words each: index, then the nine parameters.
@group(0) @binding(1) var<storage, read> moves: array<u32>;
@group(0) @binding(2) var<storage, read_write> primitives: array<f32>;
@group(0) @binding(3) var<storage, read_write> first: array<f32>;
@group(0) @binding(4) var<storage, read_write> second: array<f32>;

@compute @workgroup_size(64)
fn relocate(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) local: u32) {
    let j = group_index(group, groups) * 64u + local;
    if (j >= scene.capacity) { return; }
    let i = moves[10u * j];
    if (i >= scene.primitives) { return; }
    for (var k = 0u; k < 9u; k++) {
        primitives[9u * i + k] = bitcast<f32>(moves[10u * j + 1u + k]);
        first[9u * i + k] = 0.0;
        second[9u * i + k] = 0.0;
    }
}
