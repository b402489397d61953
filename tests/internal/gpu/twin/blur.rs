//! Twin of `blur.wgsl`.

use crate::gpu::scene::Uniforms;

pub(in crate::gpu) fn blur(scene: &Uniforms, cells: &[[f32; 4]]) -> Vec<[f32; 4]> {
    (0..scene.cells_x * scene.cells_y)
        .map(|i| {
            let x = i % scene.cells_x;
            let y = i / scene.cells_x;
            let mut at = x;
            let mut last = scene.cells_x - 1;
            let mut first = y * scene.cells_x;
            let mut stride = 1;
            if scene.mode == 1 {
                at = y;
                last = scene.cells_y - 1;
                first = x;
                stride = scene.cells_x;
            }
            let a = cells[(first + (at.max(2) - 2) * stride) as usize];
            let b = cells[(first + (at.max(1) - 1) * stride) as usize];
            let c = cells[(first + at * stride) as usize];
            let d = cells[(first + (at + 1).min(last) * stride) as usize];
            let e = cells[(first + (at + 2).min(last) * stride) as usize];
            std::array::from_fn(|k| 0.0625 * (a[k] + e[k]) + 0.25 * (b[k] + d[k]) + 0.375 * c[k])
        })
        .collect()
}
