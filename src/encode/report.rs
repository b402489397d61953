//! Account of an encode: its progress, the time of its stages, and everything that it left out.

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
    /// The stage's name.
    pub stage: &'static str,
    /// Share of the stage that is done, `0..=1`.
    pub done: f32,
    /// PSNR when it was last measured, dB, where an encode is traced.
    #[doc(hidden)]
    pub psnr: Option<f64>,
}

/// Time of one stage of an encode.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct StageTime {
    /// The stage's name, as in [`Progress`].
    pub name: &'static str,
    /// Wall-clock seconds of the stage, without the time for tracing.
    pub seconds: f64,
}

/// The account of an encode that goes on.
pub(super) struct ReportBuilder<'a> {
    pub progress: &'a mut dyn FnMut(&Progress) -> ControlFlow<()>,
    pub tracer: Tracer,
    pub stages: Vec<StageTime>,
    /// In the order in which it was found.
    pub skipped: Vec<Skipped>,
}

impl<'a> ReportBuilder<'a> {
    pub(super) fn new(progress: &'a mut dyn FnMut(&Progress) -> ControlFlow<()>, tracer: Tracer) -> Self {
        ReportBuilder { progress, tracer, stages: Vec::new(), skipped: Vec::new() }
    }

    /// Returns the seconds since the encode began, those of tracing not counted.
    pub(super) fn seconds(&self) -> f64 {
        self.tracer.seconds()
    }

    /// Reports the share of a stage that is done, where nothing is measured on the way.
    ///
    /// # Errors
    /// [`Error::Cancelled`] when the caller breaks off.
    pub(super) fn show(&mut self, stage: &'static str, done: f32) -> Result<()> {
        self.tell(&Progress { stage, done, psnr: None })
    }

    fn tell(&mut self, progress: &Progress) -> Result<()> {
        match (self.progress)(progress) {
            ControlFlow::Continue(()) => Ok(()),
            ControlFlow::Break(()) => Err(Error::Cancelled),
        }
    }

    /// Notes that a stage, which began when [`seconds`](Self::seconds) were `since`, is over; returns how long it took.
    pub(super) fn stage(&mut self, name: &'static str, since: f64) -> f64 {
        let seconds = self.seconds() - since;
        self.stages.push(StageTime { name, seconds });
        seconds
    }

    /// Notes what was left out, in place of what an earlier attempt left out for the same reason.
    pub(super) fn note(&mut self, what: SkipReason, bytes: u64, seconds: f64) {
        self.skipped.retain(|l| l.what != what);
        self.skipped.push(Skipped { what, bytes, seconds });
    }
}

/// A stage of an encode as it goes on: it is traced and reported at every step.
pub(super) struct Stage<'a, 'b> {
    pub name: &'static str,
    pub report: &'a mut ReportBuilder<'b>,
    pub input: EncodeInput<'a>,
    pub planes: &'a Planes,
}

impl Stage<'_, '_> {
    /// Reports the share of the stage that is done.
    ///
    /// # Errors
    /// [`Error::Cancelled`] when the caller breaks off, and those of looking at the work.
    pub(super) fn step(&mut self, done: f32, now: &mut dyn Snapshot) -> Result<()> {
        let stage = self.name;
        let psnr = self.report.tracer.step(stage, self.input.original, self.planes, now)?;
        self.report.tell(&Progress { stage, done, psnr })
    }
}
