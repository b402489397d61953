//! The engine that takes the steps of a fit, and the watcher that accompanies it.

use crate::error::Result;
use crate::fit::model::adam::Rates;
use crate::fit::model::drawing::field::squared_error;
use crate::fit::model::drawing::project::{self, Primitive, Projected};
use crate::fit::model::objective::rows::RowSet;
use crate::fit::model::problem::{Problem, Scene};
use crate::fit::state::State;

/// Takes the steps of a fit: [`State`] does on the CPU, `gpu::Fitter` on a GPU.
///
/// All that may have to wait for a device can fail. The problem that is given to each method is the one that the steps
/// see now: after [`zoom`](Engine::zoom) it is the smaller picture.
pub(crate) trait Engine {
    /// Returns the number of primitives.
    fn count(&self) -> usize;
    /// Returns the primitives as they are after all steps asked for, at the size that the steps see.
    fn primitives(&mut self) -> Result<Vec<Primitive>>;
    /// Waits until all steps asked for are taken.
    #[allow(dead_code, reason = "only a fit on a GPU is timed step by step")]
    fn settle(&mut self) -> Result<()>;
    /// Returns the squared error over all rows of `whole`, the picture at its own size, whatever size the steps see.
    fn error(&mut self, whole: &Problem<'_>) -> Result<f64>;
    /// Takes one step on the error over `rows`; returns that error before the step, where it is known yet.
    fn descend(&mut self, problem: &Problem<'_>, rows: RowSet, rates: Rates) -> Result<Option<f64>>;
    /// Moves at most `most` primitives to where the error over `rows` is largest; returns how many.
    fn relocate(&mut self, problem: &Problem<'_>, rows: RowSet, most: usize) -> Result<usize>;
    /// Brings the number of primitives to `wanted`: takes the cheapest away, or adds some at peaks of the error.
    fn resize(&mut self, problem: &Problem<'_>, rows: RowSet, wanted: usize) -> Result<()>;
    /// Remembers the present state if its error over all rows is the least so far.
    fn remember(&mut self, problem: &Problem<'_>) -> Result<()>;
    /// Goes back to the best state that is remembered, if the last one is clearly worse.
    fn keep_best(&mut self) -> Result<()>;
    /// Goes on with `problem`, the picture at `by` times the size before.
    fn zoom(&mut self, problem: &Problem<'_>, by: f32) -> Result<()>;
    /// Goes on with `problem`, whose pixels are weighed anew; errors from before do not compare.
    fn reweigh(&mut self, problem: &Problem<'_>) -> Result<()>;
    /// Ends the fit and returns what it came to, for the CPU.
    fn finish(self) -> Result<State>
    where
        Self: Sized;
}

/// Why a fit ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Ending {
    /// Its iterations or its time are over.
    Scheduled,
    /// The error is small enough, so many iterations before the end.
    Enough { left: u32 },
}

/// Accompanies a fit.
pub(crate) trait Watcher {
    /// Is called before every step with the share of the work that is done (0..=1). An error stops the fit.
    fn step(&mut self, done: f32, now: &mut dyn Snapshot) -> Result<()>;
    /// Tells, from the primitives so far, how many there should be.
    fn recount(&mut self, primitives: &[Primitive]) -> Result<usize>;
}

/// The work as it is now, for a watcher to look at. Each look costs about as much as a step over all rows.
pub(crate) trait Snapshot {
    /// Waits until all steps asked for are taken.
    #[allow(dead_code, reason = "only a fit on a GPU is timed step by step")]
    fn settle(&mut self) -> Result<()>;
    /// Returns the squared error of the picture over all rows.
    #[allow(dead_code, reason = "only a fit on a GPU is looked at this way")]
    fn error(&mut self) -> Result<f64>;
    /// Returns all primitives, projected, and the scene that they belong to.
    fn drawing(&mut self) -> Result<(Scene, Vec<Projected>)>;
}

/// The primitives of an engine, seen at the picture's own size.
pub(super) struct Running<'a, E> {
    pub whole: &'a Problem<'a>,
    pub engine: &'a mut E,
    /// How many times smaller the picture is that the steps see.
    pub by: u32,
}

impl<E: Engine> Running<'_, E> {
    /// Returns the primitives at the picture's own size.
    pub(super) fn primitives(&mut self) -> Result<Vec<Primitive>> {
        Ok(project::zoomed(self.engine.primitives()?, self.by as f32))
    }
}

impl<E: Engine> Snapshot for Running<'_, E> {
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

/// Primitives that lie still while they are looked at; they are projected only when somebody looks.
pub(crate) struct StaticSnapshot<'a> {
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

/// Keeps the number of primitives and looks at nothing.
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
