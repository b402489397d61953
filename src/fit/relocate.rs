//! Moving the least useful primitives to where the error is largest: what removing each costs, and the exchange.

use crate::fit::adam::Memory;
use crate::fit::field::{Field, Output, RowSet, Scene};
use crate::fit::kernel::{self, LANES, RowExponent};
use crate::fit::peaks::{at_peak, peaks};
use crate::fit::project::Projected;
use crate::fit::target::Target;
use crate::fit::{State, project_all};
use crate::gaussian::{Blend, CUTOFF_WEIGHT};
use crate::parallel;

/// The rise of the squared error when each primitive is removed, estimated without refitting the others.
///
/// `field` holds [`Output::Picture`] over `rows`; the sums are scaled up by the rows left out.
pub(crate) fn removal_costs(
    scene: &Scene,
    target: &Target,
    field: &Field,
    rows: RowSet,
    projected: &[Projected],
) -> Vec<f32> {
    const CHUNK: usize = 64;
    let arch = pulp::Arch::new();
    let chunks = projected.len().div_ceil(CHUNK);
    parallel::map(chunks, |chunk| {
        let projected = &projected[chunk * CHUNK..projected.len().min((chunk + 1) * CHUNK)];
        match target.channels.count() {
            1 => arch.dispatch(CostTask::<1> { scene, target, field, rows, projected }),
            2 => arch.dispatch(CostTask::<2> { scene, target, field, rows, projected }),
            3 => arch.dispatch(CostTask::<3> { scene, target, field, rows, projected }),
            _ => arch.dispatch(CostTask::<4> { scene, target, field, rows, projected }),
        }
    })
    .concat()
}

/// The costs of a run of primitives; a struct so that `inline(always)` carries the dispatched instruction set inside.
struct CostTask<'a, const C: usize> {
    scene: &'a Scene,
    target: &'a Target,
    field: &'a Field,
    rows: RowSet,
    projected: &'a [Projected],
}

impl<const C: usize> pulp::WithSimd for CostTask<'_, C> {
    type Output = Vec<f32>;

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) -> Vec<f32> {
        let mut out = Vec::with_capacity(self.projected.len());
        for p in self.projected {
            out.push(removal_cost::<C>(self.scene, self.target, self.field, self.rows, p));
        }
        out
    }
}

#[inline(always)]
fn removal_cost<const C: usize>(scene: &Scene, target: &Target, field: &Field, rows: RowSet, p: &Projected) -> f32 {
    let stride = field.stride;
    let mut sum = [0.0f32; LANES];
    for index in rows.index(p.rows[0])..rows.index(p.rows[1]) {
        let Some((first, end, dy)) = p.span(rows.row(index), scene.width) else { continue };
        let row = field.row(index, C);
        let exponent = RowExponent::new(p, dy);
        let amplitude = target.amplitude(rows.row(index));
        let mut x = first;
        while x < end {
            let (_, e) = exponent.at(x);
            // Lanes beyond the picture's edge have no sums to be compared with.
            let inside = end - x;
            let w = kernel::lanes(|i| if e[i] > CUTOFF_WEIGHT && i < inside { e[i] - CUTOFF_WEIGHT } else { 0.0 });
            let mut distance = [0.0f32; LANES];
            let mut share = match scene.blend {
                Blend::Normalized => {
                    let all = kernel::load(row, C * stride + x);
                    kernel::lanes(|i| (w[i] / ((all[i] - w[i]).max(0.0) + 0.02)).min(20.0))
                }
                Blend::Sum => w,
            };
            if let Some(a) = amplitude {
                let a = kernel::load(a, x);
                share = kernel::lanes(|i| share[i] * a[i]);
            }
            for k in 0..C {
                match scene.blend {
                    Blend::Normalized => {
                        let v = kernel::load(row, k * stride + x);
                        let d = kernel::lanes(|i| p.color[k] - v[i]);
                        distance = kernel::lanes(|i| distance[i] + d[i] * d[i]);
                    }
                    Blend::Sum => {
                        distance = kernel::lanes(|i| distance[i] + p.color[k] * p.color[k]);
                    }
                }
            }
            sum = kernel::lanes(|i| sum[i] + share[i] * share[i] * distance[i]);
            x += LANES;
        }
    }
    kernel::total(&sum) * rows.step as f32
}

/// Moves at most `count` primitives to peaks, as long as the estimated gain exceeds the removal cost. Returns how many.
pub(crate) fn relocate(scene: &Scene, target: &Target, state: &mut State, rows: RowSet, count: usize) -> usize {
    let costs = costs(scene, target, state, rows);
    let peaks = peaks(scene, target, &state.field, rows, count, state.primitives.len());
    let mut moved = 0;
    for (peak, i) in peaks.iter().zip(cheapest(&costs, count)) {
        if peak.gain < costs[i] {
            break;
        }
        state.primitives[i] = at_peak(peak, scene, target);
        state.memory[i] = Memory::default();
        moved += 1;
    }
    state.sort();
    moved
}

/// Brings the number of primitives to `wanted`, taking the cheapest away or adding at peaks.
pub(crate) fn resize(scene: &Scene, target: &Target, state: &mut State, rows: RowSet, wanted: usize) {
    let costs = costs(scene, target, state, rows);
    let have = state.primitives.len();
    if wanted < have {
        let mut keep = vec![true; have];
        for i in cheapest_first(&costs).into_iter().take(have - wanted) {
            keep[i] = false;
        }
        let mut kept = keep.iter();
        state.primitives.retain(|_| *kept.next().expect("one for each"));
        let mut kept = keep.iter();
        state.memory.retain(|_| *kept.next().expect("one for each"));
    } else {
        for peak in peaks(scene, target, &state.field, rows, wanted - have, wanted) {
            state.primitives.push(at_peak(&peak, scene, target));
            state.memory.push(Memory::default());
        }
    }
    state.sort();
}

/// Leaves the picture in the state's field.
fn costs(scene: &Scene, target: &Target, state: &mut State, rows: RowSet) -> Vec<f32> {
    let projected = project_all(&state.primitives, scene.height);
    state.field.draw(scene, target, &projected, rows, Output::Picture);
    removal_costs(scene, target, &state.field, rows, &projected)
}

/// Indices by rising cost; equal costs by index.
pub(crate) fn cheapest_first(costs: &[f32]) -> Vec<usize> {
    cheapest(costs, costs.len())
}

/// The first `most` of them.
pub(crate) fn cheapest(costs: &[f32], most: usize) -> Vec<usize> {
    let mut order: Vec<usize> = (0..costs.len()).collect();
    let by_cost = |a: &usize, b: &usize| costs[*a].total_cmp(&costs[*b]).then(a.cmp(b));
    if most < order.len() {
        order.select_nth_unstable_by(most, by_cost);
        order.truncate(most);
    }
    order.sort_unstable_by(by_cost);
    order
}
