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

use std::time::Duration;

use super::prepared::Prepared;
use super::state::{EncodeState, FitRequest, KeptBase, Outcome, UnderLayer};
use super::texture::Texture;
use crate::bitstream::splats::Layout;
use crate::constants::allocation;
use crate::constants::division;
use crate::constants::fit;
use crate::effort::{AllocationSettings, EffortSettings};
use crate::error::Result;
use crate::fit::model::drawing::project::Primitive;
use crate::instant::Instant;
use crate::metrics::MIN_MS_SSIM_SIDE;
use crate::options::{Detail, EncodeOptions, Tune};
use crate::rdo::size::Size;
use crate::strict_math::StrictMath;
use crate::target::Target;

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
        let room = self.fixed as f64
            + (allocation::MAX_SHARP_OVERSHOOT * most_for_base).min(allocation::MAX_SHARP_BASE_SHARE * all);
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
        _ if state.pixels() >= fit::LARGE_PIXELS && !rounds.includes_large_pictures => 0,
        Tune::Iq if state.samples() / shared as f64 <= allocation::MAX_RATIO_OF_LARGE_FILES => rounds.in_large_files,
        Tune::Iq => rounds.perceptual,
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
        Target::Auto | Target::Ratio(_) | Target::Bytes(_) | Target::Gaussians(_) | Target::Lossless => false,
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
            (state.base_factor.unwrap_or(1.0) * suited).min(allocation::MAX_TRIED_BASE_SHARE * all)
        }
    }
}

/// Returns the byte budget of the Gaussians that suits a file of `all` bytes. `texture` is that on which the allocation
/// depends (`fn texture`).
fn base_bytes(settings: &AllocationSettings, pixels: u64, texture: Option<Texture>, ratio: f64, all: f64) -> f64 {
    if texture.is_some_and(Texture::is_regular) {
        return allocation::REGULAR_BASE_SHARE * all;
    }
    let may_be_busy = texture.filter(|_| settings.has_busy_share);
    let least = all * may_be_busy.map_or(0.0, |texture| busy_share(texture, pixels, ratio));
    let suited = texture.map_or(1.0, |texture| base_factor(texture, ratio));
    (suited * bytes_of_base(settings, pixels, ratio, all)).min(max_base_share(texture, pixels, ratio) * all).max(least)
}

/// Returns the maximum share of the bytes for the Gaussians of a picture with this texture, size and ratio.
fn max_base_share(texture: Option<Texture>, pixels: u64, ratio: f64) -> f64 {
    let is_photograph = texture.is_some_and(|texture| !texture.is_drawing());
    if !is_photograph || pixels <= *allocation::SMALL_PIXELS.end() {
        return allocation::MAX_BASE_SHARE;
    }
    let grown = ramp(ratio.strict_ln(), allocation::PHOTOGRAPH_BASE_SHARE_RATIOS.map(f64::strict_ln));
    allocation::PHOTOGRAPH_BASE_SHARE + (allocation::MAX_BASE_SHARE - allocation::PHOTOGRAPH_BASE_SHARE) * grown
}

/// Returns the share of the bytes for the Gaussians of a sharp picture.
pub(super) fn most_for_base(ratio: f64) -> f64 {
    (allocation::SHARP_BASE_SHARE + allocation::SHARP_BASE_SHARE_PER_OCTAVE * (ratio / 20.0).strict_log2())
        .min(allocation::MAX_SHARP_BASE_SHARE)
}

/// Returns the maximum sharpness at which a small base is best. Sharpness is the estimated fraction of the error that
/// doubling the number of Gaussians would remove, for each decibel that doubling the bytes of the layer gains. The new
/// Gaussians are placed where the error is largest.
pub(super) fn max_sharpness(settings: &AllocationSettings, ratio: f64) -> f64 {
    settings.max_sharpness * (ratio / 20.0).strict_powf(allocation::SHARPNESS_RATIO_EXPONENT)
}

/// Returns the largest ratio at which a picture of `pixels` pixels gains from a layer. `texture` is that on which the
/// allocation depends (`fn texture`).
fn largest_ratio(settings: &AllocationSettings, pixels: u64, texture: Option<Texture>) -> f64 {
    let usual = allocation::MAX_LAYER_RATIO
        * (pixels as f64 / allocation::REFERENCE_PIXELS).strict_powf(allocation::LAYER_RATIO_EXPONENT);
    let Some(texture) = texture else { return usual };
    let larger = (pixels as f64 / allocation::FINENESS_PIXELS).strict_powf(allocation::FINENESS_RATIO_EXPONENT);
    let fine = settings.fineness[usize::from(pixels >= fit::LARGE_PIXELS)];
    let of_drawing = if texture.is_drawing() { allocation::MAX_DRAWING_LAYER_RATIO * larger } else { 0.0 };
    usual
        .min(allocation::CERTAIN_LAYER_RATIO)
        .max(allocation::FINENESS_RATIO * (texture.fineness / fine).powi(2) * larger)
        .max(of_drawing)
}

/// Returns whether a picture of `samples` samples gains from a layer in a file of `bytes` bytes. `largest` is the
/// largest ratio at which the picture gains from one. `is_small` is whether it is small and its texture is known.
fn gain_at(samples: f64, bytes: u64, largest: f64, is_small: bool) -> LayerGain {
    let ratio = samples / bytes as f64;
    let is_certain = ratio <= largest
        && bytes >= if is_small { allocation::MIN_SMALL_LAYER_FILE_BYTES } else { allocation::MIN_LAYER_FILE_BYTES };
    let may_try =
        ratio <= allocation::MAX_TRIED_LAYER_RATIO_FACTOR * largest && bytes >= allocation::MIN_TRIED_LAYER_FILE_BYTES;
    match is_small {
        true if ratio > allocation::MAX_SMALL_LAYER_RATIO => LayerGain::None,
        _ if is_certain => LayerGain::Certain,
        true if may_try => LayerGain::Uncertain,
        _ => LayerGain::None,
    }
}

/// Returns the byte budget of the Gaussians in a file of `all` bytes.
fn bytes_of_base(settings: &AllocationSettings, pixels: u64, ratio: f64, all: f64) -> f64 {
    let larger = pixels as f64 / allocation::REFERENCE_PIXELS;
    (settings.base_factor
        * allocation::REFERENCE_BASE_BYTES
        * larger.strict_powf(allocation::BASE_SIZE_EXPONENT)
        * (ratio.min(100.0) / 50.0).strict_powf(-allocation::BASE_RATIO_EXPONENT))
    .min(allocation::MAX_BASE_SHARE * all)
}

/// Returns 0 up to `from`, 1 from `to` on, and values in proportion between them.
fn ramp(value: f64, [from, to]: [f64; 2]) -> f64 {
    ((value - from) / (to - from)).clamp(0.0, 1.0)
}

/// Returns the factor on the byte budget of the Gaussians that suits the texture of a picture. Gaussians represent fine
/// texture poorly.
fn base_factor(texture: Texture, ratio: f64) -> f64 {
    if texture.is_drawing() {
        return 1.0
            + (allocation::MAX_DRAWING_BASE_FACTOR - 1.0)
                * ramp(texture.activity, allocation::DRAWING_BASE_ACTIVITIES);
    }
    let [from, to] = allocation::FINE_BASE_RATIOS;
    let strength = ((ratio / from).strict_ln() / (to / from).strict_ln()).clamp(0.0, 1.0);
    let factor = (1.0 - allocation::FINE_BASE_SLOPE * (texture.fineness - allocation::FINE_BASE_FINENESS))
        .clamp(allocation::MIN_FINE_BASE_FACTOR, 1.0);
    1.0 - strength * (1.0 - factor)
}

/// Returns the factor on the iterations of a fit under a layer with perceptual tuning.
pub(super) fn patience(
    settings: &AllocationSettings,
    pixels: u64,
    texture: Option<Texture>,
    ratio: Option<f64>,
) -> f32 {
    let of_drawing = ramp(texture.map_or(0.0, |texture| texture.flat), allocation::LONG_FIT_FLAT_SHARES) as f32;
    if of_drawing > 0.0 && settings.is_patient_with_drawings {
        return 1.0 + (allocation::MAX_LONG_FIT_FACTOR - 1.0) * of_drawing;
    }
    let Some(ratio) = ratio.filter(|_| settings.is_patient_by_ratio && pixels < fit::LARGE_PIXELS) else { return 1.0 };
    let changes = (1..allocation::FIT_FACTORS.len()).map(|i| {
        let ratios = [allocation::FIT_FACTOR_RATIOS[i - 1], allocation::FIT_FACTOR_RATIOS[i]].map(f64::strict_ln);
        (allocation::FIT_FACTORS[i] - allocation::FIT_FACTORS[i - 1]) * ramp(ratio.strict_ln(), ratios)
    });
    (allocation::FIT_FACTORS[0] + changes.sum::<f64>()) as f32
}

/// Returns whether only several encodes tell how many Gaussians a picture needs.
pub(super) fn is_uncertain(settings: &AllocationSettings, texture: Option<Texture>, ratio: f64) -> bool {
    settings.tries_divisions && ratio <= division::MAX_TRIED_RATIO && texture.is_some_and(Texture::is_mixed)
}

/// Returns the minimum share of the bytes for the Gaussians of a picture with this texture, size and ratio.
fn busy_share(texture: Texture, pixels: u64, ratio: f64) -> f64 {
    let busy = ramp(texture.activity, allocation::BUSY_SHARE_ACTIVITIES);
    let large =
        ((pixels as f64 / allocation::REFERENCE_PIXELS).strict_ln() / allocation::BUSY_SHARE_LOG_SIZE).clamp(0.0, 1.0);
    allocation::BUSY_BASE_SHARE * busy * large * (ratio / 100.0).min(1.0)
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
                return certain(shared >= allocation::MIN_REGULAR_LAYER_FILE_BYTES);
            }
            let settings = EffortSettings::from_preset(options.effort).allocation;
            let is_small = texture.is_some() && allocation::SMALL_PIXELS.contains(&pixels);
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
        assert!(largest(2, fit::LARGE_PIXELS) < 0.5 * largest(3, fit::LARGE_PIXELS));
        // Files below the minimum size have no layer, whatever the picture.
        assert!(!has(texture(9.0, 4.0), 400));
        // Larger pictures gain from a layer at larger ratios.
        assert!(largest_ratio(&of(5), 10 * PIXELS_OF_512, coarse) > 4.0 * largest_ratio(&of(5), PIXELS_OF_512, coarse));
    }

    #[test]
    fn photographs_leave_more_bytes_to_the_layer_up_to_a_ratio_of_100() {
        let share = |texture, pixels, ratio| max_base_share(texture, pixels, ratio);
        let photograph = texture(0.5, 4.0);
        assert_eq!(share(photograph, PIXELS_OF_512, 100.0), allocation::PHOTOGRAPH_BASE_SHARE);
        assert_eq!(share(photograph, PIXELS_OF_512, 200.0), allocation::MAX_BASE_SHARE);
        let between = share(photograph, PIXELS_OF_512, 140.0);
        assert!(allocation::PHOTOGRAPH_BASE_SHARE < between && between < allocation::MAX_BASE_SHARE);
        // Small pictures, drawings, and pictures whose texture is not known.
        let drawing = Some(Texture { fineness: 0.5, activity: 4.0, flat: 0.9 });
        for (texture, pixels) in [(photograph, 192 * 192), (drawing, PIXELS_OF_512), (None, PIXELS_OF_512)] {
            assert_eq!(share(texture, pixels, 100.0), allocation::MAX_BASE_SHARE);
        }
    }

    #[test]
    fn regular_textures_have_a_layer_in_small_files() {
        for fineness in [15.0, f64::INFINITY] {
            let regular = texture(fineness, 5.0);
            let has = |bytes| has_layer(&EncodeOptions::default(), 128 * 128, 49_152.0, bytes, || regular);
            assert_eq!([100, 600, 2400, 24_000].map(has), [false, true, true, true]);
            assert_eq!(base_bytes(&of(5), 128 * 128, regular, 80.0, 600.0), 600.0 * allocation::REGULAR_BASE_SHARE);
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
        assert_eq!([20.0, 200.0].map(|ratio| patience(&of(5), fit::LARGE_PIXELS, photograph, Some(ratio))), [1.0; 2]);
        assert_eq!(patience(&of(5), PIXELS_OF_512, photograph, None), 1.0);
        let drawing = photograph.map(|texture| Texture { flat: 0.4, ..texture });
        assert_eq!(
            [20.0, 200.0].map(|ratio| patience(&of(5), PIXELS_OF_512, drawing, Some(ratio))),
            [allocation::MAX_LONG_FIT_FACTOR; 2]
        );
    }

    #[test]
    fn gaussians_get_a_larger_share_of_small_files_of_large_busy_pictures() {
        let share = |activity, pixels, ratio| busy_share(texture(0.5, activity).unwrap(), pixels, ratio);
        let large = 7 * allocation::REFERENCE_PIXELS as u64;
        assert_eq!(share(5.0, large, 100.0), allocation::BUSY_BASE_SHARE);
        assert_eq!(share(5.0, large, 50.0), allocation::BUSY_BASE_SHARE / 2.0);
        assert_eq!([share(2.0, large, 100.0), share(5.0, allocation::REFERENCE_PIXELS as u64, 100.0)], [0.0; 2]);
        let half = share(3.5, large, 200.0);
        assert!((half - allocation::BUSY_BASE_SHARE / 2.0).abs() < 1e-9, "{half}");
    }
}
