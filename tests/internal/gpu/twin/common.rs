//! Twin of `common.wgsl`.

use crate::gpu::scene::{Splat, TILE, Uniforms};

pub(in crate::gpu) const CUTOFF: f32 = 3.5;
pub(in crate::gpu) const CUTOFF_WEIGHT: f32 = 0.002_187_491_1;
/// `u² + v²` at the edge of the support.
pub(in crate::gpu) const SUPPORT: f32 = 8.836_507;
/// `√(½ log₂ e)`.
pub(in crate::gpu) const HALF: f32 = 0.849_321_8;
pub(in crate::gpu) const EPSILON: f32 = 0.007_812_5;
pub(in crate::gpu) const HIDDEN: f32 = 0.000_244_140_63;

pub(in crate::gpu) fn sin_cos(x: f32) -> [f32; 2] {
    let k = (x * std::f32::consts::FRAC_2_PI + 0.5).floor();
    let r = ((x - k * 1.570_312_5) - k * 4.837_513e-4) - k * 7.549_79e-8;
    let z = r * r;
    let s = r + r * z * (-0.166_666_55 + z * (8.332_161e-3 + z * -1.951_529_6e-4));
    let c = 1.0 - 0.5 * z + z * z * (4.166_664_6e-2 + z * (-1.388_731_6e-3 + z * 2.443_315_7e-5));
    match k as i32 as u32 & 3 {
        0 => [s, c],
        1 => [c, -s],
        2 => [-s, -c],
        _ => [-c, s],
    }
}

pub(in crate::gpu) fn sampled_row(scene: &Uniforms, index: u32) -> u32 {
    scene.row_phase + index * scene.row_step
}

pub(in crate::gpu) fn tile_rows(scene: &Uniforms, splat: &Splat) -> [u32; 2] {
    let phase = scene.row_phase as f32;
    let step = scene.row_step as f32;
    let low = (splat.place[1] - splat.extent[1] - 0.5 - phase) / step;
    let high = (splat.place[1] + splat.extent[1] + 0.5 - phase) / step;
    let start = scene.band_first as f32;
    let stop = (scene.band_first + scene.band_rows) as f32;
    let first = low.ceil().clamp(start, stop);
    let end = (high.floor() + 1.0).clamp(start, stop);
    if first >= end {
        return [0, 0];
    }
    [(first as u32 - scene.band_first) / TILE, (end as u32 - 1 - scene.band_first) / TILE + 1]
}

pub(in crate::gpu) fn tile_columns(scene: &Uniforms, splat: &Splat, row: u32, slack: f32) -> [u32; 2] {
    let index = scene.band_first + row * TILE;
    let top = sampled_row(scene, index) as f32 - splat.place[1] - 0.5;
    let bottom = sampled_row(scene, index + TILE - 1) as f32 - splat.place[1] + 0.5;
    let level = splat.shape[3];
    let right = level.clamp(top, bottom);
    let left = (-level).clamp(top, bottom);
    let r = right / splat.extent[1];
    let l = left / splat.extent[1];
    let half_right = splat.shape[2] * (1.0 - r * r).max(0.0).sqrt();
    let half_left = splat.shape[2] * (1.0 - l * l).max(0.0).sqrt();
    let low = splat.place[0] + splat.shape[1] * left - half_left - slack;
    let high = splat.place[0] + splat.shape[1] * right + half_right + slack;
    let last = scene.width as f32;
    let first = low.floor().clamp(0.0, last);
    let end = (high.floor() + 1.0).clamp(0.0, last);
    if first >= end {
        return [0, 0];
    }
    [first as u32 / TILE, (end as u32 - 1) / TILE + 1]
}
