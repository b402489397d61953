//! Twin of `tile.wgsl`.

use super::common::{CUTOFF_WEIGHT, SUPPORT};
use crate::gpu::scene::Splat;

#[derive(Debug, Clone, Copy, Default)]
pub(in crate::gpu) struct Sums {
    pub color: [f32; 4],
    pub weight: f32,
}

pub(in crate::gpu) fn sum_tile(splats: &[Splat], starts: &[u32], sorted: &[u32], tile: usize, x: f32, y: f32) -> Sums {
    let mut sums = Sums::default();
    for &i in &sorted[starts[tile] as usize..starts[tile + 1] as usize] {
        let splat = &splats[i as usize];
        let place = splat.place;
        let dx = x - place[0];
        let u = place[2] * (y - place[1]) - place[3] * dx;
        let v = splat.shape[0] * dx;
        let q = u * u + v * v;
        if q < SUPPORT {
            let w = splat.extent[2] * ((-q).exp2() - CUTOFF_WEIGHT).max(0.0);
            for k in 0..4 {
                sums.color[k] += w * splat.color[k];
            }
            sums.weight += w;
        }
    }
    sums
}
