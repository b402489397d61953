//! Fits primitives to a picture: floating point, stochastic, seeded; the result is the same for any number of threads.
//!
//! A [`Job`] describes what to fit, an [`Engine`] takes the steps, and [`fit`] runs the whole process: [`multi_start`]
//! finds where to start, and [`schedule`] decides what each step does. Nothing here deals with integers or bytes.

mod cpu;
pub mod engine;
pub(crate) mod job;
pub mod method;
pub mod model;
pub(crate) mod multi_start;
pub(crate) mod plan;
mod probe_fit;
pub(crate) mod schedule;
#[cfg(test)]
#[path = "../../tests/internal/stability.rs"]
mod stability;
pub(crate) mod state;

use crate::error::Result;
use crate::options::Rung;
use engine::{Ending, Engine, Watcher};
use job::Job;
use model::problem::Problem;
use probe_fit::ProbeOutcome;
use state::State;

/// The result of a fit.
#[derive(Debug)]
pub(crate) struct Fitted<E> {
    /// The engine that took the steps, or its final state on the CPU.
    pub by: E,
    pub ending: Ending,
    /// The target's amplitudes in the last steps, if pixels were reweighted.
    pub amplitude: Option<Vec<f32>>,
}

impl<E: Engine> Fitted<E> {
    /// Transfers the result to the CPU.
    ///
    /// # Errors
    /// Returns an error of the engine.
    pub(crate) fn finished(self) -> Result<Fitted<State>> {
        Ok(Fitted { by: self.by.finish()?, ending: self.ending, amplitude: self.amplitude })
    }
}

/// Fits as described by `job`, on the engine that `open` creates from the starting state. `watcher` may correct the
/// number of primitives during the fit.
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
    // Fits from several starts have few primitives, for which pixel weights are nearly equal.
    if !job.plan.reweighs || start.from > 0 {
        let ending = schedule::run(job, &mut engine, (start.rng, start.from..end), watcher)?;
        engine.keep_best()?;
        return Ok(Fitted { by: engine, ending, amplitude: None });
    }
    let (target, from) = match probe_fit::probe(job, &mut engine, watcher)? {
        ProbeOutcome::Reweighted { target, steps } => (target, steps),
        ProbeOutcome::Ended(ending) => return Ok(Fitted { by: engine, ending, amplitude: None }),
    };
    let job = Job { problem: Problem { target: &target, ..job.problem }, ..*job };
    engine.reweigh(&job.problem)?;
    let ending = schedule::run(&job, &mut engine, (start.rng, from..end), watcher)?;
    engine.keep_best()?;
    Ok(Fitted { by: engine, ending, amplitude: Some(target.amplitude) })
}

/// Fits as described by `job` on the CPU.
///
/// # Errors
/// Returns an error of the watcher.
pub(crate) fn fit_on_cpu(job: &Job<'_>, watcher: &mut dyn Watcher) -> Result<Fitted<State>> {
    fit(job, Ok, watcher)?.finished()
}
