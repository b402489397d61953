//! Twin of `project.wgsl`.

use super::common::{CUTOFF, HALF, sin_cos};
use crate::gpu::scene::{Primitive, Splat, Uniforms};

pub(in crate::gpu) fn project(scene: &Uniforms, primitives: &[Primitive]) -> Vec<Splat> {
    primitives.iter().map(|p| one(scene, p)).collect()
}

fn one(scene: &Uniforms, p: &Primitive) -> Splat {
    let [sin, cos] = sin_cos(p.rotation);
    let s1 = p.log_scale[0].exp();
    let s2 = p.log_scale[1].exp();
    let v1 = s1 * s1;
    let v2 = s2 * s2;
    let tx = 1.0 / scene.step[0];
    let ty = 1.0 / scene.step[1];
    let wide = v1 * cos * cos + v2 * sin * sin;
    let tall = v1 * sin * sin + v2 * cos * cos;
    let mut root = s1 * s2;
    let mut amplitude = 1.0;
    let add = scene.widening;
    if add[0] > 0.0 || add[1] > 0.0 {
        root = (v1 * v2 + add[0] * tall + add[1] * wide + add[0] * add[1]).sqrt();
        amplitude = s1 * s2 / root;
    }
    let xx = (wide + add[0]) * tx * tx;
    let yy = (tall + add[1]) * ty * ty;
    let xy = (v1 - v2) * sin * cos * tx * ty;
    let det = root * tx * ty;
    let sx = xx.sqrt();
    let sy = yy.sqrt();
    let center_x = ((p.mean[0] - scene.origin_high[0]) - scene.origin_low[0]) / scene.step[0] - 0.5;
    let center_y = ((p.mean[1] - scene.origin_high[1]) - scene.origin_low[1]) / scene.step[1] - 0.5;
    let rise = HALF * sx / det;
    Splat {
        place: [center_x, center_y, rise, rise * (xy / xx)],
        shape: [HALF / sx, xy / yy, CUTOFF * det / sy, CUTOFF * xy / sx],
        extent: [CUTOFF * sx, CUTOFF * sy, amplitude, 0.0],
        color: p.color,
    }
}
