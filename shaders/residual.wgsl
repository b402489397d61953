// Averages the difference of the target and the picture over `cell` columns of each sampled row. Follows pixel.wgsl.

@group(0) @binding(1) var<storage, read> planes: array<vec4f>;
@group(0) @binding(2) var<storage, read> source: array<u32>;
@group(0) @binding(3) var<storage, read_write> cells: array<vec4f>;
@group(0) @binding(4) var<storage, read> status: array<u32>;

@compute @workgroup_size(64)
fn residual(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) local: u32) {
    let i = group_index(group, groups) * 64u + local;
    if (i >= scene.cells_x * scene.band_rows || status[1] != 0u) { return; }
    let row = i / scene.cells_x;
    let left = (i % scene.cells_x) * scene.cell;
    let y = sampled_row(scene.band_first + row);
    var sum = vec4f(0.0);
    for (var x = left; x < min(left + scene.cell, scene.width); x++) {
        let wanted = source_pixel(x, y);
        let value = clamp(planes[row * scene.width + x], vec4f(0.0), vec4f(1.0));
        sum += (wanted - value) * (importance_of_channels(wanted) * scene.channel_amplitude * amplitude(x, y) / f32(scene.cell));
    }
    cells[(scene.band_first + row) * scene.cells_x + i % scene.cells_x] = sum;
}
