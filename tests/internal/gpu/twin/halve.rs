//! Twin of `halve.wgsl`.

use crate::gpu::scene::Uniforms;

pub(in crate::gpu) fn halve(scene: &Uniforms, cells: &[[f32; 4]]) -> Vec<[f32; 4]> {
    let wide = scene.cells_x.div_ceil(2);
    let tall = scene.cells_y.div_ceil(2);
    (0..wide * tall)
        .map(|i| {
            let left = 2 * (i % wide);
            let right = (left + 1).min(scene.cells_x - 1);
            let top = 2 * (i / wide) * scene.cells_x;
            let bottom = (2 * (i / wide) + 1).min(scene.cells_y - 1) * scene.cells_x;
            let at = |i: u32, k: usize| cells[i as usize][k];
            std::array::from_fn(|k| {
                0.25 * (at(top + left, k) + at(top + right, k) + at(bottom + left, k) + at(bottom + right, k))
            })
        })
        .collect()
}
