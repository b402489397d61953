//! Twin of `peaks.wgsl`.

use super::forward::dot;
use crate::gpu::peaks::Found;
use crate::gpu::scene::Uniforms;

pub(in crate::gpu) fn find_peaks(scene: &Uniforms, cells: &[[f32; 4]], peaks: &mut Vec<Found>) {
    let score = |x: u32, y: u32| {
        let v = cells[(y * scene.cells_x + x) as usize];
        dot(v, v)
    };
    'cells: for i in 0..scene.cells_x * scene.cells_y {
        let x = i % scene.cells_x;
        let y = i / scene.cells_x;
        let own = score(x, y);
        let gain = 12.566_371 * scene.variance * own;
        if own <= 0.0 || gain < scene.least_gain {
            continue;
        }
        for ny in y.max(1) - 1..=(y + 1).min(scene.cells_y - 1) {
            for nx in x.max(1) - 1..=(x + 1).min(scene.cells_x - 1) {
                let other = score(nx, ny);
                if other > own || (other == own && (ny < y || (ny == y && nx < x))) {
                    continue 'cells;
                }
            }
        }
        peaks.push(Found { residual: cells[i as usize], gain, level: scene.level, x, y });
    }
}
