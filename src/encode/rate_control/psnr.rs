//! Encodes to a PSNR: the smallest file found that reaches it.

use super::search::{Aim, Curve, Try};
use super::{Goal, smallest};
use crate::encode::session::{EncodeSession, Outcome, decibels};
use crate::error::{Error, Result};
use crate::strict_math::StrictMath;

/// Most tries. Later ones mostly keep the Gaussians of the ones before.
const MAX_TRIES: usize = 8;
/// Parts of a budget of time: one for each of four tries, and one for taking out what is not needed. Most searches take
/// no more tries.
const TIMED_PARTS: u32 = 5;
/// Decibels above the wanted ones at which the search ends.
const TOLERANCE: f64 = 0.1;
/// Decibels above the wanted ones that tries aim at.
const AIM_ABOVE: f64 = 0.05;
/// Ratio of the first try.
const FIRST_RATIO: f64 = 50.0;

/// PSNR of a typical picture, up to a constant. In small files doubling the bytes adds 2.5 dB, in large ones each
/// further bit per sample adds 6 dB: Kodak gains 2.8 dB from a ratio of 100 to 50, and another 4.7 dB to 20.
struct Decibels;

impl Decibels {
    /// Returns about the decibels that a size has beside those of other sizes.
    fn at(size: f64) -> f64 {
        2.5 * size + 6.0 * 8.0 * size.strict_exp2()
    }

    /// Returns the size that has so many of these decibels.
    fn size_at(decibels: f64) -> f64 {
        // Halves of what is left of 64 doublings.
        let (mut low, mut high) = (-64.0, 2.0f64);
        for _ in 0..40 {
            let middle = 0.5 * (low + high);
            if Decibels::at(middle) < decibels { low = middle } else { high = middle }
        }
        high
    }
}

impl Curve for Decibels {
    fn size(&self, _: f64) -> f64 {
        // Pictures differ too much for a guess.
        -FIRST_RATIO.strict_log2()
    }

    fn beyond(&self, tried: Try, wanted: f64) -> f64 {
        Decibels::size_at(Decibels::at(tried.size) + wanted - tried.score)
    }

    fn between(&self, low: Try, high: Try, wanted: f64) -> f64 {
        let share = (wanted - low.score) / (high.score - low.score);
        let [from, to] = [low, high].map(|tried| Decibels::at(tried.size));
        Decibels::size_at(from + share * (to - from))
    }
}

/// Encodes to a PSNR of `wanted` decibels over the samples of all channels.
pub(super) fn to_psnr<'a, S: EncodeSession<'a>>(session: &mut S, wanted: f64) -> Result<Outcome> {
    let raw = session.samples();
    let aim = Aim { enough: wanted, aim: wanted + AIM_ABOVE, sizes: super::sizes_tried(raw), tries: MAX_TRIES };
    let goal = Goal { curve: Decibels, aim, timed_parts: TIMED_PARTS };
    let score = |session: &mut S, outcome: &Outcome| Ok(decibels(session.error(&outcome.splats)?, raw));
    let is_close = |_: &S, reached: f64, _: &Outcome| (0.0..TOLERANCE).contains(&(reached - wanted));
    let (reached, mut best) = smallest(session, goal, score, is_close)?;
    if reached < wanted {
        if session.options().time.is_some() {
            // The report has the PSNR that was reached in the time.
            return Ok(best);
        }
        let problem = format!("{wanted} dB cannot be reached: the largest file has {reached:.2} dB");
        return Err(Error::Parameter { name: "psnr", problem });
    }
    session.prune(&mut best, raw * 10f64.strict_powf(-0.1 * wanted))?;
    Ok(best)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_found_by_their_decibels() {
        for size in [-30.0, -8.4, -5.6, -3.3, -1.0, 0.0, 0.9] {
            assert!((Decibels::size_at(Decibels::at(size)) - size).abs() < 1e-6, "{size}");
        }
        let [low, high] = [(-5.6, 34.0), (-4.3, 39.0)].map(|(size, score)| Try { size, score });
        let found = Decibels.between(low, high, 36.0);
        assert!(found > low.size && found < high.size, "{found}");
    }
}
