//! Rate control: converts the target of an encode to file sizes and initial numbers of primitives.

mod psnr;
#[cfg(feature = "quality")]
mod quality;
mod search;

use super::input::{may_leave_out, too_small_with};
use super::session::{EncodeSession, Outcome};
use super::skipped::SkipReason;
use super::thumbnail;
use crate::bitstream::splats::{Layout, Metadata, PackedSplats};
use crate::error::Result;
use crate::gaussian::Blend;
use crate::options::EncodeOptions;
use crate::round::size::Size;
use crate::strict_math::StrictMath;
use crate::target::Target;
#[cfg(feature = "quality")]
pub(super) use quality::AIM_ABOVE;
use search::{Aim, Curve, Search};

/// Most primitives that an encode will fit.
pub(super) const MAX_PRIMITIVES: u64 = 16 << 20;

/// Ratio of [`Target::Auto`].
const AUTO_RATIO: f64 = 50.0;

/// Estimated bits of a primitive in the coded layout, before any is coded.
pub(super) const CODED_BITS: f64 = 34.5;

/// Fewest bytes for primitives of [`Target::Auto`]: some twenty of them.
const MIN_AUTO_BYTES: u64 = 80;

/// Returns the size of the file that is asked for; a file takes `fixed` bytes without primitives.
pub(super) fn size_asked(options: &EncodeOptions, samples: f64, fixed: u64) -> Size {
    match options.target {
        Target::Auto => {
            let length = |metadata: Option<&Vec<u8>>| metadata.map_or(0, |m| m.len() as u64);
            let metadata = length(options.icc.as_ref()) + length(options.exif.as_ref());
            Size::Bytes(((samples / AUTO_RATIO) as u64 + metadata).max(fixed + MIN_AUTO_BYTES))
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
        return Err(too_small_with(options, most, fixed));
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

/// Encodes to what the options ask for.
pub(super) fn to_target<'a, S: EncodeSession<'a>>(session: &mut S) -> Result<Outcome> {
    let options = session.options();
    let target = options.target;
    let size = size_asked(options, session.samples(), session.fixed()?);
    if let Some(constant) = of_one_color(session, size)? {
        return Ok(constant);
    }
    let mut outcome = match target {
        Target::Auto | Target::Ratio(_) | Target::Bytes(_) => {
            let (beside, room) = thumbnail::kept_free(session, size);
            session.at_size(beside, None).map_err(|e| thumbnail::counted(e, size, room))?
        }
        Target::Primitives(count) => session.at_count(count as usize)?,
        Target::Psnr(psnr) => psnr::to_psnr(session, psnr)?,
        #[cfg(feature = "quality")]
        Target::Quality(quality) => quality::to_quality(session, quality)?,
    };
    thumbnail::add(session, &mut outcome, size)?;
    Ok(outcome)
}

/// Returns the bytes that the ICC profile and the EXIF block take in the file.
fn metadata_bytes<'a, S: EncodeSession<'a>>(session: &S) -> Result<u64> {
    let bare = PackedSplats { metadata: Metadata::default(), ..session.empty() };
    Ok(session.fixed()? - session.file(&bare)?.len() as u64)
}

/// Returns the file of a picture of one colour, if that is what the picture is and the file may be as large.
fn of_one_color<'a, S: EncodeSession<'a>>(session: &mut S, size: Size) -> Result<Option<Outcome>> {
    let options = session.options();
    let is_wanted =
        may_leave_out(options) && session.empty().blend == Blend::Normalized && options.target != Target::Primitives(0);
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
    Ok(Some(Outcome { bytes, splats, float_error, quality: None }))
}

/// What a search looks for.
struct Goal<C> {
    curve: C,
    aim: Aim,
    /// Parts of a budget of time: one for each try that most searches take, and one for what comes after.
    timed_parts: u32,
}

/// Searches for the smallest file whose `score` is enough. Returns it, or the best one found, with its score. Ends
/// early if `is_close` says that a file is close enough.
fn smallest<'a, S: EncodeSession<'a>, C: Curve>(
    session: &mut S,
    goal: Goal<C>,
    mut score: impl FnMut(&mut S, &Outcome) -> Result<f64>,
    is_close: impl Fn(&S, f64, &Outcome) -> bool,
) -> Result<(f64, Outcome)> {
    let raw = session.samples();
    // The search is over the bytes of the picture; those of the metadata are added.
    let metadata = metadata_bytes(session)?;
    let share = session.clock().left().map(|time| time / goal.timed_parts);
    let enough = goal.aim.enough;
    let mut search = Search::new(goal.curve, goal.aim);
    let mut best: Option<(f64, Outcome)> = None;
    while let Some(size) = search.next() {
        // A budget of time is that of all tries: one that begins late would be a worse fit, and say little.
        if best.is_some() && session.clock().left() < share.map(|share| share + share / 2) {
            break;
        }
        let outcome = session.at_size(Size::Bytes(metadata + (raw * size.strict_exp2()) as u64), share)?;
        let found = score(session, &outcome)?;
        search.note(size, found);
        let is_done = is_close(session, found, &outcome);
        let is_better = best.as_ref().is_none_or(|(score, best)| match (found >= enough, *score >= enough) {
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

/// Minimum size that a search tries, bytes without metadata.
const MIN_TRIED_BYTES: f64 = 64.0;
/// Maximum size that a search tries, as a multiple of the raw bytes: noise takes more than the raw bytes.
const MAX_TRIED: f64 = 2.0;
/// The maximum for pictures of a few pixels, bytes.
const MAX_TRIED_BYTES: f64 = 512.0;

/// Returns the smallest and the largest size that a search tries for a picture of `raw` samples: binary logarithms of
/// bytes a sample.
fn sizes_tried(raw: f64) -> [f64; 2] {
    [MIN_TRIED_BYTES, (MAX_TRIED * raw).max(MAX_TRIED_BYTES)].map(|bytes| (bytes / raw).strict_log2())
}
