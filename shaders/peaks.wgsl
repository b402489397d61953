// Finds cells whose squared residual is a local maximum, and appends them to a list in any order, each with the best
// shape of a new primitive there: round, or along one of the ridges.

const RIDGES = 32u;
const TAPS = 11u;

@group(0) @binding(1) var<storage, read> cells: array<vec4f>;
// Mean residual under the shape; the ridge counts from 1 on. The number of peaks is stored separately.
struct Peak {
    residual: vec4f,
    level: u32,
    ridge: u32,
    x: u32,
    y: u32,
}
@group(0) @binding(2) var<storage, read_write> peaks: array<Peak>;
@group(0) @binding(3) var<storage, read_write> found: atomic<u32>;
// A cell next to a peak, and its mirror image.
struct Tap {
    x: i32,
    y: i32,
    weight: f32,
    aspect: f32,
}
@group(0) @binding(4) var<storage, read> ridges: array<Tap>;

fn score(x: u32, y: u32) -> f32 {
    let v = cells[y * scene.cells_x + x];
    return dot(v, v);
}

// The residual is zero beyond the edges.
fn missing(x: i32, y: i32) -> vec4f {
    if (x < 0 || y < 0 || u32(x) >= scene.cells_x || u32(y) >= scene.cells_y) { return vec4f(0.0); }
    return cells[u32(y) * scene.cells_x + u32(x)];
}

@compute @workgroup_size(64)
fn find_peaks(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) local: u32) {
    let i = group_index(group, groups) * 64u + local;
    if (i >= scene.cells_x * scene.cells_y) { return; }
    let x = i % scene.cells_x;
    let y = i / scene.cells_x;
    let own = score(x, y);
    // 4π times the variance: the reduction of the squared error by a Gaussian as wide as the blur. The reduction by
    // one along a ridge is larger by at most its aspect.
    let gain = 12.566371 * scene.variance * own;
    if (!(own > 0.0) || gain * scene.longest < scene.least_gain) { return; }
    for (var ny = max(y, 1u) - 1u; ny <= min(y + 1u, scene.cells_y - 1u); ny++) {
        for (var nx = max(x, 1u) - 1u; nx <= min(x + 1u, scene.cells_x - 1u); nx++) {
            let other = score(nx, ny);
            // Among equal cells, the first is the peak.
            if (other > own || (other == own && (ny < y || (ny == y && nx < x)))) { return; }
        }
    }
    var peak: Peak;
    peak.residual = cells[i];
    peak.level = scene.level;
    peak.ridge = 0u;
    peak.x = x;
    peak.y = y;
    var best = own;
    for (var ridge = 0u; ridge < RIDGES; ridge++) {
        if (ridges[ridge * TAPS].aspect > scene.longest) { continue; }
        var mean = vec4f(0.0);
        for (var k = ridge * TAPS; k < (ridge + 1u) * TAPS; k++) {
            let tap = ridges[k];
            mean += tap.weight * missing(i32(x) + tap.x, i32(y) + tap.y);
            mean += tap.weight * missing(i32(x) - tap.x, i32(y) - tap.y);
        }
        let score = ridges[ridge * TAPS].aspect * dot(mean, mean);
        if (score > best) {
            best = score;
            peak.residual = mean;
            peak.ridge = ridge + 1u;
        }
    }
    let slot = atomicAdd(&found, 1u);
    if (slot < scene.capacity) { peaks[slot] = peak; }
}
