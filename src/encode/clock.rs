//! The wall-clock time that an encode may take: one budget, however many fits it is spent on.

use crate::instant::Instant;
use std::time::Duration;

/// A budget of time that runs since it was made.
#[derive(Debug, Clone, Copy)]
pub(super) struct Clock {
    /// When the work should be over; `None` without a budget, or with one that no clock can tell the end of.
    end: Option<Instant>,
}

impl Clock {
    /// Starts a budget of `time`.
    pub(super) fn new(time: Option<Duration>) -> Self {
        Clock { end: time.and_then(|t| Instant::now().checked_add(t)) }
    }

    /// Returns the time that is left, nothing once it is over; `None` without a budget.
    pub(super) fn left(&self) -> Option<Duration> {
        self.end.map(|end| end.saturating_duration_since(Instant::now()))
    }

    /// Tells whether there is a budget, and all of it is spent.
    pub(super) fn is_over(&self) -> bool {
        self.left().is_some_and(|left| left.is_zero())
    }

    /// Keeps `time` for what comes behind the fits.
    pub(super) fn keep(&mut self, time: Duration) {
        self.end = self.end.map(|end| end.checked_sub(time).unwrap_or(end));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_budget_that_no_clock_can_tell_the_end_of_is_none() {
        assert_eq!(Clock::new(Some(Duration::MAX)).left(), None);
        assert_eq!(Clock::new(None).left(), None);
        assert_eq!(Clock::new(Some(Duration::ZERO)).left(), Some(Duration::ZERO));
    }

    #[test]
    fn what_is_kept_is_taken_from_what_is_left() {
        let mut clock = Clock::new(Some(Duration::from_secs(100)));
        clock.keep(Duration::from_secs(40));
        assert!(clock.left().is_some_and(|left| left <= Duration::from_secs(60)));
    }
}
