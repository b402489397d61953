//! Twin of `render.wgsl`.

use super::common::EPSILON;
use super::tile::sum_tile;
use crate::gpu::scene::{Splat, TILE, Uniforms};

pub(in crate::gpu) fn render(scene: &Uniforms, splats: &[Splat], starts: &[u32], sorted: &[u32], codes: &mut [u32]) {
    for row in 0..scene.band_rows {
        for x in 0..scene.width {
            let tile = (row / TILE) * scene.tiles_x + x / TILE;
            let y = scene.band_first + row;
            let sums = sum_tile(splats, starts, sorted, tile as usize, x as f32, y as f32);
            let mut value: [f32; 4] = std::array::from_fn(|k| match scene.blend {
                0 => (sums.color[k] + EPSILON * scene.background[k]) / (sums.weight + EPSILON),
                _ => sums.color[k] + scene.background[k],
            });
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
            let code = value.map(|v| (v.clamp(0.0, 1.0) * white + 0.5).floor() as u32);
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
