//! Precomputed strips of all primitives, shared by all passes over one drawing. Finding the rows of the strips, and the
//! Gaussian in their first row, takes more than a third of the time of a pass.

use crate::fit::model::drawing::project::Projected;
use crate::fit::model::drawing::walk::{MIN_BEND, RUN, Rows, Strip, StripBlock, Visit};
use crate::fit::model::objective::rows::RowSet;
use crate::parallel;
use crate::simd::{self, LANES, Simd, Task};

/// Primitives whose strips are stored together.
pub(crate) const PRIMITIVES_PER_PART: usize = 64;

/// Eight columns of a primitive, and its rows in them.
#[derive(Debug, Clone, Copy)]
#[repr(align(32))]
pub(crate) struct PlannedStrip {
    /// The Gaussian in the first row.
    g: [f32; LANES],
    /// The first column.
    x: u32,
    /// Index of the first sampled row.
    first: u32,
    end: u32,
    /// The distance of the first row from the centre.
    dy: f32,
    /// The ratio of the second row to the first in the middle of the columns; 0 if the recurrence is not safe.
    ratio: f32,
    /// Factor between the ratios of neighbouring rows.
    bend: f32,
}

/// The strips of primitives over the rows of a [`RowSet`].
#[derive(Debug, Default)]
pub struct Strips {
    /// Each part holds the strips of [`PRIMITIVES_PER_PART`] primitives. Memory is kept from one drawing to the next.
    parts: Vec<Part>,
}

#[derive(Debug, Default)]
struct Part {
    strips: Vec<PlannedStrip>,
    /// Index of each primitive's first strip, followed by the number of all strips.
    starts: Vec<u32>,
}

impl Strips {
    /// Computes the strips of `projected` in a picture of the given width.
    pub(crate) fn plan(&mut self, projected: &[Projected], rows: RowSet, width: u32) {
        self.parts.resize_with(projected.len().div_ceil(PRIMITIVES_PER_PART), Part::default);
        parallel::map_chunks(&mut self.parts, 1, |c, part| {
            let projected = &projected[c * PRIMITIVES_PER_PART..projected.len().min((c + 1) * PRIMITIVES_PER_PART)];
            simd::dispatch(PlanTask { projected, rows, width, part: &mut part[0] });
        });
    }

    /// Returns the strips of primitive `i`.
    #[inline(always)]
    pub(crate) fn of(&self, i: usize) -> &[PlannedStrip] {
        let (part, i) = (&self.parts[i / PRIMITIVES_PER_PART], i % PRIMITIVES_PER_PART);
        &part.strips[part.starts[i] as usize..part.starts[i + 1] as usize]
    }
}

/// Computes the strips of one part.
struct PlanTask<'a> {
    projected: &'a [Projected],
    rows: RowSet,
    width: u32,
    part: &'a mut Part,
}

impl Task for PlanTask<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let PlanTask { projected, rows, width, part } = self;
        part.strips.clear();
        part.starts.clear();
        for p in projected {
            part.starts.push(part.strips.len() as u32);
            plan(simd, p, rows, width, &mut part.strips);
        }
        part.starts.push(part.strips.len() as u32);
    }
}

/// Appends the strips of `p`.
#[inline(always)]
fn plan<S: Simd>(simd: S, p: &Projected, rows: RowSet, width: u32, strips: &mut Vec<PlannedStrip>) {
    let (from, end) = (rows.index(p.rows[0]), rows.index(p.rows[1]));
    if from >= end {
        return;
    }
    let (step, count) = (rows.step as f32, end - from);
    let dy = rows.row(from) as f32 - p.center[1];
    let (shape, column_support) = (Rows::new(p, step), p.column_support());
    let (left, right) = p.columns(dy, dy + step * (count - 1) as f32);
    let right = right.min(width as usize);
    let mut x = left;
    while x < right {
        let cut = StripBlock::new(simd, &shape, &column_support, x as f32 - p.center[0], (dy, count));
        for k in 0..LANES.min((right - x).div_ceil(LANES)) {
            if cut.first[k] >= cut.end[k] {
                continue;
            }
            let x = x + k * LANES;
            let dx = simd.add(simd.index(), simd.splat(x as f32 - p.center[0]));
            let is_safe = cut.safety[k] > 0.0 && shape.bend > MIN_BEND;
            strips.push(PlannedStrip {
                g: simd.to_array(shape.at(simd, dx, cut.start[k])),
                x: x as u32,
                first: from as u32 + cut.first[k],
                end: from as u32 + cut.end[k],
                dy: cut.start[k],
                ratio: if is_safe { cut.ratios[k] } else { 0.0 },
                bend: shape.bend,
            });
        }
        x += LANES * LANES;
    }
}

/// Visits the pixels of `p` on its `strips` in the sampled rows with indices in `range`. Rows passed to the visitor are
/// counted from the start of the range.
#[inline(always)]
pub(crate) fn walk<S: Simd>(
    simd: S,
    (p, strips): (&Projected, &[PlannedStrip]),
    (rows, range): (RowSet, std::ops::Range<usize>),
    width: u32,
    visitor: &mut impl Visit<S>,
) {
    let Some(one) = strips.first() else { return };
    let (step, from, to) = (rows.step as f32, range.start as u32, range.end as u32);
    let shape = Rows::of(p, step, one.bend);
    let (tilt, bend, down) = (shape.tilt(simd), simd.splat(shape.bend), simd.splat(step));
    for planned in strips {
        let (mut first, end) = (planned.first.max(from), planned.end.min(to));
        if first >= end {
            continue;
        }
        let x = planned.x as usize;
        let start = x as f32 - p.center[0];
        let strip = Strip::new(simd, p, x, width as usize);
        let (mut g, mut ratio) = (simd.vector(planned.g), simd.mul(tilt, simd.splat(planned.ratio)));
        let (mut dy, mut is_safe) = (planned.dy, planned.ratio > 0.0);
        let mut is_begun = first == planned.first;
        while first < end {
            if !is_begun {
                dy = planned.dy + step * (first - planned.first) as f32;
                is_safe = shape.is_recurrence_safe(start, dy);
                (g, ratio) = (shape.at(simd, strip.dx, dy), shape.ratio(simd, strip.dx, dy));
            }
            let last = end.min(first + RUN);
            let mut y = simd.splat(dy);
            if is_safe {
                for i in first..last {
                    visitor.pixels(simd, &strip, (i - from) as usize, g, y);
                    g = simd.mul(g, ratio);
                    ratio = simd.mul(ratio, bend);
                    y = simd.add(y, down);
                }
            } else {
                for i in first..last {
                    let g = shape.at(simd, strip.dx, dy + step * (i - first) as f32);
                    visitor.pixels(simd, &strip, (i - from) as usize, g, y);
                    y = simd.add(y, down);
                }
            }
            visitor.leave(simd, &strip, dy + step * (last - first) as f32, step);
            (first, is_begun) = (last, false);
        }
    }
}
