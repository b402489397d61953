//! Twin of `backward.wgsl`.

use super::common::{CUTOFF_WEIGHT, SUPPORT, sampled_row};
use super::forward::dot;
use super::pair::{area_of, span, tile_of};
use crate::gpu::scene::{Splat, Uniforms};

pub(in crate::gpu) fn backward(
    scene: &Uniforms,
    splats: &[Splat],
    starts: &[u32],
    sorted: &[u32],
    planes: &[[f32; 4]],
    tails: &[f32],
    slots: &mut [[f32; 4]],
) {
    for pair in 0..starts[scene.tiles() as usize] {
        let splat = &splats[sorted[pair as usize] as usize];
        let area = area_of(scene, tile_of(scene, starts, pair));
        let mut moments = [0.0; 4];
        let mut last = 0.0;
        let mut color = [0.0; 4];
        for row in area[2]..area[3] {
            let dy = sampled_row(scene, scene.band_first + row) as f32 - splat.place[1];
            let columns = span(splat, dy, area[0], area[1]);
            for x in columns[0]..columns[1] {
                let dx = x as f32 - splat.place[0];
                let u = splat.place[2] * dy - splat.place[3] * dx;
                let v = splat.shape[0] * dx;
                let q = u * u + v * v;
                if q < SUPPORT {
                    let at = (row * scene.width + x) as usize;
                    let g = planes[at];
                    let e = (-q).exp2();
                    let t = e * (dot(g, splat.color) - tails[at]);
                    for k in 0..4 {
                        color[k] += (e - CUTOFF_WEIGHT).max(0.0) * g[k];
                    }
                    for (m, f) in moments.iter_mut().zip([u, v, u * u, u * v]) {
                        *m += t * f;
                    }
                    last += t * (v * v);
                }
            }
        }
        let slot = 3 * pair as usize;
        slots[slot] = moments;
        slots[slot + 1] = [last, 0.0, 0.0, 0.0];
        slots[slot + 2] = color;
    }
}
