//! Twin of `peaks.wgsl`.

use super::forward::dot;
use crate::fit::model::placing::ridge::{RIDGES, TAPS, Tap};
use crate::gpu::peaks::Found;
use crate::gpu::scene::Uniforms;

pub(in crate::gpu) fn find_peaks(
    scene: &Uniforms,
    cells: &[[f32; 4]],
    ridges: &[[Tap; TAPS]; RIDGES],
    peaks: &mut Vec<Found>,
) {
    let score = |x: u32, y: u32| {
        let v = cells[(y * scene.cells_x + x) as usize];
        dot(v, v)
    };
    let missing = |x: i32, y: i32| {
        if x < 0 || y < 0 || x as u32 >= scene.cells_x || y as u32 >= scene.cells_y {
            return [0.0; 4];
        }
        cells[(y as u32 * scene.cells_x + x as u32) as usize]
    };
    'cells: for i in 0..scene.cells_x * scene.cells_y {
        let x = i % scene.cells_x;
        let y = i / scene.cells_x;
        let own = score(x, y);
        let gain = 12.566_371 * scene.variance * own;
        if own <= 0.0 || gain * scene.longest < scene.least_gain {
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
        let mut peak = Found { residual: cells[i as usize], level: scene.level, ridge: 0, x, y };
        let mut best = own;
        for (ridge, taps) in ridges.iter().enumerate().filter(|(_, r)| r[0].aspect <= scene.longest) {
            let mut mean = [0.0f32; 4];
            for tap in taps {
                for v in [missing(x as i32 + tap.x, y as i32 + tap.y), missing(x as i32 - tap.x, y as i32 - tap.y)] {
                    mean = std::array::from_fn(|k| mean[k] + tap.weight * v[k]);
                }
            }
            let score = taps[0].aspect * dot(mean, mean);
            if score > best {
                best = score;
                (peak.residual, peak.ridge) = (mean, ridge as u32 + 1);
            }
        }
        peaks.push(peak);
    }
}
