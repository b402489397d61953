//! Allocates the bytes of a file to the Gaussians and the detail layer. All constants of this decision are in this file.
//!
//! | picture and options | allocation |
//! |---|---|
//! | no size is requested, or a file without primitives is larger than the requested size | Gaussians alone |
//! | 16-bit samples within a narrow range | one colour, and a detail layer with all other bytes |
//! | another layout or method, `Detail::Off`, or not [worth a layer](LayerGain) | Gaussians alone |
//! | a small file that [may gain from a layer](LayerGain::Uncertain) | the better of both |
//! | `Detail::GaussianShare` | that share for the Gaussians, the rest for the layer |
//! | otherwise | [`base_bytes`] for the Gaussians, the rest for the layer |
//!
//! The best number of Gaussians depends on the picture and hardly on the requested file size. Gaussians represent large
//! shapes and edges; beyond those, the layer is cheaper. The Gaussians of photographs of 0.4 megapixels need about
//! 8 kB. Sharp pictures that resemble drawings need more, because additional Gaussians still reduce their error
//! quickly.
//!
//! `python lab/fit_division.py PICTURES PROGRAM` encodes sets of pictures with several divisions, fits the constants of
//! the rule for photographs to the results, and writes a table of what each picture would have had.

use std::ops::RangeInclusive;
use std::time::Duration;

use super::prepared::Prepared;
use super::state::{EncodeState, FitRequest, KeptBase, Outcome, UnderLayer};
use super::texture::{self, Texture};
use crate::bitstream::splats::Layout;
use crate::effort::{AllocationSettings, EffortSettings};
use crate::error::Result;
use crate::fit::model::drawing::project::Primitive;
use crate::fit::model::problem::LARGE_PIXELS;
use crate::instant::Instant;
use crate::metrics::MIN_MS_SSIM_SIDE;
use crate::options::{Detail, EncodeOptions, Tune};
use crate::rdo::size::Size;
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
const BUSY_DRAWING: [f64; 2] = [texture::BUSY, 3.9];
const MAX_DRAWING_BASE: f64 = 1.4;
/// Shares of flat squares at which the fit of a picture under a layer starts to be longer and at which it is longest,
/// and the largest factor on its iterations. With twice the iterations, seven diagrams and pages gain 0.5 and 0.8
/// points at ratios of 50 and 100, and take 1.4 to 1.6 times as long.
const PATIENT_FLAT: [f64; 2] = [texture::PARTLY_DRAWN, texture::DRAWING];
const MAX_PATIENCE: f32 = 2.0;
/// Factors on the iterations of the fits of other small pictures under a layer, at ratios of 10, 20, 50 and 100, at
/// efforts 4 to 6. Between the ratios they depend on the logarithm of the ratio. At 20, 1.6 gains 0.15 points on Kodak
/// and on CID22 and takes a quarter more time; 2 gains nothing more. At 10, 2 would gain
/// 0.06 points on Kodak and take 1.4 times as long. At 100, 0.8 loses 0.2 and 0.0 points and saves a seventh of the
/// time. At 2.8 megapixels, 1.6 at 20 would gain 0.05 points and 0.8 at 100 lose 0.1.
const PATIENT_RATIOS: [f64; 4] = [10.0, 20.0, 50.0, 100.0];
const PATIENCE_AT: [f64; 4] = [1.0, 1.6, 1.0, 0.8];
/// Maximum ratio at which several divisions are tried for mixed pictures. At 200, MS-SSIM prefers divisions that lose
/// SSIMULACRA2.
const MAX_TRYING_RATIO: f64 = 120.0;
/// Ratio above which files have no layer, unless the tuning is perceptual and the texture is known.
const MAX_RATIO: f64 = 120.0;
const RATIO_POWER: f64 = 0.85;
/// Ratio and number of pixels for which the settings of the effort state the [fineness](AllocationSettings::fineness) of
/// pictures with a layer. The ratio grows with the square of the fineness and with a power of the number of pixels.
const FINE_RATIO: f64 = 100.0;
const FINE_PIXELS: f64 = 262_144.0;
const FINE_RATIO_POWER: f64 = 2.0 / 3.0;
/// Maximum ratio at which drawings of [`FINE_PIXELS`] have a layer. At a ratio of 200, three diagrams gain 4 to 6
/// points with a layer.
const DRAWING_RATIO: f64 = 250.0;
/// Ratio up to which texture does not rule out a layer.
const ALWAYS_RATIO: f64 = 80.0;
/// Minimum share of the bytes for the Gaussians of a large, busy picture at a ratio of 100, where the layer is coarse.
const BUSY_SHARE: f64 = 0.5;
/// Activities at which a picture starts to count as busy and at which it counts in full.
const BUSY: [f64; 2] = [texture::BUSY, 4.1];
/// Logarithm of the number of pixels, relative to [`REFERENCE_PIXELS`], at which that share applies in full.
const BUSY_SIZE: f64 = 1.9;
/// Minimum size of a file with a layer, bytes.
const MIN_FILE_BYTES: u64 = 2_500;
/// Numbers of pixels of small pictures. If their texture is known, their files may be smaller. The values for them are from
/// crops and thumbnails of 192 to 320 pixels at 600 to 4000 bytes (docs/studies/division.md). Still smaller ones, which
/// have no MS-SSIM, keep the usual minimum: at 1200 bytes, photographs of CID22 reduced to 96 pixels lose 1.5 points with
/// a layer.
const SMALL_PIXELS: RangeInclusive<u64> = 161 * 161..=1 << 17;
/// Minimum size of a file with a layer for small pictures.
const MIN_SMALL_FILE_BYTES: u64 = 700;
/// Minimum size of a file for which a layer is tried, and up to which multiple of the largest ratio, for small pictures. A
/// file without a layer takes five times as long as one with a layer, so a try takes a fifth more time.
const MIN_TRIED_FILE_BYTES: u64 = 400;
const TRIED_RATIO: f64 = 2.0;
/// Maximum ratio of small pictures with a layer. Those that were measured have up to 205.
const MAX_SMALL_RATIO: f64 = 250.0;
/// The same for regular textures, and the share of the bytes for their Gaussians. At 600 and 1200 bytes, a weave, stripes
/// and a checkerboard of 128 × 128 pixels gain 29 to 174 SSIMULACRA2 points over Gaussians alone.
/// `python lab/division.py target/release/ssplat PICTURES... --sizes 600,1200` measures it.
const MIN_REGULAR_FILE_BYTES: u64 = 200;
const REGULAR_SHARE: f64 = 0.05;
/// Exponent with which the maximum sharpness grows with the ratio relative to 20.
const SHARP_POWER: f64 = 0.1;
/// Share of the bytes for the Gaussians of a sharp picture at a ratio of 20, and the increase with each doubling of the
/// ratio.
const SHARP_SHARE: f64 = 0.6;
const SHARP_MORE: f64 = 0.15;
/// Maximum of that share.
const MOST_SHARP: f64 = 0.9;
/// Maximum factor by which the Gaussians of a sharp picture may exceed their byte budget.
const MAX_OVERSHOOT: f64 = 1.1;
/// Maximum share of the bytes for Gaussians that are tried.
pub(super) const MAX_TRIED_SHARE: f64 = 0.82;
/// Maximum ratio of large files, which have more rounds of descent.
const MAX_RATIO_OF_LARGE_FILES: f64 = 30.0;

/// What a file of a requested size consists of.
pub(super) enum Allocation {
    /// Gaussians alone.
    Gaussians(FitRequest),
    /// One colour under a detail layer, in a file of at most this many bytes.
    OneColor(u64),
    /// Gaussians and a detail layer.
    Shared(Division),
}

/// A file whose bytes are divided between Gaussians and layer.
pub(super) struct Division {
    /// Size of header and metadata, bytes.
    pub fixed: u64,
    /// Bytes that Gaussians and layer share.
    pub shared: u64,
    /// Byte budget of the Gaussians.
    pub base_budget: f64,
    /// The texture of the picture, if the division depends on it.
    pub texture: Option<Texture>,
    /// Maximum number of rounds in which the Gaussians are optimized under the layer.
    pub rounds: u32,
    /// The ratio of the file, if fits of large files should be longer.
    pub fit_ratio: Option<f64>,
    /// The deadline.
    pub until: Option<Instant>,
    /// Whether Gaussians alone may be better than this division.
    pub is_uncertain: bool,
}

/// Whether a picture gains from a detail layer in a file of a size.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum LayerGain {
    None,
    /// Only encodes with and without a layer tell.
    Uncertain,
    Certain,
}

impl Division {
    /// Returns the size of the file, bytes.
    pub(super) fn max_bytes(&self) -> u64 {
        self.fixed + self.shared
    }

    /// Returns the ratio of the file, at least 20.
    pub(super) fn ratio(&self, samples: f64) -> f64 {
        ratio_of(samples, self.shared as f64)
    }

    /// Requests Gaussians of `bytes` bytes, without header and metadata, as the base of the layer. The fit continues
    /// `initial` if there are any.
    pub(super) fn base_request(&self, state: &EncodeState<'_>, bytes: u64, initial: Vec<Primitive>) -> FitRequest {
        let ratio = self.fit_ratio;
        let patience = patience(&state.settings.allocation, state.pixels(), self.texture, ratio);
        let under_layer = UnderLayer { max_bytes: self.max_bytes(), ratio, patience };
        let share = state.settings.fit.base.time_share;
        let time = self.until.map(|end| end.saturating_duration_since(Instant::now()).mul_f64(share));
        let size = Size::Bytes(self.fixed + bytes);
        FitRequest { count: None, size, time, under_layer: Some(under_layer), initial }
    }

    /// Requests a file of the same size without a layer.
    pub(super) fn request_without_layer(&self) -> FitRequest {
        let time = self.until.map(|end| end.saturating_duration_since(Instant::now()));
        FitRequest::alone(Size::Bytes(self.max_bytes()), time)
    }

    /// Returns the Gaussians of an earlier try of a search if they suit this file.
    pub(super) fn kept_base(&self, state: &EncodeState<'_>) -> Option<Outcome> {
        let all = self.shared as f64;
        // A base that is kept from a larger file of a sharp picture can be too large for a smaller file.
        let most_for_base = most_for_base(self.ratio(state.samples())) * all;
        let room = self.fixed as f64 + (MAX_OVERSHOOT * most_for_base).min(MOST_SHARP * all);
        state.kept.as_ref().and_then(|kept| kept.for_budget(self.base_budget, room))
    }
}

/// Keeps Gaussians for the next try if this is a search that chooses their share.
pub(super) fn keep(state: &mut EncodeState<'_>, base: &Outcome, base_budget: f64) {
    if is_search(state.options.target) && state.options.detail == Detail::Auto {
        state.kept = Some(KeptBase { base: base.clone(), base_budget });
    }
}

/// Allocates the bytes of a file of `size`. `time` is the part of the time budget that this file may take; `None` means
/// all of the remaining time.
pub(super) fn allocate(prepared: &Prepared<'_>, size: Size, time: Option<Duration>) -> Result<Allocation> {
    let state = prepared.state();
    let options = state.options;
    let alone = Allocation::Gaussians(FitRequest::alone(size, time));
    let Size::Bytes(max_bytes) = size else { return Ok(alone) };
    // The size of header and metadata does not depend on the allocation.
    let fixed = state.fixed()?;
    let Some(shared) = max_bytes.checked_sub(fixed) else { return Ok(alone) };
    if prepared.has_narrow_range() {
        return Ok(Allocation::OneColor(max_bytes));
    }
    let (pixels, samples, all) = (state.pixels(), state.samples(), shared as f64);
    let gain = layer_gain(options, pixels, samples, shared, || prepared.measured_texture());
    let may_try = state.settings.allocation.tries_divisions && !is_search(options.target);
    let limit = state.clock.left().map(|left| time.map_or(left, |time| time.min(left)));
    let may_try = may_try && limit.is_none() && state.blank.width.min(state.blank.height) >= MIN_MS_SSIM_SIDE;
    if gain == LayerGain::None || gain == LayerGain::Uncertain && !may_try {
        return Ok(alone);
    }
    let texture = texture(options, || prepared.measured_texture());
    Ok(Allocation::Shared(Division {
        fixed,
        shared,
        base_budget: base_budget(state, texture, all),
        texture,
        rounds: rounds(state, shared),
        // A search runs several fits, so it does not extend them for large files.
        fit_ratio: (!is_search(options.target)).then(|| samples / all),
        until: limit.and_then(|limit| Instant::now().checked_add(limit)),
        is_uncertain: gain == LayerGain::Uncertain,
    }))
}

/// Returns the number of rounds in which the Gaussians' integers are optimized under the layer, in a file of
/// `shared` bytes without header and metadata.
pub(super) fn rounds(state: &EncodeState<'_>, shared: u64) -> u32 {
    let rounds = state.settings.layer.rounds;
    match state.options.favoured() {
        Tune::Psnr => rounds.exact[usize::from(is_search(state.options.target))],
        _ if state.pixels() >= LARGE_PIXELS && !rounds.includes_large_pictures => 0,
        Tune::Iq if state.samples() / shared as f64 <= MAX_RATIO_OF_LARGE_FILES => rounds.in_large_files,
        Tune::Ssim | Tune::Iq => rounds.perceptual,
    }
}

/// Returns whether the Gaussians' integers are optimized under the layer.
pub(super) fn has_rounds(state: &EncodeState<'_>) -> bool {
    // The number of rounds depends on the size of the file, but not whether there are any.
    rounds(state, 1) > 0
}

/// Returns whether the encoder tries several sizes until the file reaches the requested quality.
pub(super) fn is_search(target: Target) -> bool {
    match target {
        Target::Auto | Target::Ratio(_) | Target::Bytes(_) | Target::Primitives(_) | Target::Lossless => false,
        Target::Psnr(_) => true,
        #[cfg(feature = "quality-hook")]
        Target::Quality(_) => true,
    }
}

/// Returns the ratio of a file of `bytes` bytes, at least 20.
pub(super) fn ratio_of(samples: f64, bytes: f64) -> f64 {
    (samples / bytes).max(20.0)
}

/// Returns the byte budget of the Gaussians in a file of `all` bytes, by the options or by [`base_bytes`] and what a search
/// has found. `texture` is that on which the allocation depends (`fn texture`).
pub(super) fn base_budget(state: &EncodeState<'_>, texture: Option<Texture>, all: f64) -> f64 {
    match state.options.detail {
        Detail::GaussianShare(share) => all * share,
        _ => {
            let ratio = ratio_of(state.samples(), all);
            let suited = base_bytes(&state.settings.allocation, state.pixels(), texture, ratio, all);
            (state.base_factor.unwrap_or(1.0) * suited).min(MAX_TRIED_SHARE * all)
        }
    }
}

/// Returns the byte budget of the Gaussians that suits a file of `all` bytes. `texture` is that on which the allocation
/// depends (`fn texture`).
fn base_bytes(settings: &AllocationSettings, pixels: u64, texture: Option<Texture>, ratio: f64, all: f64) -> f64 {
    if texture.is_some_and(Texture::is_regular) {
        return REGULAR_SHARE * all;
    }
    let may_be_busy = texture.filter(|_| settings.has_busy_share);
    let least = all * may_be_busy.map_or(0.0, |texture| busy_share(texture, pixels, ratio));
    let suited = texture.map_or(1.0, |texture| base_factor(texture, ratio));
    (suited * bytes_of_base(settings, pixels, ratio, all)).min(MAX_BASE_SHARE * all).max(least)
}

/// Returns the share of the bytes for the Gaussians of a sharp picture.
pub(super) fn most_for_base(ratio: f64) -> f64 {
    (SHARP_SHARE + SHARP_MORE * (ratio / 20.0).strict_log2()).min(MOST_SHARP)
}

/// Returns the maximum sharpness at which a small base is best. Sharpness is the estimated fraction of the error that
/// doubling the number of Gaussians would remove, for each decibel that doubling the bytes of the layer gains. The new
/// Gaussians are placed where the error is largest.
pub(super) fn max_sharpness(settings: &AllocationSettings, ratio: f64) -> f64 {
    settings.max_sharpness * (ratio / 20.0).strict_powf(SHARP_POWER)
}

/// Returns the largest ratio at which a picture of `pixels` pixels gains from a layer. `texture` is that on which the
/// allocation depends (`fn texture`).
fn largest_ratio(settings: &AllocationSettings, pixels: u64, texture: Option<Texture>) -> f64 {
    let usual = MAX_RATIO * (pixels as f64 / REFERENCE_PIXELS).strict_powf(RATIO_POWER);
    let Some(texture) = texture else { return usual };
    let larger = (pixels as f64 / FINE_PIXELS).strict_powf(FINE_RATIO_POWER);
    let fine = settings.fineness[usize::from(pixels >= LARGE_PIXELS)];
    let of_drawing = if texture.is_drawing() { DRAWING_RATIO * larger } else { 0.0 };
    usual.min(ALWAYS_RATIO).max(FINE_RATIO * (texture.fineness / fine).powi(2) * larger).max(of_drawing)
}

/// Returns whether a picture of `samples` samples gains from a layer in a file of `bytes` bytes. `largest` is the
/// largest ratio at which the picture gains from one. `is_small` is whether it is small and its texture is known.
fn gain_at(samples: f64, bytes: u64, largest: f64, is_small: bool) -> LayerGain {
    let ratio = samples / bytes as f64;
    let is_certain = ratio <= largest && bytes >= if is_small { MIN_SMALL_FILE_BYTES } else { MIN_FILE_BYTES };
    let may_try = ratio <= TRIED_RATIO * largest && bytes >= MIN_TRIED_FILE_BYTES;
    match is_small {
        true if ratio > MAX_SMALL_RATIO => LayerGain::None,
        _ if is_certain => LayerGain::Certain,
        true if may_try => LayerGain::Uncertain,
        _ => LayerGain::None,
    }
}

/// Returns the byte budget of the Gaussians in a file of `all` bytes.
fn bytes_of_base(settings: &AllocationSettings, pixels: u64, ratio: f64, all: f64) -> f64 {
    let larger = pixels as f64 / REFERENCE_PIXELS;
    (settings.base_factor
        * REFERENCE_BASE_BYTES
        * larger.strict_powf(BASE_POWER)
        * (ratio.min(100.0) / 50.0).strict_powf(-BASE_FALL))
    .min(MAX_BASE_SHARE * all)
}

/// Returns 0 up to `from`, 1 from `to` on, and values in proportion between them.
fn ramp(value: f64, [from, to]: [f64; 2]) -> f64 {
    ((value - from) / (to - from)).clamp(0.0, 1.0)
}

/// Returns the factor on the byte budget of the Gaussians that suits the texture of a picture. Gaussians represent fine
/// texture poorly.
fn base_factor(texture: Texture, ratio: f64) -> f64 {
    if texture.is_drawing() {
        return 1.0 + (MAX_DRAWING_BASE - 1.0) * ramp(texture.activity, BUSY_DRAWING);
    }
    let [from, to] = FINE_BASE_RATIOS;
    let strength = ((ratio / from).strict_ln() / (to / from).strict_ln()).clamp(0.0, 1.0);
    let factor = (1.0 - FINE_BASE_FALL * (texture.fineness - FINE_BASE)).clamp(MIN_FINE_BASE, 1.0);
    1.0 - strength * (1.0 - factor)
}

/// Returns the factor on the iterations of a fit under a layer with perceptual tuning.
pub(super) fn patience(
    settings: &AllocationSettings,
    pixels: u64,
    texture: Option<Texture>,
    ratio: Option<f64>,
) -> f32 {
    let of_drawing = ramp(texture.map_or(0.0, |texture| texture.flat), PATIENT_FLAT) as f32;
    if of_drawing > 0.0 && settings.is_patient_with_drawings {
        return 1.0 + (MAX_PATIENCE - 1.0) * of_drawing;
    }
    let Some(ratio) = ratio.filter(|_| settings.is_patient_by_ratio && pixels < LARGE_PIXELS) else { return 1.0 };
    let changes = (1..PATIENCE_AT.len()).map(|i| {
        let ratios = [PATIENT_RATIOS[i - 1], PATIENT_RATIOS[i]].map(f64::strict_ln);
        (PATIENCE_AT[i] - PATIENCE_AT[i - 1]) * ramp(ratio.strict_ln(), ratios)
    });
    (PATIENCE_AT[0] + changes.sum::<f64>()) as f32
}

/// Returns whether only several encodes tell how many Gaussians a picture needs.
pub(super) fn is_uncertain(settings: &AllocationSettings, texture: Option<Texture>, ratio: f64) -> bool {
    settings.tries_divisions && ratio <= MAX_TRYING_RATIO && texture.is_some_and(Texture::is_mixed)
}

/// Returns the minimum share of the bytes for the Gaussians of a picture with this texture, size and ratio.
fn busy_share(texture: Texture, pixels: u64, ratio: f64) -> f64 {
    let busy = ramp(texture.activity, BUSY);
    let large = ((pixels as f64 / REFERENCE_PIXELS).strict_ln() / BUSY_SIZE).clamp(0.0, 1.0);
    BUSY_SHARE * busy * large * (ratio / 100.0).min(1.0)
}

/// Returns whether a file with these options may have a detail layer. Only the coded layout has one, and other methods
/// consist of Gaussians alone.
fn may_have_layer(options: &EncodeOptions) -> bool {
    options.layout == Layout::Coded && options.recipe.is_own()
}

/// Returns the texture of a picture if the allocation depends on it: with perceptual tuning, and if it is regular.
pub(super) fn texture(options: &EncodeOptions, measured: impl FnOnce() -> Option<Texture>) -> Option<Texture> {
    measured().filter(|texture| options.favoured() == Tune::Iq || texture.is_regular())
}

/// Returns whether a picture of `pixels` pixels and `samples` samples certainly gains from a layer in a file of `shared`
/// bytes, without header and metadata. `texture` measures the texture of a picture that is fitted as a whole.
pub(super) fn has_layer(
    options: &EncodeOptions,
    pixels: u64,
    samples: f64,
    shared: u64,
    texture: impl FnOnce() -> Option<Texture>,
) -> bool {
    layer_gain(options, pixels, samples, shared, texture) == LayerGain::Certain
}

/// Returns whether a picture gains from a layer. The arguments are those of [`has_layer`].
fn layer_gain(
    options: &EncodeOptions,
    pixels: u64,
    samples: f64,
    shared: u64,
    texture: impl FnOnce() -> Option<Texture>,
) -> LayerGain {
    let certain = |has: bool| if has { LayerGain::Certain } else { LayerGain::None };
    match options.detail {
        _ if !may_have_layer(options) => LayerGain::None,
        Detail::GaussianShare(_) => LayerGain::Certain,
        Detail::Auto => {
            let texture = self::texture(options, texture);
            if texture.is_some_and(Texture::is_regular) {
                return certain(shared >= MIN_REGULAR_FILE_BYTES);
            }
            let settings = EffortSettings::from_preset(options.effort).allocation;
            let is_small = texture.is_some() && SMALL_PIXELS.contains(&pixels);
            gain_at(samples, shared, largest_ratio(&settings, pixels, texture), is_small)
        }
        Detail::Off => LayerGain::None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PIXELS_OF_512: u64 = 512 * 512;

    fn of(effort: u8) -> AllocationSettings {
        EffortSettings::from_preset(effort).allocation
    }

    fn texture(fineness: f64, activity: f64) -> Option<Texture> {
        Some(Texture { fineness, activity, flat: 0.0 })
    }

    #[test]
    fn fine_pictures_have_a_layer_at_larger_ratios_than_coarse_pictures() {
        let has = |texture, ratio: u64| {
            let (samples, bytes) = (3 * PIXELS_OF_512, 3 * PIXELS_OF_512 / ratio);
            let largest = largest_ratio(&of(5), PIXELS_OF_512, texture);
            gain_at(samples as f64, bytes, largest, false) == LayerGain::Certain
        };
        let [coarse, fine] = [0.46, 1.2].map(|fineness| texture(fineness, 4.0));
        assert_eq!([50, 100, 200].map(|ratio| has(coarse, ratio)), [true, true, false]);
        assert_eq!([50, 100, 200].map(|ratio| has(fine, ratio)), [true, true, true]);
        assert_eq!([50, 100, 200].map(|ratio| has(None, ratio)), [true, false, false]);
        // At effort 2, large pictures need finer texture for one.
        let largest = |effort, pixels| largest_ratio(&of(effort), pixels, coarse);
        assert_eq!(largest(2, PIXELS_OF_512), largest(3, PIXELS_OF_512));
        assert!(largest(2, LARGE_PIXELS) < 0.5 * largest(3, LARGE_PIXELS));
        // Files below the minimum size have no layer, whatever the picture.
        assert!(!has(texture(9.0, 4.0), 400));
        // Larger pictures gain from a layer at larger ratios.
        assert!(largest_ratio(&of(5), 10 * PIXELS_OF_512, coarse) > 4.0 * largest_ratio(&of(5), PIXELS_OF_512, coarse));
    }

    #[test]
    fn regular_textures_have_a_layer_in_small_files() {
        for fineness in [15.0, f64::INFINITY] {
            let regular = texture(fineness, 5.0);
            let has = |bytes| has_layer(&EncodeOptions::default(), 128 * 128, 49_152.0, bytes, || regular);
            assert_eq!([100, 600, 2400, 24_000].map(has), [false, true, true, true]);
            assert_eq!(base_bytes(&of(5), 128 * 128, regular, 80.0, 600.0), 600.0 * REGULAR_SHARE);
        }
        let has = |bytes| has_layer(&EncodeOptions::default(), 128 * 128, 49_152.0, bytes, || texture(1.2, 5.0));
        assert_eq!([600, 2400].map(has), [false; 2]);
    }

    #[test]
    fn small_files_have_a_layer_if_the_texture_is_fine_and_a_try_of_one_in_doubt() {
        use LayerGain::{Certain, None, Uncertain};
        let gain = |side: u64, texture, bytes| {
            layer_gain(&EncodeOptions::default(), side * side, (3 * side * side) as f64, bytes, || texture)
        };
        let gains = |fineness| [300, 600, 900, 1200, 2499].map(|bytes| gain(192, texture(fineness, 5.0), bytes));
        assert_eq!(gains(0.5), [None, None, None, None, Uncertain]);
        assert_eq!(gains(0.7), [None, None, Uncertain, Uncertain, Certain]);
        assert_eq!(gains(1.2), [None, Uncertain, Certain, Certain, Certain]);
        // A larger file is never less likely to have a layer, whatever the picture.
        for (side, fineness) in [96, 192, 256, 320].into_iter().flat_map(|side| [0.4, 0.6, 0.9, 2.0].map(|f| (side, f)))
        {
            let order = |gain| [None, Uncertain, Certain].iter().position(|&other| other == gain);
            let found: Vec<_> = (1..50).map(|k| order(gain(side, texture(fineness, 5.0), 100 * k))).collect();
            assert!(found.is_sorted(), "{side} pixels of fineness {fineness}: {found:?}");
        }
        // Other pictures have a larger minimum, and none is tried.
        let of = |is_small| [399, 699, 700, 2499, 2500].map(|bytes| gain_at(50_000.0, bytes, 100.0, is_small));
        assert_eq!(of(true), [None, Uncertain, Certain, Certain, Certain]);
        assert_eq!(of(false), [None, None, None, None, Certain]);
    }

    #[test]
    fn divisions_are_tried_for_pages_at_moderate_ratios_only() {
        let page = texture(0.7, 4.0).map(|texture| Texture { flat: 0.27, ..texture });
        assert_eq!([20.0, 100.0, 200.0].map(|ratio| is_uncertain(&of(5), page, ratio)), [true, true, false]);
        assert!(!is_uncertain(&of(3), page, 50.0) && !is_uncertain(&of(5), texture(0.7, 4.0), 50.0));
    }

    #[test]
    fn fits_are_longer_for_small_photographs_at_a_ratio_of_20_and_for_drawings() {
        let photograph = texture(0.7, 4.0);
        let steps = |effort, ratio| patience(&of(effort), PIXELS_OF_512, photograph, Some(ratio));
        let found = [5.0, 10.0, 14.142, 20.0, 31.62, 50.0, 70.71, 100.0, 400.0].map(|ratio| steps(5, ratio));
        for (found, wanted) in found.into_iter().zip([1.0, 1.0, 1.3, 1.6, 1.3, 1.0, 0.9, 0.8, 0.8]) {
            assert!((found - wanted).abs() < 1e-3, "{found} instead of {wanted}");
        }
        assert_eq!([3, 7].map(|effort| steps(effort, 20.0)), [1.0; 2]);
        assert_eq!([20.0, 200.0].map(|ratio| patience(&of(5), LARGE_PIXELS, photograph, Some(ratio))), [1.0; 2]);
        assert_eq!(patience(&of(5), PIXELS_OF_512, photograph, None), 1.0);
        let drawing = photograph.map(|texture| Texture { flat: 0.4, ..texture });
        assert_eq!([20.0, 200.0].map(|ratio| patience(&of(5), PIXELS_OF_512, drawing, Some(ratio))), [MAX_PATIENCE; 2]);
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
