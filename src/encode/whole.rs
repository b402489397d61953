//! Encodes a picture as a whole.

use std::cell::OnceCell;
use std::time::Duration;

use super::channels::{Narrow, narrow};
use super::clock::Clock;
use super::constant::{self, constant, is_constant};
use super::device::Choice;
#[cfg(feature = "quality-hook")]
use super::drawn::drawn_like;
use super::hidden;
use super::input::{EncodeInput, may_leave_out, stored_scene};
use super::layer::error::stored_error;
use super::layer::texture::Texture;
use super::pipeline::run;
use super::rate_control;
use super::report::ReportBuilder;
#[cfg(feature = "quality-hook")]
use super::session::AtQuality;
use super::session::{EncodeSession, FitRequest, KeptBase, Outcome};
use super::skipped::SkipReason;
use super::trace::Tracer;
use super::{Chosen, Encoded, Progress};
use crate::bitstream::splats::PackedSplats;
use crate::error::Result;
use crate::fit::engine::StaticSnapshot;
use crate::fit::model::objective::planes::Planes;
use crate::fit::model::problem::Problem;
use crate::gaussian::Channels;
use crate::options::{Detail, EncodeOptions, Needs};
use crate::pixels::Pixels;
use crate::round::rounded::projected;
use crate::round::size::Size;
#[cfg(feature = "quality-hook")]
use crate::ssimulacra2::Reference;
use crate::target::Target;
use crate::used_range::UsedRange;

/// An encode of a whole picture in progress.
pub(super) struct WholeSession<'a> {
    pub input: EncodeInput<'a>,
    /// The integers of the fitted picture, without primitives.
    pub blank: PackedSplats,
    /// The planes of the fitted picture. Their amplitudes depend on the number of primitives.
    pub planes: Planes,
    /// The time budget.
    pub clock: Clock,
    pub device: Choice,
    /// Gaussians under a detail layer from an earlier try of a search.
    pub kept: Option<KeptBase>,
    /// The best factor on the byte budget of these Gaussians, once several were tried.
    pub base_factor: Option<f64>,
    /// The range of the samples, if it is so narrow that the picture is one colour with a detail layer.
    pub range: Option<UsedRange>,
    /// The texture of the picture, once it is measured.
    pub texture: OnceCell<Option<Texture>>,
    /// The picture prepared for scores, once there is one.
    #[cfg(feature = "quality-hook")]
    reference: Option<Reference<'a>>,
    pub report: ReportBuilder<'a>,
}

/// Encodes `pixels` as a whole. `iterations` is a factor on the iterations of the fits.
pub(super) fn encode(
    pixels: &Pixels,
    options: &EncodeOptions,
    iterations: f32,
    progress: &mut dyn FnMut(&Progress) -> std::ops::ControlFlow<()>,
) -> Result<Encoded> {
    let clock = Clock::new(options.time);
    let mut report = ReportBuilder::new(progress, Tracer::new(options.trace));
    let inpainted = hidden::inpainted(pixels, options.hidden, || report.stage_progress("survey", 0.0))?;
    if inpainted.is_some() {
        report.note(SkipReason::HiddenColors, 0, 0.0);
    }
    let original = inpainted.as_ref().unwrap_or(pixels);
    let narrow: Option<Narrow> = if may_leave_out(options) { narrow(original) } else { None };
    let fitted = narrow.as_ref().map_or(original, |n| &n.pixels);
    let device = Choice::new(options, fitted)?;
    if let Some(narrow) = &narrow {
        report.note(narrow.removed.clone(), 0, 0.0);
    }
    let input = EncodeInput { original, pixels: fitted, options, iterations };
    let may_be_flat = constant::is_possible(options, input.blend()) && fitted.channels().alpha().is_none();
    let range = if may_be_flat && options.detail != Detail::Off { UsedRange::narrow(fitted) } else { None };
    if let Some(range) = range {
        report.note(SkipReason::Contrasts { levels: range.levels() }, 0, 0.0);
    }
    run(WholeSession {
        input,
        blank: input.empty(),
        planes: Planes::with_hidden(fitted, options.hidden),
        clock,
        kept: None,
        base_factor: None,
        range,
        texture: OnceCell::new(),
        #[cfg(feature = "quality-hook")]
        reference: None,
        device,
        report,
    })
}

impl<'a> EncodeSession<'a> for WholeSession<'a> {
    fn options(&self) -> &EncodeOptions {
        self.input.options
    }

    fn clock(&mut self) -> &mut Clock {
        &mut self.clock
    }

    fn report(&mut self) -> &mut ReportBuilder<'a> {
        &mut self.report
    }

    fn chosen(&self) -> Chosen {
        self.device.chosen().clone()
    }

    fn channels(&self) -> Channels {
        self.input.channels()
    }

    fn blank(&self) -> &PackedSplats {
        &self.blank
    }

    fn constant(&mut self) -> Result<Option<PackedSplats>> {
        if !is_constant(self.input.pixels) {
            return Ok(None);
        }
        Ok(Some(self.flat()))
    }

    fn at_size(&mut self, size: Size, share: Option<Duration>) -> Result<Outcome> {
        self.layered(size, share)
    }

    fn at_count(&mut self, count: usize) -> Result<Outcome> {
        self.without_layer(count, &FitRequest::alone(Size::Free, None))
    }

    fn fitted_error(&mut self, splats: &PackedSplats) -> Result<f64> {
        Ok(stored_error(splats, &self.planes.as_shown(), self.channels()))
    }

    fn error(&mut self, splats: &PackedSplats) -> Result<f64> {
        if self.fits_all_channels() {
            return self.fitted_error(splats);
        }
        Ok(stored_error(&self.widened(splats), &Planes::new(self.input.original), self.channels()))
    }

    #[cfg(feature = "quality-hook")]
    fn score(&mut self, splats: &PackedSplats) -> Result<f64> {
        let original = self.input.original;
        let drawn = drawn_like(splats, original)?;
        let reference = match self.reference.take() {
            Some(reference) => reference,
            None => Reference::new(original)?,
        };
        self.reference.insert(reference).score(&drawn)
    }

    #[cfg(feature = "quality-hook")]
    fn at_quality(&mut self, wanted: f64) -> Result<AtQuality> {
        self.layered_to_quality(wanted)
    }

    fn prune(&mut self, outcome: &mut Outcome, error: f64) -> Result<()> {
        // The contribution of channels that were left out to the error is not known here.
        match self.input.options.needs == Needs::Measured && self.fits_all_channels() {
            true => self.pruned(outcome, error),
            false => Ok(()),
        }
    }

    #[cfg(feature = "quality-hook")]
    fn can_be_trimmed(&self, outcome: &Outcome) -> bool {
        outcome.can_be_trimmed()
    }

    #[cfg(feature = "quality-hook")]
    fn trim_to_quality(&mut self, outcome: &mut Outcome, wanted: f64) -> Result<()> {
        self.trimmed(outcome, wanted)
    }

    fn trace_end(&mut self, splats: &PackedSplats, _error: f64) -> Result<()> {
        let problem = Problem { scene: stored_scene(splats), target: &self.planes };
        let project = || projected(&splats.quantizer(), &splats.gaussians, splats.height);
        let mut now = StaticSnapshot { problem: &problem, project: &project };
        self.report.tracer.step("written", self.input.original, &self.planes, &mut now)?;
        Ok(())
    }
}

impl WholeSession<'_> {
    /// Returns the squared error of the stored picture over the fitted samples. Hidden colours count if they are kept.
    pub(super) fn error_of(&self, splats: &PackedSplats) -> f64 {
        stored_error(splats, &self.planes, self.input.channels())
    }

    /// Returns the integers of the mean colour.
    pub(super) fn flat(&self) -> PackedSplats {
        let mut splats = self.blank.clone();
        constant(&mut splats, self.planes.mean);
        splats
    }

    /// Encodes to a file of the requested size without a detail layer.
    pub(super) fn gaussians_of_size(&mut self, request: &FitRequest) -> Result<Outcome> {
        let count = match request.size {
            Size::Bytes(most) => rate_control::count_for(self.input.options, most, self.fixed()?, self.samples())?,
            Size::Free => 0,
        };
        self.without_layer(count, request)
    }

    /// Encodes to a file of the requested size, starting with about `count` primitives.
    fn without_layer(&mut self, count: usize, request: &FitRequest) -> Result<Outcome> {
        let mut outcome = self.fitted(count, request)?;
        if self.input.options.needs == Needs::Measured {
            let max_error = self.input.pixels.depth().rounding_error() * self.fitted_samples();
            self.pruned(&mut outcome, max_error)?;
        }
        // The result must not be worse than a single colour, with or without a Gaussian.
        let background =
            PackedSplats { gaussians: Vec::new(), codebook: None, levels: Vec::new(), ..outcome.splats.clone() };
        let options = self.input.options;
        let may_be_flat =
            constant::is_possible(options, self.blank.blend) && !matches!(options.target, Target::Primitives(_));
        let flat = may_be_flat.then(|| self.flat());
        let mut error = self.error_of(&outcome.splats);
        for single in [Some(background), flat].into_iter().flatten() {
            let (bytes, single_error) = (self.file(&single)?, self.error_of(&single));
            if (error.is_nan() || error > single_error) && request.size.exceeded_by(&bytes) == 0 {
                error = single_error;
                (outcome.bytes, outcome.splats, outcome.pruned_bytes) = (bytes, single, 0);
            }
        }
        // The size loop exceeds the size only if a file without primitives does.
        match request.size.exceeded_by(&outcome.bytes) {
            over @ 1.. if request.under_layer.is_none() => {
                let needed = outcome.bytes.len() as u64;
                Err(self.too_small(needed - over, needed))
            }
            _ => Ok(outcome),
        }
    }
}
