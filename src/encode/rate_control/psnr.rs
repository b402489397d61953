//! Encodes to a requested PSNR: searches for the smallest file that reaches it.

use super::search::{Curve, Known, ScoreGoal, Try};
use super::{EncodeAt, SearchPlan, smallest};
use crate::constants::rate_control;
use crate::encode::prepared::Prepared;
use crate::encode::prune::prune;
use crate::encode::state::{Outcome, decibels};
use crate::error::{Error, Result};
use crate::options::Needs;
use crate::parameter::Parameter;
use crate::strict_math::StrictMath;

/// PSNR of a typical picture, up to a constant. In small files, doubling the bytes adds 2.5 dB. In large files, each
/// further bit per sample adds 6 dB. Kodak gains 2.8 dB from a ratio of 100 to 50, and another 4.7 dB to 20.
struct Decibels;

impl Decibels {
    /// Returns the approximate PSNR at a size, relative to other sizes.
    fn at(size: f64) -> f64 {
        rate_control::DECIBELS_PER_DOUBLING * size + 6.0 * 8.0 * size.strict_exp2()
    }

    /// Returns the size for a PSNR as returned by [`at`](Self::at).
    fn size_at(decibels: f64) -> f64 {
        // Bisection over the range of sizes.
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
        // Pictures differ too much for an estimate, so all searches start at the same ratio.
        -rate_control::FIRST_PSNR_RATIO.strict_log2()
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
pub(super) fn to_psnr(prepared: &mut Prepared<'_>, wanted: f64, encode_at: EncodeAt) -> Result<Outcome> {
    let raw = prepared.state().samples();
    let alternative = prepared.state().options.alternative;
    let [smallest_size, largest] = super::sizes_tried(raw);
    let largest = alternative.map_or(largest, |bytes| (bytes as f64 / raw).strict_log2().clamp(smallest_size, largest));
    let goal = ScoreGoal {
        required: wanted,
        aimed: wanted + rate_control::PSNR_AIM_ABOVE,
        sizes: [smallest_size, largest],
        tries: rate_control::MAX_PSNR_TRIES,
    };
    let plan = SearchPlan {
        curve: Decibels,
        goal,
        timed_parts: rate_control::PSNR_TIME_PARTS,
        known: Known::default(),
        encode_at,
    };
    let score = |prepared: &mut Prepared<'_>, outcome: &Outcome| Ok(decibels(prepared.error(&outcome.splats)?, raw));
    let is_close =
        |_: &Prepared<'_>, reached: f64, _: &Outcome| (0.0..rate_control::PSNR_TOLERANCE).contains(&(reached - wanted));
    let (reached, mut best) = smallest(prepared, plan, score, is_close)?;
    if reached < wanted {
        if prepared.state().options.time.is_some() || alternative.is_some() {
            // The report contains the PSNR that was reached.
            return Ok(best);
        }
        let problem = format!("{wanted} dB cannot be reached: the largest file has {reached:.2} dB");
        return Err(Error::Parameter { parameter: Parameter::Psnr, problem });
    }
    // The contribution of channels that were left out to the error is not known here.
    if let Prepared::Whole(picture) = prepared
        && picture.state.options.needs == Needs::Measured
        && picture.state.fits_all_channels()
    {
        let mut pruned = best.clone();
        prune(picture, &mut pruned, raw * 10f64.strict_powf(-0.1 * wanted))?;
        // The error is higher once it is rounded to code values.
        if decibels(prepared.error(&pruned.splats)?, raw) >= wanted {
            best = pruned;
        }
    }
    Ok(best)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn size_at_inverts_the_curve_and_interpolation_stays_between_tries() {
        for size in [-30.0, -8.4, -5.6, -3.3, -1.0, 0.0, 0.9] {
            assert!((Decibels::size_at(Decibels::at(size)) - size).abs() < 1e-6, "{size}");
        }
        let [low, high] = [(-5.6, 34.0), (-4.3, 39.0)].map(|(size, score)| Try { size, score });
        let found = Decibels.between(low, high, 36.0);
        assert!(found > low.size && found < high.size, "{found}");
    }
}
