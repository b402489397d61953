//! Detects ridges at peaks of the residual. Round primitives on thin lines rarely grow into needles, because the first
//! steps in that direction gain nothing.

use crate::constants::fit;
use crate::fit::model::objective::blur::Cells;
use crate::strict_math::StrictMath;

/// Aspect ratios of ridges.
const ASPECTS: [f32; 2] = [2.0, fit::MAX_RIDGE_ASPECT];

/// Number of directions of ridges, over half a turn.
const DIRECTIONS: usize = 16;

/// Ridges examined at each peak.
pub(crate) const RIDGES: usize = ASPECTS.len() * DIRECTIONS;

/// Cells on one side of a peak, including its own, that are examined for a ridge.
pub(crate) const TAPS: usize = 11;

/// A cell beside a peak, and its mirror image. The layout is that in `peaks.wgsl`.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "gpu", derive(bytemuck::Pod, bytemuck::Zeroable))]
#[repr(C)]
pub(crate) struct Tap {
    pub x: i32,
    pub y: i32,
    /// Weight of each of the two cells.
    pub weight: f32,
    /// Aspect ratio of the ridge.
    pub aspect: f32,
}

/// The best shape at a peak.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Shape {
    pub aspect: f32,
    /// Direction of the ridge, radians.
    pub rotation: f32,
    /// Mean residual under the shape.
    pub residual: [f32; 4],
    /// Square of the residual times the aspect ratio: the gain of a Gaussian of this shape, relative to a round one.
    pub score: f32,
}

/// Rotation of round shapes. It is not parallel to an axis, where gradients would stay 0.
const DEFAULT_ROTATION: f32 = 0.3;

impl Shape {
    /// Returns the shape of ridge `index` of [`all`], or a round one, with the mean residual `residual`.
    pub(crate) fn new(index: Option<usize>, residual: [f32; 4]) -> Self {
        let (aspect, rotation) = index.map_or((1.0, DEFAULT_ROTATION), |i| (ASPECTS[i / DIRECTIONS], rotation(i)));
        let [r, g, b, a] = residual;
        Shape { aspect, rotation, residual, score: aspect * (r * r + g * g + b * b + a * a) }
    }
}

fn rotation(index: usize) -> f32 {
    std::f32::consts::PI * (index % DIRECTIONS) as f32 / DIRECTIONS as f32
}

/// Returns all ridges: lines of cells with the weights of a Gaussian along them.
pub(crate) fn all() -> [[Tap; TAPS]; RIDGES] {
    std::array::from_fn(|i| {
        let aspect = ASPECTS[i / DIRECTIONS];
        let (sin, cos) = rotation(i).strict_sin_cos();
        let length = fit::RESIDUAL_BLUR * (aspect * aspect - 1.0).sqrt();
        let weight = |t: usize| match t {
            // This cell is its own mirror image.
            0 => 0.5,
            _ if t as f32 > (2.0 * length).ceil() => 0.0,
            _ => (-0.5 * (t as f32 / length).powi(2)).strict_exp(),
        };
        let total: f32 = (0..TAPS).map(|t| 2.0 * weight(t)).sum();
        std::array::from_fn(|t| Tap {
            x: (t as f32 * cos).round() as i32,
            y: (t as f32 * sin).round() as i32,
            weight: weight(t) / total,
            aspect,
        })
    })
}

/// Returns the largest aspect ratio of a new primitive that is `sigma` pixels wide, such that its area is at most that
/// of a round one with a scale of `spacing`.
pub(crate) fn max_aspect(spacing: f32, sigma: f32) -> f32 {
    (spacing * spacing / (sigma * sigma)).clamp(1.0, fit::MAX_RIDGE_ASPECT)
}

/// Returns the best shape at `cell` of the residuals `cells`, up to the aspect ratio `max_aspect`. Outside the picture
/// the residual is 0.
pub(crate) fn shape(ridges: &[[Tap; TAPS]; RIDGES], max_aspect: f32, cells: &Cells, cell: [usize; 2]) -> Shape {
    match cells.each {
        4 => shape_of::<4>(ridges, max_aspect, cells, cell),
        _ => shape_of::<1>(ridges, max_aspect, cells, cell),
    }
}

fn shape_of<const N: usize>(
    ridges: &[[Tap; TAPS]; RIDGES],
    max_aspect: f32,
    cells: &Cells,
    [x, y]: [usize; 2],
) -> Shape {
    let (values, _) = cells.values.as_chunks::<N>();
    let at = y * cells.width + x;
    let of = |mean: [f32; N]| std::array::from_fn(|k| mean.get(k).copied().unwrap_or(0.0));
    let mut best = Shape::new(None, of(values[at]));
    let is_inside = |v: usize, size: usize| v + 1 >= TAPS && v + TAPS <= size;
    let is_inside = is_inside(x, cells.width) && is_inside(y, cells.height);
    for (i, ridge) in ridges.iter().enumerate().filter(|(_, r)| r[0].aspect <= max_aspect) {
        let mut mean = [0.0f32; N];
        for tap in ridge.iter().filter(|t| t.weight > 0.0) {
            if is_inside {
                let by = tap.y as isize * cells.width as isize + tap.x as isize;
                mean = plus(mean, tap.weight, values[at.wrapping_add_signed(by)]);
                mean = plus(mean, tap.weight, values[at.wrapping_add_signed(-by)]);
                continue;
            }
            for [dx, dy] in [[tap.x, tap.y], [-tap.x, -tap.y]] {
                let [x, y] = [x.wrapping_add_signed(dx as isize), y.wrapping_add_signed(dy as isize)];
                if x < cells.width && y < cells.height {
                    mean = plus(mean, tap.weight, values[y * cells.width + x]);
                }
            }
        }
        let found = Shape::new(Some(i), of(mean));
        if found.score > best.score {
            best = found;
        }
    }
    best
}

/// Returns `sum + weight · cell`. Arrays are passed by value, so that the compiler makes vector instructions of the loop.
#[inline(always)]
fn plus<const N: usize>(mut sum: [f32; N], weight: f32, cell: [f32; N]) -> [f32; N] {
    for k in 0..N {
        sum[k] += weight * cell[k];
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_is_a_ridge_along_itself_and_a_dot_is_round() {
        let (w, h) = (40usize, 40usize);
        let plane = |f: &dyn Fn(f32, f32) -> f32| {
            let values = (0..w * h).map(|i| f((i % w) as f32 - 20.0, (i / w) as f32 - 20.0)).collect();
            Cells { width: w, height: h, each: 1, values }
        };
        let blurred = |v: f32| (-0.5 * (v / fit::RESIDUAL_BLUR).powi(2)).exp();
        for k in 0..DIRECTIONS {
            let (sin, cos) = rotation(k).sin_cos();
            let line = shape(&all(), fit::MAX_RIDGE_ASPECT, &plane(&|x, y| blurred(cos * y - sin * x)), [20, 20]);
            assert_eq!((line.aspect, line.rotation), (fit::MAX_RIDGE_ASPECT, rotation(k)), "{line:?}");
            // The full height of the line, except for rounding to cells.
            assert!(line.score > 0.9 * fit::MAX_RIDGE_ASPECT, "{line:?}");
        }
        let dot = shape(&all(), fit::MAX_RIDGE_ASPECT, &plane(&|x, y| blurred(x) * blurred(y)), [20, 20]);
        assert_eq!((dot.aspect, dot.rotation), (1.0, DEFAULT_ROTATION));
        let short = shape(&all(), max_aspect(2.0, 1.0), &plane(&|_, y| blurred(y)), [20, 20]);
        assert_eq!((short.aspect, max_aspect(1.0, 2.0)), (fit::MAX_RIDGE_ASPECT, 1.0));
        let short = shape(&all(), max_aspect(1.5, 1.0), &plane(&|_, y| blurred(y)), [20, 20]);
        assert_eq!((short.aspect, short.rotation), (2.0, 0.0));
        // Half of a line ends at the edge: cells outside count as 0.
        let edge = shape(&all(), fit::MAX_RIDGE_ASPECT, &plane(&|x, _| blurred(x + 20.0)), [0, 0]);
        assert!(edge.score < fit::MAX_RIDGE_ASPECT * 0.5, "{edge:?}");
    }
}
