//! The wall-clock time budget of an encode, which all its fits share.

use crate::instant::Instant;
use std::time::Duration;

/// A time budget that starts when it is created.
#[derive(Debug, Clone, Copy)]
pub(super) struct Clock {
    /// The deadline; `None` if there is no budget, or if its end cannot be represented.
    end: Option<Instant>,
}

impl Clock {
    /// Starts a budget of `time`.
    pub(super) fn new(time: Option<Duration>) -> Self {
        Clock { end: time.and_then(|t| Instant::now().checked_add(t)) }
    }

    /// Returns the remaining time, which is zero after the deadline. Returns `None` without a budget.
    pub(super) fn left(&self) -> Option<Duration> {
        self.end.map(|end| end.saturating_duration_since(Instant::now()))
    }

    /// Returns whether there is a budget and all of it is spent.
    pub(super) fn is_over(&self) -> bool {
        self.left().is_some_and(|left| left.is_zero())
    }

    /// Reserves `time` for the work after the fits.
    pub(super) fn keep(&mut self, time: Duration) {
        self.end = self.end.map(|end| end.checked_sub(time).unwrap_or(end));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_budget_without_a_representable_end_has_no_deadline() {
        assert_eq!(Clock::new(Some(Duration::MAX)).left(), None);
        assert_eq!(Clock::new(None).left(), None);
        assert_eq!(Clock::new(Some(Duration::ZERO)).left(), Some(Duration::ZERO));
    }

    #[test]
    fn reserved_time_is_subtracted_from_the_remaining_time() {
        let mut clock = Clock::new(Some(Duration::from_secs(100)));
        clock.keep(Duration::from_secs(40));
        assert!(clock.left().is_some_and(|left| left <= Duration::from_secs(60)));
    }
}
