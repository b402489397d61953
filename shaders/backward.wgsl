// Computes the contribution of each pair to its Gaussian's gradient from the planes of the gradient: Σ t u, Σ t v, Σ t
// u², Σ t uv | Σ t v² | Σ w g with t = e (Σ g c − h). Follows pair.wgsl.

@compute @workgroup_size(64)
fn backward(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) local: u32) {
    let pair = group_index(group, groups) * 64u + local;
    if (status[1] != 0u || pair >= starts[scene.tiles_x * scene.tiles_y]) { return; }
    let splat = splats[sorted[pair]];
    let area = area_of(tile_of(pair));
    var moments = vec4f(0.0);
    var last = 0.0;
    var color = vec4f(0.0);
    for (var row = area.z; row < area.w; row++) {
        let dy = f32(sampled_row(scene.band_first + row)) - splat.place.y;
        let columns = span(splat, dy, area.x, area.y);
        for (var x = columns.x; x < columns.y; x++) {
            let dx = f32(x) - splat.place.x;
            let u = splat.place.z * dy - splat.place.w * dx;
            let v = splat.shape.x * dx;
            let q = u * u + v * v;
            if (q < SUPPORT) {
                let at = row * scene.width + x;
                let g = planes[at];
                let e = exp2(-q);
                let t = e * (dot(g, splat.color) - tails[at]);
                color += max(e - CUTOFF_WEIGHT, 0.0) * g;
                moments += t * vec4f(u, v, u * u, u * v);
                last += t * (v * v);
            }
        }
    }
    slots[3u * pair] = moments;
    slots[3u * pair + 1u] = vec4f(last, 0.0, 0.0, 0.0);
    slots[3u * pair + 2u] = color;
}
