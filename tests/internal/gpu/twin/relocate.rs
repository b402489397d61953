//! Twin of `relocate.wgsl`.

use crate::gpu::scene::Uniforms;

pub(in crate::gpu) fn relocate(
    scene: &Uniforms,
    moves: &[u32],
    primitives: &mut [f32],
    first: &mut [f32],
    second: &mut [f32],
) {
    for j in 0..scene.capacity as usize {
        let i = moves[10 * j] as usize;
        if i >= scene.primitives as usize {
            continue;
        }
        for k in 0..9 {
            primitives[9 * i + k] = f32::from_bits(moves[10 * j + 1 + k]);
            first[9 * i + k] = 0.0;
            second[9 * i + k] = 0.0;
        }
    }
}
