// Blurs cells by (1 4 6 4 1)/16 along x (mode 0) or y (mode 1); cells at the border are repeated.

@group(0) @binding(1) var<storage, read> cells: array<vec4f>;
@group(0) @binding(2) var<storage, read_write> blurred: array<vec4f>;

@compute @workgroup_size(64)
fn blur(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) local: u32) {
    let i = group_index(group, groups) * 64u + local;
    if (i >= scene.cells_x * scene.cells_y) { return; }
    let x = i % scene.cells_x;
    let y = i / scene.cells_x;
    var at = x;
    var last = scene.cells_x - 1u;
    var first = y * scene.cells_x;
    var stride = 1u;
    if (scene.mode == 1u) {
        at = y;
        last = scene.cells_y - 1u;
        first = x;
        stride = scene.cells_x;
    }
    let a = cells[first + (max(at, 2u) - 2u) * stride];
    let b = cells[first + (max(at, 1u) - 1u) * stride];
    let c = cells[first + at * stride];
    let d = cells[first + min(at + 1u, last) * stride];
    let e = cells[first + min(at + 2u, last) * stride];
    blurred[i] = 0.0625 * (a + e) + 0.25 * (b + d) + 0.375 * c;
}
