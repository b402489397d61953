//! An encode of a whole picture or of one in tiles, as rate control, thumbnails and the report see it.

use std::time::Duration;

use super::Chosen;
use super::channels::widen;
use super::clock::Clock;
use super::input::{too_small_with, widened_file};
use super::report::ReportBuilder;
use crate::bitstream::splats::PackedSplats;
use crate::error::Result;
use crate::fit::model::drawing::project::Primitive;
use crate::gaussian::Channels;
use crate::options::EncodeOptions;
use crate::round::size::Size;
use crate::strict_math::StrictMath;

/// A file, its integers, and the squared error before rounding.
#[derive(Clone)]
pub(super) struct Outcome {
    pub bytes: Vec<u8>,
    /// The integers, without the constant channels that were left out.
    pub splats: PackedSplats,
    /// Squared error of the primitives before rounding, over the fitted samples.
    pub float_error: f64,
    /// SSIMULACRA2 score of the decoded file, if it was measured.
    pub quality: Option<f64>,
    /// Bytes that removing unneeded primitives saved in this file.
    pub pruned_bytes: u64,
}

impl Outcome {
    /// Returns whether single primitives can be removed from the file. Their value is not known for files with levels
    /// or a detail layer.
    #[cfg(feature = "quality-hook")]
    pub(super) fn can_be_trimmed(&self) -> bool {
        self.splats.levels.is_empty() && self.splats.detail.is_none()
    }
}

/// The result of an encode to a score with one fit.
#[cfg(feature = "quality-hook")]
pub(super) enum AtQuality {
    Done(Box<Outcome>),
    /// A search has to find the file, which probably has this size without header and metadata. `seen` are the bytes and
    /// the scores of files that are known.
    Expected {
        bytes: f64,
        seen: Vec<(u64, f64)>,
    },
    /// A search has to find the file, of which nothing is known.
    Unknown,
}

/// Gaussians that a search reuses in all its tries. Their best number depends on the picture and hardly on the size of
/// the file.
pub(super) struct KeptBase {
    pub base: Outcome,
    /// Base byte budget before the sharpness adjustment.
    pub base_budget: f64,
}

impl KeptBase {
    /// Returns a copy of the base if it is as good as one of `budget` bytes and takes at most `max_bytes`.
    pub(super) fn for_budget(&self, budget: f64, max_bytes: f64) -> Option<Outcome> {
        let serves = is_near(budget, self.base_budget) && self.base.bytes.len() as f64 <= max_bytes;
        serves.then(|| self.base.clone())
    }
}

/// Minimum factor by which a base must grow to justify another fit.
pub(super) const MIN_BASE_GROWTH: f64 = 1.5;

/// Returns whether a base of `base_budget` bytes is as good as one of `few` bytes.
fn is_near(few: f64, base_budget: f64) -> bool {
    (few / base_budget).strict_ln().abs() < MIN_BASE_GROWTH.strict_ln()
}

/// One fit of the Gaussians of a whole picture.
#[derive(Debug, Clone)]
pub(super) struct FitRequest {
    /// The requested size of the file without a detail layer.
    pub size: Size,
    /// Maximum duration; `None` means all of the remaining time.
    pub time: Option<Duration>,
    /// Set if a detail layer follows, which corrects what a short fit leaves.
    pub under_layer: Option<UnderLayer>,
    /// Primitives of a smaller fit that this one continues. If empty, the fit starts from scratch.
    pub initial: Vec<Primitive>,
}

/// Parameters of Gaussians under a detail layer.
#[derive(Debug, Clone, Copy)]
pub(super) struct UnderLayer {
    /// Ratio of the file with both layers, if fits of large files should be longer.
    pub ratio: Option<f64>,
    /// Factor on the iterations with perceptual tuning.
    pub patience: f32,
}

impl FitRequest {
    /// Requests a file of Gaussians alone.
    pub(super) fn alone(size: Size, time: Option<Duration>) -> Self {
        FitRequest { size, time, under_layer: None, initial: Vec::new() }
    }
}

/// An encode in progress. `'a` is the lifetime of the caller's progress function.
pub(super) trait EncodeSession<'a> {
    fn options(&self) -> &EncodeOptions;

    /// Returns the clock of the time budget.
    fn clock(&mut self) -> &mut Clock;

    fn report(&mut self) -> &mut ReportBuilder<'a>;

    /// Returns the device that fits the picture, and the reason for the choice.
    fn chosen(&self) -> Chosen;

    /// Returns the channels of the file.
    fn channels(&self) -> Channels;

    /// Returns the integers of the fitted picture, without primitives.
    fn blank(&self) -> &PackedSplats;

    /// Returns the integers of the picture if it has only one colour.
    fn constant(&mut self) -> Result<Option<PackedSplats>>;

    /// Encodes to a file of `size`, with a detail layer if that improves the picture. `share` is the part of the time
    /// budget that this file may take; `None` means all of the remaining time.
    fn at_size(&mut self, size: Size, share: Option<Duration>) -> Result<Outcome>;

    /// Encodes to a file of about `count` primitives.
    fn at_count(&mut self, count: usize) -> Result<Outcome>;

    /// Returns the squared error of the stored picture over the fitted samples, weighted as
    /// [`metrics::psnr`](crate::metrics::psnr) does.
    fn fitted_error(&mut self, splats: &PackedSplats) -> Result<f64>;

    /// Returns the squared error of the stored picture over the samples of all channels, weighted as
    /// [`metrics::psnr`](crate::metrics::psnr) does.
    fn error(&mut self, splats: &PackedSplats) -> Result<f64>;

    /// Returns the SSIMULACRA2 score of the stored picture, with the channels that were left out restored.
    #[cfg(feature = "quality-hook")]
    fn score(&mut self, splats: &PackedSplats) -> Result<f64>;

    /// Encodes to a score of `wanted` points with one fit, if the session can do so for this picture.
    #[cfg(feature = "quality-hook")]
    fn at_quality(&mut self, _wanted: f64) -> Result<AtQuality> {
        Ok(AtQuality::Unknown)
    }

    /// Removes primitives as long as the squared error over the samples of all channels stays within `error`.
    fn prune(&mut self, _outcome: &mut Outcome, _error: f64) -> Result<()> {
        Ok(())
    }

    /// Returns whether [`trim_to_quality`](Self::trim_to_quality) can make this file smaller.
    #[cfg(feature = "quality-hook")]
    fn can_be_trimmed(&self, _outcome: &Outcome) -> bool {
        false
    }

    /// Removes the least important primitives as long as the score stays at or above `wanted`.
    #[cfg(feature = "quality-hook")]
    fn trim_to_quality(&mut self, _outcome: &mut Outcome, _wanted: f64) -> Result<()> {
        Ok(())
    }

    /// Adds the stored picture, whose squared error over the samples of all channels is `error`, as the last point of
    /// the trace.
    fn trace_end(&mut self, _splats: &PackedSplats, _error: f64) -> Result<()> {
        Ok(())
    }

    /// Returns the number of samples of the caller's picture.
    fn samples(&self) -> f64 {
        let blank = self.blank();
        f64::from(blank.width) * f64::from(blank.height) * self.channels().count() as f64
    }

    /// Returns the number of samples that are fitted.
    fn fitted_samples(&self) -> f64 {
        self.samples() / self.channels().count() as f64 * self.blank().channels.count() as f64
    }

    /// Returns whether all channels are fitted.
    fn fits_all_channels(&self) -> bool {
        self.channels() == self.blank().channels
    }

    /// Restores the channels of `splats` that were left out.
    fn widened(&self, splats: &PackedSplats) -> PackedSplats {
        if splats.channels == self.channels() { splats.clone() } else { widen(splats, self.channels()) }
    }

    /// Writes the file of `splats`, and restores the channels that were left out.
    fn file(&self, splats: &PackedSplats) -> Result<Vec<u8>> {
        widened_file(splats, self.channels())
    }

    /// Returns the size of a file without primitives, bytes.
    fn fixed(&self) -> Result<u64> {
        Ok(self.file(self.blank())?.len() as u64)
    }

    /// Returns Gaussians of one colour as the base of a detail layer, if their file takes at most `max_bytes`.
    fn flat_base(&mut self, splats: PackedSplats, max_bytes: u64) -> Result<Outcome> {
        let bytes = self.file(&splats)?;
        let needed = bytes.len() as u64;
        if needed > max_bytes {
            return Err(self.too_small(max_bytes, needed));
        }
        let float_error = self.fitted_error(&splats)?;
        Ok(Outcome { bytes, splats, float_error, quality: None, pruned_bytes: 0 })
    }

    /// Returns the error for a file of `allowed` bytes that needs `needed` bytes even without primitives.
    fn too_small(&self, allowed: u64, needed: u64) -> crate::Error {
        too_small_with(self.options(), allowed, needed)
    }
}

/// Converts a squared error over this many samples to a PSNR in decibels.
pub(super) fn decibels(error: f64, samples: f64) -> f64 {
    -10.0 * (error / samples).strict_log10()
}
