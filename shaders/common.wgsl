// Precedes every stage: the uniforms of the scene, the projected splat, and the tiles that it touches.

struct Scene {
    background: vec4f,
    // Step sizes: mean, log-scale, rotation, colour.
    rates: vec4f,
    // Amplitude of the errors of each channel.
    channel_amplitude: vec4f,
    // Origin of the grid in the picture, pixels, as a sum of two floats.
    origin_high: vec2f,
    origin_low: vec2f,
    // Picture pixels per pixel of the grid.
    step: vec2f,
    // Bounds of the means, pixels.
    size: vec2f,
    // Increase of the variances along x and y by the low-pass filter of a reduced view, picture pixels².
    widening: vec2f,
    // β₁ and β₂: the decay of the first and second moments.
    decay: vec2f,
    min_log_scale: f32,
    max_log_scale: f32,
    max_log_aspect: f32,
    // 1 − β₁ⁿ and 1 − β₂ⁿ.
    correction_first: f32,
    correction_second: f32,
    // Peaks below this gain are ignored.
    least_gain: f32,
    // Variance of the blur so far, pixels².
    variance: f32,
    // Maximum aspect of a new primitive.
    longest: f32,
    primitives: u32,
    // Capacity of the lists in pairs.
    capacity: u32,
    // Columns and rows of samples: `across` and `down` per output pixel, which is their mean.
    width: u32,
    height: u32,
    across: u32,
    down: u32,
    // Sampled row `i` is row `row_phase + i · row_step` of the picture.
    row_step: u32,
    row_phase: u32,
    // The band: sampled rows `band_first .. band_first + band_rows`, and its tiles.
    band_first: u32,
    band_rows: u32,
    tiles_x: u32,
    tiles_y: u32,
    // Index of the band's first tile among those of all bands.
    tile_base: u32,
    // 0: normalized, 1: sum.
    blend: u32,
    channels: u32,
    // Index of the alpha channel; 4 if there is none.
    alpha: u32,
    // 32-bit words per pixel of the source: 1 with 8 bits per sample, 2 with 16, and one more if pixels are weighted.
    source_words: u32,
    // First row of the picture in the bound part of the source.
    source_first: u32,
    // Selects between the two functions of a stage.
    mode: u32,
    // Cells of the current level.
    cells_x: u32,
    cells_y: u32,
    // Cell size, pixels; words or pixels in an output row.
    cell: u32,
    stride: u32,
    level: u32,
    // Penalty for size: half the squared error per pixel² of the product of the scales.
    price: f32,
    // 1: the last word of each pixel of the source is its amplitude, a float. 0: all pixels have the same weight.
    weighted: u32,
    // 1: a detail layer adds to the pixels.
    detail: u32,
    // Number of primitives at the end of the list that do not move.
    frozen: u32,
}

// A Gaussian on the grid. With (dx, dy) from the centre, u = rise·dy − shear·dx and v = run·dx, it is amplitude ·
// 2^−(u² + v²).
struct Splat {
    // Centre, in coordinates where pixel i has its centre at i; rise; shear.
    place: vec4f,
    // run; horizontal shift of a row's middle per row; half width in the middle row; dy of the rightmost point.
    shape: vec4f,
    // Half width and half height of the support; the amplitude, which is 1 unless the low-pass filter widens the
    // Gaussian. Fits have no filter.
    extent: vec4f,
    color: vec4f,
}

const CUTOFF: f32 = 3.5;
const CUTOFF_WEIGHT: f32 = 0.0021874911;
// u² + v² at the edge of the support.
const SUPPORT: f32 = 8.836507;
// √(½ log₂ e): converts standard deviations to u and v.
const HALF: f32 = 0.8493218;
const EPSILON: f32 = 0.0078125;
const HIDDEN: f32 = 0.00024414063;
const TILE: u32 = 16u;
const GRADIENT: u32 = 0u;
const PICTURE: u32 = 1u;

@group(0) @binding(0) var<uniform> scene: Scene;

// Workgroups beyond 65535 are folded into a second dimension.
fn group_index(group: vec3u, groups: vec3u) -> u32 {
    return group.y * groups.x + group.x;
}

// Sine and cosine within 1e−7 for |x| < 100; WGSL guarantees only 2⁻¹¹.
fn sin_cos(x: f32) -> vec2f {
    let k = floor(x * 0.63661977 + 0.5);
    let r = ((x - k * 1.5703125) - k * 4.837513e-4) - k * 7.54979e-8;
    let z = r * r;
    let s = r + r * z * (-0.16666654611 + z * (8.3321608736e-3 + z * -1.9515295891e-4));
    let c = 1.0 - 0.5 * z + z * z * (4.166664568e-2 + z * (-1.388731625e-3 + z * 2.443315712e-5));
    let q = u32(i32(k)) & 3u;
    if (q == 0u) { return vec2f(s, c); }
    if (q == 1u) { return vec2f(c, -s); }
    if (q == 2u) { return vec2f(-s, -c); }
    return vec2f(-c, s);
}

// Returns the row of the picture of sampled row `index`.
fn sampled_row(index: u32) -> u32 {
    return scene.row_phase + index * scene.row_step;
}

// Returns the tile rows of the band that the splat may touch: first and end.
fn tile_rows(splat: Splat) -> vec2u {
    let phase = f32(scene.row_phase);
    let step = f32(scene.row_step);
    let low = (splat.place.y - splat.extent.y - 0.5 - phase) / step;
    let high = (splat.place.y + splat.extent.y + 0.5 - phase) / step;
    let start = f32(scene.band_first);
    let stop = f32(scene.band_first + scene.band_rows);
    let first = clamp(ceil(low), start, stop);
    let end = clamp(floor(high) + 1.0, start, stop);
    if (first >= end) { return vec2u(0u, 0u); }
    return vec2u((u32(first) - scene.band_first) / TILE, (u32(end) - 1u - scene.band_first) / TILE + 1u);
}

// Returns the tile columns that the splat may touch in tile row `row`, with `slack` pixels on either side: first and
// end.
fn tile_columns(splat: Splat, row: u32, slack: f32) -> vec2u {
    let index = scene.band_first + row * TILE;
    let top = f32(sampled_row(index)) - splat.place.y - 0.5;
    let bottom = f32(sampled_row(index + TILE - 1u)) - splat.place.y + 0.5;
    let level = splat.shape.w;
    let right = clamp(level, top, bottom);
    let left = clamp(-level, top, bottom);
    let r = right / splat.extent.y;
    let l = left / splat.extent.y;
    let half_right = splat.shape.z * sqrt(max(0.0, 1.0 - r * r));
    let half_left = splat.shape.z * sqrt(max(0.0, 1.0 - l * l));
    let low = splat.place.x + splat.shape.y * left - half_left - slack;
    let high = splat.place.x + splat.shape.y * right + half_right + slack;
    let last = f32(scene.width);
    let first = clamp(floor(low), 0.0, last);
    let end = clamp(floor(high) + 1.0, 0.0, last);
    if (first >= end) { return vec2u(0u, 0u); }
    return vec2u(u32(first) / TILE, (u32(end) - 1u) / TILE + 1u);
}
