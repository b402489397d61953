//! Encodes a file whose bytes are divided between the Gaussians and the detail layer, as `division` decides. The
//! encoder can only recognize sharp pictures, which need more Gaussians, after it has fitted the smaller base. For
//! pages of text with photographs, it encodes several divisions and compares them.

use std::sync::Arc;
use std::time::Duration;

use super::texture::Texture;
use super::{Layered, division, layered_in_parts};
use crate::bitstream::splats::PackedSplats;
use crate::encode::drawn::drawn;
use crate::encode::input::stored_scene;
use crate::encode::session::{EncodeSession, FitRequest, KeptBase, MIN_BASE_GROWTH, Outcome, UnderLayer};
use crate::encode::whole::WholeSession;
use crate::error::Result;
use crate::fit::model::drawing::field::{Field, Output};
use crate::fit::model::drawing::project::Primitive;
use crate::fit::model::objective::rows::RowSet;
use crate::fit::model::placing::peaks;
use crate::fit::model::problem::{LARGE_PIXELS, Problem};
use crate::instant::Instant;
use crate::metrics;
use crate::options::{Detail, Tune};
use crate::raster::View;
use crate::round::rounded::projected;
use crate::round::size::Size;
use crate::strict_math::StrictMath;
use crate::target::Target;

/// Maximum number of pixels for which memory holds the whole residual, at about 30 bytes per pixel. For larger pictures
/// the encoder computes the residual one part at a time and fits the Gaussians only once.
pub(super) const LARGEST: u64 = 1 << 26;
/// Minimum gain of a larger base, in decibels, that justifies trying the largest one.
const MIN_GAIN: f64 = 0.22;
/// Bytes of the layer for which sharpness is measured, relative to those of the base. Findings at a ratio of 50 hold at
/// other ratios.
const MEASURED_LAYER: f64 = 1.9;
/// Maximum factor by which these Gaussians may exceed their byte budget.
const MAX_OVERSHOOT: f64 = 1.1;

/// Maximum ratio at which two rounds of descent follow the fit at efforts 4 to 6.
const MAX_RATIO_OF_TWO_ROUNDS: f64 = 30.0;
/// Factor on the bytes of the Gaussians from one try to the next, for pictures whose texture does not tell how many
/// they need.
const TRIED_CHANGE: f64 = 1.6;
/// Minimum factor between two tries.
const MIN_CHANGE: f64 = 1.12;
/// Minimum and maximum share of the Gaussians that is tried.
const MIN_TRIED_SHARE: f64 = 0.2;
const MAX_TRIED_SHARE: f64 = 0.82;
/// Maximum of 1 − MS-SSIM after a change of the division, relative to the value before, that justifies the change.
const MIN_IMPROVEMENT: f64 = 0.98;

/// A file whose bytes are divided between Gaussians and layer.
pub(super) struct Division {
    /// Size of header and metadata, bytes.
    pub fixed: u64,
    /// Bytes that Gaussians and layer share.
    pub shared: u64,
    /// The texture of the picture, if the division depends on it.
    pub texture: Option<Texture>,
    /// Maximum number of rounds in which the Gaussians are optimized under the layer.
    pub rounds: u32,
    /// The ratio of the file, if fits of large files should be longer.
    pub fit_ratio: Option<f64>,
    /// The deadline.
    pub until: Option<Instant>,
}

impl WholeSession<'_> {
    /// Encodes to a file of `size`, in which the Gaussians and the detail layer share the bytes. `time` is the part of
    /// the time budget that this file may take; `None` means all of the remaining time.
    pub(in crate::encode) fn layered(&mut self, size: Size, time: Option<Duration>) -> Result<Outcome> {
        let options = self.input.options;
        let alone = FitRequest::alone(size, time);
        let Size::Bytes(most) = size else { return self.gaussians_of_size(&alone) };
        // The size of header and metadata does not depend on the division.
        let fixed = self.fixed()?;
        let Some(shared) = most.checked_sub(fixed) else { return self.gaussians_of_size(&alone) };
        if self.range.is_some() {
            return self.over_flat(most);
        }
        let limit = self.clock.left().map(|left| time.map_or(left, |time| time.min(left)));
        let until = limit.and_then(|limit| Instant::now().checked_add(limit));
        // A search runs several fits, so it does not extend them for large files.
        let fit_ratio = (!is_search(options.target)).then(|| self.samples() / shared as f64);
        let division = |texture| Division { fixed, shared, texture, rounds: self.rounds(shared), fit_ratio, until };
        match options.detail {
            Detail::Share(share) => {
                let division = division(self.texture());
                let base = self.base((shared as f64 * share) as u64, &division, Vec::new())?;
                if self.pixels() > LARGEST {
                    return layered_in_parts(self, self.input.pixels, base, most);
                }
                let clock = self.report.seconds();
                let layered = self.layer(base, most)?;
                if layered.coded.is_none() {
                    // There is no room for a layer, so the Gaussians get all bytes.
                    return self.gaussians_of_size(&alone);
                }
                let outcome = self.joined(layered, most, division.rounds, until)?;
                self.report.stage("detail", clock);
                Ok(outcome)
            }
            _ if division::has_layer(options, self.pixels(), self.samples(), shared, || self.measured_texture()) => {
                self.divided(&division(self.texture()), &alone)
            }
            _ => self.gaussians_of_size(&alone),
        }
    }

    /// Encodes to a file of at most `most` bytes whose Gaussians are one colour under a detail layer.
    fn over_flat(&mut self, most: u64) -> Result<Outcome> {
        let base = self.flat_base(self.flat(), most)?;
        if self.pixels() > LARGEST {
            return layered_in_parts(self, self.input.pixels, base, most);
        }
        let layered = self.timed_layer(base, most)?;
        self.joined(layered, most, 0, None)
    }

    /// Returns the texture of the picture if the division of the bytes depends on it.
    pub(super) fn texture(&self) -> Option<Texture> {
        if self.input.options.favoured() == Tune::Iq { self.measured_texture() } else { None }
    }

    /// Returns the texture of the picture, which is measured once.
    pub(super) fn measured_texture(&self) -> Option<Texture> {
        *self.texture.get_or_init(|| Texture::of(&self.planes))
    }

    /// Returns the number of rounds in which the Gaussians' integers are optimized under the layer, in a file of
    /// `shared` bytes without header and metadata.
    pub(super) fn rounds(&self, shared: u64) -> u32 {
        let tune = self.input.options.favoured();
        match self.input.options.effort {
            1 => 0,
            2 if tune != Tune::Psnr => 0,
            // At 2.8 megapixels a round gains 0.05 and 0.14 SSIMULACRA2 points at ratios of 50 and 100, and takes 14 %
            // and 18 % of the time.
            2..=5 if tune != Tune::Psnr && self.pixels() >= LARGE_PIXELS => 0,
            2 | 3 => 1,
            4..=6 => match tune {
                // The second and the third round gain 0.01 dB each, too little to run them in every try of a search.
                Tune::Psnr if is_search(self.input.options.target) => 1,
                Tune::Psnr => 3,
                // At a ratio of 20 a second round gains 0.02 SSIMULACRA2 points on Kodak and 0.05 on CID22, and takes 4
                // and 7 % more time. In general it gains 0.1 points on Kodak and 0.01 at 2.8 megapixels, and takes 7 %
                // and 13 % of the time.
                Tune::Iq if self.samples() / shared as f64 <= MAX_RATIO_OF_TWO_ROUNDS => 2,
                Tune::Ssim | Tune::Iq => 1,
            },
            _ => 4,
        }
    }

    pub(super) fn pixels(&self) -> u64 {
        u64::from(self.planes.width) * u64::from(self.planes.height)
    }

    /// Fits Gaussians of `bytes` bytes, without header and metadata, as the base of a layer. The fit continues
    /// `initial` if there are any.
    pub(super) fn base(&mut self, bytes: u64, division: &Division, initial: Vec<Primitive>) -> Result<Outcome> {
        let time = base_time(self.input.options.effort, division.until);
        let ratio = division.fit_ratio;
        let patience = division::patience(self.input.options.effort, self.pixels(), division.texture, ratio);
        let under_layer = UnderLayer { ratio, patience };
        let size = Size::Bytes(division.fixed + bytes);
        self.gaussians_of_size(&FitRequest { size, time, under_layer: Some(under_layer), initial })
    }

    /// Codes a layer over `base` in a file of `most` bytes, and records the time.
    fn timed_layer(&mut self, base: Outcome, most: u64) -> Result<Layered> {
        let clock = self.report.seconds();
        let layered = self.layer(base, most)?;
        self.report.stage("detail", clock);
        Ok(layered)
    }

    /// Finds the division of the bytes and encodes the file. `alone` requests the same file without a layer.
    fn divided(&mut self, division: &Division, alone: &FitRequest) -> Result<Outcome> {
        let &Division { fixed, shared, texture, rounds, until, .. } = division;
        let (most, all) = (fixed + shared, shared as f64);
        let ratio = (self.samples() / all).max(20.0);
        let suited = division::base_bytes(self.input.options.effort, self.pixels(), texture, ratio, all);
        let few = (self.base_factor.unwrap_or(1.0) * suited).min(MAX_TRIED_SHARE * all);
        let most_for_base = division::most_for_base(ratio) * all;
        // A base that is kept from a larger file of a sharp picture can be too large for a smaller file.
        let room = fixed as f64 + (MAX_OVERSHOOT * most_for_base).min(division::MOST_SHARP * all);
        let kept = self.kept.as_ref().and_then(|kept| kept.for_budget(few, room));
        let is_new = kept.is_none();
        let base = kept.map_or_else(|| self.base(few as u64, division, Vec::new()), Ok)?;
        if self.pixels() > LARGEST {
            if is_new {
                self.keep(&base, few);
            }
            return layered_in_parts(self, self.input.pixels, base, most);
        }
        let mut layered = self.timed_layer(base, most)?;
        // With perceptual tuning the smaller base is equally good. A time budget is too short for several fits.
        let is_exact = self.input.options.favoured() == Tune::Psnr;
        let may_be_larger = is_new && is_exact && until.is_none() && most_for_base > MIN_BASE_GROWTH * few;
        let sharpness = if may_be_larger { self.sharpness(&layered, few * MEASURED_LAYER)? } else { Some(0.0) };
        let max_sharpness = division::max_sharpness(self.input.options.effort, ratio);
        if sharpness.is_none_or(|sharpness| sharpness > max_sharpness) {
            for bytes in [(few * most_for_base).sqrt(), most_for_base] {
                let initial = primitives_of(&layered.base.splats);
                let base = self.base(bytes as u64, division, initial)?;
                let mut other = self.timed_layer(base, most)?;
                let gain =
                    10.0 * (self.error_of_layered(&mut layered) / self.error_of_layered(&mut other)).strict_log10();
                if gain > 0.0 {
                    layered = other;
                }
                if gain.is_nan() || gain < MIN_GAIN {
                    break;
                }
            }
        }
        if layered.coded.is_none() {
            return self.gaussians_of_size(alone);
        }
        let mut base_budget = few;
        let is_uncertain = division::is_uncertain(self.input.options.effort, texture, ratio);
        if is_new && until.is_none() && self.base_factor.is_none() && is_uncertain {
            (layered, base_budget) = self.best_division(layered, few, division)?;
            // Further tries of a search use the same division.
            self.base_factor = Some(base_budget / few);
        }
        if is_new {
            self.keep(&layered.base, base_budget);
        }
        let clock = self.report.seconds();
        let outcome = self.joined(layered, most, rounds, until)?;
        self.report.stage("detail", clock);
        Ok(outcome)
    }

    /// Encodes with more and with fewer bytes for the Gaussians than the base of `first`, whose budget is `few` bytes, as
    /// long as MS-SSIM increases. Returns the best result and the budget of its base.
    pub(super) fn best_division(&mut self, first: Layered, few: f64, division: &Division) -> Result<(Layered, f64)> {
        let most = MAX_TRIED_SHARE * division.shared as f64;
        let Some(mut dissimilarity) = self.dissimilarity(&first)? else { return Ok((first, few)) };
        let mut best = (first, few);
        let (up, down) = (TRIED_CHANGE, 1.0 / TRIED_CHANGE);
        for change in if few * up < most { [up, down] } else { [down, up] } {
            let (mut bytes, mut is_better) = (few, false);
            loop {
                let next = (bytes * change).min(most);
                if (next / bytes).max(bytes / next) < MIN_CHANGE || next < MIN_TRIED_SHARE * most {
                    break;
                }
                bytes = next;
                let base = self.base(bytes as u64, division, Vec::new())?;
                let other = self.timed_layer(base, division.fixed + division.shared)?;
                match self.dissimilarity(&other)? {
                    Some(found) if found < MIN_IMPROVEMENT * dissimilarity => {
                        (best, dissimilarity, is_better) = ((other, bytes), found, true);
                    }
                    _ => break,
                }
            }
            if is_better {
                break;
            }
        }
        Ok(best)
    }

    /// Returns 1 minus the MS-SSIM of a picture. Returns `None` if it has no layer or is too small for MS-SSIM.
    fn dissimilarity(&self, layered: &Layered) -> Result<Option<f64>> {
        let Some(coded) = &layered.coded else { return Ok(None) };
        let mut splats = layered.base.splats.clone();
        splats.detail = Some(Arc::new(coded.layer.clone()));
        let drawn = drawn(&splats, &View::of_size(splats.width, splats.height), splats.depth)?;
        Ok(metrics::compare(self.input.pixels, &drawn)?.ms_ssim.map(|similarity| 1.0 - similarity))
    }

    /// Keeps the Gaussians for the next try if this is a search.
    fn keep(&mut self, base: &Outcome, base_budget: f64) {
        if is_search(self.input.options.target) {
            self.kept = Some(KeptBase { base: base.clone(), base_budget });
        }
    }

    /// Returns the sharpness of a picture: the estimated gain of more Gaussians relative to the gain of a larger layer.
    /// Returns `None` if there is no layer.
    fn sharpness(&self, layered: &Layered, bytes: f64) -> Result<Option<f64>> {
        let Some(coded) = &layered.coded else { return Ok(None) };
        let splats = &layered.base.splats;
        // All errors have equal weight here, whatever the tuning, because this distinguishes pictures best.
        let [finer, coarser] = self.two_steps(splats, coded, bytes);
        let decibels = 10.0 * (coarser[1] / finer[1]).strict_log10() / (finer[0] / coarser[0]).strict_log2();
        if !decibels.is_finite() {
            return Ok(None);
        }
        let estimated_gain = self.estimated_gain(splats);
        Ok(Some(estimated_gain / decibels.max(0.1)))
    }

    /// Returns the estimated fraction of the error of `splats` that doubling the number of Gaussians would remove.
    fn estimated_gain(&self, splats: &PackedSplats) -> f64 {
        let plain = self.planes.untuned();
        let problem = Problem { scene: stored_scene(splats), target: &plain };
        let drawn = projected(&splats.quantizer(), &splats.gaussians, splats.height);
        let mut field = Field::default();
        let error = field.draw(&problem, &drawn, RowSet::ALL, Output::Picture);
        let count = splats.gaussians.len();
        let peaks = peaks::peaks(&problem, &field, RowSet::ALL, count, count);
        peaks.iter().map(|peak| f64::from(peak.gain)).sum::<f64>() / error.max(f64::MIN_POSITIVE)
    }
}

/// Returns the time for the Gaussians under a layer, given when the encode should end. At effort 1, whose fit is short,
/// the layer takes a larger part of the time.
pub(in crate::encode) fn base_time(effort: u8, until: Option<Instant>) -> Option<Duration> {
    let share = if effort == 1 { 0.72 } else { 0.88 };
    until.map(|end| end.saturating_duration_since(Instant::now()).mul_f64(share))
}

/// Returns whether the encoder tries several sizes until the file reaches the requested quality.
pub(in crate::encode) fn is_search(target: Target) -> bool {
    match target {
        Target::Auto | Target::Ratio(_) | Target::Bytes(_) | Target::Primitives(_) | Target::Lossless => false,
        Target::Psnr(_) => true,
        #[cfg(feature = "quality-hook")]
        Target::Quality(_) => true,
    }
}

/// Converts the Gaussians of `splats` to primitives of a fit.
fn primitives_of(splats: &PackedSplats) -> Vec<Primitive> {
    let quantizer = splats.quantizer();
    splats.gaussians.iter().map(|g| Primitive::from_gaussian(&quantizer.dequantize(g))).collect()
}
