//! Adam in the whitened local frame of each Gaussian.

use crate::fit::field::{Field, Gradient, RowSet, Scene};
use crate::fit::project::{Primitive, Projected};
use crate::parallel;

/// Bounds that every step respects.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Bounds {
    pub size: [f32; 2],
    pub min_log_scale: f32,
    pub max_log_scale: f32,
    pub max_log_aspect: f32,
}

impl Bounds {
    pub(crate) fn new(width: u32, height: u32) -> Self {
        let size = [width as f32, height as f32];
        Bounds {
            size,
            min_log_scale: 0.3f32.ln(),
            max_log_scale: size[0].max(size[1]).max(1.0).ln(),
            max_log_aspect: 100f32.ln(),
        }
    }

    /// Brings `p` within the bounds.
    pub(crate) fn apply(&self, p: &mut Primitive) {
        for (m, s) in p.mean.iter_mut().zip(self.size) {
            *m = m.clamp(0.0, s);
        }
        let l = &mut p.log_scale;
        for v in l.iter_mut() {
            *v = v.clamp(self.min_log_scale, self.max_log_scale);
        }
        let (low, high) = if l[0] < l[1] { (0, 1) } else { (1, 0) };
        l[low] = l[low].max(l[high] - self.max_log_aspect);
    }
}

/// Step sizes.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Rates {
    pub mean: f32,
    pub log_scale: f32,
    pub rotation: f32,
    pub color: f32,
}

impl Rates {
    pub(crate) fn scaled(self, f: f32) -> Self {
        Rates { mean: self.mean * f, log_scale: self.log_scale * f, rotation: self.rotation * f, color: self.color * f }
    }
}

/// Which parameters of a primitive may move.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) enum Freedom {
    #[default]
    All,
    Color,
}

/// First and second moments of one primitive's gradient.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Memory {
    first: [f32; 9],
    second: [f32; 9],
}

pub(crate) const BETA1: f32 = 0.9;
pub(crate) const BETA2: f32 = 0.95;

/// Gathers every primitive's gradient from `field` and takes one step. `iteration` counts from 0.
#[allow(clippy::too_many_arguments)]
pub(crate) fn step(
    scene: &Scene,
    channels: usize,
    field: &Field,
    rows: RowSet,
    projected: &[Projected],
    primitives: &mut [Primitive],
    memory: &mut [Memory],
    freedom: Option<&[Freedom]>,
    bounds: &Bounds,
    rates: Rates,
    iteration: u32,
) {
    const CHUNK: usize = 64;
    let corrections = (1.0 - BETA1.powi(iteration as i32 + 1), 1.0 - BETA2.powi(iteration as i32 + 1));
    parallel::map_chunk_pairs((primitives, CHUNK), (memory, CHUNK), |chunk, primitives, memory| {
        let start = chunk * CHUNK;
        let projected = &projected[start..][..primitives.len()];
        let gradients = field.gather(channels, rows, scene.width, projected, primitives);
        for (j, (p, m)) in primitives.iter_mut().zip(memory).enumerate() {
            let free = freedom.map_or(Freedom::All, |f| f[start + j]);
            update(p, m, &gradients[j], free, bounds, rates, corrections);
        }
    });
}

fn update(
    p: &mut Primitive,
    m: &mut Memory,
    g: &Gradient,
    free: Freedom,
    bounds: &Bounds,
    rates: Rates,
    (c1, c2): (f32, f32),
) {
    let g = [
        g.mean[0],
        g.mean[1],
        g.log_scale[0],
        g.log_scale[1],
        g.rotation,
        g.color[0],
        g.color[1],
        g.color[2],
        g.color[3],
    ];
    let mut d = [0.0f32; 9];
    for j in 0..9 {
        let v = if g[j].is_finite() { g[j] } else { 0.0 };
        m.first[j] = BETA1 * m.first[j] + (1.0 - BETA1) * v;
        m.second[j] = BETA2 * m.second[j] + (1.0 - BETA2) * v * v;
        d[j] = -(m.first[j] / c1) / ((m.second[j] / c2).sqrt() + 1e-15);
    }
    for k in 0..4 {
        p.color[k] = (p.color[k] + rates.color * d[5 + k]).clamp(-4.0, 4.0);
    }
    if free == Freedom::Color {
        return;
    }
    let [sx, sy] = p.log_scale.map(f32::exp);
    let (sin, cos) = p.rotation.sin_cos();
    let (u, v) = (rates.mean * d[0] * sx, rates.mean * d[1] * sy);
    p.mean[0] += cos * u - sin * v;
    p.mean[1] += sin * u + cos * v;
    p.log_scale[0] += rates.log_scale * d[2];
    p.log_scale[1] += rates.log_scale * d[3];
    p.rotation += rates.rotation * d[4];
    bounds.apply(p);
}
