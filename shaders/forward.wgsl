// Renders tiles to planes: the gradient of half the squared error with respect to Σwc, and Σ g I (mode 0), or the
// picture and Σw (mode 1). Follows tile.wgsl and pixel.wgsl.

@group(0) @binding(5) var<storage, read> source: array<u32>;
@group(0) @binding(6) var<storage, read_write> planes: array<vec4f>;
@group(0) @binding(7) var<storage, read_write> tails: array<f32>;
// Squared error of each tile, clamped.
@group(0) @binding(8) var<storage, read_write> errors: array<f32>;

var<workgroup> squares: array<f32, 256>;

@compute @workgroup_size(16, 16)
fn forward(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) local: u32) {
    let tile = group_index(group, groups);
    if (tile >= scene.tiles_x * scene.tiles_y || status[1] != 0u) { return; }
    let x = (tile % scene.tiles_x) * TILE + local % TILE;
    let row = (tile / scene.tiles_x) * TILE + local / TILE;
    let y = sampled_row(scene.band_first + row);
    let sums = sum_tile(tile, local, f32(x), f32(y));
    var error = 0.0;
    if (x < scene.width && row < scene.band_rows) {
        let wanted = source_pixel(x, y);
        var value: vec4f;
        var inverse = 1.0;
        if (scene.blend == 0u) {
            inverse = 1.0 / (sums.weight + EPSILON);
            value = (sums.color + EPSILON * scene.background) * inverse;
        } else {
            value = sums.color + scene.background;
        }
        // The error of the whole picture is not weighted.
        var a = vec4f(1.0);
        if (scene.mode == GRADIENT) { a = amplitude(x, y) * scene.channel_amplitude; }
        a *= importance_of_channels(wanted);
        let e = (clamp(value, vec4f(0.0), vec4f(1.0)) - wanted) * a;
        error = dot(e, e);
        let at = row * scene.width + x;
        if (scene.mode == GRADIENT) {
            let left = e * (a * inverse);
            planes[at] = left;
            if (scene.blend == 0u) { tails[at] = dot(left, value); } else { tails[at] = 0.0; }
        } else {
            planes[at] = value;
            tails[at] = sums.weight;
        }
    }
    squares[local] = error;
    workgroupBarrier();
    for (var d = 128u; d > 0u; d /= 2u) {
        if (local < d) { squares[local] += squares[local + d]; }
        workgroupBarrier();
    }
    if (local == 0u) { errors[scene.tile_base + tile] = squares[0]; }
}
