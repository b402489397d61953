//! Twin of `residual.wgsl`.

use super::common::sampled_row;
use super::forward::{amplitude, importance_of_channels, source_pixel};
use crate::gpu::scene::Uniforms;

pub(in crate::gpu) fn residual(scene: &Uniforms, planes: &[[f32; 4]], source: &[u32], cells: &mut [[f32; 4]]) {
    for i in 0..scene.cells_x * scene.band_rows {
        let row = i / scene.cells_x;
        let left = (i % scene.cells_x) * scene.cell;
        let y = sampled_row(scene, scene.band_first + row);
        let mut sum = [0.0; 4];
        for x in left..(left + scene.cell).min(scene.width) {
            let wanted = source_pixel(scene, source, x, y);
            let value = planes[(row * scene.width + x) as usize].map(|v| v.clamp(0.0, 1.0));
            let share = importance_of_channels(scene, wanted);
            let a = amplitude(scene, source, x, y);
            for k in 0..4 {
                sum[k] += (wanted[k] - value[k]) * (share[k] * scene.channel_amplitude[k] * a / scene.cell as f32);
            }
        }
        cells[((scene.band_first + row) * scene.cells_x + i % scene.cells_x) as usize] = sum;
    }
}
