//! The state of an encode that all its steps share, and the values that they pass on.

use std::time::Duration;

use super::channels::widen;
use super::clock::Clock;
use super::device::Choice;
use super::input::{too_small_with, widened_file};
use super::report::ReportBuilder;
use crate::bitstream::splats::PackedSplats;
use crate::constants::allocation;
use crate::effort::EffortSettings;
use crate::error::Result;
use crate::fit::model::drawing::project::Primitive;
use crate::gaussian::Channels;
use crate::options::EncodeOptions;
use crate::rdo::size::Size;
use crate::strict_math::StrictMath;

/// The state of an encode, whether the picture is fitted as a whole or in tiles.
pub(super) struct EncodeState<'a> {
    pub options: &'a EncodeOptions,
    /// The settings of the effort.
    pub settings: EffortSettings,
    /// The channels of the file.
    pub channels: Channels,
    /// The integers of the fitted picture, without primitives and without the channels that were left out.
    pub blank: PackedSplats,
    /// The time budget.
    pub clock: Clock,
    /// The device that fits the picture.
    pub device: &'a Choice,
    pub report: ReportBuilder<'a>,
    /// Gaussians under a detail layer from an earlier try of a search.
    pub kept: Option<KeptBase>,
    /// The best factor on the byte budget of these Gaussians, once several were tried.
    pub base_factor: Option<f64>,
}

impl EncodeState<'_> {
    /// Returns the number of pixels.
    pub(super) fn pixels(&self) -> u64 {
        u64::from(self.blank.width) * u64::from(self.blank.height)
    }

    /// Returns the number of samples of the caller's picture.
    pub(super) fn samples(&self) -> f64 {
        self.pixels() as f64 * self.channels.count() as f64
    }

    /// Returns the number of samples that are fitted.
    pub(super) fn fitted_samples(&self) -> f64 {
        self.pixels() as f64 * self.blank.channels.count() as f64
    }

    /// Returns whether all channels are fitted.
    pub(super) fn fits_all_channels(&self) -> bool {
        self.channels == self.blank.channels
    }

    /// Restores the channels of `splats` that were left out.
    pub(super) fn widened(&self, splats: &PackedSplats) -> PackedSplats {
        if splats.channels == self.channels { splats.clone() } else { widen(splats, self.channels) }
    }

    /// Writes the file of `splats`, and restores the channels that were left out.
    pub(super) fn file(&self, splats: &PackedSplats) -> Result<Vec<u8>> {
        widened_file(splats, self.channels)
    }

    /// Returns the size of a file without primitives, bytes.
    pub(super) fn fixed(&self) -> Result<u64> {
        Ok(self.file(&self.blank)?.len() as u64)
    }

    /// Returns the error for a file of `allowed` bytes that needs `needed` bytes even without primitives.
    pub(super) fn too_small(&self, allowed: u64, needed: u64) -> crate::Error {
        too_small_with(self.options, allowed, needed)
    }
}

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
    /// Byte budget of the base before the sharpness adjustment.
    pub base_budget: f64,
}

impl KeptBase {
    /// Returns a copy of the base if it is as good as one of `budget` bytes and takes at most `max_bytes`.
    pub(super) fn for_budget(&self, budget: f64, max_bytes: f64) -> Option<Outcome> {
        let is_near = (budget / self.base_budget).strict_ln().abs() < allocation::MIN_BASE_GROWTH.strict_ln();
        (is_near && self.base.bytes.len() as f64 <= max_bytes).then(|| self.base.clone())
    }
}

/// One fit of Gaussians to the whole picture.
#[derive(Debug, Clone)]
pub(super) struct FitRequest {
    /// The initial number of primitives; `None` means the number that a file of `size` probably holds.
    pub count: Option<usize>,
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
    /// Size of the file with both layers, which the Gaussians must not exceed.
    pub max_bytes: u64,
    /// Ratio of the file with both layers, if fits of large files should be longer.
    pub ratio: Option<f64>,
    /// Factor on the iterations with perceptual tuning.
    pub patience: f32,
}

impl FitRequest {
    /// Requests a file of Gaussians alone.
    pub(super) fn alone(size: Size, time: Option<Duration>) -> Self {
        FitRequest { count: None, size, time, under_layer: None, initial: Vec::new() }
    }

    /// Requests a file of about `count` Gaussians alone.
    pub(super) fn of_count(count: usize) -> Self {
        FitRequest { count: Some(count), ..FitRequest::alone(Size::Free, None) }
    }
}

/// Converts a squared error over this many samples to a PSNR in decibels.
pub(super) fn decibels(error: f64, samples: f64) -> f64 {
    -10.0 * (error / samples).strict_log10()
}
