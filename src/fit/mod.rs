//! Fitting primitives to a picture: float, stochastic, seeded; the same result for any thread count.

pub(crate) mod adam;
pub(crate) mod descend;
pub(crate) mod field;
pub(crate) mod finish;
pub(crate) mod kernel;
pub(crate) mod plan;
pub(crate) mod project;
pub(crate) mod rates;
pub(crate) mod relocate;
pub(crate) mod sample;
pub(crate) mod target;

use std::time::Instant;

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use crate::error::Result;
use crate::parallel;
use adam::{Bounds, Memory, Rates};
use field::{Field, Output, RowSet, Scene};
use plan::Plan;
use project::{Primitive, Projected};
use target::Target;

/// Step sizes at the start; see `design.md` for how they were found.
const RATES: Rates = Rates { mean: 0.1, log_scale: 0.1, rotation: 0.1, color: 0.01 };
/// Step sizes at the end, in units of those at the start.
const LAST_RATE: f32 = 0.02;
/// Share of the iterations that see a sample of the rows.
const SAMPLED: f32 = 0.75;
/// Share of the iterations after which nothing is relocated any more.
const RELOCATED: f32 = 0.7;

/// Shows the state of the work when called: costs a projection of all primitives.
pub(crate) type Drawing<'a> = &'a dyn Fn() -> (Scene, Vec<Projected>);

/// Called at every step with the share of the work done (0..=1); an error stops the fit.
pub(crate) type Watch<'a> = &'a mut dyn FnMut(f32, Drawing<'_>) -> Result<()>;

/// Fits `count` primitives to `target`.
pub(crate) fn fit(
    scene: &Scene,
    target: &Target,
    count: usize,
    plan: &Plan,
    watch: Watch<'_>,
) -> Result<Vec<Primitive>> {
    let mut rng = Pcg64Mcg::seed_from_u64(plan.seed);
    let mut primitives = sample::by_detail(target, count, &mut rng);
    let bounds = Bounds::new(target.width, target.height);
    for p in &mut primitives {
        bounds.apply(p);
    }
    let mut memory = vec![Memory::default(); count];
    sort(&mut primitives, &mut memory);
    let mut field = Field::default();
    let step = row_step(scene, count);
    let mut order = 0u32;
    let start = Instant::now();
    let mut iteration = 0;
    while iteration < plan.iterations && count > 0 {
        // With a time budget the schedule follows the clock where that is ahead.
        let done = (iteration as f32 / plan.iterations as f32).max(plan.spent(start));
        if done >= 1.0 {
            break;
        }
        watch(done, &|| (*scene, project_all(&primitives, scene.height)))?;
        if iteration > 0 && iteration % plan.relocate_every == 0 && done < RELOCATED {
            let rows = RowSet { step: step.div_ceil(2), phase: 0 };
            let most = ((count as f32 * plan.relocate_share) as usize).max(1);
            relocate::relocate(scene, target, &mut field, rows, &mut primitives, &mut memory, most);
            sort(&mut primitives, &mut memory);
        }
        let step = if done < SAMPLED { step } else { step / 4 };
        let rows = if step > 1 {
            let m = iteration % step;
            if m == 0 {
                order = rng.random::<u32>() >> 8;
            }
            RowSet { step, phase: (m * (step / 2 + 1 + step % 2 * (step > 3) as u32) + order) % step }
        } else {
            RowSet::ALL
        };
        let projected = project_all(&primitives, scene.height);
        field.draw(scene, target, &projected, rows, Output::Gradient);
        let rates = RATES.scaled(LAST_RATE + (1.0 - LAST_RATE) * 0.5 * (1.0 + (std::f32::consts::PI * done).cos()));
        let channels = target.channels.count();
        adam::step(
            scene,
            channels,
            &field,
            rows,
            &projected,
            &mut primitives,
            &mut memory,
            None,
            &bounds,
            rates,
            iteration,
        );
        iteration += 1;
    }
    Ok(primitives)
}

/// Rows in one sampled row: every Gaussian should see a few.
fn row_step(scene: &Scene, count: usize) -> u32 {
    let area = scene.width as f32 * scene.height as f32;
    let typical = 0.7 * (area / (std::f32::consts::PI * count.max(1) as f32)).sqrt();
    ((1.2 * typical) as u32).clamp(1, 16).min(scene.height)
}

pub(crate) fn project_all(primitives: &[Primitive], height: u32) -> Vec<Projected> {
    const CHUNK: usize = 512;
    let chunks = primitives.len().div_ceil(CHUNK);
    parallel::map(chunks, |c| {
        let part = &primitives[c * CHUNK..primitives.len().min((c + 1) * CHUNK)];
        part.iter().map(|p| Projected::new(p, height)).collect::<Vec<_>>()
    })
    .concat()
}

/// Brings neighbours in the picture next to each other in memory.
fn sort(primitives: &mut [Primitive], memory: &mut [Memory]) {
    let mut order: Vec<u32> = (0..primitives.len() as u32).collect();
    order.sort_by_key(|&i| {
        let [x, y] = primitives[i as usize].mean;
        ((y / 16.0) as u32, x as u32, i)
    });
    let sorted: Vec<(Primitive, Memory)> =
        order.iter().map(|&i| (primitives[i as usize], memory[i as usize])).collect();
    for (i, (p, m)) in sorted.into_iter().enumerate() {
        (primitives[i], memory[i]) = (p, m);
    }
}
