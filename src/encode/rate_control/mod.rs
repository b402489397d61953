//! Rate control: converts the target of an encode to file sizes and initial numbers of primitives.

mod psnr;
#[cfg(feature = "quality")]
mod quality;
mod search;

use super::channels::widen;
use super::constant::{constant, is_constant};
use super::input::{may_leave_out, too_small};
use super::job::{EncodeSession, Outcome, stored_error};
use super::skipped::SkipReason;
use super::thumbnail;
use crate::bitstream::splats::{Layout, Metadata, PackedSplats};
use crate::error::Result;
use crate::fit::model::objective::planes::Planes;
use crate::gaussian::Blend;
use crate::options::{EncodeOptions, Needs};
use crate::round::size::Size;
use crate::strict_math::StrictMath;
use crate::target::Target;

/// Most primitives that an encode will fit.
pub(super) const MAX_PRIMITIVES: u64 = 16 << 20;

/// Ratio of [`Target::Auto`].
const AUTO_RATIO: f64 = 50.0;

/// Estimated bits of a primitive in the coded layout, before any is coded.
pub(super) const CODED_BITS: f64 = 34.5;

/// Fewest bytes for primitives of [`Target::Auto`]: some twenty of them.
const MIN_AUTO_BYTES: u64 = 80;

/// Returns the size of the file that is asked for; a file takes `fixed` bytes without primitives.
pub(super) fn size_asked(options: &EncodeOptions, samples: f64, fixed: u64) -> Size {
    match options.target {
        Target::Auto => {
            let length = |metadata: Option<&Vec<u8>>| metadata.map_or(0, |m| m.len() as u64);
            let metadata = length(options.icc.as_ref()) + length(options.exif.as_ref());
            Size::Bytes(((samples / AUTO_RATIO) as u64 + metadata).max(fixed + MIN_AUTO_BYTES))
        }
        Target::Ratio(ratio) => Size::Bytes((samples / ratio).floor() as u64),
        Target::Bytes(bytes) => Size::Bytes(bytes),
        Target::Primitives(_) | Target::Psnr(_) => Size::Free,
        #[cfg(feature = "quality")]
        Target::Quality(_) => Size::Free,
    }
}

/// Returns the number of primitives that a fit begins with, for a file of `most` bytes that takes `fixed` without any.
///
/// # Errors
/// [`Error::TooSmall`] if there is no room for any.
pub(super) fn count_for(options: &EncodeOptions, most: u64, fixed: u64, samples: f64) -> Result<usize> {
    if most < fixed {
        return Err(too_small(options, most, fixed));
    }
    // Estimated bits of a primitive; the size is corrected while the integers are rounded.
    let bits = match options.layout {
        Layout::Packed => 56.0,
        Layout::Planes => 46.0,
        Layout::Coded => CODED_BITS,
    };
    let count = ((most - fixed) as f64 * 8.0 / bits) as u64;
    // More primitives than samples bring nothing.
    Ok(count.min(MAX_PRIMITIVES).min(samples as u64) as usize)
}

impl EncodeSession<'_> {
    /// Fits the picture as the options ask.
    pub(super) fn aim(&mut self) -> Result<Outcome> {
        let fixed = self.input.file(&self.input.empty())?.len() as u64;
        let size = size_asked(self.input.options, self.input.samples(), fixed);
        if let Some(constant) = self.constant(size)? {
            return Ok(constant);
        }
        let mut outcome = match self.input.options.target {
            Target::Auto | Target::Ratio(_) | Target::Bytes(_) => {
                let (beside, room) = self.beside_thumbnail(size);
                self.layered(beside).map_err(|e| thumbnail::counted(e, size, room))?
            }
            Target::Primitives(count) => self.at_count(count as usize, size)?,
            Target::Psnr(psnr) => self.at_psnr(psnr)?,
            #[cfg(feature = "quality")]
            Target::Quality(quality) => self.at_quality(quality)?,
        };
        self.add_thumbnail(&mut outcome, size)?;
        Ok(outcome)
    }

    /// Returns the bytes that ICC profile and EXIF block take in the file.
    pub(super) fn carried(&self) -> Result<u64> {
        let mut file = self.input.empty();
        let all = self.input.file(&file)?.len();
        file.metadata = Metadata::default();
        Ok((all - self.input.file(&file)?.len()) as u64)
    }

    /// The file of a picture of one colour, where that is what there is and the file may be as large.
    fn constant(&mut self, size: Size) -> Result<Option<Outcome>> {
        let options = self.input.options;
        let is_wanted = may_leave_out(options)
            && self.input.blend() == Blend::Normalized
            && options.target != Target::Primitives(0);
        if !is_wanted || !is_constant(self.input.pixels) {
            return Ok(None);
        }
        let mut splats = self.input.empty();
        constant(&mut splats, self.planes.mean);
        let bytes = self.input.file(&splats)?;
        if over(&bytes, size) > 0 {
            return Ok(None);
        }
        self.report.note(SkipReason::Fit, 0, 0.0);
        let float_error = self.fitted_error(&splats);
        Ok(Some(Outcome { bytes, splats, float_error, quality: None }))
    }

    pub(super) fn at_size(&mut self, size: Size) -> Result<Outcome> {
        let Size::Bytes(most) = size else { return self.at_count(0, size) };
        let fixed = self.input.file(&self.input.empty())?.len() as u64;
        let count = count_for(self.input.options, most, fixed, self.input.samples())?;
        self.at_count(count, size)
    }

    /// Returns the squared error of the stored picture over the samples of the caller's channels.
    pub(super) fn whole_error(&self, splats: &PackedSplats) -> f64 {
        match self.input.is_whole() {
            true => self.fitted_error(splats),
            false => {
                let wide = widen(splats, self.input.channels());
                stored_error(
                    &wide,
                    &Planes::with_hidden(self.input.original, self.input.options.hidden),
                    self.input.channels(),
                )
            }
        }
    }

    /// Fits a picture of `size` with about `count` primitives to begin with, and puts back what was left out.
    fn at_count(&mut self, count: usize, size: Size) -> Result<Outcome> {
        // Bytes that the constant channels may take; corrected if they are too few.
        let mut spare = match size {
            Size::Bytes(most) if !self.input.is_whole() => 6 + most.min(1 << 30) / 400,
            _ => 0,
        };
        loop {
            let narrow = match size {
                Size::Bytes(most) => Size::Bytes(most.saturating_sub(spare)),
                Size::Free => Size::Free,
            };
            let mut outcome = self.fitted(count, narrow)?;
            if !self.input.is_whole() {
                outcome.bytes = self.input.file(&outcome.splats)?;
            }
            if self.input.options.needs == Needs::Measured {
                let enough = self.input.pixels.depth().rounding_error() * self.input.fitted_samples();
                self.prune(&mut outcome, enough)?;
            }
            // Whatever a fit came to, it is not worse than one colour.
            let alone =
                PackedSplats { gaussians: Vec::new(), codebook: None, levels: Vec::new(), ..outcome.splats.clone() };
            let error = self.fitted_error(&outcome.splats);
            if error.is_nan() || error > self.fitted_error(&alone) {
                (outcome.bytes, outcome.splats) = (self.input.file(&alone)?, alone);
            }
            let over = if self.base.is_some() { 0 } else { over(&outcome.bytes, size) };
            if over == 0 {
                return Ok(outcome);
            }
            if outcome.splats.gaussians.is_empty() {
                let needed = outcome.bytes.len() as u64;
                return Err(too_small(self.input.options, needed - over, needed));
            }
            spare += over + 4;
        }
    }
}

/// Minimum size that a search tries, bytes without metadata.
const MIN_TRIED_BYTES: f64 = 64.0;
/// Maximum size that a search tries, as a multiple of the raw bytes: noise takes more than the raw bytes.
const MAX_TRIED: f64 = 2.0;
/// The maximum for pictures of a few pixels, bytes.
const MAX_TRIED_BYTES: f64 = 512.0;

/// Returns the smallest and the largest size that a search tries for a picture of `raw` samples: binary logarithms of bytes a
/// sample.
fn sizes_tried(raw: f64) -> [f64; 2] {
    [MIN_TRIED_BYTES, (MAX_TRIED * raw).max(MAX_TRIED_BYTES)].map(|bytes| (bytes / raw).strict_log2())
}

/// Bytes by which a file is larger than it may be.
fn over(bytes: &[u8], size: Size) -> u64 {
    match size {
        Size::Bytes(most) => (bytes.len() as u64).saturating_sub(most),
        Size::Free => 0,
    }
}
