//! Encodes pictures with an exact layer (spec §12): without loss where that is requested or fits into the requested size,
//! and otherwise with colours near those of the picture. Photographs within a page are left to Gaussians and the detail
//! layer.
//!
//! `survey` reads the picture, `mask` finds the photographs in it, `search` finds the smallest tolerance of colours that
//! fits, and `mixed` encodes what the exact layer does not cover.

mod mask;
mod mixed;
mod search;
mod survey;

use std::ops::ControlFlow;

use self::mask::Cover;
use self::survey::{Survey, equal_neighbours, finished, sharp_edges, without_hidden};
use super::drawn::{drawn_like, own_limits};
use super::rate_control::picture_size;
use super::report::ReportBuilder;
#[cfg(feature = "quality-hook")]
use super::score::score;
use super::skipped::SkipReason;
use super::trace::Tracer;
use super::workers::Executor;
use super::{EncodeReport, Encoded, Progress, encode_lossy, thumbnail};
use crate::bitstream::splats::{Layout, Metadata, PackedSplats};
use crate::bitstream::{self, to_bytes};
use crate::error::{Error, Result};
use crate::metrics;
use crate::options::{Detail, EncodeOptions, HiddenColors, Needs, Recipe, Thumbnail, Trace, Tune};
use crate::parameter::Parameter;
use crate::pixel_source::PixelSource;
use crate::pixels::Pixels;
use crate::rect::Rect;
use crate::round::size::Size;
use crate::strict_math::StrictMath;
use crate::target::Target;

/// Number of pairs of rows that are looked at to see whether a picture repeats itself.
const SAMPLED_PAIRS: u32 = 24;
/// Maximum number of pixels of such a picture. Larger ones may not fit into memory.
const MAX_TRIED_PIXELS: u64 = 1 << 25;
/// Minimum share of pixels that equal their left or upper neighbour in a picture for which the layer is tried. Screens,
/// pages and drawings have .8 to .98, and photographs less than .3 or, if they are dark or out of focus, up to .6.
const MIN_EQUAL: f64 = 0.35;
/// Minimum share of these that equal both. Screens, pages and drawings have .69 to .98, and photographs .18 to .58.
const MIN_BOTH_EQUAL: f64 = 0.65;
/// Minimum share of pixels with [sharp edges](sharp_edges) in any other picture for which the layer is tried: a page or
/// screen whose gradients are dithered, or with many photographs. They have 0.002 to 0.005, and photographs less than
/// 0.0007.
const MIN_EDGES: f64 = 0.0018;
/// Largest tolerance of colours with which a file is taken without comparing it with one of Gaussians and a detail layer.
/// In the worst case that was found, the latter has .2 SSIMULACRA2 points more.
const MAX_SURE_TOLERANCE: u32 = 2;
/// Effort of the first file of Gaussians and a detail layer that is compared with near colours.
const QUICK_EFFORT: u8 = 1;
/// What a higher effort can gain at most, in decibels: of MS-SSIM or PSNR.
const MAX_GAIN: f64 = 2.0;
/// Minimum share of the time limit that remains for Gaussians and the detail layer.
const MIN_TIME: f64 = 0.05;

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
    let mut report = ReportBuilder::new(progress, Tracer::new(options.trace));
    let survey = Survey::of(source, options, &mut report)?;
    let since = report.seconds();
    report.stage_progress("exact layer", 0.0)?;
    let exact = Candidate::new(survey.into_file(options), 0)?;
    report.stage("exact layer", since);
    finish(exact, None, options, report)
}

/// Returns whether the encoder should try an exact layer for the picture of `source`: its pixels are often equal to their
/// neighbours, and the options leave the layers to the encoder.
///
/// # Errors
/// Returns an error of `source`.
pub(super) fn is_worth_trying(source: &dyn PixelSource, options: &EncodeOptions) -> Result<bool> {
    let may_choose = options.layout == Layout::Coded
        && options.detail == Detail::Auto
        && options.needs == Needs::Measured
        && options.recipe == Recipe::Ssplat
        && options.blend.is_none()
        && options.levels == 1
        && options.trace == Trace::Off
        && !matches!(options.target, Target::Primitives(_) | Target::Lossless);
    let [width, height] = source.size();
    if !may_choose || height < 2 || u64::from(width) * u64::from(height) > MAX_TRIED_PIXELS {
        return Ok(false);
    }
    let pairs = SAMPLED_PAIRS.min(height / 2);
    let (mut either, mut both, mut edges, mut pixels) = (0, 0, 0, 0u64);
    for i in 0..pairs {
        let y = (u64::from(height - 2) * u64::from(i) / u64::from(pairs.max(2) - 1)) as u32;
        let rows = source.part(Rect::new(0, y.min(height - 2), width, 2))?;
        let rows = if options.hidden == HiddenColors::Keep { rows } else { without_hidden(rows)? };
        let equal = equal_neighbours(&rows);
        either += equal.iter().filter(|&&[left, above]| left || above).count();
        both += equal.iter().filter(|&&[left, above]| left && above).count();
        edges += sharp_edges(&rows, &equal);
        pixels += u64::from(width);
    }
    let is_repeated = either as f64 >= MIN_EQUAL * pixels as f64 && both as f64 >= MIN_BOTH_EQUAL * either as f64;
    Ok(is_repeated || edges as f64 >= MIN_EDGES * pixels as f64)
}

/// Encodes a picture for which an exact layer [is worth trying](is_worth_trying): without loss, with near colours, or
/// without the layer.
///
/// # Errors
/// As [`encode_lossy`].
pub(super) fn encode(
    source: &dyn PixelSource,
    options: &EncodeOptions,
    executor: Executor<'_>,
    progress: &mut dyn FnMut(&Progress) -> ControlFlow<()>,
) -> Result<Encoded> {
    let mut report = ReportBuilder::new(&mut *progress, Tracer::new(options.trace));
    let survey = Survey::of(source, options, &mut report)?;
    if survey.is_constant {
        return encode_lossy(source, options, executor, progress);
    }
    let goal = Goal::of(options, &survey);
    let pixels = source.part(Rect::new(0, 0, survey.size[0], survey.size[1]))?;
    let mask = match mask::cover(&survey, &pixels) {
        Cover::All => None,
        Cover::Some(mask) => Some(mask),
        Cover::Nothing => return encode_lossy(source, options, executor, progress),
    };
    let since = report.seconds();
    report.stage_progress("exact layer", 0.0)?;
    let exact = match (&goal, &mask) {
        (Goal::Bytes(bytes), Some(mask)) if mask.min_exact_bytes(&survey) > *bytes as f64 => None,
        _ => Some(Candidate::new(survey.file(survey.layer.clone(), options), 0)?),
    };
    report.stage("exact layer", since);
    if exact.as_ref().is_some_and(|exact| goal.is_met_by_size(exact, options)) {
        return finish(exact.expect("it is met"), None, options, report);
    }
    let near = search::near(&survey, &pixels, mask.as_ref(), &goal, options, &mut report)?;
    let near = match goal {
        Goal::Bytes(_) => near,
        // Without loss, every quality is reached.
        _ => near.into_iter().chain(exact).min_by_key(|file| file.bytes.len()),
    };
    let time = options.time.map(|time| time.mul_f64((1.0 - report.seconds() / time.as_secs_f64()).max(MIN_TIME)));
    let lossy_options = EncodeOptions { time, ..options.clone() };
    let Some(near) = near else { return encode_lossy(source, &lossy_options, executor, report.progress) };
    if near.tolerance > MAX_SURE_TOLERANCE || !matches!(goal, Goal::Bytes(_)) {
        let since = report.seconds();
        match lossy(source, &pixels, &near, &goal, &lossy_options, executor, &mut report) {
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
    pixels: &Pixels,
    near: &Candidate,
    goal: &Goal,
    options: &EncodeOptions,
    executor: Executor<'_>,
    report: &mut ReportBuilder<'_>,
) -> Result<Option<Encoded>> {
    let progress = &mut *report.progress;
    if let Goal::Bytes(_) = goal {
        let other = dissimilarity(pixels, &near.splats, options)?;
        if options.effort > QUICK_EFFORT {
            let quick = EncodeOptions { effort: QUICK_EFFORT, ..options.clone() };
            let quick = encode_lossy(source, &quick, Executor::Own, progress)?;
            let quick = dissimilarity(pixels, &read(&quick.bytes)?, options)?;
            if quick > other + MAX_GAIN {
                return Ok(None);
            }
        }
        let lossy = encode_lossy(source, options, executor, progress)?;
        let own = dissimilarity(pixels, &read(&lossy.bytes)?, options)?;
        return Ok((own <= other).then_some(lossy));
    }
    // One fit shows whether a search can find a smaller file.
    let same_size =
        EncodeOptions { target: Target::Bytes(near.bytes.len() as u64), icc: None, exif: None, ..options.clone() };
    let same_size = EncodeOptions { thumbnail: Thumbnail::Never, ..same_size };
    let first = encode_lossy(source, &same_size, Executor::Own, progress)?;
    if !goal.is_met(pixels, &read(&first.bytes)?)? {
        return Ok(None);
    }
    let lossy = encode_lossy(source, options, executor, progress)?;
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
    fn of(options: &EncodeOptions, survey: &Survey) -> Goal {
        let samples = f64::from(survey.size[0]) * f64::from(survey.size[1]) * survey.channels.count() as f64;
        match (options.target, picture_size(options, samples, 0)) {
            (_, Size::Bytes(bytes)) => Goal::Bytes(bytes),
            #[cfg(feature = "quality-hook")]
            (Target::Quality(quality), _) => Goal::Quality(quality),
            (Target::Psnr(psnr), _) => Goal::Psnr(psnr),
            (target, _) => unreachable!("{target:?} is not a goal"),
        }
    }

    /// Returns whether a size is requested into which a file and its thumbnail fit.
    fn is_met_by_size(&self, file: &Candidate, options: &EncodeOptions) -> bool {
        let size = [file.splats.width, file.splats.height];
        matches!(*self, Goal::Bytes(bytes) if file.bytes.len() as u64 + thumbnail::reserved(options, size, bytes) <= bytes)
    }

    /// Returns whether a file reaches the goal, other than a size.
    fn is_met(&self, pixels: &Pixels, splats: &PackedSplats) -> Result<bool> {
        Ok(match *self {
            Goal::Bytes(_) => true,
            Goal::Psnr(psnr) => metrics::psnr(pixels, &drawn_like(splats, pixels)?)? >= psnr,
            #[cfg(feature = "quality-hook")]
            Goal::Quality(quality) => score(pixels, splats)? >= quality,
        })
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
    let psnr = match pixels {
        Some(pixels) => metrics::psnr(pixels, &drawn_like(&splats, pixels)?)?,
        None => f64::INFINITY,
    };
    if options.target != Target::Lossless {
        report.note(if psnr.is_infinite() { SkipReason::Loss } else { SkipReason::NearColors }, 0, 0.0);
    }
    let quality = match (options.target, pixels) {
        #[cfg(feature = "quality-hook")]
        (Target::Quality(_), Some(pixels)) => Some(score(pixels, &splats)?),
        #[cfg(feature = "quality-hook")]
        (Target::Quality(_), None) => Some(100.0),
        _ => None,
    };
    let report = EncodeReport {
        primitives: splats.gaussians.len(),
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
