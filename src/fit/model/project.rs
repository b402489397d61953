//! Primitives in the fit's own coordinates, and their projection to conics and pixel rows.

use crate::gaussian::{CUTOFF, Gaussian};
use crate::parallel;
use crate::simd::Simd;

/// A primitive while it is fitted: as [`Gaussian`], with the scales as natural logarithms and in no order.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Primitive {
    /// Centre, pixels.
    pub mean: [f32; 2],
    /// Natural logarithms of the scales along the rotated x and y axes.
    pub log_scale: [f32; 2],
    /// Angle of the rotated x axis, radians.
    pub rotation: f32,
    /// Colour.
    pub color: [f32; 4],
}

impl Primitive {
    pub fn to_gaussian(self) -> Gaussian {
        let [a, b] = self.log_scale.map(f32::exp);
        let turned = if a >= b { 0.0 } else { std::f32::consts::FRAC_PI_2 };
        let rotation = (self.rotation + turned).rem_euclid(std::f32::consts::PI);
        Gaussian { mean: self.mean, scale: [a.max(b), a.min(b)], rotation, color: self.color }
    }

    pub fn from_gaussian(g: &Gaussian) -> Self {
        Primitive { mean: g.mean, log_scale: g.scale.map(f32::ln), rotation: g.rotation, color: g.color }
    }
}

/// Returns the same primitives in a picture `by` times as large.
pub fn zoomed(mut primitives: Vec<Primitive>, by: f32) -> Vec<Primitive> {
    for p in &mut primitives {
        p.mean = p.mean.map(|v| v * by);
        p.log_scale = p.log_scale.map(|v| v + by.ln());
    }
    primitives
}

/// Projects `primitives` into a picture of so many rows.
pub fn all(primitives: &[Primitive], height: u32) -> Vec<Projected> {
    const CHUNK: usize = 512;
    let chunks = primitives.len().div_ceil(CHUNK);
    parallel::map(chunks, |c| {
        let part = &primitives[c * CHUNK..primitives.len().min((c + 1) * CHUNK)];
        part.iter().map(|p| Projected::new(p, height)).collect::<Vec<_>>()
    })
    .concat()
}

/// One primitive as the pixel loops need it.
#[derive(Debug, Clone, Copy, Default)]
pub struct Projected {
    /// Mean in coordinates where pixel `i` has its centre at `i`.
    pub center: [f32; 2],
    /// The inverse covariance `[[a, b], [b, c]]`.
    pub conic: [f32; 3],
    /// `b / a`: how far the row's maximum moves per row.
    pub shear: f32,
    /// `c − b²/a`, computed without cancellation.
    pub rest: f32,
    /// `1 / a`.
    pub inv_a: f32,
    /// How far below the centre the support's rightmost point lies.
    pub tip: f32,
    /// First row of the support and the row after the last, within the picture.
    pub rows: [u32; 2],
    /// Colour.
    pub color: [f32; 4],
}

impl Projected {
    pub fn new(p: &Primitive, height: u32) -> Self {
        let [ix, iy] = p.log_scale.map(|l| (-2.0 * l).exp());
        Self::from_parts(p.mean, [ix, iy], p.rotation, p.color, height)
    }

    pub fn from_gaussian(g: &Gaussian, height: u32) -> Self {
        Self::from_parts(g.mean, g.scale.map(|s| 1.0 / (s * s)), g.rotation, g.color, height)
    }

    fn from_parts(mean: [f32; 2], [ix, iy]: [f32; 2], rotation: f32, color: [f32; 4], height: u32) -> Self {
        let (sin, cos) = rotation.sin_cos();
        let a = cos * cos * ix + sin * sin * iy;
        let b = cos * sin * (ix - iy);
        let c = sin * sin * ix + cos * cos * iy;
        let half = CUTOFF * (sin * sin / ix + cos * cos / iy).sqrt();
        let center = [mean[0] - 0.5, mean[1] - 0.5];
        let first = (center[1] - half).ceil().max(0.0);
        let end = ((center[1] + half).floor() + 1.0).clamp(0.0, height as f32);
        let rows = [first.min(end) as u32, end as u32];
        let tip = -CUTOFF * b / (ix * iy * c).sqrt();
        Projected { center, conic: [a, b, c], shear: b / a, rest: ix * iy / a, inv_a: 1.0 / a, tip, rows, color }
    }

    /// The pixels of row `y` inside the support, `first..end`, and the row's distance from the centre.
    #[inline(always)]
    pub fn span(&self, y: u32, width: u32) -> Option<(usize, usize, f32)> {
        let dy = y as f32 - self.center[1];
        let t = CUTOFF * CUTOFF - self.rest * dy * dy;
        if t <= 0.0 {
            return None;
        }
        let half = (t * self.inv_a).sqrt();
        let middle = self.center[0] - self.shear * dy;
        let first = (middle - half).ceil().max(0.0);
        let end = ((middle + half).floor() + 1.0).min(width as f32);
        (first < end).then_some((first as usize, end as usize, dy))
    }

    /// The pixels `first..end` of a row that the support reaches somewhere between the distances `top` and `bottom` from
    /// the centre; a little more, as rounding must lose none.
    #[inline(always)]
    pub fn columns(&self, top: f32, bottom: f32) -> (usize, usize) {
        let edge = |dy: f32, sign: f32| {
            let half = ((CUTOFF * CUTOFF - self.rest * dy * dy).max(0.0) * self.inv_a).sqrt();
            self.center[0] - self.shear * dy + sign * (half + 0.01)
        };
        let right = edge(self.tip.max(top).min(bottom), 1.0);
        let left = edge((-self.tip).max(top).min(bottom), -1.0);
        // Casts saturate, also from below.
        (left.ceil() as usize, (right.floor() + 1.0) as usize)
    }

    /// The rows of each column's support.
    #[inline(always)]
    pub fn lines(&self) -> Lines {
        let [a, b, c] = self.conic;
        let (inv_c, determinant) = (1.0 / c, self.rest * a);
        Lines { shear: b * inv_c, rest: determinant * inv_c, inv_c, tip: -CUTOFF * b / (determinant * a).sqrt() }
    }
}

/// Which rows of each column the support of a primitive has.
#[derive(Debug, Clone, Copy)]
pub struct Lines {
    /// `b / c`: how far the column's maximum moves per column.
    shear: f32,
    /// `a − b²/c`.
    rest: f32,
    /// `1 / c`.
    inv_c: f32,
    /// How far right of the centre the support's lowest point lies.
    tip: f32,
}

impl Lines {
    /// How far from the centre the support ends, below it with a `sign` of 1 and above with −1, somewhere between the columns
    /// `left` and `right` of it; a little more, as rounding must lose none.
    #[inline(always)]
    pub fn edge<S: Simd>(&self, simd: S, [left, right]: [S::Vector; 2], sign: f32) -> S::Vector {
        let dx = simd.min(simd.max(simd.splat(sign * self.tip), left), right);
        let rest = simd.mul(simd.mul(simd.splat(self.rest), dx), dx);
        let square = simd.max(simd.sub(simd.splat(CUTOFF * CUTOFF), rest), simd.splat(0.0));
        let half = simd.add(simd.sqrt(simd.mul(square, simd.splat(self.inv_c))), simd.splat(0.01));
        simd.sub(simd.mul(half, simd.splat(sign)), simd.mul(simd.splat(self.shear), dx))
    }
}
