//! Divides the bytes of a file between the Gaussians and the detail layer.
//!
//! The best number of Gaussians depends on the picture and hardly on the requested file size. Gaussians represent large
//! shapes and edges; beyond those, the layer is cheaper. The Gaussians of photographs of 0.4 megapixels need about
//! 8 kB. Sharp pictures that resemble drawings need more, because additional Gaussians still reduce their error
//! quickly. The encoder can only recognize such pictures after it has fitted the smaller base.

use std::time::Duration;

use super::texture::Texture;
use super::{Layered, layered_in_parts};
use crate::bitstream::splats::{Layout, PackedSplats};
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
use crate::options::{Detail, EncodeOptions, Recipe, Tune};
use crate::round::rounded::projected;
use crate::round::size::Size;
use crate::strict_math::StrictMath;
use crate::target::Target;

/// Number of pixels of the pictures from which the values below were determined. They scale with powers of the number
/// of pixels relative to this.
const REFERENCE_PIXELS: f64 = 393_216.0;
/// Bytes of a base that suits most photographs. `--detail SHARE` sets other sizes.
const REFERENCE_BASE_BYTES: f64 = 8_200.0;
const BASE_POWER: f64 = 0.35;
/// Exponent with which these bytes decrease as the ratio, relative to 50, grows from 20 to 100.
const BASE_FALL: f64 = 0.37;
/// Factor on these bytes at effort 1, where short fits use bytes less efficiently than the layer.
const HASTY_BASE: f64 = 0.4;
/// Maximum share of the bytes for such a base.
const MAX_BASE_SHARE: f64 = 0.7;
/// Fineness from which on a photograph has a smaller base, by how much the factor on its bytes falls with the fineness,
/// and the smallest factor. These and the values below were fitted to 48 pictures at ratios of 50, 100 and 200, each
/// encoded with factors from 0.35 to 1.4 and without a layer (docs/studies/all-pictures.md).
const FINE_BASE: f64 = 0.6;
const FINE_BASE_FALL: f64 = 1.3;
const MIN_FINE_BASE: f64 = 0.5;
/// Ratios from which on that factor starts to apply, and at which it applies in full.
const FINE_BASE_RATIOS: [f64; 2] = [25.0, 100.0];
/// Activities at which a drawing starts to have a larger base and at which its factor is the largest, and that factor.
/// A page of text with photographs gains 4 SSIMULACRA2 points at a ratio of 50; simple diagrams would lose up to 1.
const BUSY_DRAWING: [f64; 2] = [2.9, 3.9];
const MAX_DRAWING_BASE: f64 = 1.4;
/// Shares of flat squares at which the fit of a picture under a layer starts to be longer and at which it is longest, and
/// the largest factor on its iterations. With twice the iterations, seven diagrams and pages gain 0.5 and 0.8 points at
/// ratios of 50 and 100, and take 1.4 to 1.6 times as long.
const PATIENT_FLAT: [f64; 2] = [0.1, 0.3];
const MAX_PATIENCE: f32 = 2.0;
/// Ratio above which files have no layer, unless the tuning is perceptual and the texture is known.
const MAX_RATIO: f64 = 120.0;
const RATIO_POWER: f64 = 0.85;
/// Fineness at which a layer is worth as much as the same bytes of Gaussians, for pictures of [`FINE_PIXELS`] at
/// [`FINE_RATIO`]. The first value is for effort 1, whose short fits under a layer use bytes less efficiently. The
/// second is for effort 2 and above. The ratio grows with the square of the fineness and with a power of the number of
/// pixels. At effort 1 and a ratio of 100, this rule finds the better choice for 18 of 19 pictures of CID22 and
/// graphics. At effort 3 and the same ratio, a layer gains 0.1 to 7.9 SSIMULACRA2 points on all of 14 pictures.
const FINE: [f64; 2] = [0.71, 0.42];
const FINE_RATIO: f64 = 100.0;
const FINE_PIXELS: f64 = 262_144.0;
const FINE_RATIO_POWER: f64 = 2.0 / 3.0;
/// Maximum ratio at which drawings of [`FINE_PIXELS`] have a layer from effort 2 on. At a ratio of 200, three diagrams
/// gain 4 to 6 points with a layer.
const DRAWING_RATIO: f64 = 250.0;
/// Ratio up to which texture does not rule out a layer.
const ALWAYS_RATIO: f64 = 80.0;
/// Minimum share of the bytes for the Gaussians of a large, busy picture at a ratio of 100, where the layer is coarse.
const BUSY_SHARE: f64 = 0.5;
/// Activities at which a picture starts to count as busy and at which it counts in full.
const BUSY: [f64; 2] = [2.9, 4.1];
/// Logarithm of the number of pixels, relative to [`REFERENCE_PIXELS`], at which that share applies in full.
const BUSY_SIZE: f64 = 1.9;
/// Maximum number of pixels for which memory holds the whole residual, at about 30 bytes per pixel. For larger pictures
/// the encoder computes the residual one part at a time and fits the Gaussians only once.
const LARGEST: u64 = 1 << 26;
/// Minimum size of a file with a layer, bytes.
const MIN_FILE_BYTES: u64 = 2_500;
/// Maximum sharpness of pictures for which a small base is best. Sharpness is the estimated fraction of the error that
/// doubling the number of Gaussians would remove, for each decibel that doubling the bytes of the layer gains. The new
/// Gaussians are placed where the error is largest.
const MAX_SHARPNESS: f64 = 0.105;
/// The same from effort 7 on. Of twelve pictures, one gains 0.1 dB at a ratio of 20 and 0.2 dB at 50, and five are
/// fitted again without a gain.
const MAX_SHARPNESS_TRIED: f64 = 0.085;
/// Exponent with which the maximum sharpness grows with the ratio relative to 20.
const SHARP_POWER: f64 = 0.1;
/// Minimum gain of a larger base, in decibels, that justifies trying the largest one.
const MIN_GAIN: f64 = 0.22;
/// Bytes of the layer for which sharpness is measured, relative to those of the base. Findings at a ratio of 50 hold at
/// other ratios.
const MEASURED_LAYER: f64 = 1.9;
/// Fraction of a time budget for the Gaussians.
pub(in crate::encode) const BASE_TIME: f64 = 0.6;
/// Share of the bytes for the Gaussians of a sharp picture at a ratio of 20, and the increase with each doubling of the
/// ratio.
const SHARP_SHARE: f64 = 0.6;
const SHARP_MORE: f64 = 0.15;
/// Maximum of that share.
const MOST_SHARP: f64 = 0.9;
/// Maximum factor by which these Gaussians may exceed their byte budget.
const MAX_OVERSHOOT: f64 = 1.1;

/// A file whose bytes are divided between Gaussians and layer.
struct Division {
    /// Size of header and metadata, bytes.
    fixed: u64,
    /// Bytes that Gaussians and layer share.
    shared: u64,
    /// The texture of the picture, if the division depends on it.
    texture: Option<Texture>,
    /// Maximum number of rounds in which the Gaussians are optimized under the layer.
    rounds: u32,
    /// The deadline.
    until: Option<Instant>,
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
        let may_have = options.layout == Layout::Coded && options.recipe == Recipe::Ssplat;
        let limit = self.clock.left().map(|left| time.map_or(left, |time| time.min(left)));
        let until = limit.and_then(|limit| Instant::now().checked_add(limit));
        let division = |texture| Division { fixed, shared, texture, rounds: self.rounds(), until };
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
            Detail::Auto if may_have => {
                let texture = self.texture();
                let largest = largest_ratio(options.effort, self.pixels(), texture);
                match is_worth_a_layer(self.samples(), shared, largest) {
                    true => self.divided(&division(texture), &alone),
                    false => self.gaussians_of_size(&alone),
                }
            }
            _ => self.gaussians_of_size(&alone),
        }
    }

    /// Returns the texture of the picture if the division of the bytes depends on it.
    fn texture(&self) -> Option<Texture> {
        if self.input.options.favoured() == Tune::Iq { Texture::of(&self.planes) } else { None }
    }

    /// Returns the number of rounds in which the Gaussians' integers are optimized under the layer.
    fn rounds(&self) -> u32 {
        let tune = self.input.options.favoured();
        match self.input.options.effort {
            1 => 0,
            2 if tune != Tune::Psnr => 0,
            // At 2.8 megapixels a round gains 0.05 and 0.14 SSIMULACRA2 points at ratios of 50 and 100, and takes 14 % and
            // 18 % of the time.
            2..=5 if tune != Tune::Psnr && self.pixels() >= LARGE_PIXELS => 0,
            2 | 3 => 1,
            4..=6 => match tune {
                // The second and the third round gain 0.01 dB each, too little to run them in every try of a search.
                Tune::Psnr if is_search(self.input.options.target) => 1,
                Tune::Psnr => 3,
                // A second round gains 0.1 SSIMULACRA2 points on Kodak and 0.01 at 2.8 megapixels, and takes 7 % and
                // 13 % of the time.
                Tune::Ssim | Tune::Iq => 1,
            },
            _ => 4,
        }
    }

    pub(super) fn pixels(&self) -> u64 {
        u64::from(self.planes.width) * u64::from(self.planes.height)
    }

    /// Fits Gaussians of `bytes` bytes, without header and metadata, as the base of a layer. The fit continues `initial`
    /// if there are any.
    fn base(&mut self, bytes: u64, division: &Division, initial: Vec<Primitive>) -> Result<Outcome> {
        let time = division.until.map(|end| end.saturating_duration_since(Instant::now()).mul_f64(BASE_TIME));
        let ratio = self.samples() / division.shared as f64;
        let under_layer = UnderLayer {
            // A search runs several fits, so it does not extend them for large files.
            ratio: (!is_search(self.input.options.target)).then_some(ratio),
            patience: division.texture.map_or(1.0, patience),
        };
        let size = Size::Bytes(division.fixed + bytes);
        self.gaussians_of_size(&FitRequest { size, time, under_layer: Some(under_layer), initial })
    }

    /// Finds the division of the bytes and encodes the file. `alone` requests the same file without a layer.
    fn divided(&mut self, division: &Division, alone: &FitRequest) -> Result<Outcome> {
        let &Division { fixed, shared, texture, rounds, until } = division;
        let (most, all) = (fixed + shared, shared as f64);
        let ratio = (self.samples() / all).max(20.0);
        // At effort 1, whose short fits use bytes less efficiently, it would lose 1.7 SSIMULACRA2 points on CLIC at 100.
        let may_be_busy = texture.filter(|_| self.input.options.effort > 1);
        let least = all * may_be_busy.map_or(0.0, |texture| busy_share(texture, self.pixels(), ratio));
        let suited = texture.map_or(1.0, |texture| base_factor(texture, ratio));
        let few = (suited * bytes_of_base(self.input.options.effort, self.pixels(), ratio, all))
            .min(MAX_BASE_SHARE * all)
            .max(least);
        let most_for_base = (SHARP_SHARE + SHARP_MORE * (ratio / 20.0).strict_log2()).min(MOST_SHARP) * all;
        // A base that is kept from a larger file of a sharp picture can be too large for a smaller file.
        let room = fixed as f64 + (MAX_OVERSHOOT * most_for_base).min(MOST_SHARP * all);
        let kept = self.kept.as_ref().and_then(|kept| kept.for_budget(few, room));
        let is_new = kept.is_none();
        let base = kept.map_or_else(|| self.base(few as u64, division, Vec::new()), Ok)?;
        if self.pixels() > LARGEST {
            if is_new {
                self.keep(&base, few);
            }
            return layered_in_parts(self, self.input.pixels, base, most);
        }
        let clock = self.report.seconds();
        let mut layered = self.layer(base, most)?;
        self.report.stage("detail", clock);
        // With perceptual tuning the smaller base is equally good. A time budget is too short for several fits.
        let is_exact = self.input.options.favoured() == Tune::Psnr;
        let may_be_larger = is_new && is_exact && until.is_none() && most_for_base > MIN_BASE_GROWTH * few;
        let sharpness = if may_be_larger { self.sharpness(&layered, few * MEASURED_LAYER)? } else { Some(0.0) };
        let least = if self.input.options.effort >= 7 { MAX_SHARPNESS_TRIED } else { MAX_SHARPNESS };
        if sharpness.is_none_or(|sharpness| sharpness > least * (ratio / 20.0).strict_powf(SHARP_POWER)) {
            for bytes in [(few * most_for_base).sqrt(), most_for_base] {
                let initial = primitives_of(&layered.base.splats);
                let base = self.base(bytes as u64, division, initial)?;
                let clock = self.report.seconds();
                let mut other = self.layer(base, most)?;
                self.report.stage("detail", clock);
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
        if is_new {
            self.keep(&layered.base, few);
        }
        let clock = self.report.seconds();
        let outcome = self.joined(layered, most, rounds, until)?;
        self.report.stage("detail", clock);
        Ok(outcome)
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
        let mut plain = self.planes.weighed(Vec::new());
        plain.channel_amplitude = [1.0; 4];
        let problem = Problem { scene: stored_scene(splats), target: &plain };
        let drawn = projected(&splats.quantizer(), &splats.gaussians, splats.height);
        let mut field = Field::default();
        let error = field.draw(&problem, &drawn, RowSet::ALL, Output::Picture);
        let count = splats.gaussians.len();
        let peaks = peaks::peaks(&problem, &field, RowSet::ALL, count, count);
        peaks.iter().map(|peak| f64::from(peak.gain)).sum::<f64>() / error.max(f64::MIN_POSITIVE)
    }
}

/// Returns whether the encoder tries several sizes until the file reaches the requested quality.
pub(in crate::encode) fn is_search(target: Target) -> bool {
    match target {
        Target::Auto | Target::Ratio(_) | Target::Bytes(_) | Target::Primitives(_) => false,
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

/// Returns the largest ratio at which a picture of `pixels` pixels gains from a layer. `texture` is known only with
/// perceptual tuning.
fn largest_ratio(effort: u8, pixels: u64, texture: Option<Texture>) -> f64 {
    let usual = MAX_RATIO * (pixels as f64 / REFERENCE_PIXELS).strict_powf(RATIO_POWER);
    let Some(texture) = texture else { return usual };
    let fine = FINE[usize::from(effort > 1)];
    let larger = (pixels as f64 / FINE_PIXELS).strict_powf(FINE_RATIO_POWER);
    let of_drawing = if effort > 1 && texture.is_drawing() { DRAWING_RATIO * larger } else { 0.0 };
    usual.min(ALWAYS_RATIO).max(FINE_RATIO * (texture.fineness / fine).powi(2) * larger).max(of_drawing)
}

/// Returns whether a picture of `samples` samples gains from a layer in a file of `bytes` bytes. `largest` is the
/// largest ratio at which the picture gains from one.
fn is_worth_a_layer(samples: f64, bytes: u64, largest: f64) -> bool {
    bytes >= MIN_FILE_BYTES && samples / bytes as f64 <= largest
}

/// Returns the byte budget of the Gaussians in a file of `all` bytes.
fn bytes_of_base(effort: u8, pixels: u64, ratio: f64, all: f64) -> f64 {
    let larger = pixels as f64 / REFERENCE_PIXELS;
    let haste = if effort == 1 { HASTY_BASE } else { 1.0 };
    (haste * REFERENCE_BASE_BYTES * larger.strict_powf(BASE_POWER) * (ratio.min(100.0) / 50.0).strict_powf(-BASE_FALL))
        .min(MAX_BASE_SHARE * all)
}

/// Returns the factor on the byte budget of the Gaussians that suits the texture of a picture. Gaussians represent fine
/// texture poorly.
fn base_factor(texture: Texture, ratio: f64) -> f64 {
    if texture.is_drawing() {
        let [from, to] = BUSY_DRAWING;
        return 1.0 + (MAX_DRAWING_BASE - 1.0) * ((texture.activity - from) / (to - from)).clamp(0.0, 1.0);
    }
    let [from, to] = FINE_BASE_RATIOS;
    let strength = ((ratio / from).strict_ln() / (to / from).strict_ln()).clamp(0.0, 1.0);
    let factor = (1.0 - FINE_BASE_FALL * (texture.fineness - FINE_BASE)).clamp(MIN_FINE_BASE, 1.0);
    1.0 - strength * (1.0 - factor)
}

/// Returns the factor on the iterations of a fit under a layer that suits the texture of a picture.
fn patience(texture: Texture) -> f32 {
    let [from, to] = PATIENT_FLAT;
    1.0 + (MAX_PATIENCE - 1.0) * ((texture.flat - from) / (to - from)).clamp(0.0, 1.0) as f32
}

/// Returns the minimum share of the bytes for the Gaussians of a picture with this texture, size and ratio.
fn busy_share(texture: Texture, pixels: u64, ratio: f64) -> f64 {
    let [from, to] = BUSY;
    let busy = ((texture.activity - from) / (to - from)).clamp(0.0, 1.0);
    let large = ((pixels as f64 / REFERENCE_PIXELS).strict_ln() / BUSY_SIZE).clamp(0.0, 1.0);
    BUSY_SHARE * busy * large * (ratio / 100.0).min(1.0)
}

/// Returns the byte budget of the Gaussians of a picture that is fitted in tiles, or `None` if the picture has no
/// layer. `shared` is the size of the file without header and metadata.
pub(in crate::encode) fn base_in_tiles(options: &EncodeOptions, pixels: u64, samples: f64, shared: u64) -> Option<u64> {
    let all = shared as f64;
    match options.detail {
        Detail::Share(share) => Some((all * share) as u64),
        Detail::Auto if is_worth_a_layer(samples, shared, largest_ratio(options.effort, pixels, None)) => {
            Some(bytes_of_base(options.effort, pixels, (samples / all).max(20.0), all) as u64)
        }
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PIXELS_OF_512: u64 = 512 * 512;

    fn texture(fineness: f64, activity: f64) -> Option<Texture> {
        Some(Texture { fineness, activity, flat: 0.0 })
    }

    #[test]
    fn fine_pictures_have_a_layer_at_larger_ratios_than_coarse_pictures() {
        let has = |effort, texture, ratio: u64| {
            let (samples, bytes) = (3 * PIXELS_OF_512, 3 * PIXELS_OF_512 / ratio);
            is_worth_a_layer(samples as f64, bytes, largest_ratio(effort, PIXELS_OF_512, texture))
        };
        let [coarse, fine] = [0.46, 1.2].map(|fineness| texture(fineness, 4.0));
        assert_eq!([50, 100, 200].map(|ratio| has(5, coarse, ratio)), [true, true, false]);
        assert_eq!([50, 100, 200].map(|ratio| has(5, fine, ratio)), [true, true, true]);
        assert_eq!([50, 100, 200].map(|ratio| has(1, coarse, ratio)), [true, false, false]);
        assert_eq!([50, 100, 200].map(|ratio| has(1, None, ratio)), [true, false, false]);
        // Files below the minimum size have no layer, whatever the picture.
        assert!(!has(5, texture(9.0, 4.0), 400));
        // Larger pictures gain from a layer at larger ratios.
        assert!(largest_ratio(5, 10 * PIXELS_OF_512, coarse) > 4.0 * largest_ratio(5, PIXELS_OF_512, coarse));
    }

    #[test]
    fn gaussians_get_a_larger_share_of_small_files_of_large_busy_pictures() {
        let share = |activity, pixels, ratio| busy_share(texture(0.5, activity).unwrap(), pixels, ratio);
        let large = 7 * REFERENCE_PIXELS as u64;
        assert_eq!(share(5.0, large, 100.0), BUSY_SHARE);
        assert_eq!(share(5.0, large, 50.0), BUSY_SHARE / 2.0);
        assert_eq!([share(2.0, large, 100.0), share(5.0, REFERENCE_PIXELS as u64, 100.0)], [0.0; 2]);
        let half = share(3.5, large, 200.0);
        assert!((half - BUSY_SHARE / 2.0).abs() < 1e-9, "{half}");
    }
}
