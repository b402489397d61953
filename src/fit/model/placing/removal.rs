//! The cost of removing primitives, and the order in which they are least missed.

use crate::fit::model::drawing::field::Field;
use crate::fit::model::drawing::kernel::{self, Strip, Visit};
use crate::fit::model::drawing::project::Projected;
use crate::fit::model::drawing::strips;
use crate::fit::model::objective::rows::RowSet;
use crate::fit::model::problem::Problem;
use crate::gaussian::Blend;
use crate::parallel;
use crate::simd::{self, Simd, Task};

/// Returns the increase of the squared error when each primitive is removed, estimated without refitting the others.
///
/// `field` holds [`Output::Picture`](crate::fit::model::drawing::field::Output::Picture) over `rows`, with these
/// primitives drawn first. The sums are scaled up to account for the rows left out.
pub(crate) fn costs(problem: &Problem<'_>, field: &Field, rows: RowSet, projected: &[Projected]) -> Vec<f32> {
    const CHUNK: usize = 64;
    let chunks = projected.len().div_ceil(CHUNK);
    parallel::map(chunks, |chunk| {
        let start = chunk * CHUNK;
        let projected = &projected[start..projected.len().min(start + CHUNK)];
        match problem.target.channels.count() {
            1 => simd::dispatch(CostTask::<1> { problem, field, rows, start, projected }),
            2 => simd::dispatch(CostTask::<2> { problem, field, rows, start, projected }),
            3 => simd::dispatch(CostTask::<3> { problem, field, rows, start, projected }),
            _ => simd::dispatch(CostTask::<4> { problem, field, rows, start, projected }),
        }
    })
    .concat()
}

/// Computes the costs of consecutive primitives.
struct CostTask<'a, const C: usize> {
    problem: &'a Problem<'a>,
    field: &'a Field,
    rows: RowSet,
    /// Index of the first primitive.
    start: usize,
    projected: &'a [Projected],
}

impl<const C: usize> Task for CostTask<'_, C> {
    type Output = Vec<f32>;

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) -> Vec<f32> {
        let CostTask { problem, field, rows, start, projected } = self;
        let all = rows.count(problem.scene.height);
        let mut out = Vec::with_capacity(projected.len());
        for (i, p) in projected.iter().enumerate() {
            let color = kernel::colors(simd, p);
            let mut cost = Cost::<S, C> { problem, field, rows, color, sum: simd.splat(0.0) };
            let strips = field.strips.of(start + i);
            strips::walk(simd, (p, strips), (rows, 0..all), problem.scene.width, &mut cost);
            out.push(simd.sum(cost.sum) * rows.step as f32);
        }
        out
    }
}

/// Accumulates what the picture loses without a primitive.
struct Cost<'a, S: Simd, const C: usize> {
    problem: &'a Problem<'a>,
    field: &'a Field,
    rows: RowSet,
    color: [S::Vector; C],
    sum: S::Vector,
}

impl<S: Simd, const C: usize> Visit<S> for Cost<'_, S, C> {
    #[inline(always)]
    fn pixels(&mut self, simd: S, strip: &Strip<S>, i: usize, g: S::Vector, _dy: S::Vector) {
        let zero = simd.splat(0.0);
        let row = &self.field.row(i, C)[strip.x..];
        let w = simd.max(simd.sub(g, strip.edge), zero);
        let mut share = match self.problem.scene.blend {
            Blend::Normalized => {
                let rest = simd.max(simd.sub(simd.read(&row[C * self.field.stride..]), w), zero);
                simd.min(simd.div(w, simd.add(rest, simd.splat(0.02))), simd.splat(20.0))
            }
            Blend::Sum => w,
        };
        if let Some(a) = self.problem.target.amplitude(self.rows.row(i)) {
            share = simd.mul(share, simd.read(&a[strip.x..]));
        }
        let mut distance = zero;
        for k in 0..C {
            let d = match self.problem.scene.blend {
                Blend::Normalized => simd.sub(self.color[k], simd.read(&row[k * self.field.stride..])),
                Blend::Sum => self.color[k],
            };
            let d = simd.mul(d, simd.splat(self.problem.target.channel_amplitude[k]));
            distance = simd.add(distance, simd.mul(d, d));
        }
        self.sum = simd.add(self.sum, simd.mul(simd.mul(share, share), distance));
    }
}

/// Returns the indices by increasing cost; equal costs by index.
pub(crate) fn cheapest_first(costs: &[f32]) -> Vec<usize> {
    cheapest(costs, costs.len())
}

/// Returns the first `max_count` of these indices.
pub(crate) fn cheapest(costs: &[f32], max_count: usize) -> Vec<usize> {
    let mut order: Vec<usize> = (0..costs.len()).collect();
    let by_cost = |a: &usize, b: &usize| costs[*a].total_cmp(&costs[*b]).then(a.cmp(b));
    if max_count < order.len() {
        order.select_nth_unstable_by(max_count, by_cost);
        order.truncate(max_count);
    }
    order.sort_unstable_by(by_cost);
    order
}
