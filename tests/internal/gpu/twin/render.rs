//! Twin of `render.wgsl`.

use super::common::{EPSILON, HIDDEN};
use super::tile::sum_tile;
use crate::gpu::scene::{Splat, TILE, Uniforms};

pub(in crate::gpu) fn render(
    scene: &Uniforms,
    splats: &[Splat],
    starts: &[u32],
    sorted: &[u32],
    codes: &mut [u32],
    additions: &[f32],
) {
    let parts = [scene.across, scene.down];
    for row in 0..scene.band_rows / parts[1] {
        for x in 0..scene.width / parts[0] {
            let sample = |x: u32, y: u32| sample(scene, splats, starts, sorted, x, y);
            let mut value = if parts == [1, 1] { sample(x, row) } else { average(scene, parts, x, row, sample) };
            if scene.detail == 1 {
                let size = scene.width / parts[0];
                for k in 0..scene.channels {
                    value[k as usize] += additions[((row * scene.channels + k) * size + x) as usize];
                }
                value = value.map(|v| v.clamp(0.0, 1.0));
            }
            match scene.channels {
                1 => value = [value[0], value[0], value[0], 1.0],
                2 => value = [value[0], value[0], value[0], value[1]],
                3 => value[3] = 1.0,
                _ => {}
            }
            if scene.mode == 1 {
                value.swap(0, 2);
            }
            let white = if scene.mode == 2 { 65535.0 } else { 255.0 };
            let code = value.map(|v| (v * white + 0.5).floor() as u32);
            let at = (row * scene.stride) as usize;
            let x = x as usize;
            if scene.mode == 2 {
                codes[at + 2 * x] = code[0] | code[1] << 16;
                codes[at + 2 * x + 1] = code[2] | code[3] << 16;
            } else {
                codes[at + x] = code[0] | code[1] << 8 | code[2] << 16 | code[3] << 24;
            }
        }
    }
}

/// Returns the mean of the samples of the pixel in column `column` of row `row`. Colours are weighted by their alpha.
fn average(
    scene: &Uniforms,
    parts: [u32; 2],
    column: u32,
    row: u32,
    sample: impl Fn(u32, u32) -> [f32; 4],
) -> [f32; 4] {
    let (mut value, mut alpha, mut weights) = ([0.0; 4], 0.0, 0.0);
    for y in row * parts[1]..(row + 1) * parts[1] {
        for x in column * parts[0]..(column + 1) * parts[0] {
            let part = sample(x, y);
            let mut weight = 1.0;
            if scene.alpha < 4 {
                alpha += part[scene.alpha as usize];
                weight = part[scene.alpha as usize] + HIDDEN;
            }
            value = std::array::from_fn(|k| value[k] + weight * part[k]);
            weights += weight;
        }
    }
    value = value.map(|v| v / weights);
    if scene.alpha < 4 {
        value[scene.alpha as usize] = alpha / (parts[0] * parts[1]) as f32;
    }
    value
}

/// Returns the colour, 0..=1, of the band's sample in column `x` of row `row`.
fn sample(scene: &Uniforms, splats: &[Splat], starts: &[u32], sorted: &[u32], x: u32, row: u32) -> [f32; 4] {
    let tile = (row / TILE) * scene.tiles_x + x / TILE;
    let y = scene.band_first + row;
    let sums = sum_tile(splats, starts, sorted, tile as usize, x as f32, y as f32);
    std::array::from_fn(|k| match scene.blend {
        0 => ((sums.color[k] + EPSILON * scene.background[k]) / (sums.weight + EPSILON)).clamp(0.0, 1.0),
        _ => (sums.color[k] + scene.background[k]).clamp(0.0, 1.0),
    })
}
