//! Peaks of the residual that are part of a ridge: round primitives at thin lines seldom grow into needles, since the
//! first of their steps gains nothing.

use crate::fit::model::objective::blur::Cells;
use crate::strict_math::StrictMath;

/// Largest aspect that a new primitive gets; the fit stretches it further.
const MOST_ASPECT: f32 = 4.0;

/// Aspects of ridges.
const ASPECTS: [f32; 2] = [2.0, MOST_ASPECT];

/// Directions in which ridges are looked for, over half a turn.
const DIRECTIONS: usize = 16;

/// Ridges that are looked for at each peak.
pub(crate) const RIDGES: usize = ASPECTS.len() * DIRECTIONS;

/// Cells on one side of a peak, its own among them, that are looked at for a ridge.
pub(crate) const TAPS: usize = 11;

/// Standard deviation that the residual was blurred with, in cells of its level: between 1.2 and 1.4.
const BLUR: f32 = 1.25;

/// A cell beside a peak, and its mirror image; laid out as in `peaks.wgsl`.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "gpu", derive(bytemuck::Pod, bytemuck::Zeroable))]
#[repr(C)]
pub(crate) struct Tap {
    pub x: i32,
    pub y: i32,
    /// Weight of either.
    pub weight: f32,
    /// Aspect of the ridge.
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
    /// Its square times the aspect: what a Gaussian of the shape gains, in units of a round one's.
    pub score: f32,
}

/// A direction for what has none: none of the axes, which would keep gradients at 0.
const ANY: f32 = 0.3;

impl Shape {
    /// The shape of ridge `index` of [`all`], or a round one, under which the mean residual is `residual`.
    pub(crate) fn new(index: Option<usize>, residual: [f32; 4]) -> Self {
        let (aspect, rotation) = index.map_or((1.0, ANY), |i| (ASPECTS[i / DIRECTIONS], rotation(i)));
        let [r, g, b, a] = residual;
        Shape { aspect, rotation, residual, score: aspect * (r * r + g * g + b * b + a * a) }
    }
}

fn rotation(index: usize) -> f32 {
    std::f32::consts::PI * (index % DIRECTIONS) as f32 / DIRECTIONS as f32
}

/// The ridges: lines of cells weighted as a Gaussian would be along them.
pub(crate) fn all() -> [[Tap; TAPS]; RIDGES] {
    std::array::from_fn(|i| {
        let aspect = ASPECTS[i / DIRECTIONS];
        let (sin, cos) = rotation(i).strict_sin_cos();
        let length = BLUR * (aspect * aspect - 1.0).sqrt();
        let weight = |t: usize| match t {
            // A mirror image of itself.
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

/// The largest aspect of a new primitive `sigma` pixels wide where the largest round one has a scale of `spacing`: no
/// larger than that in area.
pub(crate) fn longest(spacing: f32, sigma: f32) -> f32 {
    (spacing * spacing / (sigma * sigma)).clamp(1.0, MOST_ASPECT)
}

/// The best shape at `cell` of the residuals `cells`, up to the aspect `longest`; beyond the edges nothing is missing.
pub(crate) fn shape(ridges: &[[Tap; TAPS]; RIDGES], longest: f32, cells: &Cells, cell: [usize; 2]) -> Shape {
    match cells.each {
        4 => shape_of::<4>(ridges, longest, cells, cell),
        _ => shape_of::<1>(ridges, longest, cells, cell),
    }
}

fn shape_of<const N: usize>(ridges: &[[Tap; TAPS]; RIDGES], longest: f32, cells: &Cells, [x, y]: [usize; 2]) -> Shape {
    let (values, _) = cells.values.as_chunks::<N>();
    let at = y * cells.width + x;
    let of = |mean: [f32; N]| std::array::from_fn(|k| mean.get(k).copied().unwrap_or(0.0));
    let mut best = Shape::new(None, of(values[at]));
    let is_inside = |v: usize, size: usize| v + 1 >= TAPS && v + TAPS <= size;
    let is_inside = is_inside(x, cells.width) && is_inside(y, cells.height);
    for (i, ridge) in ridges.iter().enumerate().filter(|(_, r)| r[0].aspect <= longest) {
        let mut mean = [0.0f32; N];
        let mut add = |weight: f32, cell: &[f32; N]| {
            for (m, v) in mean.iter_mut().zip(cell) {
                *m += weight * v;
            }
        };
        for tap in ridge.iter().filter(|t| t.weight > 0.0) {
            if is_inside {
                let by = tap.y as isize * cells.width as isize + tap.x as isize;
                add(tap.weight, &values[at.wrapping_add_signed(by)]);
                add(tap.weight, &values[at.wrapping_add_signed(-by)]);
                continue;
            }
            for [dx, dy] in [[tap.x, tap.y], [-tap.x, -tap.y]] {
                let [x, y] = [x.wrapping_add_signed(dx as isize), y.wrapping_add_signed(dy as isize)];
                if x < cells.width && y < cells.height {
                    add(tap.weight, &values[y * cells.width + x]);
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
        let blurred = |v: f32| (-0.5 * (v / BLUR).powi(2)).exp();
        for k in 0..DIRECTIONS {
            let (sin, cos) = rotation(k).sin_cos();
            let line = shape(&all(), MOST_ASPECT, &plane(&|x, y| blurred(cos * y - sin * x)), [20, 20]);
            assert_eq!((line.aspect, line.rotation), (MOST_ASPECT, rotation(k)), "{line:?}");
            // All of the line's height, but for rounding to cells.
            assert!(line.score > 0.9 * MOST_ASPECT, "{line:?}");
        }
        let dot = shape(&all(), MOST_ASPECT, &plane(&|x, y| blurred(x) * blurred(y)), [20, 20]);
        assert_eq!((dot.aspect, dot.rotation), (1.0, ANY));
        let short = shape(&all(), longest(2.0, 1.0), &plane(&|_, y| blurred(y)), [20, 20]);
        assert_eq!((short.aspect, longest(1.0, 2.0)), (MOST_ASPECT, 1.0));
        let short = shape(&all(), longest(1.5, 1.0), &plane(&|_, y| blurred(y)), [20, 20]);
        assert_eq!((short.aspect, short.rotation), (2.0, 0.0));
        // Half of a line ends at the edge: cells that are not there count as 0.
        let edge = shape(&all(), MOST_ASPECT, &plane(&|x, _| blurred(x + 20.0)), [0, 0]);
        assert!(edge.score < MOST_ASPECT * 0.5, "{edge:?}");
    }
}
