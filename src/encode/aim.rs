//! From what is asked for to a file of that kind: with how many primitives a fit begins, and how often one is tried.

use super::channels::widen;
use super::constant::{constant, is_constant};
use super::job::{Encoding, Outcome, decibels, stored_error};
use super::left_out::Omission;
use super::subject::{may_leave_out, too_small};
use super::thumbnail;
use crate::bitstream::splats::{Layout, Metadata, PackedSplats};
use crate::error::{Error, Result};
use crate::fit::model::target::planes::Planes;
use crate::gaussian::Blend;
use crate::options::{EncodeOptions, Needs};
use crate::round::size::Size;
use crate::target::Target;

/// Most primitives that an encode will fit.
pub(super) const MAX_PRIMITIVES: u64 = 16 << 20;

/// Ratio of [`Target::Auto`].
const RATIO: f64 = 50.0;

/// Estimated bits of a primitive in the coded layout, before any is coded.
pub(super) const CODED_BITS: f64 = 34.5;

/// Fewest bytes for primitives of [`Target::Auto`]: some twenty of them.
const LEAST: u64 = 80;

/// Returns the size of the file that is asked for; a file takes `fixed` bytes without primitives.
pub(super) fn size_asked(options: &EncodeOptions, samples: f64, fixed: u64) -> Size {
    match options.target {
        Target::Auto => {
            let length = |metadata: Option<&Vec<u8>>| metadata.map_or(0, |m| m.len() as u64);
            let metadata = length(options.icc.as_ref()) + length(options.exif.as_ref());
            Size::Bytes(((samples / RATIO) as u64 + metadata).max(fixed + LEAST))
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

impl Encoding<'_> {
    /// Fits the picture as the options ask.
    pub(super) fn aim(&mut self) -> Result<Outcome> {
        let fixed = self.subject.file(&self.subject.empty())?.len() as u64;
        let size = size_asked(self.subject.options, self.subject.samples(), fixed);
        if let Some(constant) = self.constant(size)? {
            return Ok(constant);
        }
        let mut outcome = match self.subject.options.target {
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
        let mut file = self.subject.empty();
        let all = self.subject.file(&file)?.len();
        file.metadata = Metadata::default();
        Ok((all - self.subject.file(&file)?.len()) as u64)
    }

    /// The file of a picture of one colour, where that is what there is and the file may be as large.
    fn constant(&mut self, size: Size) -> Result<Option<Outcome>> {
        let options = self.subject.options;
        let is_wanted = may_leave_out(options)
            && self.subject.blend() == Blend::Normalized
            && options.target != Target::Primitives(0);
        if !is_wanted || !is_constant(self.subject.pixels) {
            return Ok(None);
        }
        let mut splats = self.subject.empty();
        constant(&mut splats, self.planes.mean);
        let bytes = self.subject.file(&splats)?;
        if over(&bytes, size) > 0 {
            return Ok(None);
        }
        self.journal.note(Omission::Fit, 0, 0.0);
        let float_error = self.fitted_error(&splats);
        Ok(Some(Outcome { bytes, splats, float_error, quality: None }))
    }

    pub(super) fn at_size(&mut self, size: Size) -> Result<Outcome> {
        let Size::Bytes(most) = size else { return self.at_count(0, size) };
        let fixed = self.subject.file(&self.subject.empty())?.len() as u64;
        let count = count_for(self.subject.options, most, fixed, self.subject.samples())?;
        self.at_count(count, size)
    }

    /// Returns the squared error of the stored picture over the samples of the caller's channels.
    pub(super) fn whole_error(&self, splats: &PackedSplats) -> f64 {
        match self.subject.is_whole() {
            true => self.fitted_error(splats),
            false => {
                let wide = widen(splats, self.subject.channels());
                stored_error(
                    &wide,
                    &Planes::with_hidden(self.subject.original, self.subject.options.hidden),
                    self.subject.channels(),
                )
            }
        }
    }

    fn at_psnr(&mut self, wanted: f64) -> Result<Outcome> {
        let raw = self.subject.samples();
        // The search is over the bytes of the picture; those of the metadata are added.
        let carried = self.carried()?;
        let share = self.clock.left().map(|time| time / TIMED_PARTS);
        let mut bytes = (raw / 50.0).max(LEAST_TRIED);
        let mut best: Option<Outcome> = None;
        let mut reached: f64 = 0.0;
        // Last tries below and above the wanted PSNR: bytes a sample and decibels.
        let (mut below, mut above): (Option<[f64; 2]>, Option<[f64; 2]>) = (None, None);
        for _ in 0..TRIES {
            // A budget of time is that of all tries: one that begins late would be a worse fit, and say little.
            let left = self.clock.left();
            if reached > 0.0 && left < share.map(|s| s + s / 2) {
                break;
            }
            self.share = share;
            let outcome = self.layered(Size::Bytes(carried + bytes as u64))?;
            let got = decibels(self.whole_error(&outcome.splats), raw);
            reached = reached.max(got);
            if got >= wanted {
                above = Some([bytes / raw, got]);
                if best.as_ref().is_none_or(|b| outcome.bytes.len() < b.bytes.len()) {
                    best = Some(outcome);
                }
                if got - wanted < CLOSE {
                    break;
                }
            } else {
                below = Some([bytes / raw, got]);
            }
            bytes = match (below, above) {
                (Some(low), Some(high)) if high[0] / low[0] < 1.01 => break,
                (Some(low), Some(high)) => raw * between(low, high, wanted + CLOSE / 2.0),
                (Some(_), None) if bytes >= raw => break,
                (None, Some(_)) if bytes <= LEAST_TRIED => break,
                _ => {
                    let at = raw * bytes_at(expected(bytes / raw) + wanted - got + CLOSE / 2.0);
                    at.clamp(0.05 * bytes, 20.0 * bytes).min(raw).max(LEAST_TRIED)
                }
            };
        }
        let Some(mut best) = best else {
            let within = self.subject.options.time.map(|t| format!(" within {:.1} s", t.as_secs_f64()));
            let within = within.unwrap_or_default();
            let problem = format!("{wanted} dB cannot be reached{within}: the best fit has {reached:.2} dB");
            return Err(Error::Parameter { name: "psnr", problem });
        };
        // Where channels were left out, what they add to the error is not known here.
        if self.subject.options.needs == Needs::Measured && self.subject.is_whole() {
            self.prune(&mut best, raw * 10f64.powf(-0.1 * wanted))?;
        }
        Ok(best)
    }

    /// Fits a picture of `size` with about `count` primitives to begin with, and puts back what was left out.
    fn at_count(&mut self, count: usize, size: Size) -> Result<Outcome> {
        // Bytes that the constant channels may take; corrected if they are too few.
        let mut spare = match size {
            Size::Bytes(most) if !self.subject.is_whole() => 6 + most.min(1 << 30) / 400,
            _ => 0,
        };
        loop {
            let narrow = match size {
                Size::Bytes(most) => Size::Bytes(most.saturating_sub(spare)),
                Size::Free => Size::Free,
            };
            let mut outcome = self.fitted(count, narrow)?;
            if !self.subject.is_whole() {
                outcome.bytes = self.subject.file(&outcome.splats)?;
            }
            if self.subject.options.needs == Needs::Measured {
                let enough = self.subject.pixels.depth().rounding_error() * self.subject.fitted_samples();
                self.prune(&mut outcome, enough)?;
            }
            // Whatever a fit came to, it is not worse than one colour.
            let alone =
                PackedSplats { gaussians: Vec::new(), codebook: None, levels: Vec::new(), ..outcome.splats.clone() };
            let error = self.fitted_error(&outcome.splats);
            if error.is_nan() || error > self.fitted_error(&alone) {
                (outcome.bytes, outcome.splats) = (self.subject.file(&alone)?, alone);
            }
            let over = if self.base.is_some() { 0 } else { over(&outcome.bytes, size) };
            if over == 0 {
                return Ok(outcome);
            }
            if outcome.splats.gaussians.is_empty() {
                let needed = outcome.bytes.len() as u64;
                return Err(too_small(self.subject.options, needed - over, needed));
            }
            spare += over + 4;
        }
    }
}

/// Most tries of a search for a PSNR.
const TRIES: u32 = 6;
/// Parts of a budget of time: one for each of four tries, and one for taking out what is not needed. Most searches take no
/// more tries.
const TIMED_PARTS: u32 = 5;
/// Decibels above the wanted ones at which the search ends.
const CLOSE: f64 = 0.1;
/// Fewest bytes that the search tries, without those of metadata.
const LEAST_TRIED: f64 = 64.0;

/// Returns about the decibels that so many bytes a sample have beside those of other numbers. In small files doubling them wins 2.5 dB, and in large
/// ones each further bit of a sample wins 6: Kodak has 2.8 dB more at a ratio of 50 than at 100, and 4.7 more at 20.
fn expected(bytes: f64) -> f64 {
    2.5 * bytes.log2() + 6.0 * 8.0 * bytes
}

/// Returns the bytes a sample, up to 1, that have so many of these decibels.
fn bytes_at(decibels: f64) -> f64 {
    // Halves of what is left of 64 doublings.
    let (mut low, mut high) = (-64.0, 0.0f64);
    for _ in 0..40 {
        let middle = 0.5 * (low + high);
        if expected(middle.exp2()) < decibels { low = middle } else { high = middle }
    }
    high.exp2()
}

/// Returns the bytes a sample between two tries at which `wanted` decibels may be met.
fn between(low: [f64; 2], high: [f64; 2], wanted: f64) -> f64 {
    // Never next to either: decibels scatter by some tenths from fit to fit.
    let share = ((wanted - low[1]) / (high[1] - low[1])).clamp(0.1, 0.9);
    let [from, to] = [low, high].map(|at| expected(at[0]));
    bytes_at(from + share * (to - from))
}

/// Bytes by which a file is larger than it may be.
fn over(bytes: &[u8], size: Size) -> u64 {
    match size {
        Size::Bytes(most) => (bytes.len() as u64).saturating_sub(most),
        Size::Free => 0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_are_found_by_their_decibels() {
        for bytes in [1e-9, 0.003, 0.02, 0.1, 0.4, 1.0] {
            assert!((bytes_at(expected(bytes)) / bytes - 1.0).abs() < 1e-6, "{bytes}");
        }
        assert_eq!(bytes_at(1e9), 1.0);
        let found = between([0.02, 34.0], [0.05, 39.0], 36.0);
        assert!(found > 0.02 && found < 0.05, "{found}");
    }
}
