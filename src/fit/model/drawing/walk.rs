//! Visits the pixels of a primitive: eight columns at a time, down runs of rows by recurrence, as the decoder does. Rows
//! are padded by eight samples, because the last strip may overhang.

use crate::fit::model::drawing::project::{ColumnSupport, Projected};
use crate::fit::model::objective::rows::RowSet;
use crate::gaussian::CUTOFF_WEIGHT;
use crate::simd::{self, Simd};
use crate::strict_math::StrictMath;

/// Maximum number of sampled rows that the recurrence runs before it restarts. This bounds its drift: relative errors
/// of 2⁻²⁴ in the ratio of rows grow to at most 7·10⁻⁵ in the last row.
pub(in crate::fit::model) const RUN: u32 = 32;

/// Largest `−log₂` of a Gaussian from which the recurrence may start, and largest `|log₂|` of the ratio between rows.
/// Beyond it, f32 would underflow.
const REACH: f32 = 110.0;

/// Smallest factor between the ratios of neighbouring rows. Below it, f32 would underflow as well.
pub(in crate::fit::model) const MIN_BEND: f32 = 1e-9;

/// Distance from the first of eight columns to their middle.
const MIDDLE: f32 = 0.5 * (simd::LANES - 1) as f32;

/// A primitive on rows that are `step` pixels apart: `2^((a·dx + b·dy)·dx + c·dy²)`.
#[derive(Clone, Copy)]
pub(in crate::fit::model) struct Rows {
    a: f32,
    b: f32,
    c: f32,
    step: f32,
    /// Factor between the ratios of neighbouring rows.
    pub bend: f32,
}

impl Rows {
    #[inline(always)]
    pub(crate) fn new(p: &Projected, step: f32) -> Self {
        const L2E: f32 = std::f32::consts::LOG2_E;
        let [_, _, c] = p.conic;
        let bend = (-L2E * c * step * step).max(-126.0).strict_exp2();
        Self::of(p, step, bend)
    }

    /// Returns `p` on rows that are `step` pixels apart, with the known factor `bend` between their ratios.
    #[inline(always)]
    pub(crate) fn of(p: &Projected, step: f32, bend: f32) -> Self {
        const L2E: f32 = std::f32::consts::LOG2_E;
        let [a, b, c] = p.conic;
        Rows { a: -0.5 * L2E * a, b: -L2E * b, c: -0.5 * L2E * c, step, bend }
    }

    /// Returns the exponent at the distance `(dx, dy)` from the centre.
    #[inline(always)]
    fn exponent(&self, dx: f32, dy: f32) -> f32 {
        (self.a * dx + self.b * dy) * dx + self.c * dy * dy
    }

    /// Returns by how much the exponent grows from that row to the next.
    #[inline(always)]
    fn growth(&self, dx: f32, dy: f32) -> f32 {
        self.step * (self.b * dx + self.c * (2.0 * dy + self.step))
    }

    /// Returns whether the recurrence is safe for eight columns from `dx` on, starting at `dy`. Exponents are concave
    /// along the row, so their minimum is at one of its ends.
    #[inline(always)]
    pub(crate) fn is_recurrence_safe(&self, dx: f32, dy: f32) -> bool {
        let last = dx + (simd::LANES - 1) as f32;
        self.exponent(dx, dy).min(self.exponent(last, dy)) > -REACH
            && self.growth(dx, dy).abs().max(self.growth(last, dy).abs()) < REACH
            && self.bend > MIN_BEND
    }

    /// Returns the ratio of the next row to the one at `dy`.
    #[inline(always)]
    pub(crate) fn ratio<S: Simd>(&self, simd: S, dx: S::Vector, dy: f32) -> S::Vector {
        let growth = self.step * self.c * (2.0 * dy + self.step);
        simd.exp2(simd.add(simd.mul(simd.splat(self.step * self.b), dx), simd.splat(growth)))
    }

    /// Returns the factors from the ratio of rows in the middle of eight columns to that in each column.
    #[inline(always)]
    pub(crate) fn tilt<S: Simd>(&self, simd: S) -> S::Vector {
        simd.exp2(simd.mul(simd.splat(self.step * self.b), simd.sub(simd.index(), simd.splat(MIDDLE))))
    }

    /// Returns the Gaussian at the distances `dx` and `dy` from the centre.
    #[inline(always)]
    pub(crate) fn at<S: Simd>(&self, simd: S, dx: S::Vector, dy: f32) -> S::Vector {
        let slope = simd.add(simd.mul(simd.splat(self.a), dx), simd.splat(self.b * dy));
        simd.exp2(simd.add(simd.mul(slope, dx), simd.splat(self.c * dy * dy)))
    }
}

/// Returns the Gaussian of `p` at the eight pixels from `x` on, in a row at distance `dy` from its centre.
#[inline(always)]
pub fn at<S: Simd>(simd: S, p: &Projected, x: usize, dy: f32) -> S::Vector {
    let dx = simd.add(simd.index(), simd.splat(x as f32 - p.center[0]));
    Rows::new(p, 1.0).at(simd, dx, dy)
}

/// Eight adjacent columns.
#[derive(Clone, Copy)]
pub struct Strip<S: Simd> {
    /// The first column.
    pub x: usize,
    /// Distances of the columns from the centre.
    pub dx: S::Vector,
    /// Threshold that the Gaussian must exceed to count: [`CUTOFF_WEIGHT`], or for excluded columns a value that no
    /// Gaussian exceeds.
    pub edge: S::Vector,
}

impl<S: Simd> Strip<S> {
    /// Returns the columns from `x` on. Columns from `end` on are excluded.
    #[inline(always)]
    pub(in crate::fit::model) fn new(simd: S, p: &Projected, x: usize, end: usize) -> Self {
        let mut edge = simd.splat(CUTOFF_WEIGHT);
        if x + simd::LANES > end {
            let beyond = simd.sub(simd.index(), simd.splat((end - x) as f32 - 0.5));
            edge = simd.max(edge, simd.mul(beyond, simd.splat(1e9)));
        }
        Strip { x, dx: simd.add(simd.index(), simd.splat(x as f32 - p.center[0])), edge }
    }
}

/// An operation on the pixels of one primitive.
pub trait Visit<S: Simd> {
    /// Processes row `i` of the visited rows, at distance `dy` from the centre. `g` is the Gaussian there, which may be
    /// below the threshold of the strip.
    fn pixels(&mut self, simd: S, strip: &Strip<S>, i: usize, g: S::Vector, dy: S::Vector);

    /// Called after a run of rows of a strip that are `step` apart. The next row would be at distance `dy` from the
    /// centre.
    #[inline(always)]
    fn leave(&mut self, _simd: S, _strip: &Strip<S>, _dy: f32, _step: f32) {}
}

/// Eight adjacent strips and the rows on which they may intersect the support. They are computed together, because
/// finding the rows of a single strip would take longer than visiting them.
pub(in crate::fit::model) struct StripBlock {
    /// The first row in which the support reaches each strip.
    pub first: [u32; simd::LANES],
    pub end: [u32; simd::LANES],
    /// The distance of the first row from the centre.
    pub start: [f32; simd::LANES],
    /// Positive if the recurrence may start in the first row.
    pub safety: [f32; simd::LANES],
    /// The ratio of the second row to the first, in the middle of each strip.
    pub ratios: [f32; simd::LANES],
}

impl StripBlock {
    /// Computes the strips from `dx` on, over `count` rows of which the first is at `dy`.
    #[inline(always)]
    pub(crate) fn new<S: Simd>(
        simd: S,
        rows: &Rows,
        column_support: &ColumnSupport,
        dx: f32,
        (dy, count): (f32, usize),
    ) -> Self {
        let (zero, all) = (simd.splat(0.0), simd.splat(count as f32));
        let left = simd.add(simd.mul(simd.index(), simd.splat(simd::LANES as f32)), simd.splat(dx));
        let right = simd.add(left, simd.splat((simd::LANES - 1) as f32));
        let (steps, shift) = (simd.splat(1.0 / rows.step), simd.splat(dy));
        // The first row is counted from below, so that rounding down there rounds it up.
        let top = simd.mul(simd.sub(column_support.edge(simd, [left, right], -1.0), shift), steps);
        let above = simd.floor(simd.sub(all, simd.min(simd.max(top, zero), all)));
        let bottom = simd.mul(simd.sub(column_support.edge(simd, [left, right], 1.0), shift), steps);
        let end = simd.floor(simd.min(simd.max(simd.add(bottom, simd.splat(1.0)), zero), all));
        let (mut first, mut start) = ([0; simd::LANES], [0.0; simd::LANES]);
        for k in 0..simd::LANES {
            first[k] = count as u32 - above[k];
            start[k] = dy + rows.step * first[k] as f32;
        }
        // The same formulas as in `exponent`, `growth` and `is_recurrence_safe`.
        let y = simd.vector(start);
        let (a, b, slope) = (simd.splat(rows.a), simd.splat(rows.b), simd.mul(simd.splat(rows.b), y));
        let square = simd.mul(simd.mul(simd.splat(rows.c), y), y);
        let (step, twice) = (simd.splat(rows.step), simd.add(y, y));
        let bend = simd.mul(simd.splat(rows.c), simd.add(twice, step));
        let (mut least, mut largest) = (simd.splat(f32::INFINITY), zero);
        for dx in [left, right] {
            let exponent = simd.add(simd.mul(simd.add(simd.mul(a, dx), slope), dx), square);
            let growth = simd.mul(step, simd.add(simd.mul(b, dx), bend));
            least = simd.min(exponent, least);
            largest = simd.max(simd.max(growth, simd.sub(zero, growth)), largest);
        }
        let reach = simd.splat(REACH);
        let safety = simd.min(simd.add(least, reach), simd.sub(reach, largest));
        let middle = simd.add(left, simd.splat(MIDDLE));
        let growth = simd.mul(step, simd.add(simd.mul(b, middle), bend));
        StripBlock { first, end, start, safety: simd.to_array(safety), ratios: simd.to_array(simd.exp2(growth)) }
    }
}

/// Visits the pixels of `p` in `count` rows that are `step` apart, the first at distance `dy` from the centre. The last
/// strip may contain columns outside `columns`; their threshold excludes them.
#[inline(always)]
pub fn walk<S: Simd>(
    simd: S,
    p: &Projected,
    (dy, step, count): (f32, f32, usize),
    columns: std::ops::Range<usize>,
    visitor: &mut impl Visit<S>,
) {
    if count == 0 {
        return;
    }
    let (rows, column_support) = (Rows::new(p, step), p.column_support());
    let (left, right) = p.columns(dy, dy + step * (count - 1) as f32);
    let right = right.min(columns.end);
    let mut x = left.max(columns.start);
    let (tilt, bend) = (rows.tilt(simd), simd.splat(rows.bend));
    while x < right {
        let cut = StripBlock::new(simd, &rows, &column_support, x as f32 - p.center[0], (dy, count));
        let strips = simd::LANES.min((right - x).div_ceil(simd::LANES));
        for k in 0..strips {
            let (mut first, end) = (cut.first[k], cut.end[k]);
            let x = x + k * simd::LANES;
            let start = x as f32 - p.center[0];
            let strip = Strip::new(simd, p, x, columns.end);
            let (mut dy, mut is_safe) = (cut.start[k], cut.safety[k] > 0.0 && rows.bend > MIN_BEND);
            let (mut g, mut ratio) = (rows.at(simd, strip.dx, dy), simd.mul(tilt, simd.splat(cut.ratios[k])));
            while first < end {
                let last = end.min(first + RUN);
                let (mut y, down) = (simd.splat(dy), simd.splat(step));
                if is_safe {
                    for i in first..last {
                        visitor.pixels(simd, &strip, i as usize, g, y);
                        g = simd.mul(g, ratio);
                        ratio = simd.mul(ratio, bend);
                        y = simd.add(y, down);
                    }
                } else {
                    for i in first..last {
                        let g = rows.at(simd, strip.dx, dy + step * (i - first) as f32);
                        visitor.pixels(simd, &strip, i as usize, g, y);
                        y = simd.add(y, down);
                    }
                }
                dy += step * (last - first) as f32;
                visitor.leave(simd, &strip, dy, step);
                first = last;
                if first < end {
                    is_safe = rows.is_recurrence_safe(start, dy);
                    (g, ratio) = (rows.at(simd, strip.dx, dy), rows.ratio(simd, strip.dx, dy));
                }
            }
        }
        x += simd::LANES * simd::LANES;
    }
}

/// Visits the pixels of `p` in the sampled rows with indices in `range`.
#[inline(always)]
pub fn walk_rows<S: Simd>(
    simd: S,
    p: &Projected,
    (rows, range): (RowSet, std::ops::Range<usize>),
    width: u32,
    visitor: &mut impl Visit<S>,
) {
    let dy = rows.row(range.start) as f32 - p.center[1];
    walk(simd, p, (dy, rows.step as f32, range.len()), 0..width as usize, visitor);
}
