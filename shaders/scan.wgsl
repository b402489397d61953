// Converts the counts of the tiles to the starts of their lists: sums of blocks of 1024, their prefix sums, and those
// within blocks.

@group(0) @binding(1) var<storage, read_write> cursors: array<u32>;
// One more than there are tiles.
@group(0) @binding(2) var<storage, read_write> starts: array<u32>;
@group(0) @binding(3) var<storage, read_write> blocks: array<u32>;
@group(0) @binding(4) var<storage, read_write> status: array<u32>;

var<workgroup> sums: array<u32, 256>;

// Inclusive prefix sum over the workgroup.
fn running(local: u32, value: u32) -> u32 {
    sums[local] = value;
    workgroupBarrier();
    for (var d = 1u; d < 256u; d *= 2u) {
        var before = 0u;
        if (local >= d) { before = sums[local - d]; }
        workgroupBarrier();
        sums[local] += before;
        workgroupBarrier();
    }
    return sums[local];
}

fn count(tile: u32) -> u32 {
    if (tile < scene.tiles_x * scene.tiles_y) { return cursors[tile]; }
    return 0u;
}

@compute @workgroup_size(256)
fn scan_sum(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) local: u32) {
    let tile = group.x * 1024u + local * 4u;
    let total = running(local, count(tile) + count(tile + 1u) + count(tile + 2u) + count(tile + 3u));
    if (local == 255u) { blocks[group.x] = total; }
}

@compute @workgroup_size(256)
fn scan_top(@builtin(local_invocation_index) local: u32) {
    let tiles = scene.tiles_x * scene.tiles_y;
    let used = (tiles + 1023u) / 1024u;
    var own = array<u32, 4>(0u, 0u, 0u, 0u);
    var sum = 0u;
    for (var k = 0u; k < 4u; k++) {
        let block = local * 4u + k;
        if (block < used) { own[k] = blocks[block]; }
        sum += own[k];
    }
    let total = running(local, sum);
    var before = total - sum;
    for (var k = 0u; k < 4u; k++) {
        let block = local * 4u + k;
        if (block < used) { blocks[block] = before; }
        before += own[k];
    }
    if (local == 255u) {
        let pairs = max(total, status[0]);
        if (pairs > scene.capacity) { status[1] = max(status[1], pairs); }
        starts[tiles] = total;
    }
}

@compute @workgroup_size(256)
fn scan_spread(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) local: u32) {
    let tile = group.x * 1024u + local * 4u;
    var own = array<u32, 4>(count(tile), count(tile + 1u), count(tile + 2u), count(tile + 3u));
    let sum = own[0] + own[1] + own[2] + own[3];
    var start = blocks[group.x] + running(local, sum) - sum;
    for (var k = 0u; k < 4u; k++) {
        if (tile + k < scene.tiles_x * scene.tiles_y) {
            starts[tile + k] = start;
            cursors[tile + k] = start;
        }
        start += own[k];
    }
}
