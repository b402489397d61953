//! Encodes pictures with an exact layer (spec §12): without loss where that is requested or fits into the requested size,
//! and otherwise with colours near those of the picture. Photographs within a page are left to Gaussians and the detail
//! layer.
//!
//! `survey` reads the picture, `mask` finds the photographs in it, `search` finds the smallest tolerance of colours that
//! fits, and `mixed` encodes what the exact layer does not cover.

mod mask;
mod mixed;
mod paper;
mod search;
mod survey;

use std::ops::ControlFlow;
use std::time::Duration;

use self::mask::Cover;
use self::paper::Paper;
use self::survey::{Survey, equal_neighbours, finished, sampled_rows, sharp_edges, without_hidden};
use super::clock::Clock;
#[cfg(feature = "quality-hook")]
use super::detail::quality_search::predicted_bytes;
use super::rate_control::picture_size;
use super::render::{drawn_like, own_limits};
use super::report::ReportBuilder;
use super::report::{EncodeReport, Encoded, Progress};
use super::skipped::SkipReason;
use super::workers::Executor;
use super::{steps, thumbnail};
use crate::bitstream::splats::{Layout, Metadata, PackedSplats};
use crate::bitstream::{self, to_bytes};
use crate::constants::exact;
#[cfg(feature = "quality-hook")]
use crate::constants::quality;
use crate::effort::EffortSettings;
use crate::error::{Error, Result};
use crate::gaussian::Channels;
use crate::metrics;
use crate::options::{Detail, EncodeOptions, HiddenColors, Needs, Thumbnail, Tune};
use crate::parameter::Parameter;
use crate::pixel_source::PixelSource;
use crate::pixels::Pixels;
use crate::rdo::size::Size;
use crate::rect::Rect;
#[cfg(feature = "quality-hook")]
use crate::ssimulacra2::{Reference, ssimulacra2};
use crate::strict_math::StrictMath;
use crate::target::Target;

/// Maximum number of pixels of such a picture. Larger ones may not fit into memory.
const MAX_TRIED_PIXELS: u64 = 1 << 25;

/// Encodes the picture of `source` without loss.
///
/// # Errors
/// [`Error::Parameter`] for another layout than the coded one, [`Error::Cancelled`] if the caller cancels, and the
/// errors of `source`.
pub(super) fn lossless(
    source: &dyn PixelSource,
    options: &EncodeOptions,
    progress: &mut dyn FnMut(&Progress) -> ControlFlow<()>,
) -> Result<Encoded> {
    if options.layout != Layout::Coded {
        let problem = "only the coded layout stores pictures without loss".into();
        return Err(Error::Parameter { parameter: Parameter::Other("layout"), problem });
    }
    let mut report = ReportBuilder::new(progress, options.inspector);
    let exact = exact_candidate(source, options, &mut report)?;
    finish(exact, None, options, report)
}

/// Returns the file that stores the picture of `source` without loss.
fn exact_candidate(
    source: &dyn PixelSource,
    options: &EncodeOptions,
    report: &mut ReportBuilder<'_>,
) -> Result<Candidate> {
    let survey = Survey::of(source, options, report)?;
    let since = report.seconds();
    report.stage_progress("exact layer", 0.0)?;
    let exact = Candidate::new(survey.into_file(options), 0)?;
    report.stage("exact layer", since);
    Ok(exact)
}

/// Encodes a picture that is not stored with near colours: with Gaussians and a detail layer, or without loss if that
/// takes no more bytes.
///
/// # Errors
/// As [`steps::encode`] and [`lossless`].
pub(super) fn encode_photograph(
    source: &dyn PixelSource,
    options: &EncodeOptions,
    executor: Executor<'_>,
    progress: &mut dyn FnMut(&Progress) -> ControlFlow<()>,
) -> Result<Encoded> {
    match options.target {
        #[cfg(feature = "quality-hook")]
        Target::Quality(wanted) if may_choose(options) => to_quality(source, options, wanted, executor, progress),
        Target::Psnr(wanted) if may_choose(options) => to_psnr(source, options, wanted, executor, progress),
        Target::Ratio(_) | Target::Bytes(_) if may_choose(options) => to_size(source, options, executor, progress),
        _ => steps::encode(source, options, executor, progress),
    }
}

/// Encodes the picture of `source` to a size: without loss if that fits, and otherwise with Gaussians and a detail layer.
///
/// # Errors
/// As [`steps::encode`] and [`lossless`].
fn to_size(
    source: &dyn PixelSource,
    options: &EncodeOptions,
    executor: Executor<'_>,
    progress: &mut dyn FnMut(&Progress) -> ControlFlow<()>,
) -> Result<Encoded> {
    let goal = Goal::of(options, source.size(), source.channels());
    let may_fit = matches!(goal, Goal::Bytes(bytes) if pixels_of(source) <= MAX_TRIED_PIXELS
        && exact::MIN_LOSSLESS_SIZE * survey::estimated_bytes(source)? <= bytes as f64);
    if !may_fit || !has_time(source, options) {
        return steps::encode(source, options, executor, progress);
    }
    let mut report = ReportBuilder::new(&mut *progress, options.inspector);
    let exact = exact_candidate(source, options, &mut report)?;
    if goal.is_met_by_size(&exact, options) {
        return finish(exact, None, options, report);
    }
    let seconds = report.seconds();
    let time = options.time.map(|time| time.saturating_sub(Duration::from_secs_f64(seconds)));
    let mut lossy = steps::encode(source, &EncodeOptions { time, ..options.clone() }, executor, progress)?;
    lossy.report.seconds += seconds;
    Ok(lossy)
}

/// Encodes the picture of `source` to a PSNR: with Gaussians and a detail layer, or without loss if that takes no more
/// bytes or if the other file misses the PSNR.
///
/// # Errors
/// As [`steps::encode`] and [`lossless`].
fn to_psnr(
    source: &dyn PixelSource,
    options: &EncodeOptions,
    wanted: f64,
    executor: Executor<'_>,
    progress: &mut dyn FnMut(&Progress) -> ControlFlow<()>,
) -> Result<Encoded> {
    // Decibels above an error of one code value.
    let level = wanted - 20.0 * f64::from(source.depth().max()).strict_log10();
    if level < exact::LOSSLESS_TRIED_LEVEL || !has_time(source, options) {
        return steps::encode(source, options, executor, progress);
    }
    let mut exact = lossless(source, options, progress)?;
    let time = options.time.map(|time| time.saturating_sub(Duration::from_secs_f64(exact.report.seconds)));
    if level >= exact::LOSSLESS_LEVEL || time.is_some_and(|time| time.is_zero()) {
        return Ok(exact);
    }
    let options = EncodeOptions { alternative: Some(exact.bytes.len() as u64), time, ..options.clone() };
    let mut lossy = steps::encode(source, &options, executor, progress)?;
    let seconds = lossy.report.seconds + exact.report.seconds;
    (lossy.report.seconds, exact.report.seconds) = (seconds, seconds);
    let is_better = lossy.report.psnr >= wanted && lossy.bytes.len() < exact.bytes.len();
    Ok(if is_better { lossy } else { exact })
}

/// Encodes the picture of `source` to a quality: with Gaussians and a detail layer, or without loss if that takes no more
/// bytes or if the other file misses the quality.
///
/// # Errors
/// As [`steps::encode`] and [`lossless`].
#[cfg(feature = "quality-hook")]
fn to_quality(
    source: &dyn PixelSource,
    options: &EncodeOptions,
    wanted: f64,
    executor: Executor<'_>,
    progress: &mut dyn FnMut(&Progress) -> ControlFlow<()>,
) -> Result<Encoded> {
    if wanted >= exact::LOSSLESS_QUALITY {
        return lossless(source, options, progress);
    }
    let lossy = steps::encode(source, options, executor, progress)?;
    let is_missed = lossy.report.quality.is_some_and(|found| found < wanted - quality::TOLERANCE);
    let seconds = lossy.report.seconds;
    let is_late = options.time.is_some_and(|time| seconds >= time.as_secs_f64());
    let is_tried = is_missed
        || wanted >= exact::LOSSLESS_TRIED_QUALITY
        || exact::MIN_LOSSLESS_SIZE * survey::estimated_bytes(source)? <= lossy.bytes.len() as f64;
    if is_late || !is_tried {
        return Ok(lossy);
    }
    let mut exact = lossless(source, options, progress)?;
    if !is_missed && exact.bytes.len() > lossy.bytes.len() {
        return Ok(lossy);
    }
    exact.report.seconds += seconds;
    Ok(exact)
}

/// Returns whether the time limit is long enough to try a photograph without loss.
fn has_time(source: &dyn PixelSource, options: &EncodeOptions) -> bool {
    let needed = exact::LOSSLESS_SECONDS * pixels_of(source) as f64;
    options.time.is_none_or(|time| time.as_secs_f64() >= needed)
}

fn pixels_of(source: &dyn PixelSource) -> u64 {
    u64::from(source.width()) * u64::from(source.height())
}

/// Returns whether the options leave it to the encoder to choose an exact layer.
fn may_choose(options: &EncodeOptions) -> bool {
    options.layout == Layout::Coded
        && options.detail == Detail::Auto
        && options.needs == Needs::Measured
        && options.recipe.is_own()
        && options.blend.is_none()
        && options.levels == 1
        && options.inspector.is_none()
        && !matches!(options.target, Target::Gaussians(_) | Target::Lossless)
}

/// Returns whether the encoder should try an exact layer for the picture of `source`: its pixels are often equal to their
/// neighbours, and the options leave the layers to the encoder.
///
/// # Errors
/// Returns an error of `source`.
pub(super) fn is_worth_trying(source: &dyn PixelSource, options: &EncodeOptions) -> Result<bool> {
    let [width, height] = source.size();
    if !may_choose(options) || height < 2 || pixels_of(source) > MAX_TRIED_PIXELS {
        return Ok(false);
    }
    let (mut either, mut both, mut edges, mut pixels) = (0, 0, 0, 0u64);
    for rows in sampled_rows(source, exact::SAMPLED_PAIRS) {
        let rows = if options.hidden == HiddenColors::Keep { rows? } else { without_hidden(rows?)? };
        let equal = equal_neighbours(&rows);
        either += equal.iter().filter(|&&[left, above]| left || above).count();
        both += equal.iter().filter(|&&[left, above]| left && above).count();
        edges += sharp_edges(&rows, &equal);
        pixels += u64::from(width);
    }
    let is_repeated =
        either as f64 >= exact::MIN_EQUAL * pixels as f64 && both as f64 >= exact::MIN_BOTH_EQUAL * either as f64;
    Ok(is_repeated || edges as f64 >= exact::MIN_EDGES * pixels as f64 || Paper::of(source)?.is_some())
}

/// Encodes a picture for which an exact layer [is worth trying](is_worth_trying): without loss, with near colours, or
/// without the layer.
///
/// # Errors
/// As [`steps::encode`].
pub(super) fn encode(
    source: &dyn PixelSource,
    options: &EncodeOptions,
    executor: Executor<'_>,
    progress: &mut dyn FnMut(&Progress) -> ControlFlow<()>,
) -> Result<Encoded> {
    let mut report = ReportBuilder::new(&mut *progress, options.inspector);
    let clock = Clock::new(options.time);
    let [width, height] = source.size();
    let pixels = source.part(Rect::new(0, 0, width, height))?;
    let cleaned = Paper::of(source)?.map(|paper| paper.without_noise(&pixels)).transpose()?;
    let shown = cleaned.as_ref().unwrap_or(&pixels);
    let has_black = options.hidden != HiddenColors::Keep && shown.channels().alpha().is_some();
    let blackened = has_black.then(|| without_hidden(shown.clone())).transpose()?;
    let shown = blackened.as_ref().unwrap_or(shown);
    let survey = Survey::of(shown, options, &mut report)?;
    if survey.is_constant {
        return encode_photograph(source, options, executor, progress);
    }
    let goal = Goal::of(options, survey.size, survey.channels);
    let mask = match mask::cover(&survey, shown) {
        Cover::All => None,
        Cover::Some(mask) => Some(mask),
        Cover::Nothing => return encode_photograph(source, options, executor, progress),
    };
    let since = report.seconds();
    report.stage_progress("exact layer", 0.0)?;
    let exact = match (&goal, &mask) {
        (Goal::Bytes(bytes), Some(mask)) if mask.min_exact_bytes(&survey) > *bytes as f64 => None,
        _ => Some(Candidate::new(survey.file(survey.layer.clone(), options), 0)?),
    };
    report.stage("exact layer", since);
    let (fitting, larger) = match exact {
        Some(exact) if goal.is_met_by_size(&exact, options) => match cleaned {
            None => return finish(exact, None, options, report),
            Some(_) => (Some(exact), None),
        },
        other => (None, other),
    };
    let judge = Judge::new(&pixels, &goal)?;
    let near = match fitting {
        Some(fitting) => Some(fitting),
        None => {
            let exact = larger.as_ref().map(|exact| exact.bytes.len());
            search::near(&survey, &judge, (shown, mask.as_ref()), (exact, &clock), options, &mut report)?
        }
    };
    let near = match goal {
        Goal::Bytes(_) => near,
        _ => {
            // Without loss, every quality is reached.
            let exact = match larger {
                Some(exact) if cleaned.is_none() || judge.is_met(&exact.splats)? => Some(exact),
                _ => None,
            };
            near.into_iter().chain(exact).min_by_key(|file| file.bytes.len())
        }
    };
    let time =
        options.time.map(|time| time.mul_f64((1.0 - report.seconds() / time.as_secs_f64()).max(exact::MIN_TIME_SHARE)));
    let lossy_options = EncodeOptions { time, ..options.clone() };
    let Some(near) = near else { return steps::encode(source, &lossy_options, executor, report.progress) };
    let is_sure = cleaned.is_none() && near.tolerance <= exact::MAX_SURE_TOLERANCE && matches!(goal, Goal::Bytes(_));
    if is_sure || clock.is_over() {
        return finish(near, Some(&pixels), options, report);
    }
    let predicted = goal.predicted_bytes(&pixels, options);
    // Where alpha is soft, photographs take fewer bytes than predicted.
    let is_unpredictable = pixels.channels().alpha().is_some() && !near.splats.gaussians.is_empty();
    if is_unpredictable || near.bytes.len() as f64 >= exact::MIN_PREDICTED_SIZE * predicted {
        let is_close = match goal {
            Goal::Psnr(_) => true,
            _ => {
                (near.tolerance > 0 || cleaned.is_some())
                    && near.bytes.len() as f64 <= exact::MAX_SINGLE_FIT_SIZE * predicted
            }
        };
        let alternative = is_close.then_some(near.bytes.len() as u64);
        let lossy_options = EncodeOptions { alternative, ..lossy_options };
        let since = report.seconds();
        match lossy(source, &judge, &near, (&lossy_options, &clock), executor, &mut report) {
            Ok(Some(lossy)) => return Ok(lossy),
            Ok(None) | Err(Error::TooSmall { .. } | Error::LimitExceeded { .. }) => {}
            Err(error) => return Err(error),
        }
        report.stage("comparison with Gaussians", since);
    }
    finish(near, Some(&pixels), options, report)
}

/// Encodes the picture of `source` with Gaussians and a detail layer. Returns `None` if `near` is better.
fn lossy(
    source: &dyn PixelSource,
    judge: &Judge<'_>,
    near: &Candidate,
    (options, clock): (&EncodeOptions, &Clock),
    executor: Executor<'_>,
    report: &mut ReportBuilder<'_>,
) -> Result<Option<Encoded>> {
    let progress = &mut *report.progress;
    let timed = |options: &EncodeOptions| EncodeOptions { time: clock.left(), ..options.clone() };
    if let Goal::Bytes(_) = judge.goal {
        let other = dissimilarity(judge.pixels, &near.splats, options)?;
        if EffortSettings::from_preset(options.effort).compares_quickly {
            let quick = EncodeOptions { effort: exact::QUICK_EFFORT, ..timed(options) };
            let quick = steps::encode(source, &quick, Executor::Own, progress)?;
            if dissimilarity(judge.pixels, &read(&quick.bytes)?, options)? > other + exact::MAX_EFFORT_GAIN {
                return Ok(None);
            }
            if clock.is_over() {
                return Ok((dissimilarity(judge.pixels, &read(&quick.bytes)?, options)? <= other).then_some(quick));
            }
        }
        let lossy = steps::encode(source, &timed(options), executor, progress)?;
        let own = dissimilarity(judge.pixels, &read(&lossy.bytes)?, options)?;
        return Ok((own <= other).then_some(lossy));
    }
    // One fit to the size of `near` shows whether a search can find a smaller file.
    let mut of_same_size = |effort: u8| {
        let (target, thumbnail) = (Target::Bytes(near.bytes.len() as u64), Thumbnail::Never);
        let plain = EncodeOptions { target, effort, thumbnail, cicp: None, icc: None, exif: None, ..timed(options) };
        read(&steps::encode(source, &plain, Executor::Own, progress)?.bytes)
    };
    if let Goal::Psnr(_) = judge.goal
        && !judge.is_met(&of_same_size(options.effort)?)?
    {
        return Ok(None);
    }
    #[cfg(feature = "quality-hook")]
    if let Goal::Quality(wanted) = judge.goal
        && EffortSettings::from_preset(options.effort).compares_quickly
        && !near.splats.gaussians.is_empty()
        && judge.score(&of_same_size(exact::QUICK_EFFORT)?)? < wanted - exact::MAX_EFFORT_GAIN_POINTS
    {
        return Ok(None);
    }
    if clock.is_over() {
        return Ok(None);
    }
    let lossy = steps::encode(source, &timed(options), executor, progress)?;
    if matches!(judge.goal, Goal::Psnr(wanted) if lossy.report.psnr < *wanted) {
        return Ok(None);
    }
    #[cfg(feature = "quality-hook")]
    if let (Goal::Quality(wanted), Some(found)) = (judge.goal, lossy.report.quality)
        && found < wanted - quality::TOLERANCE
    {
        return Ok(None);
    }
    let plain = PackedSplats { metadata: Metadata::default(), ..read(&lossy.bytes)? };
    Ok((to_bytes(&plain)?.len() < near.bytes.len()).then_some(lossy))
}

/// Returns the integers of a file.
fn read(bytes: &[u8]) -> Result<PackedSplats> {
    bitstream::read(bytes, &own_limits())
}

/// Returns how much a file differs from the picture, in decibels: by PSNR if the options ask for it, otherwise by
/// MS-SSIM, and for small pictures by SSIM or PSNR.
fn dissimilarity(pixels: &Pixels, splats: &PackedSplats, options: &EncodeOptions) -> Result<f64> {
    let rendered = drawn_like(splats, pixels)?;
    if options.favoured() == Tune::Psnr {
        return metrics::psnr(pixels, &rendered).map(|psnr| -psnr);
    }
    let found = metrics::compare(pixels, &rendered)?;
    Ok(match found.ms_ssim.or(found.ssim) {
        Some(similarity) => 10.0 * (1.0 - similarity).strict_log10(),
        None => -found.psnr,
    })
}

/// A file, without its metadata and thumbnail.
struct Candidate {
    splats: PackedSplats,
    /// The file.
    bytes: Vec<u8>,
    /// Tolerance of the colours in the exact layer, 8-bit code values.
    tolerance: u32,
}

impl Candidate {
    fn new(splats: PackedSplats, tolerance: u32) -> Result<Candidate> {
        let bytes = to_bytes(&splats)?;
        Ok(Candidate { splats, bytes, tolerance })
    }
}

/// What a file should reach.
enum Goal {
    /// The size of the file without its metadata, bytes.
    Bytes(u64),
    /// PSNR, dB.
    Psnr(f64),
    /// SSIMULACRA2 points.
    #[cfg(feature = "quality-hook")]
    Quality(f64),
}

impl Goal {
    fn of(options: &EncodeOptions, [width, height]: [u32; 2], channels: Channels) -> Goal {
        let samples = f64::from(width) * f64::from(height) * channels.count() as f64;
        match (options.target, picture_size(options, samples, 0)) {
            (_, Size::Bytes(bytes)) => Goal::Bytes(bytes),
            #[cfg(feature = "quality-hook")]
            (Target::Quality(quality), _) => Goal::Quality(quality),
            (Target::Psnr(psnr), _) => Goal::Psnr(psnr),
            (target, _) => unreachable!("{target:?} is not a goal"),
        }
    }

    /// Returns about the bytes of a file of Gaussians and a detail layer that reaches a quality; 0 for another goal.
    #[cfg_attr(not(feature = "quality-hook"), allow(unused_variables, reason = "there is no quality"))]
    fn predicted_bytes(&self, pixels: &Pixels, options: &EncodeOptions) -> f64 {
        match *self {
            Goal::Bytes(_) | Goal::Psnr(_) => 0.0,
            #[cfg(feature = "quality-hook")]
            Goal::Quality(wanted) => predicted_bytes(pixels, options, wanted),
        }
    }

    /// Returns whether a size is requested into which a file and its thumbnail fit.
    fn is_met_by_size(&self, file: &Candidate, options: &EncodeOptions) -> bool {
        let size = [file.splats.width, file.splats.height];
        matches!(*self, Goal::Bytes(bytes) if file.bytes.len() as u64 + thumbnail::reserved(options, size, bytes) <= bytes)
    }
}

/// Tells whether files reach a goal.
struct Judge<'a> {
    pixels: &'a Pixels,
    goal: &'a Goal,
    /// The picture prepared for scores.
    #[cfg(feature = "quality-hook")]
    reference: Option<Reference<'a>>,
}

impl<'a> Judge<'a> {
    #[cfg_attr(not(feature = "quality-hook"), allow(clippy::unnecessary_wraps, reason = "a score can fail"))]
    fn new(pixels: &'a Pixels, goal: &'a Goal) -> Result<Self> {
        Ok(Judge {
            pixels,
            goal,
            #[cfg(feature = "quality-hook")]
            reference: if let Goal::Quality(_) = goal { Some(Reference::new(pixels)?) } else { None },
        })
    }

    /// Returns whether a file reaches the goal, other than a size.
    fn is_met(&self, splats: &PackedSplats) -> Result<bool> {
        let drawn = || drawn_like(splats, self.pixels);
        Ok(match *self.goal {
            Goal::Bytes(_) => true,
            Goal::Psnr(psnr) => metrics::psnr(self.pixels, &drawn()?)? >= psnr,
            #[cfg(feature = "quality-hook")]
            Goal::Quality(quality) => self.score(splats)? >= quality - exact::NEAR_COLOR_TOLERANCE,
        })
    }

    /// Returns the score of a file. The goal must be a quality.
    #[cfg(feature = "quality-hook")]
    fn score(&self, splats: &PackedSplats) -> Result<f64> {
        let reference = self.reference.as_ref().expect("the goal is a quality");
        reference.score(&drawn_like(splats, self.pixels)?)
    }
}

/// Adds the metadata to a file with an exact layer, and reports the result. `pixels` are those of the picture if the file
/// may differ from it.
fn finish(
    candidate: Candidate,
    pixels: Option<&Pixels>,
    options: &EncodeOptions,
    mut report: ReportBuilder<'_>,
) -> Result<Encoded> {
    let (splats, bytes) = finished(candidate.splats, candidate.bytes, options, &mut report)?;
    let drawn = pixels.map(|pixels| drawn_like(&splats, pixels).map(|drawn| (pixels, drawn))).transpose()?;
    let psnr = match &drawn {
        Some((pixels, drawn)) => metrics::psnr(pixels, drawn)?,
        None => f64::INFINITY,
    };
    if options.target != Target::Lossless {
        report.note(if psnr.is_infinite() { SkipReason::Loss } else { SkipReason::NearColors }, 0, 0.0);
    }
    let quality = match (options.target, &drawn) {
        #[cfg(feature = "quality-hook")]
        (Target::Quality(_), Some((pixels, drawn))) => Some(ssimulacra2(pixels, drawn)?),
        #[cfg(feature = "quality-hook")]
        (Target::Quality(_), None) => Some(100.0),
        _ => None,
    };
    let report = EncodeReport {
        gaussians: splats.gaussians.len(),
        effort: options.effort,
        psnr,
        float_psnr: psnr,
        quality,
        seconds: report.seconds(),
        stages: report.stages,
        skipped: report.skipped,
        ..EncodeReport::default()
    };
    Ok(Encoded { bytes, report })
}
