//! The report of an encode: its progress, the time of its stages, and everything that it skipped.

use std::ops::ControlFlow;
use std::time::Duration;

use super::device::Chosen;
use super::input::EncodeInput;
use super::skipped::{SkipReason, Skipped};
use crate::error::{Error, Result};
use crate::fit::engine::{Inspector, Moment, Snapshot};
use crate::fit::model::objective::planes::Planes;
use crate::instant::Instant;

/// An encoded picture.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Encoded {
    /// The file.
    pub bytes: Vec<u8>,
    /// Report of the encode.
    pub report: EncodeReport,
}

/// Report of an encode: its result, its cost, and what was skipped.
#[derive(Debug, Clone, Default)]
#[non_exhaustive]
pub struct EncodeReport {
    /// Number of Gaussians in the file.
    pub gaussians: usize,
    /// Effort of the encode, 1 to 9: the requested one, or a lower one if the time limit is too short for it. It is 0
    /// if the Gaussians were given.
    pub effort: u8,
    /// PSNR of the stored picture against the source in dB, before rounding to code values. It is infinite if they are
    /// equal. Errors of colours are weighted by the alpha of the source, even if hidden colours are kept.
    pub psnr: f64,
    /// PSNR of the picture before quantization, in dB.
    pub float_psnr: f64,
    /// SSIMULACRA2 score of the decoded file against the source; `None` unless the target was `Target::Quality`. Pictures
    /// with a side below 64 pixels are mirrored before they are measured, and samples of 16 bits that use less than an
    /// eighth of their range are stretched, as described at `Target::Quality`.
    pub quality: Option<f64>,
    /// Wall-clock seconds of the encode.
    pub seconds: f64,
    /// Seconds of each stage, in order.
    pub stages: Vec<StageTime>,
    /// Everything that the encode skipped, with the reasons.
    pub skipped: Vec<Skipped>,
    /// Device that fitted the picture, and the reason for the choice.
    pub chosen: Chosen,
}

/// Progress of an encode.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct Progress {
    /// Name of the stage.
    pub stage: &'static str,
    /// Fraction of the stage that is done, `0..=1`.
    pub done: f32,
}

/// Time of one stage of an encode.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct StageTime {
    /// Name of the stage, as in [`Progress`].
    pub name: &'static str,
    /// Wall-clock seconds of the stage.
    pub seconds: f64,
}

/// The report of an encode in progress.
pub(super) struct ReportBuilder<'a> {
    pub progress: &'a mut dyn FnMut(&Progress) -> ControlFlow<()>,
    start: Instant,
    inspector: Option<Inspector>,
    /// Time that the inspector took.
    inspected: Duration,
    pub stages: Vec<StageTime>,
    /// The skipped parts, in the order in which they were found.
    pub skipped: Vec<Skipped>,
}

impl<'a> ReportBuilder<'a> {
    pub(super) fn new(progress: &'a mut dyn FnMut(&Progress) -> ControlFlow<()>, inspector: Option<Inspector>) -> Self {
        let (start, inspected) = (Instant::now(), Duration::ZERO);
        ReportBuilder { progress, start, inspector, inspected, stages: Vec::new(), skipped: Vec::new() }
    }

    /// Returns the seconds since the start of the encode, excluding inspections.
    pub(super) fn seconds(&self) -> f64 {
        (self.start.elapsed() - self.inspected).as_secs_f64()
    }

    /// Reports the fraction of a stage that is done, without an inspection.
    ///
    /// # Errors
    /// [`Error::Cancelled`] if the caller cancels.
    pub(super) fn stage_progress(&mut self, stage: &'static str, done: f32) -> Result<()> {
        match (self.progress)(&Progress { stage, done }) {
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

/// A stage of an encode in progress, which is reported at every step.
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
        self.inspect(now)?;
        self.report.stage_progress(self.name, done)
    }

    /// Shows the current state to the inspector, if there is one.
    pub(super) fn inspect(&mut self, now: &mut dyn Snapshot) -> Result<()> {
        let Some(inspector) = self.report.inspector else { return Ok(()) };
        let (clock, seconds) = (Instant::now(), self.report.seconds());
        inspector
            .0
            .inspect(&Moment { stage: self.name, seconds, original: self.input.original, target: self.planes }, now)?;
        self.report.inspected += clock.elapsed();
        Ok(())
    }
}
