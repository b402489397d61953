//! Bracketed search for the smallest file that reaches a score.
//!
//! Sizes are binary logarithms of bytes per raw byte. Scores are decibels or points. They grow with the size, but
//! scatter from fit to fit. The bracket is the smallest file that reached the score and the largest smaller file that
//! did not.

use crate::constants::rate_control;

/// Model of how the score of a typical picture grows with the size of its file.
pub(super) trait Curve {
    /// Returns the size at which a typical picture has this score.
    fn size(&self, score: f64) -> f64;
    /// Returns the size at which a picture is expected to have the score `wanted`, given one try.
    fn beyond(&self, tried: Try, wanted: f64) -> f64;
    /// Returns the size between two tries at which the score `wanted` is expected.
    fn between(&self, low: Try, high: Try, wanted: f64) -> f64;
}

/// Size and score of a file that was tried.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Try {
    /// Binary logarithm of the requested bytes per raw byte.
    pub size: f64,
    /// Score of the file, decibels or points.
    pub score: f64,
}

/// Goal and bounds of a search.
#[derive(Debug, Clone, Copy)]
pub(super) struct ScoreGoal {
    /// Minimum score of the file.
    pub required: f64,
    /// Score that tries aim at, no lower than `required`.
    pub aimed: f64,
    /// Smallest and largest size.
    pub sizes: [f64; 2],
    /// Maximum number of tries once a file has reached the score.
    pub tries: usize,
}

/// What is known of a picture before a search.
#[derive(Debug, Clone, Default)]
pub(super) struct Known {
    /// The size to try first, unless tries are known.
    pub first: Option<f64>,
    /// Files that were tried otherwise. They do not count as tries of the search.
    pub tries: Vec<Try>,
}

/// A search in progress.
pub(super) struct Search<C> {
    curve: C,
    goal: ScoreGoal,
    tries: Vec<Try>,
    first: Option<f64>,
    /// Number of tries that were known before.
    known: usize,
}

impl<C: Curve> Search<C> {
    pub(super) fn new(curve: C, goal: ScoreGoal) -> Self {
        Search { curve, goal, tries: Vec::new(), first: None, known: 0 }
    }

    /// Starts with what is known of the picture.
    pub(super) fn with(self, known: Known) -> Self {
        Search { known: known.tries.len(), tries: known.tries, first: known.first, ..self }
    }

    /// Returns the number of tries of the search itself.
    fn count(&self) -> usize {
        self.tries.len() - self.known
    }

    /// Records the score of a file of this size.
    pub(super) fn note(&mut self, size: f64, score: f64) {
        self.tries.push(Try { size, score });
    }

    /// Returns the size to try next, or `None` if the search is over.
    pub(super) fn next(&self) -> Option<f64> {
        let [smallest, largest] = self.goal.sizes;
        let inside = |size: f64| Some(size.clamp(smallest, largest));
        match self.bracket() {
            (None, None) => inside(self.first.unwrap_or_else(|| self.curve.size(self.goal.aimed))),
            // The largest file is not good enough.
            (Some(low), None) if low.size >= largest && self.count() > 0 => None,
            (Some(_), None) if self.count() >= rate_control::MAX_FAILED_TRIES => Some(largest),
            (Some(low), None) => inside(low.size + self.step(self.curve.beyond(low, self.goal.aimed) - low.size)),
            // One file is good enough, and no tries remain.
            (_, Some(_)) if self.count() >= self.goal.tries => None,
            (None, Some(high)) if high.size <= smallest && self.count() > 0 => None,
            (None, Some(high)) => inside(high.size - self.step(high.size - self.curve.beyond(high, self.goal.aimed))),
            (Some(low), Some(high)) => {
                let width = high.size - low.size;
                let at = self
                    .curve
                    .between(low, high, self.goal.aimed)
                    .max(low.size + rate_control::MIN_BRACKET_MARGIN * width);
                (width >= rate_control::MIN_BRACKET || self.count() == 0)
                    .then(|| at.min(high.size - rate_control::MIN_BRACKET_MARGIN * width))
            }
        }
    }

    /// Returns the step out of an open bracket for an `expected` step of the curve.
    fn step(&self, expected: f64) -> f64 {
        let least = rate_control::MIN_OPEN_STEP * rate_control::OPEN_STEP_GROWTH.powi(self.tries.len() as i32 - 1);
        if expected.is_finite() { expected.clamp(least, rate_control::MAX_OPEN_STEP) } else { least }
    }

    /// Returns the ends of the bracket: the largest failed try below the smallest successful one, and the smallest
    /// successful one.
    fn bracket(&self) -> (Option<Try>, Option<Try>) {
        let by_size = |a: &&Try, b: &&Try| a.size.total_cmp(&b.size);
        let high = self.tries.iter().filter(|t| t.score >= self.goal.required).min_by(by_size).copied();
        let is_below = |t: &&Try| t.score < self.goal.required && high.is_none_or(|high| t.size < high.size);
        (self.tries.iter().filter(is_below).max_by(by_size).copied(), high)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Six points for each doubling of the size.
    struct Straight;

    impl Curve for Straight {
        fn size(&self, score: f64) -> f64 {
            score / 6.0 - 8.0
        }

        fn beyond(&self, tried: Try, wanted: f64) -> f64 {
            tried.size + (wanted - tried.score) / 6.0
        }

        fn between(&self, low: Try, high: Try, wanted: f64) -> f64 {
            low.size + (wanted - low.score) / (high.score - low.score) * (high.size - low.size)
        }
    }

    const SIZES: [f64; 2] = [-9.0, 1.0];

    /// Searches for the score `wanted` in a picture whose score is a function of the size. Returns the sizes that were
    /// tried, and the smallest one that reached the score.
    fn search(wanted: f64, score: impl Fn(f64) -> f64) -> (Vec<f64>, Option<f64>) {
        let mut search =
            Search::new(Straight, ScoreGoal { required: wanted, aimed: wanted + 0.05, sizes: SIZES, tries: 8 });
        let mut tried = Vec::new();
        while let Some(size) = search.next() {
            assert!((SIZES[0]..=SIZES[1]).contains(&size), "{size}");
            search.note(size, score(size));
            tried.push(size);
            assert!(tried.len() < 14, "{tried:?}");
            if (0.0..0.1).contains(&(score(size) - wanted)) {
                break;
            }
        }
        let good = tried.iter().copied().filter(|&size| score(size) >= wanted).reduce(f64::min);
        (tried, good)
    }

    #[test]
    fn a_reachable_score_is_found_at_any_slope() {
        for slope in [0.7, 3.0, 6.0, 25.0] {
            for at in [-8.5, -4.0, 0.0, 0.95] {
                let (tried, good) = search(30.0, |size| 30.0 + slope * (size - at));
                let good = good.unwrap_or_else(|| panic!("slope {slope} at {at}: {tried:?}"));
                assert!(slope * (good - at) < 1.0 || good - at < 0.2, "slope {slope} at {at}: {good} of {tried:?}");
            }
        }
    }

    #[test]
    fn a_jump_of_the_score_is_found() {
        // The score jumps at a certain size, as for a checkerboard of single pixels.
        for at in [-6.0, -1.0, 0.9] {
            for wanted in [18.0, 20.0, 22.0, 30.0, 40.0] {
                let (tried, good) = search(wanted, |size| if size < at { 6.0 } else { 60.0 });
                assert!(good.is_some_and(|good| good - at < 1.5), "{wanted} at {at}: {good:?} of {tried:?}");
            }
        }
    }

    #[test]
    fn a_search_fails_only_after_the_largest_size() {
        let (tried, good) = search(90.0, |size| 20.0 + size);
        assert!(
            good.is_none() && tried.last() == Some(&SIZES[1]) && tried.len() <= rate_control::MAX_FAILED_TRIES + 1,
            "{tried:?}"
        );
        // The smallest file is good enough.
        let (tried, good) = search(10.0, |size| 90.0 + size);
        assert!(good == Some(SIZES[0]) && tried.len() <= rate_control::MAX_FAILED_TRIES + 3, "{tried:?}");
    }

    #[test]
    fn a_score_is_found_despite_scatter() {
        // Scores scatter by up to 3 points in both directions.
        let score = |size: f64| 30.0 + 6.0 * (size + 3.0) + 3.0 * (size * 977.0).sin();
        for wanted in [10.0, 28.0, 31.0, 45.0] {
            let (tried, good) = search(wanted, score);
            assert!(good.is_some(), "{wanted}: {tried:?}");
        }
    }
}
