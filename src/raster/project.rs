//! Projects Gaussians of the picture onto the sampling grid of a view. The grid has several pixels per output pixel if
//! the view is reduced.
//!
//! With `u = rise·dy − shear·dx` and `v = run·dx`, where `(dx, dy)` is the offset from the mean in pixels of that
//! grid, the Gaussian is `2^(level − u² − v²)`. Large offsets cancel in `u`, so offsets are f64 up to the corner of a
//! strip.

use super::view::View;
use crate::angle::sin_cos;
use crate::budget::{Budget, Reservation};
use crate::error::{Error, Result};
use crate::gaussian::{CUTOFF, CUTOFF_WEIGHT, Gaussian};
use crate::parallel;
use crate::parameter::Parameter;
use crate::simd::LANES;

/// `u² + v²` at the edge of the support: `K²/2 · log₂ e`.
pub(super) const SUPPORT: f64 = 0.5 * (CUTOFF as f64) * (CUTOFF as f64) * std::f64::consts::LOG2_E;

/// Largest `u² + v² − level` at which the recurrence may start; beyond it, f32 would underflow.
const RECURRENCE_REACH: f64 = 120.0;

/// Largest rise of the recurrence. Its ratios stay within the range of f32, because `|u| ≤ √120`.
const RECURRENCE_RISE: f64 = 4.0;

/// Largest change of `u` or `v` from column to column for which every strip that the support touches is within reach
/// of the recurrence. Up to seven columns and the row in which the support ends lie beyond the edge `u² + v² = 8.9`.
const RECURRENCE_RUN: f64 = 1.0;

/// Relative time of a row with an exponential: 4.1 with AVX2, less with plain instructions.
const EXPONENTIAL_COST: u64 = 4;

/// A Gaussian on the grid of a view.
#[derive(Debug, Clone, Copy)]
pub(super) struct Splat {
    /// Centre, in pixels from the grid's corner.
    pub mean: [f64; 2],
    /// Increase of `u` per pixel down.
    pub rise: f64,
    /// Decrease of `u` per pixel to the right.
    pub shear: f64,
    /// Increase of `v` per pixel to the right.
    pub run: f64,
    /// Horizontal offset of the support's lowest point (largest y) from the mean, pixels.
    pub tip: f64,
    /// Half width and half height of the support's bounding box, pixels, rounded up; may be infinite.
    extent: [f32; 2],
    /// Ratio of the ratios of neighbouring rows: `2^(−2·rise²)`.
    pub bend: f32,
    /// Correction of the ratio's exponent for each row of a segment, which compensates the rounding of `bend`: see
    /// [`Splat::new`].
    pub drift: f32,
    /// Binary logarithm of the amplitude; 0 unless the filter widens the Gaussian.
    pub level: f32,
    /// Offset that makes the weight continuous at the edge of the support: [`CUTOFF_WEIGHT`] times the amplitude.
    pub edge: f32,
    pub color: [f32; 4],
}

impl Splat {
    fn new(g: &Gaussian, view: &View, variance: [f64; 2]) -> Self {
        let (sin, cos) = sin_cos(g.rotation.into());
        let [s1, s2] = g.scale.map(f64::from);
        let [tx, ty] = view.step.map(f64::recip);
        let (v1, v2) = (s1 * s1, s2 * s2);
        let (xx, yy) = (v1 * cos * cos + v2 * sin * sin, v1 * sin * sin + v2 * cos * cos);
        // Square root of the covariance's determinant. `√(xx·yy − xy²)` would cancel for very narrow Gaussians.
        let (mut root, mut amplitude, mut level) = (s1 * s2, 1.0, 0.0);
        if variance != [0.0; 2] {
            root = (v1 * v2 + variance[0] * yy + variance[1] * xx + variance[0] * variance[1]).sqrt();
            amplitude = s1 * s2 / root;
            level = amplitude.log2();
        }
        let xx = (xx + variance[0]) * tx * tx;
        let yy = (yy + variance[1]) * ty * ty;
        let xy = (v1 - v2) * sin * cos * tx * ty;
        let det = root * tx * ty;
        let half = (0.5 * std::f64::consts::LOG2_E).sqrt();
        let (sx, sy) = (xx.sqrt(), yy.sqrt());
        let rise = half * sx / det;
        let steep = rise > RECURRENCE_RISE;
        let cutoff = f64::from(CUTOFF);
        // f32 represents `bend` within 2⁻²⁴; after n rows, the Gaussian has n²/2 times that error. Subtracting (√2 −
        // 1)·N times the error from the first ratio of N rows leaves at most 0.086·N² times it: 8·10⁻⁵ at 128 rows.
        let bend = -2.0 * rise * rise;
        let (bend, drift) = match steep {
            true => (0.0, 0.0),
            false => {
                let exact = bend.exp2();
                let rounded = exact as f32;
                (
                    rounded,
                    (1.0 - std::f64::consts::SQRT_2) * std::f64::consts::LOG2_E * (f64::from(rounded) / exact - 1.0),
                )
            }
        };
        Splat {
            mean: std::array::from_fn(|k| (f64::from(g.mean[k]) - view.origin[k]) / view.step[k]),
            rise,
            shear: rise * (xy / xx),
            run: half / sx,
            tip: cutoff * xy / sy,
            extent: [cutoff * sx, cutoff * sy].map(|extent| (extent as f32).next_up()),
            bend,
            drift: drift as f32,
            level: level as f32,
            edge: (amplitude * f64::from(CUTOFF_WEIGHT)) as f32,
            color: g.color,
        }
    }

    /// Returns the half width and half height of a box around the support, pixels: its bounding box, slightly enlarged
    /// by rounding.
    #[inline(always)]
    pub(super) fn extent(&self) -> [f64; 2] {
        self.extent.map(f64::from)
    }

    /// Returns the pixels down per unit of `u`.
    #[inline(always)]
    pub(super) fn pitch(&self) -> f32 {
        self.rise.recip() as f32
    }

    /// Returns the largest `u² + v²` on the first row of a segment at which the recurrence may start; never if
    /// negative.
    #[inline(always)]
    pub(super) fn reach(&self) -> f32 {
        if self.rise > RECURRENCE_RISE { -1.0 } else { (RECURRENCE_REACH + f64::from(self.level)) as f32 }
    }

    /// Returns an upper estimate of the pixels of `view` that the kernel visits for this splat: those within the
    /// support's box and within a strip's width of the support.
    pub(super) fn covered(&self, view: &View) -> u64 {
        let side = [view.width, view.height];
        let extent = self.extent();
        let [wide, high] = std::array::from_fn(|k| {
            let (first, last) = (f64::from(view.offset[k]), f64::from(view.offset[k]) + f64::from(side[k]));
            (self.mean[k] + extent[k]).min(last) - (self.mean[k] - extent[k]).max(first) + 1.0
        });
        let [ex, ey] = extent;
        // In each row, the support is an interval; the strips at both ends are drawn completely.
        let ellipse = std::f64::consts::PI * (ex * ex - self.tip * self.tip).max(0.0).sqrt() * ey;
        let ends = 2.0 * LANES as f64;
        // Strips start inside the picture, so only the last one in a row overhangs its edge.
        let widest = (wide + ends).min(f64::from(side[0]) + LANES as f64);
        // The cast saturates.
        (ellipse + ends * high).min(widest * high) as u64
    }

    /// Returns the work per pixel of the splat, relative to a wide Gaussian. It is higher if each row takes an
    /// exponential. The estimate may be too high for a few Gaussians.
    pub(super) fn cost(&self) -> u64 {
        let is_narrow = self.rise > RECURRENCE_RISE || self.run.abs().max(self.shear.abs()) > RECURRENCE_RUN;
        if is_narrow { EXPONENTIAL_COST } else { 1 }
    }

    /// Tells whether the support contains a pixel centre's column and row within the view.
    fn touches(&self, view: &View) -> bool {
        let (side, extent) = ([view.width, view.height], self.extent());
        (0..2).all(|k| {
            let (first, last) = (f64::from(view.offset[k]), f64::from(view.offset[k]) + f64::from(side[k]));
            self.mean[k] + extent[k] >= first && self.mean[k] - extent[k] <= last
        })
    }
}

/// The rectangle of the picture that a view shows, and the reach of the filter, in pixels of the picture.
struct ViewBounds {
    first: [f64; 2],
    last: [f64; 2],
    margin: [f64; 2],
}

impl ViewBounds {
    fn new(view: &View, variance: [f64; 2]) -> Self {
        let side = [view.width, view.height];
        let corner = |k: usize, pixels: u32| view.origin[k] + f64::from(pixels) * view.step[k];
        // Extents are computed from sums of variances. The margin of half a pixel ensures that rounding does not lose
        // a Gaussian.
        ViewBounds {
            first: std::array::from_fn(|k| corner(k, view.offset[k]) - 0.5),
            last: std::array::from_fn(|k| corner(k, view.offset[k]) + f64::from(side[k]) * view.step[k] + 0.5),
            margin: variance.map(|v| f64::from(CUTOFF) * v.sqrt()),
        }
    }

    /// Tells whether even the circle around the support of `g` lies outside. This test is much cheaper than the
    /// extent.
    fn excludes(&self, g: &Gaussian) -> bool {
        let radius = f64::from(CUTOFF) * f64::from(g.scale[0].max(g.scale[1]));
        (0..2).any(|k| {
            let (mean, reach) = (f64::from(g.mean[k]), (radius + self.margin[k]) * (1.0 + 1e-9));
            mean + reach < self.first[k] || mean - reach > self.last[k]
        })
    }
}

/// Gaussians that are projected as one unit of work.
const CHUNK: usize = 1024;

/// Splats that are visible in a view, in the picture's order.
#[derive(Debug)]
pub(super) struct Splats {
    /// Visible splats of each [`CHUNK`] of the picture's Gaussians. Threads fill separate chunks and need no common
    /// index.
    chunks: Vec<Vec<Splat>>,
    #[expect(dead_code, reason = "held until the splats are gone")]
    memory: Reservation,
}

impl Splats {
    /// Returns the number of splats.
    pub(super) fn len(&self) -> usize {
        self.chunks.iter().map(Vec::len).sum()
    }

    /// Returns all splats in runs of consecutive numbers, each with its first number.
    pub(super) fn runs(&self) -> impl Iterator<Item = (u32, &[Splat])> {
        self.chunks.iter().enumerate().map(|(i, chunk)| ((i * CHUNK) as u32, &chunk[..]))
    }

    /// Returns the splat with number `id`.
    #[inline(always)]
    pub(super) fn get(&self, id: u32) -> &Splat {
        &self.chunks[id as usize / CHUNK][id as usize % CHUNK]
    }
}

/// Projects those of `count` Gaussians that are visible in `view`, widened by `variance` along x and y, in squared
/// picture pixels.
pub(super) fn project(
    (count, gaussian): (usize, impl Fn(usize) -> Gaussian + Sync + Send),
    view: &View,
    variance: [f64; 2],
    budget: &Budget,
) -> Result<Splats> {
    let mut memory = budget.reserve(count as u64 * size_of::<Splat>() as u64)?;
    let bounds = ViewBounds::new(view, variance);
    let chunks = parallel::map(count.div_ceil(CHUNK), |i| {
        let range = i * CHUNK..count.min((i + 1) * CHUNK);
        let mut splats = Vec::with_capacity(range.len());
        for i in range {
            let g = gaussian(i);
            let sound = g.mean.iter().chain([&g.rotation]).all(|v| v.is_finite())
                && g.color.iter().all(|v| v.is_finite())
                && g.scale.iter().all(|&s| s > 0.0 && s.is_finite());
            if !sound {
                return Err(Error::Parameter {
                    parameter: Parameter::Gaussians,
                    problem: format!("number {i} is not finite or has a scale of zero: {g:?}"),
                });
            }
            if bounds.excludes(&g) {
                continue;
            }
            let splat = Splat::new(&g, view, variance);
            if splat.touches(view) {
                splats.push(splat);
            }
        }
        Ok(splats)
    });
    let chunks = chunks.into_iter().collect::<Result<Vec<Vec<Splat>>>>()?;
    memory.shrink(chunks.iter().map(|chunk| (chunk.capacity() * size_of::<Splat>()) as u64).sum());
    Ok(Splats { chunks, memory })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::limits::Limits;
    use crate::rect::Rect;

    #[test]
    fn what_is_left_out_early_touches_nothing() {
        let full = View::new(500, 300);
        let views = [
            full.crop(Rect::new(100, 60, 130, 90)).unwrap(),
            full.resized(1100, 400).unwrap().crop(Rect::new(300, 100, 200, 50)).unwrap(),
            full.resized(200, 40).unwrap().crop(Rect::new(60, 10, 3, 2)).unwrap(),
            full.resized(7, 5).unwrap(),
        ];
        let (mut left_out, mut drawn) = (0, 0);
        for view in views {
            let filter = view.filter();
            let view = view.refined(filter.parts);
            let bounds = ViewBounds::new(&view, filter.variance);
            for i in 0..20_000u32 {
                let f = |k: u32| (f64::from(i) * f64::from(k).sqrt()).fract() as f32;
                let g = Gaussian {
                    mean: [900.0 * f(2) - 200.0, 700.0 * f(3) - 200.0],
                    scale: [0.25 + 60.0 * f(5) * f(7), 0.25 + 20.0 * f(11)],
                    rotation: 3.2 * f(13),
                    color: [0.0; 4],
                };
                let touches = Splat::new(&g, &view, filter.variance).touches(&view);
                assert!(!(touches && bounds.excludes(&g)), "{g:?} in {view:?}");
                left_out += u32::from(!touches && bounds.excludes(&g));
                drawn += u32::from(touches);
            }
        }
        assert!(left_out > 10_000 && drawn > 5_000, "{left_out} {drawn}");
    }

    #[test]
    fn what_is_no_number_is_refused_even_outside_the_view() {
        let far = Gaussian { mean: [1e6, 1e6], scale: [1.0; 2], rotation: 0.0, color: [f32::NAN; 4] };
        let found = project((1, |_| far), &View::new(8, 8), [0.0; 2], &Budget::of(&Limits::default()));
        assert!(matches!(found, Err(Error::Parameter { parameter: Parameter::Gaussians, .. })));
    }
}
