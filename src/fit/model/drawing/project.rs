//! Primitives in the fit's own parametrization, and their projection to conics and pixel rows.

use crate::gaussian::{CUTOFF, Gaussian};
use crate::parallel;
use crate::simd::{self, LANES, Simd, Task};
use crate::strict_math::StrictMath;

/// A primitive during the fit: like [`Gaussian`], but with logarithmic scales in any order.
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
        let [a, b] = self.log_scale.map(f32::strict_exp);
        let turned = if a >= b { 0.0 } else { std::f32::consts::FRAC_PI_2 };
        let rotation = (self.rotation + turned).rem_euclid(std::f32::consts::PI);
        Gaussian { mean: self.mean, scale: [a.max(b), a.min(b)], rotation, color: self.color }
    }

    pub fn from_gaussian(g: &Gaussian) -> Self {
        Primitive { mean: g.mean, log_scale: g.scale.map(f32::strict_ln), rotation: g.rotation, color: g.color }
    }
}

/// Returns the same primitives in a picture that is `by` times as large.
pub fn zoomed(mut primitives: Vec<Primitive>, by: f32) -> Vec<Primitive> {
    for p in &mut primitives {
        p.mean = p.mean.map(|v| v * by);
        p.log_scale = p.log_scale.map(|v| v + by.strict_ln());
    }
    primitives
}

/// Projects `primitives` into a picture of `height` rows.
pub fn all(primitives: &[Primitive], height: u32) -> Vec<Projected> {
    const CHUNK: usize = 512;
    let mut projected = vec![Projected::default(); primitives.len()];
    parallel::map_chunks(&mut projected, CHUNK, |c, out| {
        simd::dispatch(ProjectTask { primitives: &primitives[c * CHUNK..][..out.len()], height, out });
    });
    projected
}

/// Primitives to project.
struct ProjectTask<'a> {
    primitives: &'a [Primitive],
    height: u32,
    out: &'a mut [Projected],
}

impl Task for ProjectTask<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        for (primitives, out) in self.primitives.chunks(LANES).zip(self.out.chunks_mut(LANES)) {
            project_eight(simd, primitives, self.height, out);
        }
    }
}

/// Scales, and sines and cosines of the rotations, of eight primitives.
#[derive(Debug, Clone, Copy)]
pub struct Frames {
    pub scales: [[f32; LANES]; 2],
    pub sin: [f32; LANES],
    pub cos: [f32; LANES],
}

/// Returns log-scales and rotations as structure of arrays.
#[inline(always)]
fn shapes(primitives: &[Primitive]) -> [[f32; LANES]; 3] {
    let mut shapes = [[0.0; LANES]; 3];
    for (k, p) in primitives.iter().enumerate() {
        (shapes[0][k], shapes[1][k], shapes[2][k]) = (p.log_scale[0], p.log_scale[1], p.rotation);
    }
    shapes
}

/// Returns the frames of at most eight primitives.
#[inline(always)]
pub fn frames<S: Simd>(simd: S, primitives: &[Primitive]) -> Frames {
    let [major, minor, rotation] = shapes(primitives);
    let [sin, cos] = simd.sin_cos(simd.vector(rotation));
    let scales = [simd.to_array(simd.exp(simd.vector(major))), simd.to_array(simd.exp(simd.vector(minor)))];
    Frames { scales, sin: simd.to_array(sin), cos: simd.to_array(cos) }
}

/// Projects at most eight primitives at once, like [`Projected::from_parts`] for one.
#[inline(always)]
fn project_eight<S: Simd>(simd: S, primitives: &[Primitive], height: u32, out: &mut [Projected]) {
    let [major, minor, rotation] = shapes(primitives);
    let twice = simd.splat(-2.0);
    let ix = simd.exp(simd.mul(simd.vector(major), twice));
    let iy = simd.exp(simd.mul(simd.vector(minor), twice));
    let [sin, cos] = simd.sin_cos(simd.vector(rotation));
    let (ss, cc, one) = (simd.mul(sin, sin), simd.mul(cos, cos), simd.splat(1.0));
    let a = simd.add(simd.mul(cc, ix), simd.mul(ss, iy));
    let b = simd.mul(simd.mul(cos, sin), simd.sub(ix, iy));
    let c = simd.add(simd.mul(ss, ix), simd.mul(cc, iy));
    let cutoff = simd.splat(CUTOFF);
    let half = simd.mul(cutoff, simd.sqrt(simd.add(simd.div(ss, ix), simd.div(cc, iy))));
    let (inv_a, both) = (simd.div(one, a), simd.mul(ix, iy));
    let tip = simd.div(simd.mul(simd.sub(simd.splat(0.0), cutoff), b), simd.sqrt(simd.mul(both, c)));
    let [shear, rest] = [simd.div(b, a), simd.div(both, a)];
    let (half, inv_a, tip) = (simd.to_array(half), simd.to_array(inv_a), simd.to_array(tip));
    let (a, b, c) = (simd.to_array(a), simd.to_array(b), simd.to_array(c));
    let (shear, rest) = (simd.to_array(shear), simd.to_array(rest));
    for (k, (p, out)) in primitives.iter().zip(out).enumerate() {
        let center = [p.mean[0] - 0.5, p.mean[1] - 0.5];
        *out = Projected {
            center,
            conic: [a[k], b[k], c[k]],
            shear: shear[k],
            rest: rest[k],
            inv_a: inv_a[k],
            tip: tip[k],
            rows: rows(center[1], half[k], height),
            color: p.color,
        };
    }
}

/// Returns the rows within `half` of `center`, clamped to `height` rows.
#[inline(always)]
fn rows(center: f32, half: f32, height: u32) -> [u32; 2] {
    let first = (center - half).ceil().max(0.0);
    let end = ((center + half).floor() + 1.0).clamp(0.0, height as f32);
    [first.min(end) as u32, end as u32]
}

/// One primitive in the form that the pixel loops use.
#[derive(Debug, Clone, Copy, Default)]
pub struct Projected {
    /// Mean, in coordinates where the centre of pixel `i` is at `i`.
    pub center: [f32; 2],
    /// The inverse covariance `[[a, b], [b, c]]`.
    pub conic: [f32; 3],
    /// `b / a`: the shift of a row's maximum from one row to the next.
    pub shear: f32,
    /// `c − b²/a`, computed without cancellation.
    pub rest: f32,
    /// `1 / a`.
    pub inv_a: f32,
    /// Distance by which the rightmost point of the support is below the centre.
    pub tip: f32,
    /// First row of the support and the row after the last, within the picture.
    pub rows: [u32; 2],
    /// Colour.
    pub color: [f32; 4],
}

impl Projected {
    #[cfg(any(test, feature = "unstable"))]
    pub fn new(p: &Primitive, height: u32) -> Self {
        let [ix, iy] = p.log_scale.map(|l| (-2.0 * l).strict_exp());
        Self::from_parts(p.mean, [ix, iy], p.rotation, p.color, height)
    }

    pub fn from_gaussian(g: &Gaussian, height: u32) -> Self {
        Self::from_parts(g.mean, g.scale.map(|s| 1.0 / (s * s)), g.rotation, g.color, height)
    }

    fn from_parts(mean: [f32; 2], [ix, iy]: [f32; 2], rotation: f32, color: [f32; 4], height: u32) -> Self {
        let (sin, cos) = rotation.strict_sin_cos();
        let a = cos * cos * ix + sin * sin * iy;
        let b = cos * sin * (ix - iy);
        let c = sin * sin * ix + cos * cos * iy;
        let half = CUTOFF * (sin * sin / ix + cos * cos / iy).sqrt();
        let center = [mean[0] - 0.5, mean[1] - 0.5];
        let rows = rows(center[1], half, height);
        let tip = -CUTOFF * b / (ix * iy * c).sqrt();
        Projected { center, conic: [a, b, c], shear: b / a, rest: ix * iy / a, inv_a: 1.0 / a, tip, rows, color }
    }

    /// Returns the pixels `first..end` of row `y` inside the support, and the row's distance from the centre.
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

    /// Returns the ends of the support in row `y`, slightly enlarged, or `None` if it does not reach there.
    #[inline(always)]
    pub fn row_ends(&self, y: u32) -> Option<[f32; 2]> {
        let dy = y as f32 - self.center[1];
        let t = CUTOFF * CUTOFF - self.rest * dy * dy;
        // Rounding must not lose a row at a tip.
        if t < -1e-3 * CUTOFF * CUTOFF {
            return None;
        }
        let half = (t.max(0.0) * self.inv_a).sqrt() + 1.0;
        let middle = self.center[0] - self.shear * dy;
        Some([middle - half, middle + half])
    }

    /// Returns the pixels `first..end` that the support covers in any row between the distances `top` and `bottom` from
    /// the centre. The range is slightly enlarged, so that rounding loses no pixel.
    #[inline(always)]
    pub fn columns(&self, top: f32, bottom: f32) -> (usize, usize) {
        let edge = |dy: f32, sign: f32| {
            let half = ((CUTOFF * CUTOFF - self.rest * dy * dy).max(0.0) * self.inv_a).sqrt();
            self.center[0] - self.shear * dy + sign * (half + 0.01)
        };
        let right = edge(self.tip.max(top).min(bottom), 1.0);
        let left = edge((-self.tip).max(top).min(bottom), -1.0);
        // Casts saturate at both ends.
        (left.ceil() as usize, (right.floor() + 1.0) as usize)
    }

    /// Returns the parameters from which the rows of each column's support follow.
    #[inline(always)]
    pub fn column_support(&self) -> ColumnSupport {
        let [a, b, c] = self.conic;
        let (inv_c, determinant) = (1.0 / c, self.rest * a);
        ColumnSupport {
            shear: b * inv_c,
            rest: determinant * inv_c,
            inv_c,
            tip: -CUTOFF * b / (determinant * a).sqrt(),
        }
    }
}

/// Parameters of a primitive's support, column by column.
#[derive(Debug, Clone, Copy)]
pub struct ColumnSupport {
    /// `b / c`: the shift of a column's maximum from one column to the next.
    shear: f32,
    /// `a − b²/c`.
    rest: f32,
    /// `1 / c`.
    inv_c: f32,
    /// Distance by which the lowest point of the support is right of the centre.
    tip: f32,
}

impl ColumnSupport {
    /// Returns the largest distance from the centre to the edge of the support in any column between `left` and
    /// `right`: below the centre with a `sign` of 1, above it with −1. It is slightly enlarged, so that rounding loses
    /// no pixel.
    #[inline(always)]
    pub fn edge<S: Simd>(&self, simd: S, [left, right]: [S::Vector; 2], sign: f32) -> S::Vector {
        let dx = simd.min(simd.max(simd.splat(sign * self.tip), left), right);
        let rest = simd.mul(simd.mul(simd.splat(self.rest), dx), dx);
        let square = simd.max(simd.sub(simd.splat(CUTOFF * CUTOFF), rest), simd.splat(0.0));
        let half = simd.add(simd.sqrt(simd.mul(square, simd.splat(self.inv_c))), simd.splat(0.01));
        simd.sub(simd.mul(half, simd.splat(sign)), simd.mul(simd.splat(self.shear), dx))
    }
}
