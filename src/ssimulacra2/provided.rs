//! SSIMULACRA2 computed by a function that the program provides.

use std::sync::OnceLock;

use super::measurable::measurable;
use crate::error::{Error, Result};
use crate::parameter::Parameter;
use crate::pixels::Pixels;

/// Computes the score of the second picture against the first.
type Score = fn(&Pixels, &Pixels) -> f64;

static SCORE: OnceLock<Score> = OnceLock::new();

/// Provides the SSIMULACRA2 of this program: a function that returns the score of its second argument against its
/// first. Returns whether none was provided before.
pub fn provide_score(score: Score) -> bool {
    SCORE.set(score).is_ok()
}

/// Returns the SSIMULACRA2 score of two pictures of the same size, channels and depth. Small pictures are mirrored, and
/// narrow ranges of 16 bits are stretched before they are measured.
///
/// # Errors
/// [`Error::Parameter`] if the two differ in width, height, channels or depth, or if no score was provided.
pub(crate) fn ssimulacra2(reference: &Pixels, test: &Pixels) -> Result<f64> {
    crate::metrics::check_alike(reference, test)?;
    let problem = || "this build has no SSIMULACRA2, and the program provides none".to_owned();
    let score = SCORE.get().ok_or_else(|| Error::Parameter { parameter: Parameter::Quality, problem: problem() })?;
    Ok(match measurable(reference, test) {
        Some([reference, test]) => score(&reference, &test),
        None => score(reference, test),
    })
}

/// A picture against which several others are measured.
pub(crate) struct Reference<'a>(&'a Pixels);

impl<'a> Reference<'a> {
    /// Prepares `pixels`.
    #[allow(clippy::unnecessary_wraps, reason = "the computed measure can fail")]
    pub(crate) fn new(pixels: &'a Pixels) -> Result<Self> {
        Ok(Reference(pixels))
    }

    /// Returns the score of `test`, as [`ssimulacra2`] does.
    ///
    /// # Errors
    /// As [`ssimulacra2`].
    pub(crate) fn score(&self, test: &Pixels) -> Result<f64> {
        ssimulacra2(self.0, test)
    }
}

/// Returns whether this program provides a score.
pub(crate) fn is_provided() -> bool {
    SCORE.get().is_some()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gaussian::Channels;
    use crate::pixels::Samples;

    #[test]
    fn without_a_provided_score_a_quality_is_refused() {
        let grey = |side: u32, value| {
            let samples = Samples::U8(vec![value; (side * side) as usize]);
            Pixels::new(side, side, Channels::Grey, samples).unwrap()
        };
        let (a, b) = (grey(8, 1), grey(8, 2));
        assert!(matches!(ssimulacra2(&a, &b), Err(Error::Parameter { parameter: Parameter::Quality, .. })));
        fn score(a: &Pixels, b: &Pixels) -> f64 {
            let first = |p: &Pixels| if let Samples::U8(v) = p.samples() { f64::from(v[0]) } else { f64::NAN };
            10.0 * first(a) + first(b)
        }
        assert!(provide_score(score) && !provide_score(score));
        assert_eq!(ssimulacra2(&a, &b).unwrap(), 12.0);
        assert!(ssimulacra2(&a, &grey(9, 2)).is_err());
    }
}
