// Renders tiles to code values: red, green, blue and straight alpha, 8 bits each in a word (mode 0), the same with red
// and blue exchanged (mode 1), or 16 bits each in two words (mode 2). Follows tile.wgsl.

@group(0) @binding(5) var<storage, read_write> codes: array<u32>;
// Additions of a detail layer to the band's rows, in parts of white: channel after channel in each row. One pixel if
// there is no layer.
@group(0) @binding(6) var<storage, read> additions: array<f32>;

@compute @workgroup_size(16, 16)
fn render(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) local: u32) {
    let tile = group_index(group, groups);
    if (tile >= scene.tiles_x * scene.tiles_y || status[1] != 0u) { return; }
    // Position of the sample in the tile, and later of the pixel.
    var at = vec2u(local % TILE, local / TILE);
    let corner = vec2u(tile % scene.tiles_x, tile / scene.tiles_x) * TILE;
    let sums = sum_tile(tile, local, f32(corner.x + at.x), f32(scene.band_first + corner.y + at.y));
    var value: vec4f;
    if (scene.blend == 0u) {
        value = (sums.color + EPSILON * scene.background) / (sums.weight + EPSILON);
    } else {
        value = sums.color + scene.background;
    }
    value = clamp(value, vec4f(0.0), vec4f(1.0));
    var pixel = corner + at;
    var size = vec2u(scene.width, scene.band_rows);
    let parts = vec2u(scene.across, scene.down);
    if (any(parts != vec2u(1u))) {
        // Tiles contain whole pixels, each of which is the mean of its samples. The memory of the list is no longer
        // needed.
        colors[local] = value;
        workgroupBarrier();
        let pixels = TILE / parts;
        if (local >= pixels.x * pixels.y) { return; }
        at = vec2u(local % pixels.x, local / pixels.x);
        // Colours are weighted by their alpha, so that colours under alpha 0 do not become visible.
        value = vec4f(0.0);
        var alpha = 0.0;
        var weights = 0.0;
        for (var y = at.y * parts.y; y < (at.y + 1u) * parts.y; y++) {
            for (var x = at.x * parts.x; x < (at.x + 1u) * parts.x; x++) {
                let part = colors[y * TILE + x];
                var weight = 1.0;
                if (scene.alpha < 4u) {
                    alpha += part[scene.alpha];
                    weight = part[scene.alpha] + HIDDEN;
                }
                value += weight * part;
                weights += weight;
            }
        }
        // A power of two without alpha, so that the mean is as exact as the sum.
        value /= weights;
        if (scene.alpha < 4u) { value[scene.alpha] = alpha / f32(parts.x * parts.y); }
        pixel = corner / parts + at;
        size /= parts;
    }
    if (any(pixel >= size)) { return; }
    if (scene.detail == 1u) {
        for (var k = 0u; k < scene.channels; k++) {
            value[k] += additions[(pixel.y * scene.channels + k) * size.x + pixel.x];
        }
        value = clamp(value, vec4f(0.0), vec4f(1.0));
    }
    if (scene.channels == 1u) { value = vec4f(value.xxx, 1.0); }
    if (scene.channels == 2u) { value = vec4f(value.xxx, value.y); }
    if (scene.channels == 3u) { value.w = 1.0; }
    if (scene.mode == 1u) { value = value.zyxw; }
    var white = 255.0;
    if (scene.mode == 2u) { white = 65535.0; }
    let code = vec4u(floor(value * white + 0.5));
    let row = pixel.y * scene.stride;
    if (scene.mode == 2u) {
        codes[row + 2u * pixel.x] = code.x | (code.y << 16u);
        codes[row + 2u * pixel.x + 1u] = code.z | (code.w << 16u);
    } else {
        codes[row + pixel.x] = code.x | (code.y << 8u) | (code.z << 16u) | (code.w << 24u);
    }
}
