// Cells whose squared residual is the largest around them, appended to a list in any order.

@group(0) @binding(1) var<storage, read> cells: array<vec4f>;
// Level and index, residual, gain; the number of them is counted apart.
struct Peak {
    residual: vec4f,
    gain: f32,
    level: u32,
    x: u32,
    y: u32,
}
@group(0) @binding(2) var<storage, read_write> peaks: array<Peak>;
@group(0) @binding(3) var<storage, read_write> found: atomic<u32>;

fn score(x: u32, y: u32) -> f32 {
    let v = cells[y * scene.cells_x + x];
    return dot(v, v);
}

@compute @workgroup_size(64)
fn find_peaks(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) local: u32) {
    let i = group_index(group, groups) * 64u + local;
    if (i >= scene.cells_x * scene.cells_y) { return; }
    let x = i % scene.cells_x;
    let y = i / scene.cells_x;
    let own = score(x, y);
    // Four times π times the variance: the squared error that a Gaussian as wide as the blur takes away.
    let gain = 12.566371 * scene.variance * own;
    if (!(own > 0.0) || gain < scene.least_gain) { return; }
    for (var ny = max(y, 1u) - 1u; ny <= min(y + 1u, scene.cells_y - 1u); ny++) {
        for (var nx = max(x, 1u) - 1u; nx <= min(x + 1u, scene.cells_x - 1u); nx++) {
            let other = score(nx, ny);
            // Of equals the first counts.
            if (other > own || (other == own && (ny < y || (ny == y && nx < x)))) { return; }
        }
    }
    let slot = atomicAdd(&found, 1u);
    if (slot >= scene.capacity) { return; }
    var peak: Peak;
    peak.residual = cells[i];
    peak.gain = gain;
    peak.level = scene.level;
    peak.x = x;
    peak.y = y;
    peaks[slot] = peak;
}
