//! Encodes to a SSIMULACRA2 score: the size is searched for, and what is better than asked for is trimmed.

use super::search::{Aim, Curve, Try};
use super::{Goal, smallest};
use crate::bitstream::{self, splats::PackedSplats};
use crate::encode::drawn::own_limits;
use crate::encode::session::{EncodeSession, Outcome};
use crate::error::{Error, Result};
use crate::ssimulacra2::MIN_SIDE;

/// Most tries. Later ones mostly keep the Gaussians of the ones before.
const MAX_TRIES: usize = 6;
/// Parts of a budget of time: one for each of three tries, and one for taking out what is too good.
const TIMED_PARTS: u32 = 4;
/// Points by which a file may miss what is asked for.
const TOLERANCE: f64 = 0.5;
/// Points above it that a try aims at: what is better can be made worse without another fit, not the other way round.
pub(in crate::encode) const AIM_ABOVE: f64 = 0.25;
/// A try this far above is near enough to be made worse instead of trying again.
const MAX_TRIMMED: f64 = 2.5;
/// The curve that pictures are taken to have until theirs is known: halvings of the raw bytes, and points. Kodak, the
/// means of twelve pictures from 20 on; pictures differ by a shift along the first axis for the most part. `cargo run
/// --release -p ssplat-lab --example rate_distortion -- KODAK` measures it.
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

/// Returns the halvings at which that curve has so many points.
fn halvings(points: f64) -> f64 {
    let next = TYPICAL_CURVE.iter().position(|c| c[1] <= points).unwrap_or(TYPICAL_CURVE.len() - 1).max(1);
    let [[from, high], [to, low]] = [TYPICAL_CURVE[next - 1], TYPICAL_CURVE[next]];
    from + (to - from) * (high - points) / (high - low)
}

/// Points of pictures, which differ from that curve by a shift along the sizes for the most part.
struct Points;

impl Curve for Points {
    fn size(&self, score: f64) -> f64 {
        -halvings(score)
    }

    fn beyond(&self, tried: Try, wanted: f64) -> f64 {
        tried.size + halvings(tried.score) - halvings(wanted)
    }

    fn between(&self, low: Try, high: Try, wanted: f64) -> f64 {
        // A straight line on the curve's own scale.
        let [from, to, at] = [low.score, high.score, wanted].map(|score| -halvings(score));
        low.size + (high.size - low.size) * (at - from) / (to - from)
    }
}

/// Encodes to a SSIMULACRA2 score of `wanted` points.
pub(super) fn to_quality<'a, S: EncodeSession<'a>>(session: &mut S, wanted: f64) -> Result<Outcome> {
    let PackedSplats { width, height, .. } = session.empty();
    if width.min(height) < MIN_SIDE {
        let problem = format!(
            "SSIMULACRA2 takes no picture of {width} × {height}: a side has to have {MIN_SIDE} pixels at least"
        );
        return Err(Error::Parameter { name: "quality", problem });
    }
    let sizes = super::sizes_tried(session.samples());
    let aim = Aim { enough: wanted - TOLERANCE, aim: wanted + AIM_ABOVE, sizes, tries: MAX_TRIES };
    let goal = Goal { curve: Points, aim, timed_parts: TIMED_PARTS };
    let score = |session: &mut S, outcome: &Outcome| {
        let wide = session.widened(&outcome.splats);
        session.score(&wide)
    };
    let is_close = |session: &S, score: f64, outcome: &Outcome| {
        let above = if session.can_be_trimmed(outcome) { MAX_TRIMMED } else { TOLERANCE };
        (-TOLERANCE..=above).contains(&(score - wanted))
    };
    let (found, mut outcome) = smallest(session, goal, score, is_close)?;
    outcome.quality = Some(found);
    if found > wanted + AIM_ABOVE {
        session.trim_to_quality(&mut outcome, wanted)?;
    }
    // A decoder sees the Gaussians in the order of the file, which changes the last bits.
    let written = bitstream::read(&outcome.bytes[..], &own_limits())?;
    outcome.quality = Some(session.score(&written)?);
    Ok(outcome)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::encode::rate_control::Search;

    #[test]
    fn the_curve_falls_and_is_met_at_its_knots() {
        assert!(TYPICAL_CURVE.windows(2).all(|c| c[0][0] < c[1][0] && c[0][1] > c[1][1]));
        for [at, points] in TYPICAL_CURVE {
            assert!((halvings(points) - at).abs() < 1e-9, "{points}");
        }
        let all: Vec<f64> = (0..=100).map(|q| halvings(f64::from(q))).collect();
        assert!(all.is_sorted_by(|a, b| a > b) && all[100] < 1.0 && all[0] < 9.0, "{all:?}");
    }

    #[test]
    fn two_tries_find_a_picture_whose_curve_is_another() {
        // kodim15 at effort 3: halvings of the raw bytes, and points.
        let known = [[3.0, 87.97], [3.907, 80.33], [4.907, 69.39], [5.907, 58.49], [6.907, 44.26], [7.907, 26.3]];
        let measured = |at: f64| {
            let next = known.iter().position(|k| k[0] >= at).unwrap_or(known.len() - 1).max(1);
            let [[a, p], [b, q]] = [known[next - 1], known[next]];
            p + (q - p) * (at - a) / (b - a)
        };
        for wanted in [30.0, 50.0, 70.0, 85.0] {
            let aim = Aim { enough: wanted - TOLERANCE, aim: wanted, sizes: [-9.0, 0.0], tries: MAX_TRIES };
            let mut search = Search::new(Points, aim);
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
