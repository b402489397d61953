// Sorts each tile's list in ascending order, so that sums do not depend on the order of threads. Ranks are found by
// counting, since lists are short.

@group(0) @binding(1) var<storage, read> starts: array<u32>;
@group(0) @binding(2) var<storage, read> lists: array<u32>;
@group(0) @binding(3) var<storage, read_write> sorted: array<u32>;
@group(0) @binding(4) var<storage, read> status: array<u32>;

var<workgroup> others: array<u32, 64>;

@compute @workgroup_size(64)
fn sort(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) local: u32) {
    let tile = group_index(group, groups);
    if (tile >= scene.tiles_x * scene.tiles_y || status[1] != 0u) { return; }
    let first = starts[tile];
    let end = starts[tile + 1u];
    for (var base = first; base < end; base += 64u) {
        var own = 0xffffffffu;
        if (base + local < end) { own = lists[base + local]; }
        var rank = 0u;
        for (var chunk = first; chunk < end; chunk += 64u) {
            var other = 0xffffffffu;
            if (chunk + local < end) { other = lists[chunk + local]; }
            others[local] = other;
            workgroupBarrier();
            for (var j = 0u; j < 64u; j++) { rank += u32(others[j] < own); }
            workgroupBarrier();
        }
        if (base + local < end) { sorted[first + rank] = own; }
    }
}
