//! The interfaces of a fit: the engine that takes its steps, and the watcher that follows its progress.

use crate::error::Result;
use crate::fit::model::adam::Rates;
use crate::fit::model::drawing::field::squared_error;
use crate::fit::model::drawing::project::{self, Primitive, Projected};
use crate::fit::model::objective::planes::Planes;
use crate::fit::model::objective::rows::RowSet;
use crate::fit::model::problem::{Problem, Scene};
use crate::fit::state::State;
use crate::pixels::Pixels;

/// Takes the steps of a fit. [`State`] implements it on the CPU, `gpu::Fitter` on a GPU.
///
/// Methods that may have to wait for a device return a `Result`. Each method receives the problem that the steps
/// currently work on: after [`zoom`](Engine::zoom) that is the smaller picture.
pub(crate) trait Engine {
    /// Whether a step on all rows also does what [`remember`](Engine::remember) does with the state before the step,
    /// because it computes the error anyway.
    const REMEMBERS_WHOLE_STEPS: bool;

    /// Returns the number of primitives.
    fn count(&self) -> usize;
    /// Returns the primitives after all requested steps, at the picture size that the steps work on.
    fn primitives(&mut self) -> Result<Vec<Primitive>>;
    /// Waits until all requested steps have been taken.
    #[allow(dead_code, reason = "only a fit on a GPU is timed step by step")]
    fn settle(&mut self) -> Result<()>;
    /// Returns the squared error over all rows of `whole`, the picture at full size, whatever size the steps work on.
    fn error(&mut self, whole: &Problem<'_>) -> Result<f64>;
    /// Takes one step on the error over `rows`. Returns the error before the step if it is already known.
    fn descend(&mut self, problem: &Problem<'_>, rows: RowSet, rates: Rates) -> Result<Option<f64>>;
    /// Moves at most `max_count` primitives to where the error over `rows` is largest. Returns how many were moved.
    fn relocate(&mut self, problem: &Problem<'_>, rows: RowSet, max_count: usize) -> Result<usize>;
    /// Changes the number of primitives to `wanted`: removes the cheapest ones, or adds new ones at peaks of the error.
    fn resize(&mut self, problem: &Problem<'_>, rows: RowSet, wanted: usize) -> Result<()>;
    /// Releases the memory of [`relocate`](Engine::relocate) and [`resize`](Engine::resize), which are no longer called.
    fn end_searches(&mut self) {}
    /// Saves the current state if its error over all rows is the smallest so far.
    fn remember(&mut self, problem: &Problem<'_>) -> Result<()>;
    /// Restores the best saved state if the current one is clearly worse.
    fn keep_best(&mut self) -> Result<()>;
    /// Continues with `problem`, the picture at `by` times the previous size.
    fn zoom(&mut self, problem: &Problem<'_>, by: f32) -> Result<()>;
    /// Continues with `problem`, which has new pixel weights. Earlier errors are no longer comparable.
    fn reweigh(&mut self, problem: &Problem<'_>) -> Result<()>;
    /// Ends the fit and returns the final state on the CPU.
    fn finish(self) -> Result<State>
    where
        Self: Sized;
}

/// Why a fit ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Ending {
    /// All iterations have run, or the time is up.
    Scheduled,
    /// The error became small enough `left` iterations before the end.
    Enough { left: u32 },
}

/// Follows the progress of a fit.
pub trait Watcher {
    /// Called before every step with the fraction of the work that is done (0..=1). An error stops the fit.
    fn step(&mut self, done: f32, now: &mut dyn Snapshot) -> Result<()>;
    /// Returns how many primitives there should be, given the current ones.
    fn recount(&mut self, primitives: &[Primitive]) -> Result<usize>;
}

/// The current state of the work, for a watcher to inspect. Each call costs about as much as a step over all rows.
pub trait Snapshot {
    /// Waits until all requested steps have been taken.
    #[allow(dead_code, reason = "only a fit on a GPU is timed step by step")]
    fn settle(&mut self) -> Result<()>;
    /// Returns the squared error of the picture over all rows.
    #[allow(dead_code, reason = "only a fit on a GPU is inspected this way")]
    fn error(&mut self) -> Result<f64>;
    /// Returns all primitives, projected, and the scene that they belong to.
    #[cfg_attr(not(feature = "unstable"), allow(dead_code, reason = "tools bring inspectors"))]
    fn drawing(&mut self) -> Result<(Scene, Vec<Projected>)>;
}

/// Looks at the states of an encode, for measurements.
#[cfg_attr(not(feature = "unstable"), allow(dead_code, reason = "tools bring inspectors"))]
pub trait Inspect: std::fmt::Debug + std::panic::RefUnwindSafe + Sync {
    /// Called before every step of a fit and every round of rounding, and for the stored picture. An error stops the
    /// encode.
    ///
    /// # Errors
    /// Returns an error of `now`.
    fn inspect(&self, moment: &Moment<'_>, now: &mut dyn Snapshot) -> Result<()>;
}

/// A reference to an inspector. Inspectors are equal if they are the same value in memory.
#[derive(Debug, Clone, Copy)]
pub struct Inspector(pub &'static dyn Inspect);

impl PartialEq for Inspector {
    fn eq(&self, other: &Self) -> bool {
        std::ptr::addr_eq(self.0, other.0)
    }
}

/// When and where an encode is inspected.
#[cfg_attr(not(feature = "unstable"), allow(dead_code, reason = "tools bring inspectors"))]
pub struct Moment<'a> {
    /// Name of the stage, as in [`Progress`](crate::Progress), or "written".
    pub stage: &'static str,
    /// Seconds since the start of the encode, excluding inspections.
    pub seconds: f64,
    /// The picture, and its planes without constant channels.
    pub original: &'a Pixels,
    pub target: &'a Planes,
}

/// The primitives of an engine, converted to the picture's full size.
pub(super) struct EngineSnapshot<'a, E> {
    pub whole: &'a Problem<'a>,
    pub engine: &'a mut E,
    /// Factor by which the picture that the steps work on is smaller.
    pub by: u32,
}

impl<E: Engine> EngineSnapshot<'_, E> {
    /// Returns the primitives at the picture's full size.
    pub(super) fn primitives(&mut self) -> Result<Vec<Primitive>> {
        Ok(project::zoomed(self.engine.primitives()?, self.by as f32))
    }
}

impl<E: Engine> Snapshot for EngineSnapshot<'_, E> {
    fn settle(&mut self) -> Result<()> {
        self.engine.settle()
    }

    fn error(&mut self) -> Result<f64> {
        self.engine.error(self.whole)
    }

    fn drawing(&mut self) -> Result<(Scene, Vec<Projected>)> {
        let scene = self.whole.scene;
        Ok((scene, project::all(&self.primitives()?, scene.height)))
    }
}

/// A snapshot of primitives that do not change. They are projected only on demand.
pub struct StaticSnapshot<'a> {
    pub problem: &'a Problem<'a>,
    pub project: &'a dyn Fn() -> Vec<Projected>,
}

impl Snapshot for StaticSnapshot<'_> {
    fn settle(&mut self) -> Result<()> {
        Ok(())
    }

    fn error(&mut self) -> Result<f64> {
        Ok(squared_error(self.problem, &(self.project)()))
    }

    fn drawing(&mut self) -> Result<(Scene, Vec<Projected>)> {
        Ok((self.problem.scene, (self.project)()))
    }
}

/// A watcher that keeps the number of primitives and ignores progress.
#[cfg(test)]
pub(crate) struct Unwatched;

#[cfg(test)]
impl Watcher for Unwatched {
    fn step(&mut self, _: f32, _: &mut dyn Snapshot) -> Result<()> {
        Ok(())
    }

    fn recount(&mut self, primitives: &[Primitive]) -> Result<usize> {
        Ok(primitives.len())
    }
}
