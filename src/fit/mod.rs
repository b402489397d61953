//! Fitting primitives to a picture: float, stochastic, seeded; the same result for any thread count.
//!
//! A [`Job`] says what to fit, an [`Engine`] takes the steps, and [`fit`] is the one way through them: [`draft`] finds where
//! to start, [`schedule`] says which step comes when. Nothing here knows of integers or bytes.

#[cfg(all(test, unix))]
mod coarse;
mod cpu;
pub(crate) mod draft;
pub(crate) mod engine;
pub(crate) mod job;
pub(crate) mod model;
pub(crate) mod plan;
pub(crate) mod schedule;
pub(crate) mod smartsplat;
#[cfg(test)]
mod stability;
pub(crate) mod state;

use crate::error::Result;
use crate::options::Rung;
use engine::{Ending, Engine, Watcher};
use job::Job;
use state::State;

/// Fits as `job` says, on the engine that `open` makes of where the fit starts. `watcher` corrects the number on the way.
///
/// # Errors
/// Those of `open`, the engine and the watcher.
pub(crate) fn fit<E: Engine>(
    job: &Job<'_>,
    open: impl FnOnce(State) -> Result<E>,
    watcher: &mut dyn Watcher,
) -> Result<(E, Ending)> {
    let mut start = draft::start(job, watcher)?;
    start.state.is_priced = job.plan.rung >= Rung::Price;
    let mut engine = open(start.state)?;
    let ending = schedule::run(job, &mut engine, (start.rng, start.from..job.plan.iterations), watcher)?;
    engine.keep_best()?;
    Ok((engine, ending))
}

/// Fits as `job` says on the CPU.
///
/// # Errors
/// Those of the watcher.
pub(crate) fn fit_on_cpu(job: &Job<'_>, watcher: &mut dyn Watcher) -> Result<(State, Ending)> {
    let (state, ending) = fit(job, Ok, watcher)?;
    Ok((state.finish()?, ending))
}
