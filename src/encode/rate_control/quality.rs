//! Encodes to a requested SSIMULACRA2 score: searches for the size, and trims files that exceed the score.

use super::search::{Curve, Known, ScoreGoal, Try};
use super::{SearchPlan, smallest};
use crate::bitstream;
use crate::encode::drawn::own_limits;
use crate::encode::session::{AtQuality, EncodeSession, Outcome};
use crate::error::Result;
use crate::strict_math::StrictMath;

/// Maximum number of tries. Later tries mostly reuse the Gaussians of earlier ones.
const MAX_TRIES: usize = 6;
/// Number of parts of the time budget: one for each of three tries, and one for trimming.
const TIMED_PARTS: u32 = 4;
/// Points by which a file may miss the requested score.
const TOLERANCE: f64 = 0.5;
/// Margin above the requested score that tries aim at, points. Trimming can lower the score without another fit, but
/// cannot raise it.
pub(in crate::encode) const AIM_ABOVE: f64 = 0.25;
/// Maximum margin above the requested score, in points, at which a file is trimmed instead of fitted again.
const MAX_TRIMMED: f64 = 4.0;
/// Expected size of a file, relative to another file that reaches the score, up to which it is searched for.
const MAX_EXPECTED: f64 = 0.7;
/// Scores that are assumed for a picture until its own are known: halvings of the raw bytes, and points. The values
/// were measured on Kodak; from a ratio of 20 on, they are means of twelve pictures. Pictures differ mostly by a shift
/// along the first axis. `cargo run --release -p ssplat-lab --example rate_distortion -- KODAK` measures the curve.
const TYPICAL_CURVE: [[f64; 2]; 10] = [
    [0.5, 100.0],
    [1.5, 97.0],
    [2.3, 94.5],
    [3.0, 90.5],
    [3.9, 82.0],
    [4.32, 76.1],
    [5.64, 56.1],
    [6.64, 36.7],
    [7.64, 12.7],
    [8.97, -23.9],
];

/// Returns the number of halvings at which the typical curve has this score.
pub(in crate::encode) fn halvings(points: f64) -> f64 {
    at_points(&TYPICAL_CURVE, points)
}

/// Returns where a curve of falling points has this many: linear between its knots and beyond them.
pub(in crate::encode) fn at_points(curve: &[[f64; 2]], points: f64) -> f64 {
    let next = curve.iter().position(|c| c[1] <= points).unwrap_or(curve.len() - 1).max(1);
    let [[from, high], [to, low]] = [curve[next - 1], curve[next]];
    from + (to - from) * (high - points) / (high - low)
}

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
pub(super) fn to_quality<'a, S: EncodeSession<'a>>(session: &mut S, wanted: f64) -> Result<Outcome> {
    let samples = session.samples();
    let known = match session.at_quality(wanted)? {
        AtQuality::Done(outcome) => return as_written(session, *outcome),
        AtQuality::Expected { bytes, .. } if is_hopeless(session.options().alternative, bytes) => {
            return nothing(session);
        }
        AtQuality::Unknown if session.options().alternative.is_some() => return nothing(session),
        AtQuality::Expected { bytes, seen } => {
            let size = |bytes: f64| (bytes / samples).strict_log2();
            let tries = seen.iter().map(|&(bytes, score)| Try { size: size(bytes as f64), score }).collect();
            Known { first: Some(size(bytes + session.fixed()? as f64)), tries }
        }
        AtQuality::Unknown => Known::default(),
    };
    let sizes = super::sizes_tried(samples);
    let goal = ScoreGoal { required: wanted - TOLERANCE, aimed: wanted + AIM_ABOVE, sizes, tries: MAX_TRIES };
    let plan = SearchPlan { curve: Points, goal, timed_parts: TIMED_PARTS, known };
    let score = |session: &mut S, outcome: &Outcome| session.score(&outcome.splats);
    let is_close = |session: &S, score: f64, outcome: &Outcome| {
        let above = if session.can_be_trimmed(outcome) { MAX_TRIMMED } else { TOLERANCE };
        (-TOLERANCE..=above).contains(&(score - wanted))
    };
    let (found, mut outcome) = smallest(session, plan, score, is_close)?;
    outcome.quality = Some(found);
    if found > wanted + AIM_ABOVE {
        session.trim_to_quality(&mut outcome, wanted)?;
    }
    as_written(session, outcome)
}

/// Returns whether a search that is expected to end with this many bytes will hardly find a smaller file than another one.
fn is_hopeless(alternative: Option<u64>, expected: f64) -> bool {
    alternative.is_some_and(|bytes| expected > MAX_EXPECTED * bytes as f64)
}

/// Measures the score of the file. A decoder renders the Gaussians in the order of the file, which changes the last bits.
fn as_written<'a, S: EncodeSession<'a>>(session: &mut S, mut outcome: Outcome) -> Result<Outcome> {
    let written = bitstream::read(&outcome.bytes[..], &own_limits())?;
    outcome.quality = Some(session.score(&written)?);
    Ok(outcome)
}

/// Returns a file without primitives, which reaches no quality.
fn nothing<'a, S: EncodeSession<'a>>(session: &S) -> Result<Outcome> {
    let splats = session.blank().clone();
    let bytes = session.file(&splats)?;
    Ok(Outcome { bytes, splats, float_error: f64::INFINITY, quality: Some(f64::NEG_INFINITY), pruned_bytes: 0 })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::encode::rate_control::Search;

    #[test]
    fn the_typical_curve_decreases_and_passes_through_its_knots() {
        assert!(TYPICAL_CURVE.windows(2).all(|c| c[0][0] < c[1][0] && c[0][1] > c[1][1]));
        for [at, points] in TYPICAL_CURVE {
            assert!((halvings(points) - at).abs() < 1e-9, "{points}");
        }
        let all: Vec<f64> = (0..=100).map(|q| halvings(f64::from(q))).collect();
        assert!(all.is_sorted_by(|a, b| a > b) && all[100] < 1.0 && all[0] < 9.0, "{all:?}");
    }

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
            let goal = ScoreGoal { required: wanted - TOLERANCE, aimed: wanted, sizes: [-9.0, 0.0], tries: MAX_TRIES };
            let mut search = Search::new(Points, goal);
            let (mut tries, mut points) = (0, 0.0);
            while let Some(size) = search.next() {
                points = measured(-size);
                search.note(size, points);
                tries += 1;
                if (points - wanted).abs() < TOLERANCE {
                    break;
                }
            }
            assert!((points - wanted).abs() < TOLERANCE && tries <= 3, "{wanted}: {points} after {tries}");
        }
    }
}
