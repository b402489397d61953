//! Twin of `adam.wgsl`.

use super::common::{HALF, sin_cos};
use crate::gpu::scene::Uniforms;

/// Returns the gradient of half the squared error in the Gaussian's own frame: mean in units of its scales,
/// log-scales, rotation, colour.
pub(in crate::gpu) fn gradient(scene: &Uniforms, p: &[f32], moments: &[f32], i: usize) -> [f32; 9] {
    let n = scene.primitives as usize;
    let s1 = p[2].exp();
    let s2 = p[3].exp();
    let [sin, cos] = sin_cos(p[4]);
    let sx = (s1 * s1 * cos * cos + s2 * s2 * sin * sin).sqrt();
    let f = [s1 * cos / sx, s2 * sin / sx];
    let u = moments[i] / HALF;
    let v = moments[n + i] / HALF;
    let uu = moments[2 * n + i] / (HALF * HALF);
    let uv = moments[3 * n + i] / (HALF * HALF);
    let vv = moments[4 * n + i] / (HALF * HALF);
    [
        f[0] * v + f[1] * u,
        f[0] * u - f[1] * v,
        f[0] * f[0] * vv + 2.0 * f[0] * f[1] * uv + f[1] * f[1] * uu,
        f[0] * f[0] * uu - 2.0 * f[0] * f[1] * uv + f[1] * f[1] * vv,
        (f[0] * f[1] * (uu - vv) + (f[0] * f[0] - f[1] * f[1]) * uv) * (s1 / s2 - s2 / s1),
        moments[5 * n + i],
        moments[6 * n + i],
        moments[7 * n + i],
        moments[8 * n + i],
    ]
}

pub(in crate::gpu) fn adam(
    scene: &Uniforms,
    primitives: &mut [f32],
    moments: &[f32],
    first: &mut [f32],
    second: &mut [f32],
) {
    for i in 0..(scene.primitives - scene.frozen) as usize {
        let p = &mut primitives[9 * i..9 * i + 9];
        let mut gradient = gradient(scene, p, moments, i);
        let s1 = p[2].exp();
        let s2 = p[3].exp();
        gradient[2] += scene.price * s1 * s2;
        gradient[3] += scene.price * s1 * s2;
        let [sin, cos] = sin_cos(p[4]);
        let mut move_by = [0.0f32; 9];
        for k in 0..9 {
            let mut g = gradient[k];
            if !g.is_finite() {
                g = 0.0;
            }
            let m = scene.decay[0] * first[9 * i + k] + (1.0 - scene.decay[0]) * g;
            let s = scene.decay[1] * second[9 * i + k] + (1.0 - scene.decay[1]) * g * g;
            first[9 * i + k] = m;
            second[9 * i + k] = s;
            move_by[k] = -(m / scene.correction_first) / ((s / scene.correction_second).sqrt() + 1e-15);
        }
        for k in 5..9 {
            p[k] = (p[k] + scene.rates[3] * move_by[k]).clamp(-4.0, 4.0);
        }
        let along = scene.rates[0] * move_by[0] * s1;
        let across = scene.rates[0] * move_by[1] * s2;
        let x = p[0] + (cos * along - sin * across);
        let y = p[1] + (sin * along + cos * across);
        p[0] = x.clamp(0.0, scene.size[0]);
        p[1] = y.clamp(0.0, scene.size[1]);
        let mut a = (p[2] + scene.rates[1] * move_by[2]).clamp(scene.min_log_scale, scene.max_log_scale);
        let mut b = (p[3] + scene.rates[1] * move_by[3]).clamp(scene.min_log_scale, scene.max_log_scale);
        if a < b {
            a = a.max(b - scene.max_log_aspect);
        } else {
            b = b.max(a - scene.max_log_aspect);
        }
        p[2] = a;
        p[3] = b;
        p[4] += scene.rates[2] * move_by[4];
    }
}
