// Averages 2 × 2 cells; cells at the border are repeated. `cells_x` and `cells_y` are those of the input.

@group(0) @binding(1) var<storage, read> cells: array<vec4f>;
@group(0) @binding(2) var<storage, read_write> halved: array<vec4f>;

@compute @workgroup_size(64)
fn halve(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) local: u32) {
    let i = group_index(group, groups) * 64u + local;
    let wide = (scene.cells_x + 1u) / 2u;
    let tall = (scene.cells_y + 1u) / 2u;
    if (i >= wide * tall) { return; }
    let left = 2u * (i % wide);
    let right = min(left + 1u, scene.cells_x - 1u);
    let top = 2u * (i / wide) * scene.cells_x;
    let bottom = min(2u * (i / wide) + 1u, scene.cells_y - 1u) * scene.cells_x;
    halved[i] = 0.25 * (cells[top + left] + cells[top + right] + cells[bottom + left] + cells[bottom + right]);
}
