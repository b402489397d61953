//! Which step of a fit comes when: step sizes, sampled rows, relocations, corrections of the number, the picture's size.

use std::ops::Range;

use rand::RngExt;
use rand_pcg::Pcg64Mcg;

use crate::error::Result;
use crate::fit::engine::{Ending, Engine, Running, Watcher};
use crate::fit::job::Job;
use crate::fit::model::adam::{self, Rates};
use crate::fit::model::objective::reduced::{Coarse, Reduced};
use crate::fit::model::objective::rows::RowSet;
use crate::fit::model::problem::{Problem, Scene};
use crate::fit::plan::{HalfSize, Pace};
use crate::instant::Instant;
use crate::options::Rung;
use crate::strict_math::StrictMath;

/// Step sizes at the start, in each Gaussian's own frame and units. What others would win or lose is measured by
/// `cargo run --release -p ssplat-lab --example rate_distortion -- PICTURES`.
pub(crate) const RATES: Rates = Rates { mean: 0.3, log_scale: 0.3, rotation: 0.15, color: 0.02, decay: [0.9, 0.95] };
/// Share of the iterations that see the fewest rows.
pub(crate) const SAMPLED: f32 = 0.8;
/// Share of the iterations after which the most rows are seen.
const SETTLED: f32 = 0.95;
/// Iterations between looks at the error over all rows when few are seen in the last steps.
pub(crate) const REMEMBERED: u32 = 20;
/// Pixels of a picture that is looked at in each of those steps: a few primitives can lose tenths of a decibel in one.
const STAMP: u64 = 1 << 14;
/// Share of the iterations after which nothing is relocated any more, at a brisk pace.
const RELOCATED: f32 = 0.6;
/// Share of the iterations after which nothing is relocated any more, at a steady pace.
const RELOCATED_STEADILY: f32 = 0.7;
/// Share of the primitives that may be relocated at a time at a brisk pace, at first; it falls to none.
const MOVED: f32 = 0.2;

fn relocated(pace: Pace) -> f32 {
    match pace {
        Pace::Steady => RELOCATED_STEADILY,
        Pace::Brisk => RELOCATED,
    }
}

/// Share of the iterations that see a large picture at half its size: `coarse.rs` measures it.
const COARSE: f32 = 0.7;
/// Primitives from which on that is worth it: fewer cost little, and each matters to the end.
const MANY: usize = 1000;
/// Rows in one sampled row from which on half the size loses nothing at first: Gaussians span several pixels.
const SPARSE: u32 = 5;
/// When the number of primitives is corrected, as shares of the iterations.
const RECOUNTED: [f32; 3] = [0.3, 0.6, 0.85];

/// Fits the primitives of `engine` in those of the job's iterations that are `steps`; `watcher` corrects their number on the way.
pub(crate) fn run<E: Engine>(
    job: &Job<'_>,
    engine: &mut E,
    (rng, steps): (Pcg64Mcg, Range<u32>),
    watcher: &mut dyn Watcher,
) -> Result<Ending> {
    let (scene, count) = (&job.problem.scene, engine.count());
    let step = scene.row_step(count);
    let large = HalfSize { share: COARSE, row_step: SPARSE };
    let half = if scene.is_large() && count >= MANY { Some(large) } else { job.plan.half };
    // How often the picture is halved, and for which share of the steps.
    let seen = match job.plan.by {
        1 => half.filter(|half| step >= half.row_step).map(|half| (1, half.share)),
        by => Some((by.ilog2(), 1.0)),
    };
    let reduced = seen.map(|(times, _)| Reduced::new(&job.problem, times));
    let coarse = reduced.as_ref().zip(seen).map(|(reduced, (_, share))| Coarse { reduced, share });
    run_part(job, Part { steps, coarse }, engine, rng, watcher)
}

/// Brings the number of primitives of `engine` to that of the job, as a correction on the way would.
pub(super) fn grow<E: Engine>(job: &Job<'_>, engine: &mut E) -> Result<()> {
    let rows = RowSet { step: surveyed(&job.problem.scene, job.problem.scene.row_step(engine.count())), phase: 0 };
    engine.resize(&job.problem, rows, job.count)
}

/// A part of the iterations, of which the first may see a smaller picture.
pub(super) struct Part<'a> {
    pub steps: Range<u32>,
    pub coarse: Option<Coarse<'a>>,
}

/// Takes the steps of `part`.
pub(super) fn run_part<E: Engine>(
    job: &Job<'_>,
    part: Part<'_>,
    engine: &mut E,
    rng: Pcg64Mcg,
    watcher: &mut dyn Watcher,
) -> Result<Ending> {
    Schedule::new(job, part, rng, engine.count()).run(engine, watcher)
}

/// A part of a fit on its way.
struct Schedule<'a> {
    job: &'a Job<'a>,
    part: Part<'a>,
    /// The picture that the steps see, as long as that is a smaller one.
    small: Option<&'a Reduced>,
    /// Set when the error at the smaller size is small enough: the whole size must be looked at then.
    is_near: bool,
    /// The distance of sampled rows at the picture's own size.
    row_step: u32,
    rows: RowCycle,
    rng: Pcg64Mcg,
    /// When the number of primitives will be corrected: those of [`RECOUNTED`] that are still to come.
    recounts: &'static [f32],
    start: Instant,
}

impl<'a> Schedule<'a> {
    fn new(job: &'a Job<'a>, part: Part<'a>, rng: Pcg64Mcg, count: usize) -> Self {
        let from = part.steps.start as f32 / job.plan.iterations as f32;
        let passed = RECOUNTED.iter().take_while(|&&at| at < from).count();
        Schedule {
            job,
            small: part.coarse.map(|c| c.reduced),
            part,
            is_near: false,
            row_step: job.problem.scene.row_step(count),
            rows: RowCycle::new(),
            rng,
            recounts: &RECOUNTED[passed..],
            start: Instant::now(),
        }
    }

    fn run<E: Engine>(mut self, engine: &mut E, watcher: &mut dyn Watcher) -> Result<Ending> {
        let plan = self.job.plan;
        if let Some(small) = self.small {
            engine.zoom(&small.problem(), 1.0 / small.by as f32)?;
        }
        let [from, to] = [self.part.steps.start, self.part.steps.end].map(|step| step as f32 / plan.iterations as f32);
        for iteration in self.part.steps.clone() {
            if engine.count() == 0 {
                break;
            }
            // With a time budget the schedule follows the clock where that is ahead.
            let spent = plan.spent(self.start);
            let done = (iteration as f32 / plan.iterations as f32).max(from + (to - from) * spent);
            if spent >= 1.0 {
                break;
            }
            let is_coarse = self.part.coarse.is_some_and(|c| done < c.share) && !self.is_near;
            if !is_coarse {
                self.go_back(engine)?;
            }
            watcher.step(done, &mut self.running(engine))?;
            self.reshape(iteration, done, engine, watcher)?;
            let left = plan.iterations - iteration - 1;
            if self.step(iteration, done, engine)? && left > 0 {
                return Ok(Ending::Enough { left });
            }
        }
        self.go_back(engine)?;
        // Even the last step can lose something, and where it left rows out nobody has seen what it came to.
        let is_whole = self.part.steps.end == plan.iterations && engine.count() > 0;
        if is_whole && plan.rung >= Rung::Sampling && sampling(self.row_step, 1.0) > 1 {
            engine.remember(&self.job.problem)?;
        }
        Ok(Ending::Scheduled)
    }

    /// Goes on with the picture at its own size, if the steps saw a smaller one.
    fn go_back<E: Engine>(&mut self, engine: &mut E) -> Result<()> {
        match self.small.take() {
            Some(small) => engine.zoom(&self.job.problem, small.by as f32),
            None => Ok(()),
        }
    }

    /// Returns what the steps see, and how many times smaller that is.
    fn seen(&self) -> (Problem<'a>, u32) {
        self.small.map_or((self.job.problem, 1), |small| (small.problem(), small.by))
    }

    fn running<'b, E>(&'b self, engine: &'b mut E) -> Running<'b, E> {
        Running { whole: &self.job.problem, engine, by: self.seen().1 }
    }

    /// Returns the same share of the rows that the steps see: at half the size as many rows, each half as long.
    fn seen_rows(&self, rows: RowSet) -> RowSet {
        let (_, by) = self.seen();
        let step = ((rows.step as f64 / by as f64) as u32).max(1);
        RowSet { step, phase: rows.phase / by % step }
    }

    /// Corrects the number of primitives or moves the least useful ones, when that is due.
    fn reshape<E: Engine>(
        &mut self,
        iteration: u32,
        done: f32,
        engine: &mut E,
        watcher: &mut dyn Watcher,
    ) -> Result<()> {
        let (plan, scene) = (self.job.plan, &self.job.problem.scene);
        let step = surveyed(scene, self.row_step);
        let rows = self.seen_rows(RowSet { step, phase: 0 });
        let (seen, _) = self.seen();
        if self.recounts.first().is_some_and(|&at| done >= at) {
            self.recounts = &self.recounts[1..];
            let wanted = watcher.recount(&self.running(engine).primitives()?)?;
            engine.resize(&seen, rows, wanted)?;
            self.row_step = scene.row_step(engine.count());
        } else if plan.rung >= Rung::Relocation
            && iteration > 0
            && iteration.is_multiple_of(plan.relocate_every)
            && done < relocated(plan.pace)
        {
            let share = match plan.pace {
                Pace::Steady => plan.moved,
                Pace::Brisk => MOVED * (1.0 - done / RELOCATED),
            };
            let most = ((engine.count() as f32 * share) as usize).max(1);
            engine.relocate(&seen, rows, most)?;
        }
        Ok(())
    }

    /// Takes one step of the optimizer; returns whether the error is small enough.
    fn step<E: Engine>(&mut self, iteration: u32, done: f32, engine: &mut E) -> Result<bool> {
        let (plan, whole) = (self.job.plan, &self.job.problem);
        let step = if plan.rung >= Rung::Sampling { sampling(self.row_step, done) } else { 1 };
        let sampled = self.rows.next(step, &mut self.rng);
        let sampled = self.seen_rows(sampled);
        let cosine = 0.5 * (1.0 + (std::f32::consts::PI * done).strict_cos());
        // With a time budget there may be fewer than planned.
        let steps = if done > 0.0 { iteration as f32 / done } else { f32::INFINITY }.min(plan.iterations as f32);
        let rates = match plan.pace {
            Pace::Steady => RATES,
            Pace::Brisk => Rates { decay: adam::decay(steps), ..RATES },
        };
        let rates = rates.scaled(plan.rate).scaled(plan.last_rate + (1.0 - plan.last_rate) * cosine);
        // A step on all rows tells the error by itself.
        let each = if whole.scene.pixels() <= STAMP { 1 } else { REMEMBERED };
        let is_due = iteration.is_multiple_of(each);
        if done >= SAMPLED && sampled.step > 1 && self.small.is_none() && is_due {
            engine.remember(whole)?;
        }
        let (seen, _) = self.seen();
        let error = engine.descend(&seen, sampled, rates)?;
        // A sample of the rows only hints at the error, and so does half the size.
        if !error.is_some_and(|e| e <= plan.enough * seen.samples(sampled)) {
            return Ok(false);
        }
        if self.small.is_some() {
            self.is_near = true;
            return Ok(false);
        }
        Ok(iteration + 1 < plan.iterations && engine.error(whole)? <= plan.enough * whole.samples(RowSet::ALL))
    }
}

/// Returns the distance of the rows that a survey sees where those of steps are `row_step` from each other.
fn surveyed(scene: &Scene, row_step: u32) -> u32 {
    // Thin lines are lost on a survey that leaves rows out, but it is half of the work on a large picture.
    if scene.is_large() { row_step.div_ceil(2) } else { 1 }
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

/// Returns the distance of sampled rows. Fewer rows are left out towards the end, so that the noise of sampling does not
/// stay. All are seen only where few are left out from the start: neighbouring rows say nearly the same of Gaussians that
/// span many.
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
