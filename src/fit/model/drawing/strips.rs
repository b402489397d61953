//! The strips that primitives are walked in, worked out once a drawing for all who walk them: finding their rows, and the
//! Gaussian in the first of those, takes longer than a third of all walks.

use crate::fit::model::drawing::kernel::{Cut, LEAST_BEND, RUN, Rows, Strip, Visit};
use crate::fit::model::drawing::project::Projected;
use crate::fit::model::objective::rows::RowSet;
use crate::parallel;
use crate::simd::{self, LANES, Simd, Task};

/// Primitives whose strips lie together.
pub(crate) const TOGETHER: usize = 64;

/// Eight columns of a primitive, and its rows there.
#[derive(Debug, Clone, Copy)]
#[repr(align(32))]
pub(crate) struct Planned {
    /// The Gaussian in the first row.
    g: [f32; LANES],
    /// The first column.
    x: u32,
    /// Index of the first sampled row, and of the one after the last.
    first: u32,
    end: u32,
    /// The distance of the first from the centre.
    dy: f32,
    /// The ratio of the second row to the first, in the middle of the columns; 0 where there is no recurrence to start.
    ratio: f32,
    /// Factor between the ratios of neighbouring rows.
    bend: f32,
}

/// The strips of primitives over the rows of a set.
#[derive(Debug, Default)]
pub struct Strips {
    /// Parts that hold the strips of [`TOGETHER`] primitives each. Memory is kept from one drawing to the next.
    parts: Vec<Part>,
}

#[derive(Debug, Default)]
struct Part {
    strips: Vec<Planned>,
    /// Index of the first strip of each primitive, and the number of all strips.
    starts: Vec<u32>,
}

impl Strips {
    /// Works out the strips of `projected` in a picture of such a width.
    pub(crate) fn plan(&mut self, projected: &[Projected], rows: RowSet, width: u32) {
        self.parts.resize_with(projected.len().div_ceil(TOGETHER), Part::default);
        parallel::map_chunks(&mut self.parts, 1, |c, part| {
            let projected = &projected[c * TOGETHER..projected.len().min((c + 1) * TOGETHER)];
            simd::dispatch(PlanTask { projected, rows, width, part: &mut part[0] });
        });
    }

    /// Returns the strips of primitive `i`.
    #[inline(always)]
    pub(crate) fn of(&self, i: usize) -> &[Planned] {
        let (part, i) = (&self.parts[i / TOGETHER], i % TOGETHER);
        &part.strips[part.starts[i] as usize..part.starts[i + 1] as usize]
    }
}

/// The strips of a part to work out.
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

/// Adds the strips of `p`.
#[inline(always)]
fn plan<S: Simd>(simd: S, p: &Projected, rows: RowSet, width: u32, strips: &mut Vec<Planned>) {
    let (from, end) = (rows.index(p.rows[0]), rows.index(p.rows[1]));
    if from >= end {
        return;
    }
    let (step, count) = (rows.step as f32, end - from);
    let dy = rows.row(from) as f32 - p.center[1];
    let (shape, lines) = (Rows::new(p, step), p.lines());
    let (left, right) = p.columns(dy, dy + step * (count - 1) as f32);
    let right = right.min(width as usize);
    let mut x = left;
    while x < right {
        let cut = Cut::new(simd, &shape, &lines, x as f32 - p.center[0], (dy, count));
        for k in 0..LANES.min((right - x).div_ceil(LANES)) {
            if cut.first[k] >= cut.end[k] {
                continue;
            }
            let x = x + k * LANES;
            let dx = simd.add(simd.index(), simd.splat(x as f32 - p.center[0]));
            let is_mild = cut.mildness[k] > 0.0 && shape.bend > LEAST_BEND;
            strips.push(Planned {
                g: simd.to_array(shape.at(simd, dx, cut.start[k])),
                x: x as u32,
                first: from as u32 + cut.first[k],
                end: from as u32 + cut.end[k],
                dy: cut.start[k],
                ratio: if is_mild { cut.ratios[k] } else { 0.0 },
                bend: shape.bend,
            });
        }
        x += LANES * LANES;
    }
}

/// Visits the pixels of `p` on its `strips` in the sampled rows with the indices `range`, which the visitor counts from its
/// start.
#[inline(always)]
pub(crate) fn walk<S: Simd>(
    simd: S,
    (p, strips): (&Projected, &[Planned]),
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
        let (mut dy, mut is_mild) = (planned.dy, planned.ratio > 0.0);
        let mut is_begun = first == planned.first;
        while first < end {
            if !is_begun {
                dy = planned.dy + step * (first - planned.first) as f32;
                is_mild = shape.are_mild(start, dy);
                (g, ratio) = (shape.at(simd, strip.dx, dy), shape.ratio(simd, strip.dx, dy));
            }
            let last = end.min(first + RUN);
            let mut y = simd.splat(dy);
            if is_mild {
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
