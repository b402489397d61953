//! Twin of `gather.wgsl`.

use super::common::{tile_columns, tile_rows};
use crate::gpu::scene::{Splat, Uniforms};

pub(in crate::gpu) fn gather(
    scene: &Uniforms,
    splats: &[Splat],
    starts: &[u32],
    sorted: &[u32],
    slots: &[[f32; 4]],
    moments: &mut [f32],
) {
    for (i, splat) in splats.iter().enumerate() {
        let mut all = [[0.0f32; 4]; 3];
        let rows = tile_rows(scene, splat);
        for row in rows[0]..rows[1] {
            let columns = tile_columns(scene, splat, row, 2.0);
            for column in columns[0]..columns[1] {
                let tile = (row * scene.tiles_x + column) as usize;
                let mut low = starts[tile];
                let end = starts[tile + 1];
                let mut high = end;
                while low < high {
                    let middle = (low + high) / 2;
                    if sorted[middle as usize] < i as u32 {
                        low = middle + 1;
                    } else {
                        high = middle;
                    }
                }
                if low < end && sorted[low as usize] == i as u32 {
                    for (a, s) in all.iter_mut().zip(&slots[3 * low as usize..]) {
                        for k in 0..4 {
                            a[k] += s[k];
                        }
                    }
                }
            }
        }
        let n = scene.primitives as usize;
        let [a, b, c] = all;
        let mut sums = [a[0], a[1], a[2], a[3], b[0], c[0], c[1], c[2], c[3]];
        for (k, sum) in sums.iter_mut().enumerate() {
            if scene.mode == 1 {
                *sum += moments[k * n + i];
            }
            moments[k * n + i] = *sum;
        }
    }
}
