//! A picture that is fitted as a whole: its preparation and its measurements.

use std::cell::OnceCell;
use std::ops::ControlFlow;

use super::Progress;
use super::channels::{Narrow, narrow};
use super::clock::Clock;
use super::constant::{self, constant, is_constant};
use super::device::Choice;
use super::hidden;
use super::input::{EncodeInput, may_leave_out, stored_scene};
use super::render::{decoded_error, drawn_like};
use super::report::{ReportBuilder, Stage};
use super::skipped::SkipReason;
use super::state::EncodeState;
use super::stored_error::stored_error;
use super::texture::Texture;
use crate::bitstream::splats::PackedSplats;
use crate::effort::EffortSettings;
use crate::error::Result;
use crate::fit::engine::StaticSnapshot;
use crate::fit::model::objective::planes::Planes;
use crate::fit::model::problem::Problem;
use crate::options::{Detail, EncodeOptions};
use crate::pixels::Pixels;
use crate::rdo::rounded::projected;
#[cfg(feature = "quality-hook")]
use crate::ssimulacra2::Reference;
use crate::used_range::UsedRange;

/// A picture that is fitted as a whole.
pub(super) struct WholePicture<'a> {
    pub state: EncodeState<'a>,
    pub input: EncodeInput<'a>,
    /// The planes of the fitted picture. Their amplitudes depend on the number of primitives.
    pub planes: Planes,
    /// The range of the samples, if it is so narrow that the picture is one colour with a detail layer.
    pub range: Option<UsedRange>,
    /// The texture of the picture, once it is measured.
    texture: OnceCell<Option<Texture>>,
    /// The picture prepared for scores, once there is one.
    #[cfg(feature = "quality-hook")]
    reference: Option<Reference<'a>>,
}

/// Prepares `pixels` and encodes them by `encode`: continues hidden colours, leaves out constant channels, and chooses
/// the device. `iterations` is a factor on the iterations of the fits.
pub(super) fn prepare<T>(
    pixels: &Pixels,
    options: &EncodeOptions,
    iterations: f32,
    progress: &mut dyn FnMut(&Progress) -> ControlFlow<()>,
    encode: impl FnOnce(WholePicture<'_>) -> Result<T>,
) -> Result<T> {
    let clock = Clock::new(options.time);
    let mut report = ReportBuilder::new(progress, options.inspector);
    let inpainted = hidden::inpainted(pixels, options.hidden, || report.stage_progress("survey", 0.0))?;
    if inpainted.is_some() {
        report.note(SkipReason::HiddenColors, 0, 0.0);
    }
    let original = inpainted.as_ref().unwrap_or(pixels);
    let narrow: Option<Narrow> = if may_leave_out(options) { narrow(original) } else { None };
    let fitted = narrow.as_ref().map_or(original, |n| &n.pixels);
    let device = &Choice::new(options, fitted)?;
    if let Some(narrow) = &narrow {
        report.note(narrow.removed.clone(), 0, 0.0);
    }
    let input = EncodeInput { original, pixels: fitted, options, iterations };
    let may_be_flat = constant::is_possible(options, input.blend()) && fitted.channels().alpha().is_none();
    let range = if may_be_flat && options.detail != Detail::Off { UsedRange::narrow(fitted) } else { None };
    if let Some(range) = range {
        report.note(SkipReason::Contrasts { levels: range.levels() }, 0, 0.0);
    }
    let (blank, channels) = (input.empty(), input.channels());
    let settings = EffortSettings::from_preset(options.effort);
    encode(WholePicture {
        state: EncodeState { options, settings, channels, blank, clock, device, report, kept: None, base_factor: None },
        input,
        planes: Planes::with_hidden(fitted, options.hidden),
        range,
        texture: OnceCell::new(),
        #[cfg(feature = "quality-hook")]
        reference: None,
    })
}

impl WholePicture<'_> {
    /// Returns the integers of the picture if it has only one colour.
    pub(super) fn constant(&self) -> Option<PackedSplats> {
        is_constant(self.input.pixels).then(|| self.flat())
    }

    /// Returns the integers of the mean colour.
    pub(super) fn flat(&self) -> PackedSplats {
        let mut splats = self.state.blank.clone();
        constant(&mut splats, self.planes.mean);
        splats
    }

    /// Returns the texture of the picture, which is measured once.
    pub(super) fn measured_texture(&self) -> Option<Texture> {
        *self.texture.get_or_init(|| Texture::of(&self.planes))
    }

    /// Returns the squared error of the stored picture over the fitted samples. Hidden colours count if they are kept.
    pub(super) fn error_of(&self, splats: &PackedSplats) -> f64 {
        stored_error(splats, &self.planes, self.state.channels)
    }

    /// Returns the squared error of the stored picture over the fitted samples, weighted as
    /// [`metrics::psnr`](crate::metrics::psnr) does.
    pub(super) fn shown_error(&self, splats: &PackedSplats) -> f64 {
        stored_error(splats, &self.planes.as_shown(), self.state.channels)
    }

    /// Returns the squared error of the decoded picture over the samples of `pixels`: the caller's picture, or that with
    /// the fitted channels.
    pub(super) fn decoded_error(&self, pixels: &Pixels, splats: &PackedSplats) -> Result<f64> {
        Ok(decoded_error(pixels, &drawn_like(splats, pixels)?))
    }

    /// Returns the SSIMULACRA2 score of the stored picture, with the channels that were left out restored.
    #[cfg(feature = "quality-hook")]
    pub(super) fn score(&mut self, splats: &PackedSplats) -> Result<f64> {
        let original = self.input.original;
        let drawn = drawn_like(splats, original)?;
        let reference = match self.reference.take() {
            Some(reference) => reference,
            None => Reference::new(original)?,
        };
        self.reference.insert(reference).score(&drawn)
    }

    /// Shows the stored picture to the inspector.
    pub(super) fn inspect_written(&mut self, splats: &PackedSplats) -> Result<()> {
        let problem = Problem { scene: stored_scene(splats), target: &self.planes };
        let project = || projected(&splats.quantizer(), &splats.gaussians, splats.height);
        let mut now = StaticSnapshot { problem: &problem, project: &project };
        let mut stage =
            Stage { name: "written", report: &mut self.state.report, input: self.input, planes: &self.planes };
        stage.inspect(&mut now)
    }
}
