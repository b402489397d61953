// Computes the increase of the error in each pair's pixels when its Gaussian is removed. Follows pair.wgsl and
// pixel.wgsl.

@group(0) @binding(8) var<storage, read> source: array<u32>;

@compute @workgroup_size(64)
fn importance(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) local: u32) {
    let pair = group_index(group, groups) * 64u + local;
    if (status[1] != 0u || pair >= starts[scene.tiles_x * scene.tiles_y]) { return; }
    let splat = splats[sorted[pair]];
    let area = area_of(tile_of(pair));
    var cost = 0.0;
    for (var row = area.z; row < area.w; row++) {
        let y = sampled_row(scene.band_first + row);
        let dy = f32(y) - splat.place.y;
        let columns = span(splat, dy, area.x, area.y);
        for (var x = columns.x; x < columns.y; x++) {
            let dx = f32(x) - splat.place.x;
            let u = splat.place.z * dy - splat.place.w * dx;
            let v = splat.shape.x * dx;
            let q = u * u + v * v;
            if (q < SUPPORT) {
                let at = row * scene.width + x;
                let w = max(exp2(-q) - CUTOFF_WEIGHT, 0.0);
                var share = w;
                let used = importance_of_channels(source_pixel(x, y)) * scene.channel_amplitude;
                var distance = splat.color * used;
                if (scene.blend == 0u) {
                    share = min(w / (max(tails[at] - w, 0.0) + 0.02), 20.0);
                    distance = (splat.color - planes[at]) * used;
                }
                share *= amplitude(x, y);
                cost += share * share * dot(distance, distance);
            }
        }
    }
    slots[3u * pair] = vec4f(cost * f32(scene.row_step), 0.0, 0.0, 0.0);
    slots[3u * pair + 1u] = vec4f(0.0);
    slots[3u * pair + 2u] = vec4f(0.0);
}
