//! Twin of `pair.wgsl`.

use crate::gpu::scene::{Splat, TILE, Uniforms};

pub(in crate::gpu) fn tile_of(scene: &Uniforms, starts: &[u32], pair: u32) -> u32 {
    let mut low = 0;
    let mut high = scene.tiles_x * scene.tiles_y;
    while high - low > 1 {
        let middle = (low + high) / 2;
        if starts[middle as usize] <= pair {
            low = middle;
        } else {
            high = middle;
        }
    }
    low
}

pub(in crate::gpu) fn span(splat: &Splat, dy: f32, left: u32, right: u32) -> [u32; 2] {
    let t = dy / splat.extent[1];
    let rest = 1.0 - t * t;
    if rest <= 0.0 {
        return [0, 0];
    }
    let half = splat.shape[2] * rest.sqrt();
    let middle = splat.place[0] + splat.shape[1] * dy;
    let first = (middle - half - 0.5).ceil().clamp(left as f32, right as f32);
    let end = ((middle + half + 0.5).floor() + 1.0).clamp(left as f32, right as f32);
    [first as u32, end as u32]
}

pub(in crate::gpu) fn area_of(scene: &Uniforms, tile: u32) -> [u32; 4] {
    let left = (tile % scene.tiles_x) * TILE;
    let first = (tile / scene.tiles_x) * TILE;
    [left, (left + TILE).min(scene.width), first, (first + TILE).min(scene.band_rows)]
}
