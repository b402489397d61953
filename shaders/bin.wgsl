// Counts the (Gaussian, tile) pairs of each tile (mode 0), then writes them to the tiles' lists (mode 1). One shader
// does both, so that both find the same pairs, however the compiler translates the arithmetic.

@group(0) @binding(1) var<storage, read> splats: array<Splat>;
// First the counts, then the position of the next pair.
@group(0) @binding(2) var<storage, read_write> cursors: array<atomic<u32>>;
@group(0) @binding(3) var<storage, read_write> lists: array<u32>;
// Pairs of this band; maximum number of pairs of a band that did not fit; steps done.
@group(0) @binding(4) var<storage, read_write> status: array<atomic<u32>>;

@compute @workgroup_size(64)
fn bin(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) local: u32) {
    let i = group_index(group, groups) * 64u + local;
    if (i >= scene.primitives) { return; }
    // Stop once the lists have overflowed, which also bounds the work.
    if (atomicLoad(&status[1]) != 0u || atomicLoad(&status[0]) > scene.capacity) { return; }
    let splat = splats[i];
    let rows = tile_rows(splat);
    if (scene.mode == 0u) {
        var pairs = 0u;
        for (var row = rows.x; row < rows.y; row++) {
            let columns = tile_columns(splat, row, 1.0);
            pairs += columns.y - columns.x;
        }
        if (pairs == 0u) { return; }
        let before = atomicAdd(&status[0], pairs);
        if (before > scene.capacity) {
            // Recorded here, because the sum over many threads may wrap at 2³² and look small again, but not in one
            // step.
            atomicMax(&status[1], before);
            return;
        }
    }
    for (var row = rows.x; row < rows.y; row++) {
        let columns = tile_columns(splat, row, 1.0);
        for (var column = columns.x; column < columns.y; column++) {
            let slot = atomicAdd(&cursors[row * scene.tiles_x + column], 1u);
            if (scene.mode == 1u && slot < scene.capacity) { lists[slot] = i; }
        }
    }
}
