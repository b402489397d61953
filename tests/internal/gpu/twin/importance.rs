//! Twin of `importance.wgsl`.

use super::common::{CUTOFF_WEIGHT, SUPPORT, sampled_row};
use super::forward::{amplitude, dot, importance_of_channels, source_pixel};
use super::pair::{area_of, span, tile_of};
use crate::gpu::scene::{Splat, Uniforms};

pub(in crate::gpu) fn importance(
    scene: &Uniforms,
    splats: &[Splat],
    starts: &[u32],
    sorted: &[u32],
    (planes, tails): (&[[f32; 4]], &[f32]),
    source: &[u32],
    slots: &mut [[f32; 4]],
) {
    for pair in 0..starts[scene.tiles() as usize] {
        let splat = &splats[sorted[pair as usize] as usize];
        let area = area_of(scene, tile_of(scene, starts, pair));
        let mut cost = 0.0;
        for row in area[2]..area[3] {
            let y = sampled_row(scene, scene.band_first + row);
            let dy = y as f32 - splat.place[1];
            let columns = span(splat, dy, area[0], area[1]);
            for x in columns[0]..columns[1] {
                let dx = x as f32 - splat.place[0];
                let u = splat.place[2] * dy - splat.place[3] * dx;
                let v = splat.shape[0] * dx;
                let q = u * u + v * v;
                if q < SUPPORT {
                    let at = (row * scene.width + x) as usize;
                    let w = ((-q).exp2() - CUTOFF_WEIGHT).max(0.0);
                    let mut share = w;
                    let counts = importance_of_channels(scene, source_pixel(scene, source, x, y));
                    let used = |v: [f32; 4]| -> [f32; 4] {
                        std::array::from_fn(|k| v[k] * (counts[k] * scene.channel_amplitude[k]))
                    };
                    let mut distance = used(splat.color);
                    if scene.blend == 0 {
                        share = (w / ((tails[at] - w).max(0.0) + 0.02)).min(20.0);
                        distance = used(std::array::from_fn(|k| splat.color[k] - planes[at][k]));
                    }
                    share *= amplitude(scene, source, x, y);
                    cost += share * share * dot(distance, distance);
                }
            }
        }
        let slot = 3 * pair as usize;
        slots[slot] = [cost * scene.row_step as f32, 0.0, 0.0, 0.0];
        slots[slot + 1] = [0.0; 4];
        slots[slot + 2] = [0.0; 4];
    }
}
