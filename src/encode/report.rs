//! What an encode tells of itself: progress, the time of its stages, and what it did without.

use std::fmt;
use std::ops::ControlFlow;

use super::Progress;
use super::subject::Subject;
use super::trace::Tracer;
use crate::error::{Error, Result};
use crate::fit::engine::Sight;
use crate::fit::model::planes::Planes;

/// Something that the encoder did without, because the picture or the options do not need it or it was not to be had.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct LeftOut {
    /// What it is, and why.
    pub what: Omission,
    /// Bytes saved; 0 where it saves only time, which then buys quality, or nothing that was measured.
    pub bytes: u64,
    /// Seconds saved, estimated from the cost of one iteration; 0 where that is not known.
    pub seconds: f64,
}

/// What an encode can do without. As text it is the thing, a colon, and why it was not needed.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Omission {
    /// Alpha, where all is opaque.
    Alpha,
    /// Colour, where all is grey.
    Color,
    /// Colour and alpha, where all is grey and opaque.
    ColorAndAlpha,
    /// The weights of [`Tune::Ssim`](crate::Tune::Ssim) and [`Tune::Iq`](crate::Tune::Iq), where the picture is so even
    /// that they are the same everywhere.
    StructureWeights,
    /// The fit, where the picture is one colour.
    Fit,
    /// Iterations, where the error was small enough before the last one.
    Iterations,
    /// Primitives without which the error stays small enough.
    Primitives,
    /// A colour of its own for each primitive, where a codebook is smaller.
    OwnColors,
    /// The GPU, where one might have been taken.
    Gpu {
        /// Why it was not.
        reason: String,
    },
}

impl fmt::Display for Omission {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Omission::Alpha => "alpha: all is opaque",
            Omission::Color => "colour: all is grey",
            Omission::ColorAndAlpha => "colour and alpha: all is grey and opaque",
            Omission::StructureWeights => "SSIM terms: the picture is so even that all pixels weigh the same",
            Omission::Fit => "the fit: the picture is one colour",
            Omission::Iterations => "iterations: the error is below that of rounding, or well below the target",
            Omission::Primitives => "primitives without which the error stays below that of rounding, or of the target",
            Omission::OwnColors => "a colour of its own for each primitive: a codebook is smaller",
            Omission::Gpu { reason } => return write!(f, "the GPU: {reason}"),
        })
    }
}

/// What is told of an encode on its way.
pub(super) struct Journal<'a> {
    progress: &'a mut dyn FnMut(&Progress) -> ControlFlow<()>,
    pub tracer: Tracer,
    pub stages: Vec<(&'static str, f64)>,
    /// In the order in which it was found.
    pub left_out: Vec<LeftOut>,
}

impl<'a> Journal<'a> {
    pub(super) fn new(progress: &'a mut dyn FnMut(&Progress) -> ControlFlow<()>, tracer: Tracer) -> Self {
        Journal { progress, tracer, stages: Vec::new(), left_out: Vec::new() }
    }

    /// Returns the seconds since the encode began, those of tracing not counted.
    pub(super) fn seconds(&self) -> f64 {
        self.tracer.seconds()
    }

    /// Notes that a stage, which began when [`seconds`](Self::seconds) were `since`, is over; returns how long it took.
    pub(super) fn stage(&mut self, name: &'static str, since: f64) -> f64 {
        let seconds = self.seconds() - since;
        self.stages.push((name, seconds));
        seconds
    }

    /// Notes what was left out, in place of what an earlier attempt left out for the same reason.
    pub(super) fn note(&mut self, what: Omission, bytes: u64, seconds: f64) {
        self.left_out.retain(|l| l.what != what);
        self.left_out.push(LeftOut { what, bytes, seconds });
    }
}

/// A stage of an encode as it goes on: it is traced and reported at every step.
pub(super) struct Stage<'a, 'b> {
    pub name: &'static str,
    pub journal: &'a mut Journal<'b>,
    pub subject: Subject<'a>,
    pub planes: &'a Planes,
}

impl Stage<'_, '_> {
    /// Reports the share of the stage that is done.
    ///
    /// # Errors
    /// [`Error::Cancelled`] when the caller breaks off, and those of looking at the work.
    pub(super) fn step(&mut self, done: f32, now: &mut dyn Sight) -> Result<()> {
        let stage = self.name;
        let psnr = self.journal.tracer.step(stage, self.subject.original, self.planes, now)?;
        match (self.journal.progress)(&Progress { stage, done, psnr }) {
            ControlFlow::Continue(()) => Ok(()),
            ControlFlow::Break(()) => Err(Error::Cancelled),
        }
    }
}
