//! Encodes what an exact layer does not cover, with Gaussians and a detail layer.

use super::mask::Mask;
use super::{Candidate, Goal, Judge, read};
use crate::bitstream::splats::PackedSplats;
use crate::bitstream::to_bytes;
use crate::constants::exact;
use crate::encode::channels::widen;
use crate::encode::clock::Clock;
use crate::encode::hidden::inpainted;
use crate::encode::report::ReportBuilder;
use crate::encode::steps::encode_whole;
use crate::error::{Error, Result};
use crate::gaussian::Channels;
use crate::options::{Detail, EncodeOptions, HiddenColors, Thumbnail};
use crate::pixels::{Pixels, Samples};
use crate::strict_math::StrictMath;
use crate::target::Target;

/// Returns a file of at most `bytes` bytes: `exact`, and Gaussians and a detail layer where it does not cover the picture.
/// Returns `None` if they do not fit.
pub(super) fn file(
    (exact, tolerance): (PackedSplats, u32),
    mask: &Mask,
    pixels: &Pixels,
    (bytes, clock): (u64, &Clock),
    options: &EncodeOptions,
    report: &mut ReportBuilder<'_>,
) -> Result<Option<Candidate>> {
    let layer = to_bytes(&exact)?.len() - to_bytes(&PackedSplats { exact: None, ..exact.clone() })?.len();
    let Some(room) = bytes.checked_sub(layer as u64) else { return Ok(None) };
    let detail = if room >= exact::MIN_PHOTOGRAPH_LAYER_BYTES {
        Detail::GaussianShare(exact::PHOTOGRAPH_BASE_SHARE)
    } else {
        Detail::Off
    };
    let options = EncodeOptions { target: Target::Bytes(room), detail, time: clock.left(), ..options.clone() };
    let Some(splats) = photographs(mask, pixels, &options, report)? else { return Ok(None) };
    let file = Candidate::new(PackedSplats { exact: exact.exact, ..splats }, tolerance)?;
    Ok((file.bytes.len() as u64 <= bytes).then_some(file))
}

/// Returns Gaussians and a detail layer of the photographs that reach the goal of `judge`, other than a size, as far as
/// their share of the picture is concerned. Returns `None` if there are none.
pub(super) fn reaching(
    mask: &Mask,
    judge: &Judge<'_>,
    clock: &Clock,
    options: &EncodeOptions,
    report: &mut ReportBuilder<'_>,
) -> Result<Option<PackedSplats>> {
    let share = 1.0 - mask.share();
    let (target, alternative) = match *judge.goal {
        Goal::Bytes(_) => return Ok(None),
        // The squared errors of all pixels are added.
        Goal::Psnr(psnr) => (Target::Psnr(psnr - 10.0 * share.strict_log10()), None),
        // No search of several fits.
        #[cfg(feature = "quality-hook")]
        Goal::Quality(wanted) => (Target::Quality(wanted + exact::PHOTOGRAPH_AIM_ABOVE * (100.0 - wanted)), Some(0)),
    };
    // The tolerances are searched for in the other half of the time.
    let (time, detail) = (clock.left().map(|left| left / 2), Detail::GaussianShare(exact::PHOTOGRAPH_BASE_SHARE));
    let options = EncodeOptions { target, detail, time, alternative, ..options.clone() };
    photographs(mask, judge.pixels, &options, report)
}

/// Encodes the part of a picture that the exact layer does not cover. Returns `None` if the target is too small.
fn photographs(
    mask: &Mask,
    pixels: &Pixels,
    options: &EncodeOptions,
    report: &mut ReportBuilder<'_>,
) -> Result<Option<PackedSplats>> {
    let filled = continued(pixels, mask, options.hidden, report)?;
    let since = report.seconds();
    let options = EncodeOptions { thumbnail: Thumbnail::Never, cicp: None, icc: None, exif: None, ..options.clone() };
    let encoded = match encode_whole(&filled, &options, exact::PHOTOGRAPH_ITERATIONS, &mut |now| (report.progress)(now))
    {
        Ok(encoded) => encoded,
        Err(Error::TooSmall { .. }) => return Ok(None),
        Err(error) => return Err(error),
    };
    report.stage("photographs", since);
    let splats = read(&encoded.bytes)?;
    Ok(Some(if splats.channels == pixels.channels() { splats } else { widen(&splats, pixels.channels()) }))
}

/// Returns the picture with covered pixels replaced by a smooth continuation of the others, alpha included.
fn continued(pixels: &Pixels, mask: &Mask, hidden: HiddenColors, report: &mut ReportBuilder<'_>) -> Result<Pixels> {
    let (width, size, channels) = (pixels.width() as usize, [pixels.width(), pixels.height()], pixels.channels());
    let covers = |i: usize| mask.covers([i % width, i / width]);
    let Some(alpha) = channels.alpha() else {
        return filled(pixels, |i| if covers(i) { 0.0 } else { 1.0 }, report);
    };
    fn split<T: Copy>(v: &[T], count: usize) -> [Vec<T>; 2] {
        let colors = v.chunks_exact(count).flat_map(|pixel| pixel[..count - 1].iter().copied());
        [colors.collect(), v.iter().skip(count - 1).step_by(count).copied().collect()]
    }
    fn joined<T: Copy>(colors: &[T], alpha: &[T]) -> Vec<T> {
        let pixels = colors.chunks_exact(colors.len() / alpha.len()).zip(alpha);
        pixels.flat_map(|(colors, alpha)| colors.iter().chain([alpha]).copied()).collect()
    }
    let count = channels.count();
    let [colors, alphas] = match pixels.samples() {
        Samples::U8(v) => split(v, count).map(Samples::U8),
        Samples::U16(v) => split(v, count).map(Samples::U16),
    };
    let opaque = if channels == Channels::GreyAlpha { Channels::Grey } else { Channels::Rgb };
    let opacity = |i: usize| if hidden == HiddenColors::Keep { 1.0 } else { pixels.value(i * count + alpha) };
    let colors = Pixels::new(size[0], size[1], opaque, colors)?;
    let colors = filled(&colors, |i| if covers(i) { 0.0 } else { opacity(i) }, report)?;
    let alphas = Pixels::new(size[0], size[1], Channels::Grey, alphas)?;
    let alphas = filled(&alphas, |i| if covers(i) { 0.0 } else { 1.0 }, report)?;
    let samples = match (colors.samples(), alphas.samples()) {
        (Samples::U8(colors), Samples::U8(alphas)) => Samples::U8(joined(colors, alphas)),
        (Samples::U16(colors), Samples::U16(alphas)) => Samples::U16(joined(colors, alphas)),
        _ => unreachable!("colours and alpha have the same depth"),
    };
    Pixels::new(size[0], size[1], channels, samples)
}

/// Returns a picture without alpha in which pixels of weight 0 are a smooth continuation of the others, by their weights
/// of 0 to 1.
fn filled(pixels: &Pixels, weight: impl Fn(usize) -> f32, report: &mut ReportBuilder<'_>) -> Result<Pixels> {
    let count = pixels.channels().count();
    fn with_alpha<T: Copy>(v: &[T], count: usize, alpha: impl Fn(usize) -> T) -> Vec<T> {
        let pixel = |(i, pixel): (usize, &[T])| pixel.iter().copied().chain([alpha(i)]).collect::<Vec<T>>();
        v.chunks_exact(count).enumerate().flat_map(pixel).collect()
    }
    fn without_alpha<T: Copy>(v: &[T], count: usize) -> Vec<T> {
        v.chunks_exact(count + 1).flat_map(|pixel| pixel[..count].iter().copied()).collect()
    }
    let samples = match pixels.samples() {
        Samples::U8(v) => Samples::U8(with_alpha(v, count, |i| (weight(i) * f32::from(u8::MAX)).round() as u8)),
        Samples::U16(v) => Samples::U16(with_alpha(v, count, |i| (weight(i) * f32::from(u16::MAX)).round() as u16)),
    };
    let channels = if count == 1 { Channels::GreyAlpha } else { Channels::Rgba };
    let shown = Pixels::new(pixels.width(), pixels.height(), channels, samples)?;
    let filled = inpainted(&shown, HiddenColors::default(), || report.stage_progress("exact layer", 1.0))?;
    let samples = match filled.unwrap_or(shown).into_samples() {
        Samples::U8(v) => Samples::U8(without_alpha(&v, count)),
        Samples::U16(v) => Samples::U16(without_alpha(&v, count)),
    };
    Pixels::new(pixels.width(), pixels.height(), pixels.channels(), samples)
}
