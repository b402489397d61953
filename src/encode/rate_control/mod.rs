//! Rate control: converts the target of an encode to file sizes and initial numbers of primitives.

mod psnr;
#[cfg(feature = "quality-hook")]
mod quality;
mod search;

use std::time::Duration;

use super::constant;
use super::gaussians;
use super::prepared::Prepared;
use super::render::check_renders;
use super::skipped::SkipReason;
use super::state::{FitRequest, Outcome};
use super::thumbnail;
use crate::bitstream::sections::{SECTION_COUNT_BYTES, section_bytes};
use crate::constants::rate_control;
use crate::error::{Error, Result};
use crate::options::EncodeOptions;
use crate::rdo::size::Size;
use crate::strict_math::StrictMath;
use crate::target::Target;
use search::{Curve, Known, ScoreGoal, Search};

/// Returns the requested size of the file without its metadata. `fixed` is the size of the file without primitives and
/// metadata, in bytes.
pub(super) fn picture_size(options: &EncodeOptions, samples: f64, fixed: u64) -> Size {
    let metadata = metadata_bytes(options);
    match options.target {
        Target::Auto => {
            Size::Bytes(((samples / rate_control::AUTO_RATIO) as u64).max(fixed + rate_control::MIN_AUTO_BYTES))
        }
        Target::Ratio(ratio) => Size::Bytes(((samples / ratio).floor() as u64).saturating_sub(metadata)),
        Target::Bytes(bytes) => Size::Bytes(bytes.saturating_sub(metadata)),
        Target::Gaussians(_) | Target::Psnr(_) | Target::Lossless => Size::Free,
        #[cfg(feature = "quality-hook")]
        Target::Quality(_) => Size::Free,
    }
}

/// Encodes to a file of one size. The duration is the part of the time budget that this file may take; `None` means all
/// of the remaining time.
pub(super) type EncodeAt = fn(&mut Prepared<'_>, Size, Option<Duration>) -> Result<Outcome>;

/// Encodes to the target of the options by `encode_at`, without metadata. Returns the file and the maximum size of its
/// thumbnail in bytes, which is 0 if it has none.
pub(super) fn to_target(prepared: &mut Prepared<'_>, encode_at: EncodeAt) -> Result<(Outcome, u64)> {
    let outcome = picture(prepared, encode_at);
    outcome.map_err(|e| with_metadata(e, prepared.state().options, prepared.state().samples()))
}

/// Adds the metadata to an error about the size of a file.
fn with_metadata(error: Error, options: &EncodeOptions, samples: f64) -> Error {
    match error {
        Error::TooSmall { asked, allowed, needed, icc, exif } => {
            let metadata = metadata_bytes(options);
            let allowed = match options.target {
                Target::Bytes(bytes) => bytes,
                Target::Ratio(ratio) => (samples / ratio).floor() as u64,
                _ => allowed + metadata,
            };
            Error::TooSmall { asked, allowed, needed: needed + metadata, icc, exif }
        }
        e => e,
    }
}

fn picture(prepared: &mut Prepared<'_>, encode_at: EncodeAt) -> Result<(Outcome, u64)> {
    let options = prepared.state().options;
    let target = options.target;
    let size = picture_size(options, prepared.state().samples(), prepared.state().fixed()?);
    if let Some(constant) = of_one_color(prepared, size)? {
        return Ok((constant, 0));
    }
    let outcome = match target {
        Target::Auto | Target::Ratio(_) | Target::Bytes(_) => {
            let (mut remaining, room) = thumbnail::reserve_thumbnail(prepared, size);
            loop {
                let outcome = encode_at(prepared, remaining, None).map_err(|e| thumbnail::counted(e, size, room))?;
                match (check_renders(&prepared.state().widened(&outcome.splats)), remaining) {
                    // Gaussians that cover much of a very large picture can take too much work to render. Fewer of them
                    // fit into fewer bytes.
                    (Err(Error::LimitExceeded { .. }), Size::Bytes(bytes))
                        if bytes > 2 * prepared.state().fixed()? =>
                    {
                        remaining = Size::Bytes(bytes / 2);
                    }
                    (checked, _) => break checked.map(|()| outcome)?,
                }
            }
        }
        Target::Gaussians(count) => gaussians::encode(prepared, &FitRequest::of_count(count as usize))?,
        Target::Psnr(psnr) => psnr::to_psnr(prepared, psnr, encode_at)?,
        Target::Lossless => unreachable!("a file without loss needs no fit"),
        #[cfg(feature = "quality-hook")]
        Target::Quality(quality) => quality::to_quality(prepared, quality, encode_at)?,
    };
    if size == Size::Free {
        check_renders(&prepared.state().widened(&outcome.splats))?;
    }
    let thumbnail = thumbnail::max_bytes(prepared, &outcome, size);
    Ok((outcome, thumbnail))
}

/// Returns the number of bytes that code points, the ICC profile and the EXIF block add to a file.
fn metadata_bytes(options: &EncodeOptions) -> u64 {
    let sections: u64 = options.stored_lengths().map(section_bytes).sum();
    if sections > 0 { SECTION_COUNT_BYTES + sections } else { 0 }
}

/// Returns a file without a fit if all pixels have the same colour. Returns `None` for other pictures, if the options
/// exclude such a file, or if it would be larger than `size`.
fn of_one_color(prepared: &mut Prepared<'_>, size: Size) -> Result<Option<Outcome>> {
    let options = prepared.state().options;
    let is_wanted =
        constant::is_possible(options, prepared.state().blank.blend) && options.target != Target::Gaussians(0);
    if !is_wanted {
        return Ok(None);
    }
    let Some(splats) = prepared.constant()? else { return Ok(None) };
    let bytes = prepared.state().file(&splats)?;
    if size.exceeded_by(&bytes) > 0 {
        return Ok(None);
    }
    prepared.state_mut().report.note(SkipReason::Fit, 0, 0.0);
    let float_error = prepared.fitted_error(&splats)?;
    let quality = match prepared.state().options.target {
        #[cfg(feature = "quality-hook")]
        Target::Quality(_) => Some(prepared.score(&splats)?),
        _ => None,
    };
    Ok(Some(Outcome { bytes, splats, float_error, quality, pruned_bytes: 0 }))
}

/// Curve, goal and time limit of a search.
struct SearchPlan<C> {
    curve: C,
    goal: ScoreGoal,
    /// Number of parts of the time budget: one for each try of a typical search, and one for the work after the search.
    timed_parts: u32,
    /// What is known of the picture before the search.
    known: Known,
    encode_at: EncodeAt,
}

/// Searches for the smallest file whose `score` is high enough. Returns it with its score, or the best file found if no
/// score is high enough. Ends early if `is_close` accepts a file.
fn smallest<C: Curve>(
    prepared: &mut Prepared<'_>,
    plan: SearchPlan<C>,
    mut score: impl FnMut(&mut Prepared<'_>, &Outcome) -> Result<f64>,
    is_close: impl Fn(&Prepared<'_>, f64, &Outcome) -> bool,
) -> Result<(f64, Outcome)> {
    let raw = prepared.state().samples();
    let share = prepared.state().clock.left().map(|time| time / plan.timed_parts);
    let required = plan.goal.required;
    let mut search = Search::new(plan.curve, plan.goal).with(plan.known);
    let mut best: Option<(f64, Outcome)> = None;
    while let Some(size) = search.next() {
        // All tries share the time budget. A try that starts late would be a worse fit, and its score would say little.
        if best.is_some() && prepared.state().clock.left() < share.map(|share| share + share / 2) {
            break;
        }
        let outcome = (plan.encode_at)(prepared, Size::Bytes((raw * size.strict_exp2()) as u64), share)?;
        let found = score(prepared, &outcome)?;
        search.note(size, found);
        let is_done = is_close(prepared, found, &outcome);
        let is_better = best.as_ref().is_none_or(|(score, best)| match (found >= required, *score >= required) {
            (true, true) => outcome.bytes.len() < best.bytes.len(),
            (is_enough, was_enough) => is_enough || !was_enough && found > *score,
        });
        if is_better {
            best = Some((found, outcome));
        }
        if is_done {
            break;
        }
    }
    Ok(best.expect("one try at least"))
}

/// Returns the smallest and the largest size that a search tries for a picture of `raw` samples, as binary logarithms
/// of bytes per sample.
fn sizes_tried(raw: f64) -> [f64; 2] {
    [rate_control::MIN_TRIED_BYTES, (rate_control::MAX_TRIED_SIZE * raw).max(rate_control::MIN_LARGEST_TRIED_BYTES)]
        .map(|bytes| (bytes / raw).strict_log2())
}
