//! Twin of `bin.wgsl`. Threads run one after the other.

use super::common::{tile_columns, tile_rows};
use crate::gpu::scene::{Splat, Uniforms};

pub(in crate::gpu) fn bin(
    scene: &Uniforms,
    splats: &[Splat],
    cursors: &mut [u32],
    lists: &mut [u32],
    status: &mut [u32; 4],
) {
    for (i, splat) in splats.iter().enumerate() {
        if status[1] != 0 || status[0] > scene.capacity {
            return;
        }
        let rows = tile_rows(scene, splat);
        if scene.mode == 0 {
            let mut pairs = 0;
            for row in rows[0]..rows[1] {
                let columns = tile_columns(scene, splat, row, 1.0);
                pairs += columns[1] - columns[0];
            }
            if pairs == 0 {
                continue;
            }
            let before = status[0];
            status[0] += pairs;
            if before > scene.capacity {
                status[1] = status[1].max(before);
                continue;
            }
        }
        for row in rows[0]..rows[1] {
            let columns = tile_columns(scene, splat, row, 1.0);
            for column in columns[0]..columns[1] {
                let cursor = &mut cursors[(row * scene.tiles_x + column) as usize];
                let slot = *cursor;
                *cursor += 1;
                if scene.mode == 1 && slot < scene.capacity {
                    lists[slot as usize] = i as u32;
                }
            }
        }
    }
}
