// Tiles to code values: red, green, blue and straight alpha, 8 bits each in a word (mode 0), the same with red and blue
// exchanged (mode 1), or 16 bits each in two words (mode 2).

@group(0) @binding(5) var<storage, read_write> codes: array<u32>;

@compute @workgroup_size(16, 16)
fn render(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) local: u32) {
    let tile = group_index(group, groups);
    if (tile >= scene.tiles_x * scene.tiles_y || status[1] != 0u) { return; }
    let x = (tile % scene.tiles_x) * TILE + local % TILE;
    let row = (tile / scene.tiles_x) * TILE + local / TILE;
    let y = scene.band_first + row;
    let sums = sum_tile(tile, local, f32(x), f32(y));
    if (x >= scene.width || row >= scene.band_rows) { return; }
    var value: vec4f;
    if (scene.blend == 0u) {
        value = (sums.color + EPSILON * scene.background) / (sums.weight + EPSILON);
    } else {
        value = sums.color + scene.background;
    }
    if (scene.channels == 1u) { value = vec4f(value.xxx, 1.0); }
    if (scene.channels == 2u) { value = vec4f(value.xxx, value.y); }
    if (scene.channels == 3u) { value.w = 1.0; }
    if (scene.mode == 1u) { value = value.zyxw; }
    var white = 255.0;
    if (scene.mode == 2u) { white = 65535.0; }
    let code = vec4u(floor(clamp(value, vec4f(0.0), vec4f(1.0)) * white + 0.5));
    let at = row * scene.stride;
    if (scene.mode == 2u) {
        codes[at + 2u * x] = code.x | (code.y << 16u);
        codes[at + 2u * x + 1u] = code.z | (code.w << 16u);
    } else {
        codes[at + x] = code.x | (code.y << 8u) | (code.z << 16u) | (code.w << 24u);
    }
}
