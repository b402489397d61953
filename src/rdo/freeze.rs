//! Incremental freezing: the primitives closest to their lattice points are fixed there a few at a time, while the rest
//! continues to adapt.

use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;

use crate::error::Result;
use crate::fit::engine::{Snapshot, StaticSnapshot};
use crate::fit::model::adam::{Freedom, Rates};
use crate::fit::model::drawing::project::{self, Primitive};
use crate::fit::model::problem::Problem;
use crate::fit::plan::Plan;
use crate::fit::schedule::RowCycle;
use crate::fit::state::State;
use crate::quantize::Quantizer;
use crate::strict_math::StrictMath;

/// Step sizes during freezing: far below those of the fit, but large enough to move by a lattice step.
const RATES: Rates = Rates { mean: 0.03, log_scale: 0.03, rotation: 0.03, color: 0.004, decay: [0.9, 0.95] };

/// Fixes the geometry of all primitives of `state` on the lattice over `plan.freezing` steps, as far as time allows.
/// Colours stay free.
pub(crate) fn freeze(
    problem: &Problem<'_>,
    state: &mut State,
    quantizer: &Quantizer,
    plan: &Plan,
    watch: &mut dyn FnMut(f32, &mut dyn Snapshot) -> Result<()>,
) -> Result<()> {
    let scene = &problem.scene;
    let (count, iterations) = (state.primitives.len(), plan.freezing);
    let mut rng = Pcg64Mcg::seed_from_u64(plan.seed ^ 0x5f72_656e);
    let mut rows = RowCycle::new();
    let step = (scene.row_step(count) / 2).max(1);
    let rounds = 20.min(iterations.max(1));
    state.freedom = vec![Freedom::All; count];
    for round in 0..rounds {
        let project = || project::all(&state.primitives, scene.height);
        watch(round as f32 / rounds as f32, &mut StaticSnapshot { problem, project: &project })?;
        // All primitives are frozen shortly before the end, so that the colours can settle.
        let share = ((round + 1) as f32 / rounds as f32 / 0.92).min(1.0);
        let frozen = state.freedom.iter().filter(|f| **f == Freedom::Color).count();
        let wanted = (share * count as f32).ceil() as usize;
        let mut distances: Vec<(f32, usize)> = (0..count)
            .filter(|&i| state.freedom[i] == Freedom::All)
            .map(|i| (distance(&state.primitives[i], quantizer), i))
            .collect();
        distances.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        for &(_, i) in distances.iter().take(wanted.saturating_sub(frozen)) {
            let p = &mut state.primitives[i];
            let g = p.to_gaussian();
            let rounded = quantizer.dequantize(&quantizer.quantize(&g));
            *p = Primitive { color: p.color, ..Primitive::from_gaussian(&rounded) };
            state.freedom[i] = Freedom::Color;
        }
        let done = round as f32 / rounds as f32;
        let rates = RATES.scaled(0.1 + 0.9 * 0.5 * (1.0 + (std::f32::consts::PI * done).strict_cos()));
        for _ in 0..iterations / rounds {
            if plan.is_fit_over() {
                return Ok(());
            }
            let sampled = rows.next(step, &mut rng);
            state.descend(problem, sampled, rates);
        }
    }
    Ok(())
}

/// Returns the squared distance of `p` from its lattice point, in its own units.
fn distance(p: &Primitive, quantizer: &Quantizer) -> f32 {
    let g = p.to_gaussian();
    let rounded = quantizer.dequantize(&quantizer.quantize(&g));
    let (sin, cos) = rounded.rotation.strict_sin_cos();
    let [dx, dy] = [rounded.mean[0] - g.mean[0], rounded.mean[1] - g.mean[1]];
    let (u, v) = ((cos * dx + sin * dy) / rounded.scale[0], (cos * dy - sin * dx) / rounded.scale[1]);
    let (a, b) = ((rounded.scale[0] / g.scale[0]).strict_ln(), (rounded.scale[1] / g.scale[1]).strict_ln());
    let aspect = rounded.scale[0] / rounded.scale[1];
    let turn = (rounded.rotation - g.rotation).strict_sin() * (aspect - 1.0 / aspect);
    u * u + v * v + a * a + b * b + 0.5 * turn * turn
}
