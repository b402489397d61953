//! What each step of a fit does: step sizes, sampled rows, relocations, corrections of the number of primitives,
//! picture size.

use std::ops::Range;

use rand::RngExt;
use rand_pcg::Pcg64Mcg;

use crate::constants::fit;
use crate::effort::HalfSize;
use crate::error::Result;
use crate::fit::engine::{Ending, Engine, EngineSnapshot, Watcher};
use crate::fit::job::Job;
use crate::fit::model::adam::{self, Rates};
use crate::fit::model::objective::reduced::{Coarse, Reduced};
use crate::fit::model::objective::rows::RowSet;
use crate::fit::model::problem::{Problem, Scene};
use crate::fit::plan::Pace;
use crate::instant::Instant;
use crate::options::Rung;
use crate::strict_math::StrictMath;

/// Step sizes at the start, in each Gaussian's own frame and units.
pub(crate) const RATES: Rates = Rates {
    mean: fit::MEAN_RATE,
    log_scale: fit::LOG_SCALE_RATE,
    rotation: fit::ROTATION_RATE,
    color: fit::COLOR_RATE,
    decay: fit::DECAYS[2],
};

fn relocation_end(pace: Pace) -> f32 {
    match pace {
        Pace::Steady => fit::STEADY_RELOCATION_END,
        Pace::Brisk => fit::BRISK_RELOCATION_END,
    }
}

/// Fits the primitives of `engine` in the iterations `steps` of the job. `watcher` may correct their number.
pub(crate) fn run<E: Engine>(
    job: &Job<'_>,
    engine: &mut E,
    (rng, steps): (Pcg64Mcg, Range<u32>),
    watcher: &mut dyn Watcher,
) -> Result<Ending> {
    let (scene, count) = (&job.problem.scene, engine.count());
    let step = scene.row_step(count);
    let large = HalfSize { share: fit::HALF_SIZE_SHARE, row_step: fit::MIN_HALF_SIZE_ROW_STEP };
    let half = if scene.is_large() && count >= fit::MIN_HALF_SIZE_COUNT { Some(large) } else { job.plan.half };
    // How often the picture is halved, and for which fraction of the steps.
    let seen = match job.plan.by {
        1 => half.filter(|half| step >= half.row_step).map(|half| (1, half.share)),
        by => Some((by.ilog2(), 1.0)),
    };
    let coarse = seen.map(|(times, share)| Coarse { reduced: Reduced::new(&job.problem, times).into(), share });
    run_part(job, Part { steps, coarse }, engine, rng, watcher)
}

/// Changes the number of primitives of `engine` to that of the job.
pub(super) fn grow<E: Engine>(job: &Job<'_>, engine: &mut E) -> Result<()> {
    let rows = RowSet { step: search_step(&job.problem.scene, job.problem.scene.row_step(engine.count())), phase: 0 };
    engine.resize(&job.problem, rows, job.count)
}

/// A range of iterations, the first of which may use a smaller picture.
pub(super) struct Part {
    pub steps: Range<u32>,
    pub coarse: Option<Coarse>,
}

/// Takes the steps of `part`.
pub(super) fn run_part<E: Engine>(
    job: &Job<'_>,
    part: Part,
    engine: &mut E,
    rng: Pcg64Mcg,
    watcher: &mut dyn Watcher,
) -> Result<Ending> {
    Schedule::new(job, part, rng, engine.count()).run(engine, watcher)
}

/// A part of a fit in progress.
struct Schedule<'a> {
    job: &'a Job<'a>,
    steps: Range<u32>,
    /// The smaller picture, as long as the steps use it.
    coarse: Option<Coarse>,
    /// Set when the error at the smaller size is small enough. The fit must then continue at full size.
    is_near: bool,
    /// The distance of sampled rows at full size.
    row_step: u32,
    rows: RowCycle,
    rng: Pcg64Mcg,
    /// The remaining corrections of the number of primitives: the end of [`fit::RECOUNT_AT`].
    recounts: &'static [f32],
    start: Instant,
}

impl<'a> Schedule<'a> {
    fn new(job: &'a Job<'a>, Part { steps, coarse }: Part, rng: Pcg64Mcg, count: usize) -> Self {
        let from = steps.start as f32 / job.plan.iterations as f32;
        let passed = fit::RECOUNT_AT.iter().take_while(|&&at| at < from).count();
        Schedule {
            job,
            steps,
            coarse,
            is_near: false,
            row_step: job.problem.scene.row_step(count),
            rows: RowCycle::new(),
            rng,
            recounts: &fit::RECOUNT_AT[passed..],
            start: Instant::now(),
        }
    }

    fn run<E: Engine>(mut self, engine: &mut E, watcher: &mut dyn Watcher) -> Result<Ending> {
        let plan = self.job.plan;
        if let Some(Coarse { reduced, .. }) = &self.coarse {
            engine.zoom(&reduced.problem(), 1.0 / reduced.by as f32)?;
        }
        let [from, to] = [self.steps.start, self.steps.end].map(|step| step as f32 / plan.iterations as f32);
        for iteration in self.steps.clone() {
            if engine.count() == 0 {
                break;
            }
            // With a time budget, the clock may be ahead of the iterations.
            let spent = plan.spent(self.start);
            let done = (iteration as f32 / plan.iterations as f32).max(from + (to - from) * spent);
            if spent >= 1.0 {
                break;
            }
            let is_coarse = self.coarse.as_ref().is_some_and(|c| done < c.share) && !self.is_near;
            if !is_coarse {
                self.return_to_full_size(engine)?;
            }
            watcher.step(done, &mut self.snapshot(engine))?;
            self.reshape(iteration, done, engine, watcher)?;
            let left = plan.iterations - iteration - 1;
            if self.step(iteration, done, engine)? && left > 0 {
                return Ok(Ending::Enough { left });
            }
        }
        self.return_to_full_size(engine)?;
        // Even the last step can increase the error. If it skipped rows, its result has not been checked yet.
        let is_whole = self.steps.end == plan.iterations && engine.count() > 0;
        if is_whole && plan.rung >= Rung::Sampling && sampled_step(self.row_step, 1.0) > 1 {
            engine.remember(&self.job.problem)?;
        }
        Ok(Ending::Scheduled)
    }

    /// Continues at full size, if the steps used a smaller picture.
    fn return_to_full_size<E: Engine>(&mut self, engine: &mut E) -> Result<()> {
        match self.coarse.take() {
            Some(Coarse { reduced, .. }) => engine.zoom(&self.job.problem, reduced.by as f32),
            None => Ok(()),
        }
    }

    /// Returns the problem that the steps work on, and the factor by which its picture is smaller.
    fn current(&self) -> (Problem<'_>, u32) {
        self.coarse.as_ref().map_or((self.job.problem, 1), |c| (c.reduced.problem(), c.reduced.by))
    }

    fn snapshot<'b, E>(&'b self, engine: &'b mut E) -> EngineSnapshot<'b, E> {
        EngineSnapshot { whole: &self.job.problem, engine, by: self.current().1 }
    }

    /// Converts sampled rows at full size to those of the current size, with the same fraction of rows: at half size
    /// there are as many sampled rows, each half as long.
    fn current_rows(&self, rows: RowSet) -> RowSet {
        let (_, by) = self.current();
        let step = ((rows.step as f64 / by as f64) as u32).max(1);
        RowSet { step, phase: rows.phase / by % step }
    }

    /// Corrects the number of primitives or relocates the least useful ones, when that is due.
    fn reshape<E: Engine>(
        &mut self,
        iteration: u32,
        done: f32,
        engine: &mut E,
        watcher: &mut dyn Watcher,
    ) -> Result<()> {
        let (plan, scene) = (self.job.plan, &self.job.problem.scene);
        let step = search_step(scene, self.row_step);
        let rows = self.current_rows(RowSet { step, phase: 0 });
        let can_relocate = plan.rung >= Rung::Relocation && done < relocation_end(plan.pace);
        if self.recounts.first().is_some_and(|&at| done >= at) {
            self.recounts = &self.recounts[1..];
            let wanted = watcher.recount(&self.snapshot(engine).primitives()?)?;
            engine.resize(&self.current().0, rows, wanted)?;
            self.row_step = scene.row_step(engine.count());
        } else if can_relocate && iteration > 0 && iteration.is_multiple_of(plan.relocate_every) {
            let share = match plan.pace {
                Pace::Steady => plan.relocated_share,
                Pace::Brisk => fit::BRISK_RELOCATED_SHARE * (1.0 - done / fit::BRISK_RELOCATION_END),
            };
            let max_count = ((engine.count() as f32 * share) as usize).max(1);
            engine.relocate(&self.current().0, rows, max_count)?;
        }
        if self.recounts.is_empty() && !can_relocate {
            engine.end_searches();
        }
        Ok(())
    }

    /// Takes one step of the optimizer. Returns whether the error is small enough.
    fn step<E: Engine>(&mut self, iteration: u32, done: f32, engine: &mut E) -> Result<bool> {
        let (plan, whole) = (self.job.plan, &self.job.problem);
        let step = if plan.rung >= Rung::Sampling { sampled_step(self.row_step, done) } else { 1 };
        let sampled = self.rows.next(step, &mut self.rng);
        let sampled = self.current_rows(sampled);
        let cosine = 0.5 * (1.0 + (std::f32::consts::PI * done).strict_cos());
        // With a time budget there may be fewer steps than planned.
        let steps = if done > 0.0 { iteration as f32 / done } else { f32::INFINITY }.min(plan.iterations as f32);
        let decay = plan.decay.unwrap_or_else(|| match plan.pace {
            Pace::Steady => RATES.decay,
            Pace::Brisk => adam::decay(steps),
        });
        let rates = Rates { decay, ..RATES };
        let rates = rates.scaled(plan.rate).scaled(plan.last_rate + (1.0 - plan.last_rate) * cosine);
        let each = if whole.scene.pixels() <= fit::MAX_ALWAYS_CHECKED_PIXELS { 1 } else { fit::CHECK_INTERVAL };
        let is_due = done >= fit::SAMPLED_UNTIL && self.coarse.is_none() && iteration.is_multiple_of(each);
        if is_due && !(E::REMEMBERS_WHOLE_STEPS && sampled == RowSet::ALL) {
            engine.remember(whole)?;
        }
        let (problem, _) = self.current();
        let error = engine.descend(&problem, sampled, rates)?;
        // The error over sampled rows or at half size is only an estimate.
        if !error.is_some_and(|e| e <= plan.enough * problem.samples(sampled)) {
            return Ok(false);
        }
        if self.coarse.is_some() {
            self.is_near = true;
            return Ok(false);
        }
        Ok(iteration + 1 < plan.iterations && engine.error(whole)? <= plan.enough * whole.samples(RowSet::ALL))
    }
}

/// Returns the row distance of a search for misplaced primitives, given that of the steps.
fn search_step(scene: &Scene, row_step: u32) -> u32 {
    // A search that skips rows misses thin lines, but on a large picture it halves the work.
    if scene.is_large() { row_step.div_ceil(2) } else { 1 }
}

/// Chooses the rows of each iteration: every phase once in a shuffled cycle.
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
        // A stride coprime to `step` keeps consecutive samples apart.
        let stride = (step / 2 + 1..step).find(|&s| gcd(s, step) == 1).unwrap_or(1);
        RowSet { step, phase: (m * stride + self.shift) % step }
    }
}

/// Returns the distance of sampled rows. It decreases towards the end, so that the noise of sampling does not remain.
/// All rows are used only if few are skipped from the start, because neighbouring rows carry nearly the same
/// information about Gaussians that span many of them.
fn sampled_step(step: u32, done: f32) -> u32 {
    match done {
        ..fit::SAMPLED_UNTIL => step,
        ..fit::DENSE_FROM => step * 10 / 19,
        _ => step / 3,
    }
}

fn gcd(a: u32, b: u32) -> u32 {
    if b == 0 { a } else { gcd(b, a % b) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::engine::Unwatched;
    use crate::fit::model::drawing::project::Primitive;
    use crate::fit::model::objective::planes::Planes;
    use crate::fit::plan::Plan;
    use crate::fit::state::State;
    use crate::gaussian::{Blend, Channels};
    use crate::pixels::{Pixels, Samples};

    /// Records for each step its rows and whether the state before it was remembered.
    #[derive(Default)]
    struct Recorder<const REMEMBERS: bool> {
        steps: Vec<(RowSet, bool)>,
        is_remembered: bool,
    }

    impl<const REMEMBERS: bool> Engine for Recorder<REMEMBERS> {
        const REMEMBERS_WHOLE_STEPS: bool = REMEMBERS;

        fn count(&self) -> usize {
            236
        }

        fn primitives(&mut self) -> Result<Vec<Primitive>> {
            Ok(Vec::new())
        }

        fn settle(&mut self) -> Result<()> {
            Ok(())
        }

        fn error(&mut self, _: &Problem<'_>) -> Result<f64> {
            Ok(1.0)
        }

        fn descend(&mut self, _: &Problem<'_>, rows: RowSet, _: Rates) -> Result<Option<f64>> {
            self.steps.push((rows, std::mem::take(&mut self.is_remembered)));
            Ok(None)
        }

        fn relocate(&mut self, _: &Problem<'_>, _: RowSet, _: usize) -> Result<usize> {
            Ok(0)
        }

        fn resize(&mut self, _: &Problem<'_>, _: RowSet, _: usize) -> Result<()> {
            Ok(())
        }

        fn remember(&mut self, _: &Problem<'_>) -> Result<()> {
            self.is_remembered = true;
            Ok(())
        }

        fn keep_best(&mut self) -> Result<()> {
            Ok(())
        }

        fn zoom(&mut self, _: &Problem<'_>, _: f32) -> Result<()> {
            Ok(())
        }

        fn reweigh(&mut self, _: &Problem<'_>) -> Result<()> {
            Ok(())
        }

        fn finish(self) -> Result<State> {
            unreachable!("the schedule does not end the fit")
        }
    }

    /// Runs 100 steps on a picture with this side.
    fn recorded<const REMEMBERS: bool>(side: u32) -> Vec<(RowSet, bool)> {
        let samples = Samples::U8(vec![99; (side * side) as usize]);
        let target = Planes::new(&Pixels::new(side, side, Channels::Grey, samples).unwrap());
        let scene = Scene { width: side, height: side, blend: Blend::Normalized, background: target.mean };
        let plan = Plan::steps(100, 0);
        let job = Job { problem: Problem { scene, target: &target }, count: 236, plan: &plan };
        let mut engine = Recorder::<REMEMBERS>::default();
        let rng = rand::SeedableRng::seed_from_u64(0);
        run(&job, &mut engine, (rng, 0..100), &mut Unwatched).unwrap();
        engine.steps
    }

    #[test]
    fn every_late_state_of_a_small_picture_is_remembered_by_every_engine() {
        let (own, asked) = (recorded::<true>(128), recorded::<false>(128));
        assert!(own.iter().map(|s| s.0).eq(asked.iter().map(|s| s.0)), "both take the same steps");
        assert_eq!(own.iter().filter(|s| s.0 == RowSet::ALL).count(), 20);
        for (i, (own, asked)) in own.iter().zip(&asked).enumerate() {
            assert_eq!(asked.1, i >= 80, "step {i}");
            assert_eq!(own.1 || own.0 == RowSet::ALL, i >= 80, "step {i}");
        }
        let sparse: Vec<usize> =
            recorded::<false>(129).iter().enumerate().filter(|(_, s)| s.1).map(|(i, _)| i).collect();
        assert_eq!(sparse, [80], "a larger picture is checked every 20 steps");
    }
}
