//! The picture's definition in plain f64 (spec §5.2, §5.3): slow, short, and what everything else is tested against.

use super::view::View;
use crate::gaussian::{Blend, CUTOFF, EPSILON, Gaussian, Picture};
use crate::pixels::Depth;

/// Weight `max(0, exp(−d²/2) − exp(−K²/2))` of `g` at `(x, y)`, pixels.
#[must_use]
pub fn weight(g: &Gaussian, x: f64, y: f64) -> f64 {
    let (sin, cos) = f64::from(g.rotation).sin_cos();
    let (dx, dy) = (x - f64::from(g.mean[0]), y - f64::from(g.mean[1]));
    let u = (dx * cos + dy * sin) / f64::from(g.scale[0]);
    let v = (dy * cos - dx * sin) / f64::from(g.scale[1]);
    let cutoff = f64::from(CUTOFF);
    ((-0.5 * (u * u + v * v)).exp() - (-0.5 * cutoff * cutoff).exp()).max(0.0)
}

/// Colour of `picture` at `(x, y)`, pixels: 1.0 is white, not clamped; unused channels are those of the background.
#[must_use]
pub fn color(picture: &Picture, x: f64, y: f64) -> [f64; 4] {
    let background = picture.background.map(f64::from);
    let (mut sum, mut total) = ([0.0; 4], 0.0);
    for g in &picture.gaussians {
        let w = weight(g, x, y);
        total += w;
        for (s, c) in sum.iter_mut().zip(g.color) {
            *s += w * f64::from(c);
        }
    }
    let epsilon = f64::from(EPSILON);
    std::array::from_fn(|k| match picture.blend {
        Blend::Normalized => (sum[k] + epsilon * background[k]) / (total + epsilon),
        Blend::Sum => background[k] + sum[k],
    })
}

/// The code value of a colour value at `depth`: `floor(clamp(v, 0, 1) · max + ½)` (spec §5.4).
#[must_use]
pub fn code(value: f64, depth: Depth) -> u16 {
    (value.clamp(0.0, 1.0) * f64::from(depth.max()) + 0.5).floor() as u16
}

/// Colour values of every pixel of `view`, row by row with interleaved channels: the picture sampled at the
/// pixel centres, with no filter, so that for reduced views it is not what a [`Renderer`](super::Renderer) draws.
#[must_use]
pub fn sample(picture: &Picture, view: &View) -> Vec<f64> {
    let mut out = Vec::new();
    for j in 0..view.height() {
        for i in 0..view.width() {
            let [x, y] = view.position(i, j);
            out.extend_from_slice(&color(picture, x, y)[..picture.channels.count()]);
        }
    }
    out
}
