//! Fitting primitives to a picture: float, stochastic, seeded; the same result for any thread count.

#[cfg(all(test, unix))]
mod coarse;
pub(crate) mod draft;
pub(crate) mod model;
pub(crate) mod plan;
pub(crate) mod smartsplat;
#[cfg(test)]
mod stability;

use std::ops::Range;
use std::time::Instant;

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use crate::error::Result;
use crate::parallel;
use model::adam::{self, Bounds, Freedom, Memory, Rates};
use model::field::{Field, Output, Scene};
use model::planes::Target;
use model::project::{Primitive, Projected};
use model::reduced::{Coarse, Reduced};
use model::rows::RowSet;
use model::{relocate, sample};
use plan::Plan;

/// Step sizes at the start; see `design.md` for how they were found.
const RATES: Rates = Rates { mean: 0.3, log_scale: 0.3, rotation: 0.15, color: 0.01 };
/// Step sizes at the end, in units of those at the start.
const LAST_RATE: f32 = 0.02;
/// Share of the iterations that see the fewest rows.
const SAMPLED: f32 = 0.8;
/// Share of the iterations after which the most rows are seen.
const SETTLED: f32 = 0.95;
/// Iterations between looks at the error over all rows when few are seen in the last steps.
pub(crate) const REMEMBERED: u32 = 20;
/// Error of the last state, over that of the best one, from which on the best one is gone back to.
pub(crate) const CLEARLY_WORSE: f64 = 1.01;
/// Share of the iterations after which nothing is relocated any more.
const RELOCATED: f32 = 0.7;
/// Share of the iterations that see a large picture at half its size: `coarse.rs` measures it.
const COARSE: f32 = 0.7;
/// Pixels of a large picture: smaller ones are done soon enough.
pub(crate) const LARGE: u64 = 1 << 21;
/// Primitives that are worth it: fewer cost little, and each matters to the end.
const MANY: usize = 1000;
/// Rows in one sampled row from which on half the size loses nothing at first: Gaussians span several pixels.
const SPARSE: u32 = 5;

/// Shows the state of the work when called: costs a projection of all primitives.
pub(crate) type Drawing<'a> = &'a dyn Fn() -> (Scene, Vec<Projected>);

/// Called at every step with the share of the work done (0..=1); an error stops the fit.
pub(crate) type Watch<'a> = &'a mut dyn FnMut(f32, Drawing<'_>) -> Result<()>;

/// When the number of primitives is corrected, as shares of the iterations.
const RECOUNTED: [f32; 3] = [0.3, 0.6, 0.85];

/// Tells, from the primitives so far, how many there should be.
pub(crate) type Recount<'a> = &'a mut dyn FnMut(&[Primitive]) -> Result<usize>;

/// Why a fit ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Ending {
    /// Its iterations or its time are over.
    Scheduled,
    /// The error is small enough.
    Enough,
}

/// What takes the steps of a fit: [`State`] on the CPU, or a GPU.
pub(crate) trait Engine {
    /// Number of primitives.
    fn count(&self) -> usize;
    /// The primitives as they are now.
    fn primitives(&self) -> Vec<Primitive>;
    /// Squared error of the picture so far.
    fn error(&mut self, scene: &Scene, target: &Target) -> Result<f64>;
    /// One step of the optimizer on the error over `rows`; returns that error before the step, where it is known yet.
    fn descend(&mut self, scene: &Scene, target: &Target, rows: RowSet, rates: Rates) -> Result<Option<f64>>;
    /// Moves at most `most` primitives to where the error over `rows` is largest; returns how many.
    fn relocate(&mut self, scene: &Scene, target: &Target, rows: RowSet, most: usize) -> Result<usize>;
    /// Brings the number of primitives to `wanted`, taking the cheapest away or adding at peaks.
    fn resize(&mut self, scene: &Scene, target: &Target, rows: RowSet, wanted: usize) -> Result<()>;
    /// Remembers the present state if its error over all rows is the least so far.
    fn remember(&mut self, _scene: &Scene, _target: &Target) -> Result<()> {
        Ok(())
    }
    /// Goes on with the picture at another size, `by` times the one before.
    fn zoom(&mut self, scene: &Scene, target: &Target, by: f32) -> Result<()>;
}

/// The same primitives in a picture `by` times as large.
pub(crate) fn zoomed(mut primitives: Vec<Primitive>, by: f32) -> Vec<Primitive> {
    for p in &mut primitives {
        p.mean = p.mean.map(|v| v * by);
        p.log_scale = p.log_scale.map(|v| v + by.ln());
    }
    primitives
}

/// Where a fit of about `count` primitives starts, and the random numbers that it goes on with.
pub(crate) fn start(target: &Target, count: usize, plan: &Plan) -> (State, Pcg64Mcg) {
    let mut rng = Pcg64Mcg::seed_from_u64(plan.seed);
    let primitives = sample::by_detail(target, count, &mut rng);
    (State::new(primitives, Bounds::new(target.width, target.height)), rng)
}

/// Fits about `count` primitives to `target` on the CPU; `recount` corrects the number on the way.
pub(crate) fn fit(
    scene: &Scene,
    target: &Target,
    count: usize,
    plan: &Plan,
    recount: Recount<'_>,
    watch: Watch<'_>,
) -> Result<State> {
    let (mut state, rng, from) = draft::start(scene, target, count, plan, recount, watch)?;
    state.is_enough = run(scene, target, &mut state, rng, plan, from, recount, watch)? == Ending::Enough;
    state.keep_best();
    Ok(state)
}

/// Fits the primitives of `engine` to `target`, from the iteration `from` on; `recount` corrects their number on the way.
#[allow(clippy::too_many_arguments)]
pub(crate) fn run<E: Engine>(
    scene: &Scene,
    target: &Target,
    engine: &mut E,
    rng: Pcg64Mcg,
    plan: &Plan,
    from: u32,
    recount: Recount<'_>,
    watch: Watch<'_>,
) -> Result<Ending> {
    let count = engine.count();
    let pays = is_large(scene) && count >= MANY && row_step(scene, count) >= SPARSE;
    let half = pays.then(|| Reduced::new(scene, target, 1));
    let coarse = half.as_ref().map(|reduced| Coarse { reduced, share: COARSE });
    run_part(scene, target, engine, rng, plan, from..plan.iterations, coarse, recount, watch)
}

/// The same in a part of the iterations, of which the first may see a smaller picture.
#[allow(clippy::too_many_arguments)]
fn run_part<E: Engine>(
    scene: &Scene,
    target: &Target,
    engine: &mut E,
    mut rng: Pcg64Mcg,
    plan: &Plan,
    part: Range<u32>,
    coarse: Option<Coarse<'_>>,
    recount: Recount<'_>,
    watch: Watch<'_>,
) -> Result<Ending> {
    let mut small = coarse.map(|c| c.reduced);
    if let Some(small) = small {
        engine.zoom(&small.scene, &small.target, 1.0 / small.by as f32)?;
    }
    let mut is_near = false;
    let mut step = row_step(scene, engine.count());
    let mut rows = RowCycle::new();
    let start = Instant::now();
    let share = |iteration: u32| iteration as f32 / plan.iterations as f32;
    let mut recounts = RECOUNTED.iter().filter(|&&at| at >= share(part.start)).peekable();
    let samples = |scene: &Scene, rows: RowSet| {
        rows.count(scene.height) as f64 * f64::from(scene.width) * target.channels.count() as f64
    };
    let mut iteration = part.start;
    while iteration < part.end && engine.count() > 0 {
        // With a time budget the schedule follows the clock where that is ahead.
        let done = share(iteration).max(plan.spent(start));
        if done >= 1.0 {
            break;
        }
        let is_coarse = coarse.is_some_and(|c| done < c.share) && !is_near;
        if let Some(small) = small.take_if(|_| !is_coarse) {
            engine.zoom(scene, target, small.by as f32)?;
        }
        let (seen, seen_target, by) = match small {
            Some(small) => (&small.scene, &small.target, small.by),
            None => (scene, target, 1),
        };
        // At half the size as many rows are seen, each half as long.
        let seen_rows = |rows: RowSet| {
            let step = ((rows.step as f64 / by as f64) as u32).max(1);
            RowSet { step, phase: rows.phase / by % step }
        };
        let whole = |engine: &E| zoomed(engine.primitives(), by as f32);
        watch(done, &|| (*scene, project_all(&whole(engine), scene.height)))?;
        // Thin lines are lost on a survey that leaves rows out, but it is half of the work on a large picture.
        let surveyed = seen_rows(RowSet { step: if is_large(scene) { step.div_ceil(2) } else { 1 }, phase: 0 });
        if recounts.next_if(|&&at| done >= at).is_some() {
            let wanted = recount(&whole(engine))?;
            engine.resize(seen, seen_target, surveyed, wanted)?;
            step = row_step(scene, engine.count());
        } else if iteration > 0 && iteration.is_multiple_of(plan.relocate_every) && done < RELOCATED {
            let most = ((engine.count() as f32 * plan.relocate_share) as usize).max(1);
            engine.relocate(seen, seen_target, surveyed, most)?;
        }
        let sampled = seen_rows(rows.next(sampling(step, done), &mut rng));
        let rates = RATES
            .scaled(plan.rate)
            .scaled(LAST_RATE + (1.0 - LAST_RATE) * 0.5 * (1.0 + (std::f32::consts::PI * done).cos()));
        // A step on all rows tells the error by itself.
        let is_due = iteration.is_multiple_of(REMEMBERED) || iteration + 1 == plan.iterations;
        if done >= SAMPLED && sampled.step > 1 && small.is_none() && is_due {
            engine.remember(scene, target)?;
        }
        let error = engine.descend(seen, seen_target, sampled, rates)?;
        iteration += 1;
        // A sample of the rows only hints at it, and so does half the size.
        let hinted = error.is_some_and(|e| e <= plan.enough * samples(seen, sampled));
        if hinted && small.is_some() {
            is_near = true;
        } else if hinted && iteration < plan.iterations {
            let most = plan.enough * samples(scene, RowSet::ALL);
            if engine.error(scene, target)? <= most {
                return Ok(Ending::Enough);
            }
        }
    }
    if let Some(small) = small {
        engine.zoom(scene, target, small.by as f32)?;
    }
    Ok(Ending::Scheduled)
}

/// Primitives on their way, with what the optimizer remembers of each.
#[derive(Debug)]
pub(crate) struct State {
    pub primitives: Vec<Primitive>,
    pub memory: Vec<Memory>,
    /// Which parameters may move; empty: all.
    pub freedom: Vec<Freedom>,
    pub bounds: Bounds,
    pub field: Field,
    /// Whether the fit ended early because the error was small enough.
    pub is_enough: bool,
    /// The price of size, by the error that was seen last: see [`adam::price`].
    pub price: f32,
    iteration: u32,
    /// The least error over all rows that was seen with this many primitives, and the primitives that had it.
    best: Option<(f64, Vec<Primitive>)>,
    /// The error over all rows that was seen last.
    latest: f64,
}

impl State {
    pub(crate) fn new(mut primitives: Vec<Primitive>, bounds: Bounds) -> Self {
        for p in &mut primitives {
            bounds.apply(p);
        }
        let memory = vec![Memory::default(); primitives.len()];
        let field = Field::default();
        let mut state = State {
            primitives,
            memory,
            freedom: Vec::new(),
            bounds,
            field,
            is_enough: false,
            price: 0.0,
            iteration: 0,
            best: None,
            latest: 0.0,
        };
        state.sort();
        state
    }

    /// One step of the optimizer on the error over `rows`; returns that error before the step.
    pub(crate) fn descend(&mut self, scene: &Scene, target: &Target, rows: RowSet, rates: Rates) -> f64 {
        let projected = project_all(&self.primitives, scene.height);
        let error = self.field.draw(scene, target, &projected, rows, Output::Gradient);
        let freedom = (!self.freedom.is_empty()).then_some(&self.freedom[..]);
        adam::step(
            scene,
            target.channels.count(),
            &self.field,
            rows,
            &projected,
            &mut self.primitives,
            &mut self.memory,
            freedom,
            &self.bounds,
            rates,
            self.price,
            self.iteration,
        );
        self.iteration += 1;
        error
    }

    fn keep(&mut self, error: f64, primitives: Vec<Primitive>) {
        self.latest = error;
        if self.best.as_ref().is_none_or(|b| error < b.0) {
            self.best = Some((error, primitives));
        }
    }

    /// Goes back to the best state where the fit has ended in a clearly worse one. Few primitives can lose decibels
    /// in their first steps on all rows: the optimizer's memory is of the noise of samples, and those steps are long.
    fn keep_best(&mut self) {
        if let Some((error, primitives)) = self.best.take()
            && self.latest > CLEARLY_WORSE * error
        {
            *self = State { is_enough: self.is_enough, price: self.price, ..State::new(primitives, self.bounds) };
        }
    }

    /// Brings neighbours in the picture next to each other in memory.
    pub(crate) fn sort(&mut self) {
        let mut order: Vec<u32> = (0..self.primitives.len() as u32).collect();
        order.sort_by_key(|&i| {
            let [x, y] = self.primitives[i as usize].mean;
            ((y / 16.0) as u32, x as u32, i)
        });
        self.primitives = order.iter().map(|&i| self.primitives[i as usize]).collect();
        self.memory = order.iter().map(|&i| self.memory[i as usize]).collect();
    }
}

impl Engine for State {
    fn count(&self) -> usize {
        self.primitives.len()
    }

    fn primitives(&self) -> Vec<Primitive> {
        self.primitives.clone()
    }

    fn error(&mut self, scene: &Scene, target: &Target) -> Result<f64> {
        let projected = project_all(&self.primitives, scene.height);
        Ok(self.field.draw(scene, target, &projected, RowSet::ALL, Output::Picture))
    }

    fn descend(&mut self, scene: &Scene, target: &Target, rows: RowSet, rates: Rates) -> Result<Option<f64>> {
        let before = (rows == RowSet::ALL).then(|| self.primitives.clone());
        let error = State::descend(self, scene, target, rows, rates);
        if let Some(before) = before {
            self.keep(error, before);
        }
        Ok(Some(error))
    }

    fn remember(&mut self, scene: &Scene, target: &Target) -> Result<()> {
        let error = self.error(scene, target)?;
        self.keep(error, self.primitives.clone());
        Ok(())
    }

    fn relocate(&mut self, scene: &Scene, target: &Target, rows: RowSet, most: usize) -> Result<usize> {
        Ok(relocate::relocate(scene, target, self, rows, most))
    }

    fn resize(&mut self, scene: &Scene, target: &Target, rows: RowSet, wanted: usize) -> Result<()> {
        relocate::resize(scene, target, self, rows, wanted);
        self.best.take_if(|(_, primitives)| primitives.len() != wanted);
        Ok(())
    }

    fn zoom(&mut self, scene: &Scene, _: &Target, by: f32) -> Result<()> {
        // Gradients grow with the picture: what the optimizer remembers would mislead it.
        let bounds = Bounds::new(scene.width, scene.height);
        let zoomed = State::new(zoomed(std::mem::take(&mut self.primitives), by), bounds);
        let (iteration, price, field) = (self.iteration, self.price, std::mem::take(&mut self.field));
        *self = State { iteration, price, field, ..zoomed };
        Ok(())
    }
}

/// Which rows each iteration sees: every phase once in a shuffled cycle.
pub(crate) struct RowCycle {
    count: u32,
    shift: u32,
}

impl RowCycle {
    pub(crate) fn new() -> Self {
        RowCycle { count: 0, shift: 0 }
    }

    pub(crate) fn next(&mut self, step: u32, rng: &mut Pcg64Mcg) -> RowSet {
        if step <= 1 {
            return RowSet::ALL;
        }
        let m = self.count % step;
        self.count += 1;
        if m == 0 {
            self.shift = rng.random::<u32>() >> 8;
        }
        // A stride prime to `step` keeps consecutive samples apart.
        let stride = (step / 2 + 1..step).find(|&s| gcd(s, step) == 1).unwrap_or(1);
        RowSet { step, phase: (m * stride + self.shift) % step }
    }
}

/// Fewer rows are left out towards the end, so that the noise of sampling does not stay. All of them only where few are
/// left out from the start: neighbouring rows say nearly the same of Gaussians that span many.
fn sampling(step: u32, done: f32) -> u32 {
    match done {
        ..SAMPLED => step,
        ..SETTLED => step * 10 / 19,
        _ => step / 3,
    }
}

fn gcd(a: u32, b: u32) -> u32 {
    if b == 0 { a } else { gcd(b, a % b) }
}

pub(crate) fn is_large(scene: &Scene) -> bool {
    u64::from(scene.width) * u64::from(scene.height) >= LARGE
}

/// About the scale of `count` Gaussians, pixels.
fn typical_scale(scene: &Scene, count: usize) -> f32 {
    let area = scene.width as f32 * scene.height as f32;
    0.7 * (area / (std::f32::consts::PI * count.max(1) as f32)).sqrt()
}

/// Rows in one sampled row: every Gaussian should see a few.
pub(crate) fn row_step(scene: &Scene, count: usize) -> u32 {
    // Sampling few rows of large Gaussians would save more, but each of a few primitives matters.
    let typical = typical_scale(scene, count);
    (f32::min(0.9 * typical, 1.6 * typical.powf(0.6)) as u32).clamp(1, 16).min(scene.height)
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
