//! Rate control: converts the target of an encode to file sizes and initial numbers of primitives.

mod psnr;
#[cfg(feature = "quality-hook")]
mod quality;
mod search;

use super::constant;
use super::drawn::check_renders;
use super::input::too_small_with;
use super::session::{EncodeSession, Outcome};
use super::skipped::SkipReason;
use super::thumbnail;
use crate::bitstream::sections::{SECTION_COUNT_BYTES, section_bytes};
use crate::bitstream::splats::Layout;
use crate::error::{Error, Result};
use crate::options::EncodeOptions;
use crate::round::size::Size;
use crate::strict_math::StrictMath;
use crate::target::Target;
#[cfg(feature = "quality-hook")]
pub(super) use quality::{AIM_ABOVE, at_points, halvings};
use search::{Curve, Known, ScoreGoal, Search};

/// Maximum number of primitives that an encode fits.
pub(super) const MAX_PRIMITIVES: u64 = 16 << 20;

/// Compression ratio of [`Target::Auto`] where the default quality is not measured. It is that of a typical photograph
/// with this quality.
const AUTO_RATIO: f64 = 25.0;

/// Estimated bits per primitive in the coded layout, before any primitive is coded.
pub(super) const CODED_BITS: f64 = 34.5;

/// Minimum number of bytes for the primitives of [`Target::Auto`], enough for about twenty.
const MIN_AUTO_BYTES: u64 = 80;

/// Returns the requested size of the file without its metadata. `fixed` is the size of the file without primitives and
/// metadata, in bytes.
pub(super) fn picture_size(options: &EncodeOptions, samples: f64, fixed: u64) -> Size {
    let metadata = metadata_bytes(options);
    match options.target {
        Target::Auto => Size::Bytes(((samples / AUTO_RATIO) as u64).max(fixed + MIN_AUTO_BYTES)),
        Target::Ratio(ratio) => Size::Bytes(((samples / ratio).floor() as u64).saturating_sub(metadata)),
        Target::Bytes(bytes) => Size::Bytes(bytes.saturating_sub(metadata)),
        Target::Primitives(_) | Target::Psnr(_) | Target::Lossless => Size::Free,
        #[cfg(feature = "quality-hook")]
        Target::Quality(_) => Size::Free,
    }
}

/// Returns the initial number of primitives for a file of `most` bytes. `fixed` is the size of the file without
/// primitives, in bytes.
///
/// # Errors
/// [`Error::TooSmall`] if the file without primitives is larger than `most`.
pub(super) fn count_for(options: &EncodeOptions, most: u64, fixed: u64, samples: f64) -> Result<usize> {
    if most < fixed {
        return Err(too_small_with(options, most, fixed));
    }
    // These bits per primitive are estimates. The size is corrected while the integers are rounded.
    let bits = match options.layout {
        Layout::Packed => 56.0,
        Layout::Planes => 46.0,
        Layout::Coded => CODED_BITS,
    };
    let count = ((most - fixed) as f64 * 8.0 / bits) as u64;
    // More primitives than samples bring no gain.
    Ok(count.min(MAX_PRIMITIVES).min(samples as u64) as usize)
}

/// Encodes to the target of the options, without metadata except for the thumbnail.
pub(super) fn to_target<'a, S: EncodeSession<'a>>(session: &mut S) -> Result<Outcome> {
    picture(session).map_err(|e| with_metadata(e, session.options(), session.samples()))
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

fn picture<'a, S: EncodeSession<'a>>(session: &mut S) -> Result<Outcome> {
    let options = session.options();
    let target = options.target;
    let size = picture_size(options, session.samples(), session.fixed()?);
    if let Some(constant) = of_one_color(session, size)? {
        return Ok(constant);
    }
    let mut outcome = match target {
        Target::Auto | Target::Ratio(_) | Target::Bytes(_) => {
            let (mut remaining, room) = thumbnail::reserve_thumbnail(session, size);
            loop {
                let outcome = session.at_size(remaining, None).map_err(|e| thumbnail::counted(e, size, room))?;
                match (check_renders(&session.widened(&outcome.splats)), remaining) {
                    // Gaussians that cover much of a very large picture can take too much work to render. Fewer of them
                    // fit into fewer bytes.
                    (Err(Error::LimitExceeded { .. }), Size::Bytes(bytes)) if bytes > 2 * session.fixed()? => {
                        remaining = Size::Bytes(bytes / 2);
                    }
                    (checked, _) => break checked.map(|()| outcome)?,
                }
            }
        }
        Target::Primitives(count) => session.at_count(count as usize)?,
        Target::Psnr(psnr) => psnr::to_psnr(session, psnr)?,
        Target::Lossless => unreachable!("a file without loss needs no fit"),
        #[cfg(feature = "quality-hook")]
        Target::Quality(quality) => quality::to_quality(session, quality)?,
    };
    if size == Size::Free {
        check_renders(&session.widened(&outcome.splats))?;
    }
    thumbnail::add(session, &mut outcome, size)?;
    Ok(outcome)
}

/// Returns the number of bytes that code points, the ICC profile and the EXIF block add to a file.
fn metadata_bytes(options: &EncodeOptions) -> u64 {
    let sections: u64 = options.stored_lengths().map(section_bytes).sum();
    if sections > 0 { SECTION_COUNT_BYTES + sections } else { 0 }
}

/// Returns a file without a fit if all pixels have the same colour. Returns `None` for other pictures, if the options
/// exclude such a file, or if it would be larger than `size`.
fn of_one_color<'a, S: EncodeSession<'a>>(session: &mut S, size: Size) -> Result<Option<Outcome>> {
    let options = session.options();
    let is_wanted = constant::is_possible(options, session.blank().blend) && options.target != Target::Primitives(0);
    if !is_wanted {
        return Ok(None);
    }
    let Some(splats) = session.constant()? else { return Ok(None) };
    let bytes = session.file(&splats)?;
    if size.exceeded_by(&bytes) > 0 {
        return Ok(None);
    }
    session.report().note(SkipReason::Fit, 0, 0.0);
    let float_error = session.fitted_error(&splats)?;
    let quality = match session.options().target {
        #[cfg(feature = "quality-hook")]
        Target::Quality(_) => Some(session.score(&splats)?),
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
}

/// Searches for the smallest file whose `score` is high enough. Returns it with its score, or the best file found if no
/// score is high enough. Ends early if `is_close` accepts a file.
fn smallest<'a, S: EncodeSession<'a>, C: Curve>(
    session: &mut S,
    plan: SearchPlan<C>,
    mut score: impl FnMut(&mut S, &Outcome) -> Result<f64>,
    is_close: impl Fn(&S, f64, &Outcome) -> bool,
) -> Result<(f64, Outcome)> {
    let raw = session.samples();
    let share = session.clock().left().map(|time| time / plan.timed_parts);
    let required = plan.goal.required;
    let mut search = Search::new(plan.curve, plan.goal).with(plan.known);
    let mut best: Option<(f64, Outcome)> = None;
    while let Some(size) = search.next() {
        // All tries share the time budget. A try that starts late would be a worse fit, and its score would say little.
        if best.is_some() && session.clock().left() < share.map(|share| share + share / 2) {
            break;
        }
        let outcome = session.at_size(Size::Bytes((raw * size.strict_exp2()) as u64), share)?;
        let found = score(session, &outcome)?;
        search.note(size, found);
        let is_done = is_close(session, found, &outcome);
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

/// Minimum size that a search tries, bytes.
const MIN_TRIED_BYTES: f64 = 64.0;
/// Maximum size that a search tries, as a multiple of the raw bytes. Noise takes more than the raw bytes.
const MAX_TRIED: f64 = 2.0;
/// Lower bound of that maximum, for pictures of a few pixels, bytes.
const MAX_TRIED_BYTES: f64 = 512.0;

/// Returns the smallest and the largest size that a search tries for a picture of `raw` samples, as binary logarithms
/// of bytes per sample.
fn sizes_tried(raw: f64) -> [f64; 2] {
    [MIN_TRIED_BYTES, (MAX_TRIED * raw).max(MAX_TRIED_BYTES)].map(|bytes| (bytes / raw).strict_log2())
}
