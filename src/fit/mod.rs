//! Fitting primitives to a picture: float, stochastic, seeded; the same result for any thread count.
//!
//! A [`Job`] says what to fit, an [`Engine`] takes the steps, and [`fit`] is the one way through them: [`draft`] finds where
//! to start, [`schedule`] says which step comes when. Nothing here knows of integers or bytes.

#[cfg(all(test, unix))]
mod coarse;
mod cpu;
pub(crate) mod engine;
pub(crate) mod job;
pub mod model;
pub(crate) mod multi_start;
pub(crate) mod plan;
mod probe_fit;
pub(crate) mod schedule;
#[cfg(feature = "smartsplat")]
pub(crate) mod smartsplat;
#[cfg(test)]
mod stability;
pub(crate) mod state;

use crate::error::Result;
use crate::options::Rung;
use engine::{Ending, Engine, Watcher};
use job::Job;
use model::problem::Problem;
use probe_fit::Rehearsed;
use state::State;

/// Result of a fit.
#[derive(Debug)]
pub(crate) struct Fitted<E> {
    /// The engine that took the steps, or its state on the CPU.
    pub by: E,
    pub ending: Ending,
    /// The amplitudes of the target in the last steps, where the pixels were weighed anew.
    pub amplitude: Option<Vec<f32>>,
}

impl<E: Engine> Fitted<E> {
    /// Brings it to the CPU.
    ///
    /// # Errors
    /// Returns an error of the engine.
    pub(crate) fn finished(self) -> Result<Fitted<State>> {
        Ok(Fitted { by: self.by.finish()?, ending: self.ending, amplitude: self.amplitude })
    }
}

/// Fits as `job` says, on the engine that `open` makes of where the fit starts. `watcher` corrects the number on the way.
///
/// # Errors
/// Returns an error of `open`, of the engine or of the watcher.
pub(crate) fn fit<E: Engine>(
    job: &Job<'_>,
    open: impl FnOnce(State) -> Result<E>,
    watcher: &mut dyn Watcher,
) -> Result<Fitted<E>> {
    let mut start = multi_start::start(job, watcher)?;
    start.state.is_priced = job.plan.rung >= Rung::Price;
    let mut engine = open(start.state)?;
    let end = job.plan.iterations;
    if !job.plan.initial.is_empty() {
        schedule::grow(job, &mut engine)?;
    }
    // Those that start from a draft are few, and their pixels weigh nearly alike.
    if !job.plan.reweighs || start.from > 0 {
        let ending = schedule::run(job, &mut engine, (start.rng, start.from..end), watcher)?;
        engine.keep_best()?;
        return Ok(Fitted { by: engine, ending, amplitude: None });
    }
    let (target, from) = match probe_fit::probe(job, &mut engine, watcher)? {
        Rehearsed::Weighed { target, steps } => (target, steps),
        Rehearsed::Ended(ending) => return Ok(Fitted { by: engine, ending, amplitude: None }),
    };
    let job = Job { problem: Problem { target: &target, ..job.problem }, ..*job };
    engine.reweigh(&job.problem)?;
    let ending = schedule::run(&job, &mut engine, (start.rng, from..end), watcher)?;
    engine.keep_best()?;
    Ok(Fitted { by: engine, ending, amplitude: Some(target.amplitude) })
}

/// Fits as `job` says on the CPU.
///
/// # Errors
/// Returns an error of the watcher.
pub(crate) fn fit_on_cpu(job: &Job<'_>, watcher: &mut dyn Watcher) -> Result<Fitted<State>> {
    fit(job, Ok, watcher)?.finished()
}
