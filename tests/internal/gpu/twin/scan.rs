//! Twin of `scan.wgsl`.

use crate::gpu::scene::Uniforms;

pub(in crate::gpu) fn scan(scene: &Uniforms, cursors: &mut [u32], starts: &mut [u32], status: &mut [u32; 4]) {
    let tiles = scene.tiles() as usize;
    let mut start = 0;
    for tile in 0..tiles {
        let own = cursors[tile];
        starts[tile] = start;
        cursors[tile] = start;
        start += own;
    }
    let pairs = start.max(status[0]);
    if pairs > scene.capacity {
        status[1] = status[1].max(pairs);
    }
    starts[tiles] = start;
}
