// Shared by backward and importance: one thread for each (Gaussian, tile) pair, which writes to its own slot.

@group(0) @binding(1) var<storage, read> splats: array<Splat>;
@group(0) @binding(2) var<storage, read> starts: array<u32>;
@group(0) @binding(3) var<storage, read> sorted: array<u32>;
@group(0) @binding(4) var<storage, read> status: array<u32>;
@group(0) @binding(5) var<storage, read> planes: array<vec4f>;
@group(0) @binding(6) var<storage, read> tails: array<f32>;
// Three per pair.
@group(0) @binding(7) var<storage, read_write> slots: array<vec4f>;

// Returns the tile whose list contains `pair`.
fn tile_of(pair: u32) -> u32 {
    var low = 0u;
    var high = scene.tiles_x * scene.tiles_y;
    while (high - low > 1u) {
        let middle = (low + high) / 2u;
        if (starts[middle] <= pair) { low = middle; } else { high = middle; }
    }
    return low;
}

// Returns the columns from `left` to `right` in which the splat's row `dy` from the centre is within the support:
// first and end.
fn span(splat: Splat, dy: f32, left: u32, right: u32) -> vec2u {
    let t = dy / splat.extent.y;
    let rest = 1.0 - t * t;
    if (rest <= 0.0) { return vec2u(0u, 0u); }
    let half = splat.shape.z * sqrt(rest);
    let middle = splat.place.x + splat.shape.y * dy;
    // Half a pixel more on either side; the weight outside the support is 0.
    let first = clamp(ceil(middle - half - 0.5), f32(left), f32(right));
    let end = clamp(floor(middle + half + 0.5) + 1.0, f32(left), f32(right));
    return vec2u(u32(first), u32(end));
}

// Returns the part of the band that `tile` covers: columns from x to y, sampled rows from z to w.
fn area_of(tile: u32) -> vec4u {
    let left = (tile % scene.tiles_x) * TILE;
    let first = (tile / scene.tiles_x) * TILE;
    return vec4u(left, min(left + TILE, scene.width), first, min(first + TILE, scene.band_rows));
}
