//! Adam in the whitened local frame of each Gaussian.

use crate::constants::fit;
use crate::fit::model::drawing::field::{Frame, Gradient};
use crate::fit::model::drawing::project::Primitive;
use crate::fit::model::objective::rows::RowSet;
use crate::gaussian::CUTOFF;
use crate::strict_math::StrictMath;

/// Bounds on the parameters, enforced after every step.
#[derive(Debug, Clone, Copy)]
pub struct Bounds {
    pub size: [f32; 2],
    pub min_log_scale: f32,
    pub max_log_scale: f32,
    pub max_log_aspect: f32,
}

impl Bounds {
    pub fn new(width: u32, height: u32) -> Self {
        let size = [width as f32, height as f32];
        Bounds {
            size,
            min_log_scale: 0.3f32.strict_ln(),
            max_log_scale: size[0].max(size[1]).max(1.0).strict_ln(),
            max_log_aspect: 100f32.strict_ln(),
        }
    }

    /// Clamps `p` to the bounds.
    pub fn apply(&self, p: &mut Primitive) {
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

/// Step sizes, in the local frame of each Gaussian.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Rates {
    pub mean: f32,
    pub log_scale: f32,
    pub rotation: f32,
    pub color: f32,
    /// Decay rates of the first and second moments: Adam's `β₁` and `β₂`.
    pub decay: [f32; 2],
}

impl Rates {
    pub(crate) fn scaled(self, f: f32) -> Self {
        Rates {
            mean: self.mean * f,
            log_scale: self.log_scale * f,
            rotation: self.rotation * f,
            color: self.color * f,
            ..self
        }
    }
}

/// Returns the decay rates of the first and second moments for a fit of `steps` steps. In short fits each step goes
/// further, so earlier gradients become outdated sooner.
pub(crate) fn decay(steps: f32) -> [f32; 2] {
    fit::DECAYS[fit::DECAY_STEPS.iter().filter(|&&limit| steps >= limit).count()]
}

/// Returns half the price for a Gaussian of scales 1, where `count` Gaussians have the squared error `error` over the
/// rows `rows`. It is half the price because gradients are those of half the squared error.
pub(crate) fn price(error: f64, [width, height]: [u32; 2], rows: RowSet, count: usize) -> f32 {
    let pixels = |rows: u64| rows as f64 * f64::from(width);
    let pixels_each = pixels(height.into()) / count.max(1) as f64;
    let support = std::f64::consts::PI * f64::from(CUTOFF) * f64::from(CUTOFF);
    let error = error / pixels(rows.count(height) as u64).max(1.0);
    (0.5 * fit::AREA_PRICE * (pixels_each / fit::FULL_PRICE_PIXELS).min(1.0) * support * error) as f32
}

/// First and second moments of one primitive's gradient.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct AdamMoments {
    pub first: [f32; 9],
    pub second: [f32; 9],
}

/// Returns the divisors that correct the bias of the moments at step `iteration`, counted from 0.
pub(crate) fn corrections(decay: [f32; 2], iteration: u32) -> [f32; 2] {
    decay.map(|d| 1.0 - d.powi(iteration as i32 + 1))
}

/// Moves a primitive one step against its gradient `g`, in the frame that it has before the step.
pub(crate) fn update(
    p: &mut Primitive,
    m: &mut AdamMoments,
    g: &Gradient,
    bounds: &Bounds,
    rates: Rates,
    [c1, c2]: [f32; 2],
) {
    let Frame { scale: [sx, sy], turn: (sin, cos) } = g.frame;
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
    let [b1, b2] = rates.decay;
    let mut d = [0.0f32; 9];
    for j in 0..9 {
        let v = if g[j].is_finite() { g[j] } else { 0.0 };
        m.first[j] = b1 * m.first[j] + (1.0 - b1) * v;
        m.second[j] = b2 * m.second[j] + (1.0 - b2) * v * v;
        d[j] = -(m.first[j] / c1) / ((m.second[j] / c2).sqrt() + 1e-15);
    }
    for k in 0..4 {
        p.color[k] = (p.color[k] + rates.color * d[5 + k]).clamp(-4.0, 4.0);
    }
    let (u, v) = (rates.mean * d[0] * sx, rates.mean * d[1] * sy);
    p.mean[0] += cos * u - sin * v;
    p.mean[1] += sin * u + cos * v;
    p.log_scale[0] += rates.log_scale * d[2];
    p.log_scale[1] += rates.log_scale * d[3];
    p.rotation += rates.rotation * d[4];
    bounds.apply(p);
}
