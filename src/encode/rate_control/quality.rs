//! Encodes to a requested SSIMULACRA2 score: searches for the size, and trims files that exceed the score.

use super::search::{Curve, Known, ScoreGoal, Try};
use super::{EncodeAt, SearchPlan, smallest};
use crate::bitstream;
use crate::constants::quality;
use crate::encode::detail::quality_search::layered_to_quality;
use crate::encode::prepared::Prepared;
use crate::encode::render::own_limits;
use crate::encode::score_curve::halvings;
use crate::encode::state::{AtQuality, Outcome};
use crate::encode::trim::trim;
use crate::error::Result;
use crate::strict_math::StrictMath;

/// The typical curve, shifted along the sizes to match a picture. Pictures differ from it mostly by such a shift.
struct Points;

impl Curve for Points {
    fn size(&self, score: f64) -> f64 {
        -halvings(score)
    }

    fn beyond(&self, tried: Try, wanted: f64) -> f64 {
        tried.size + halvings(tried.score) - halvings(wanted)
    }

    fn between(&self, low: Try, high: Try, wanted: f64) -> f64 {
        // Linear interpolation on the scale of the typical curve.
        let [from, to, at] = [low.score, high.score, wanted].map(|score| -halvings(score));
        low.size + (high.size - low.size) * (at - from) / (to - from)
    }
}

/// Encodes to a SSIMULACRA2 score of `wanted` points.
pub(super) fn to_quality(prepared: &mut Prepared<'_>, wanted: f64, encode_at: EncodeAt) -> Result<Outcome> {
    let samples = prepared.state().samples();
    let known = match at_quality(prepared, wanted)? {
        AtQuality::Done(outcome) => return as_written(prepared, *outcome),
        AtQuality::Expected { bytes, .. } if is_hopeless(prepared.state().options.alternative, bytes) => {
            return nothing(prepared);
        }
        AtQuality::Unknown if prepared.state().options.alternative.is_some() => return nothing(prepared),
        AtQuality::Expected { bytes, seen } => {
            let size = |bytes: f64| (bytes / samples).strict_log2();
            let tries = seen.iter().map(|&(bytes, score)| Try { size: size(bytes as f64), score }).collect();
            Known { first: Some(size(bytes + prepared.state().fixed()? as f64)), tries }
        }
        AtQuality::Unknown => Known::default(),
    };
    let sizes = super::sizes_tried(samples);
    let goal = ScoreGoal {
        required: wanted - quality::TOLERANCE,
        aimed: wanted + quality::AIM_ABOVE,
        sizes,
        tries: quality::MAX_FILE_TRIES,
    };
    let plan = SearchPlan { curve: Points, goal, timed_parts: quality::TIME_PARTS, known, encode_at };
    let score = |prepared: &mut Prepared<'_>, outcome: &Outcome| prepared.score(&outcome.splats);
    let is_close = |prepared: &Prepared<'_>, score: f64, outcome: &Outcome| {
        let above = if can_be_trimmed(prepared, outcome) { quality::MAX_TRIMMED_POINTS } else { quality::TOLERANCE };
        (-quality::TOLERANCE..=above).contains(&(score - wanted))
    };
    let (found, mut outcome) = smallest(prepared, plan, score, is_close)?;
    outcome.quality = Some(found);
    if let Prepared::Whole(picture) = prepared
        && found > wanted + quality::AIM_ABOVE
    {
        trim(picture, &mut outcome, wanted)?;
    }
    as_written(prepared, outcome)
}

/// Encodes to a score of `wanted` points with one fit, if that is possible for this picture.
fn at_quality(prepared: &mut Prepared<'_>, wanted: f64) -> Result<AtQuality> {
    match prepared {
        Prepared::Whole(picture) => layered_to_quality(picture, wanted),
        Prepared::Tiled(_) => Ok(AtQuality::Unknown),
    }
}

/// Returns whether a file can become smaller by removing single primitives. Their value is not known for files with
/// levels or a detail layer.
fn can_be_trimmed(prepared: &Prepared<'_>, outcome: &Outcome) -> bool {
    matches!(prepared, Prepared::Whole(_)) && outcome.splats.levels.is_empty() && outcome.splats.detail.is_none()
}

/// Returns whether a search that is expected to end with this many bytes will hardly find a smaller file than another one.
fn is_hopeless(alternative: Option<u64>, expected: f64) -> bool {
    alternative.is_some_and(|bytes| expected > quality::MAX_EXPECTED_SIZE * bytes as f64)
}

/// Measures the score of the file. A decoder renders the Gaussians in the order of the file, which changes the last bits.
fn as_written(prepared: &mut Prepared<'_>, mut outcome: Outcome) -> Result<Outcome> {
    let written = bitstream::read(&outcome.bytes[..], &own_limits())?;
    outcome.quality = Some(prepared.score(&written)?);
    Ok(outcome)
}

/// Returns a file without primitives, which reaches no quality.
fn nothing(prepared: &Prepared<'_>) -> Result<Outcome> {
    let splats = prepared.state().blank.clone();
    let bytes = prepared.state().file(&splats)?;
    Ok(Outcome { bytes, splats, float_error: f64::INFINITY, quality: Some(f64::NEG_INFINITY), pruned_bytes: 0 })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::encode::rate_control::Search;

    #[test]
    fn three_tries_are_enough_for_a_picture_with_another_curve() {
        // Measured for kodim15 at effort 3: halvings of the raw bytes, and points.
        let known = [[3.0, 87.97], [3.907, 80.33], [4.907, 69.39], [5.907, 58.49], [6.907, 44.26], [7.907, 26.3]];
        let measured = |at: f64| {
            let next = known.iter().position(|k| k[0] >= at).unwrap_or(known.len() - 1).max(1);
            let [[a, p], [b, q]] = [known[next - 1], known[next]];
            p + (q - p) * (at - a) / (b - a)
        };
        for wanted in [30.0, 50.0, 70.0, 85.0] {
            let goal = ScoreGoal {
                required: wanted - quality::TOLERANCE,
                aimed: wanted,
                sizes: [-9.0, 0.0],
                tries: quality::MAX_FILE_TRIES,
            };
            let mut search = Search::new(Points, goal);
            let (mut tries, mut points) = (0, 0.0);
            while let Some(size) = search.next() {
                points = measured(-size);
                search.note(size, points);
                tries += 1;
                if (points - wanted).abs() < quality::TOLERANCE {
                    break;
                }
            }
            assert!((points - wanted).abs() < quality::TOLERANCE && tries <= 3, "{wanted}: {points} after {tries}");
        }
    }
}
