//! Twin of `forward.wgsl` and `pixel.wgsl`.

use super::common::{EPSILON, sampled_row};
use super::tile::sum_tile;
use crate::gpu::scene::{Splat, TILE, Uniforms};

pub(in crate::gpu) fn source_pixel(scene: &Uniforms, source: &[u32], x: u32, y: u32) -> [f32; 4] {
    let at = (((y - scene.source_first) * scene.width + x) * scene.source_words) as usize;
    if scene.source_words - scene.weighted == 1 {
        return std::array::from_fn(|k| (source[at] >> (8 * k) & 0xff) as f32 / 255.0);
    }
    std::array::from_fn(|k| (source[at + k / 2] >> (16 * (k % 2)) & 0xffff) as f32 / 65535.0)
}

pub(in crate::gpu) fn amplitude(scene: &Uniforms, source: &[u32], x: u32, y: u32) -> f32 {
    if scene.weighted == 0 {
        return 1.0;
    }
    f32::from_bits(source[(((y - scene.source_first) * scene.width + x + 1) * scene.source_words - 1) as usize])
}

pub(in crate::gpu) fn importance_of_channels(scene: &Uniforms, wanted: [f32; 4]) -> [f32; 4] {
    let mut opacity = 1.0;
    if scene.alpha == 1 {
        opacity = wanted[1];
    }
    if scene.alpha == 3 {
        opacity = wanted[3];
    }
    let mut share = [opacity.sqrt(); 4];
    if scene.alpha == 1 {
        share[1] = 1.0;
    }
    if scene.alpha == 3 {
        share[3] = 1.0;
    }
    std::array::from_fn(|k| if (k as u32) < scene.channels { share[k] } else { 0.0 })
}

pub(in crate::gpu) struct Output<'a> {
    pub planes: &'a mut [[f32; 4]],
    pub tails: &'a mut [f32],
    pub errors: &'a mut [f32],
}

pub(in crate::gpu) fn forward(
    scene: &Uniforms,
    splats: &[Splat],
    starts: &[u32],
    sorted: &[u32],
    source: &[u32],
    out: &mut Output<'_>,
) {
    for row in 0..scene.band_rows {
        for x in 0..scene.width {
            let tile = ((row / TILE) * scene.tiles_x + x / TILE) as usize;
            let y = sampled_row(scene, scene.band_first + row);
            let sums = sum_tile(splats, starts, sorted, tile, x as f32, y as f32);
            let wanted = source_pixel(scene, source, x, y);
            let value: [f32; 4];
            let mut inverse = 1.0;
            if scene.blend == 0 {
                inverse = 1.0 / (sums.weight + EPSILON);
                value = std::array::from_fn(|k| (sums.color[k] + EPSILON * scene.background[k]) * inverse);
            } else {
                value = std::array::from_fn(|k| sums.color[k] + scene.background[k]);
            }
            let share = importance_of_channels(scene, wanted);
            let mut a = match scene.mode {
                0 => scene.channel_amplitude.map(|c| c * amplitude(scene, source, x, y)),
                _ => [1.0; 4],
            };
            a = std::array::from_fn(|k| a[k] * share[k]);
            let e: [f32; 4] = std::array::from_fn(|k| (value[k].clamp(0.0, 1.0) - wanted[k]) * a[k]);
            out.errors[scene.tile_base as usize + tile] += dot(e, e);
            let at = (row * scene.width + x) as usize;
            if scene.mode == 0 {
                let left = std::array::from_fn(|k| e[k] * (a[k] * inverse));
                out.planes[at] = left;
                out.tails[at] = if scene.blend == 0 { dot(left, value) } else { 0.0 };
            } else {
                out.planes[at] = value;
                out.tails[at] = sums.weight;
            }
        }
    }
}

pub(in crate::gpu) fn dot(a: [f32; 4], b: [f32; 4]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3]
}
