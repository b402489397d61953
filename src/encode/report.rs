//! The report of an encode: its progress, the time of its stages, and everything that it skipped.

use std::ops::ControlFlow;

use super::input::EncodeInput;
use super::skipped::{SkipReason, Skipped};
use super::trace::Tracer;
use crate::error::{Error, Result};
use crate::fit::engine::Snapshot;
use crate::fit::model::objective::planes::Planes;

/// Progress of an encode.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct Progress {
    /// Name of the stage.
    pub stage: &'static str,
    /// Fraction of the stage that is done, `0..=1`.
    pub done: f32,
    /// Last measured PSNR in dB, if the encode is traced.
    #[cfg(feature = "unstable")]
    pub psnr: Option<f64>,
    #[cfg(not(feature = "unstable"))]
    #[allow(dead_code, reason = "only tools trace encodes")]
    pub(crate) psnr: Option<f64>,
}

/// Time of one stage of an encode.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct StageTime {
    /// Name of the stage, as in [`Progress`].
    pub name: &'static str,
    /// Wall-clock seconds of the stage, excluding tracing.
    pub seconds: f64,
}

/// The report of an encode in progress.
pub(super) struct ReportBuilder<'a> {
    pub progress: &'a mut dyn FnMut(&Progress) -> ControlFlow<()>,
    pub tracer: Tracer,
    pub stages: Vec<StageTime>,
    /// The skipped parts, in the order in which they were found.
    pub skipped: Vec<Skipped>,
}

impl<'a> ReportBuilder<'a> {
    pub(super) fn new(progress: &'a mut dyn FnMut(&Progress) -> ControlFlow<()>, tracer: Tracer) -> Self {
        ReportBuilder { progress, tracer, stages: Vec::new(), skipped: Vec::new() }
    }

    /// Returns the seconds since the start of the encode, excluding tracing.
    pub(super) fn seconds(&self) -> f64 {
        self.tracer.seconds()
    }

    /// Reports the fraction of a stage that is done, without measuring anything.
    ///
    /// # Errors
    /// [`Error::Cancelled`] if the caller cancels.
    pub(super) fn stage_progress(&mut self, stage: &'static str, done: f32) -> Result<()> {
        self.notify(&Progress { stage, done, psnr: None })
    }

    fn notify(&mut self, progress: &Progress) -> Result<()> {
        match (self.progress)(progress) {
            ControlFlow::Continue(()) => Ok(()),
            ControlFlow::Break(()) => Err(Error::Cancelled),
        }
    }

    /// Records the end of a stage that started when [`seconds`](Self::seconds) returned `since`. Returns its duration.
    pub(super) fn stage(&mut self, name: &'static str, since: f64) -> f64 {
        let seconds = self.seconds() - since;
        self.stages.push(StageTime { name, seconds });
        seconds
    }

    /// Records something that was skipped. It replaces what an earlier attempt skipped for the same reason.
    pub(super) fn note(&mut self, what: SkipReason, bytes: u64, seconds: f64) {
        self.skipped.retain(|l| l.what != what);
        self.skipped.push(Skipped { what, bytes, seconds });
    }
}

/// A stage of an encode in progress, which is traced and reported at every step.
pub(super) struct Stage<'a, 'b> {
    pub name: &'static str,
    pub report: &'a mut ReportBuilder<'b>,
    pub input: EncodeInput<'a>,
    pub planes: &'a Planes,
}

impl Stage<'_, '_> {
    /// Reports the fraction of the stage that is done.
    ///
    /// # Errors
    /// [`Error::Cancelled`] if the caller cancels, and the errors of inspecting the current state.
    pub(super) fn step(&mut self, done: f32, now: &mut dyn Snapshot) -> Result<()> {
        let stage = self.name;
        let psnr = self.report.tracer.step(stage, self.input.original, self.planes, now)?;
        self.report.notify(&Progress { stage, done, psnr })
    }
}
