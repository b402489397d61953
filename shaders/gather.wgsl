// Sums the slots of the pairs for each Gaussian, tile by tile in a fixed order. Mode 0 starts the sums, mode 1 adds to
// those of the previous bands.

@group(0) @binding(1) var<storage, read> splats: array<Splat>;
@group(0) @binding(2) var<storage, read> starts: array<u32>;
@group(0) @binding(3) var<storage, read> sorted: array<u32>;
@group(0) @binding(4) var<storage, read> status: array<u32>;
@group(0) @binding(5) var<storage, read> slots: array<vec4f>;
// Nine planes of `primitives` sums: u, v, uu, uv, vv, four colours.
@group(0) @binding(6) var<storage, read_write> moments: array<f32>;

@compute @workgroup_size(64)
fn gather(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) local: u32) {
    let i = group_index(group, groups) * 64u + local;
    if (i >= scene.primitives || status[1] != 0u) { return; }
    let splat = splats[i];
    var a = vec4f(0.0);
    var b = vec4f(0.0);
    var c = vec4f(0.0);
    let rows = tile_rows(splat);
    for (var row = rows.x; row < rows.y; row++) {
        // One pixel more than when the lists were made: an additional tile does not contain the pair, but a missing
        // one would be lost.
        let columns = tile_columns(splat, row, 2.0);
        for (var column = columns.x; column < columns.y; column++) {
            let tile = row * scene.tiles_x + column;
            var low = starts[tile];
            let end = starts[tile + 1u];
            var high = end;
            while (low < high) {
                let middle = (low + high) / 2u;
                if (sorted[middle] < i) { low = middle + 1u; } else { high = middle; }
            }
            if (low < end && sorted[low] == i) {
                a += slots[3u * low];
                b += slots[3u * low + 1u];
                c += slots[3u * low + 2u];
            }
        }
    }
    let n = scene.primitives;
    var sums = array<f32, 9>(a.x, a.y, a.z, a.w, b.x, c.x, c.y, c.z, c.w);
    for (var k = 0u; k < 9u; k++) {
        if (scene.mode == 1u) { sums[k] += moments[k * n + i]; }
        moments[k * n + i] = sums[k];
    }
}
