//! The size loop: sweeps over the integers, and corrections of their number, until the file has the requested size. The
//! loop is the same for the integers of a whole picture and for those of a picture in tiles.

use std::time::Duration;

use crate::constants::rdo;
use crate::error::Result;
use crate::instant::Instant;
use crate::rdo::size::{Size, is_settled};

/// Integers of a picture, and the file that they make.
pub(crate) trait IntegerSet {
    /// A copy of the integers.
    type Snapshot;

    /// Called before every round. An error stops the loop.
    fn start_round(&mut self, round: u32, rounds: u32) -> Result<()>;
    /// Returns whether there are no primitives.
    fn is_empty(&self) -> bool;
    /// Returns the length of the file. May sort the integers into the order of the file.
    fn bytes(&mut self) -> Result<u64>;
    /// Returns the squared error of the picture, with the weights of the fit.
    fn error(&mut self) -> Result<f64>;
    /// Sweeps over all integers once, where each bit must save `lambda` of the squared error. Returns by how much
    /// `error + lambda * bits` fell, if that is known.
    fn sweep(&mut self, lambda: f64) -> Result<Option<f64>>;
    /// Removes the cheapest primitives of a file of `bytes`, or adds some where the error is largest, to bring it to
    /// `max_bytes`.
    fn resize(&mut self, bytes: u64, max_bytes: u64) -> Result<()>;
    fn snapshot(&self) -> Self::Snapshot;
    fn restore(&mut self, snapshot: Self::Snapshot);
}

/// The size to reach, and the work that may be done for it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SizeSchedule {
    pub size: Size,
    /// Number of planned sweeps.
    pub sweeps: u32,
    /// Whether there are sweeps at all. Without them, only the size is corrected.
    pub descends: bool,
    /// Squared error, with the weights of the fit, at which more primitives gain nothing. The loop then ends with a file
    /// that may be smaller than its size.
    pub enough: f64,
    /// When the loop should end, whatever remains to be done.
    pub deadline: Option<Instant>,
}

impl SizeSchedule {
    /// Returns whether the time will be up before work that takes `next` is complete.
    fn is_over(&self, next: Duration) -> bool {
        self.deadline.is_some_and(|d| d.saturating_duration_since(Instant::now()) <= next)
    }
}

/// Refines `set` until its file has the requested size, and leaves the best integers in it whose file is not too large.
/// The file is too large only if it is so without primitives.
///
/// # Errors
/// Returns an error of `set`.
pub(crate) fn bring_to_size<S: IntegerSet>(set: &mut S, schedule: SizeSchedule) -> Result<()> {
    let sizing = SizeLoop { set, schedule, best: None, quiet: 0, expected_bytes: 0.0, shrink: rdo::FIRST_SHRINK };
    sizing.run()
}

/// Removes the cheapest primitives until the file, which takes `bytes`, takes at most `max_bytes` or no primitive is
/// left.
///
/// # Errors
/// Returns an error of `set`.
pub(crate) fn trim<S: IntegerSet>(set: &mut S, mut bytes: u64, max_bytes: u64) -> Result<()> {
    while bytes > max_bytes && !set.is_empty() {
        set.resize(bytes, max_bytes)?;
        bytes = set.bytes()?;
    }
    Ok(())
}

/// The state of the loop from round to round.
struct SizeLoop<'a, S: IntegerSet> {
    set: &'a mut S,
    schedule: SizeSchedule,
    best: Option<Best<S::Snapshot>>,
    /// Number of consecutive quiet sweeps.
    quiet: u32,
    /// Expected bytes of the file before the last sweep.
    expected_bytes: f64,
    /// Share of the bytes that the next sweep is expected to save.
    shrink: f64,
}

impl<S: IntegerSet> SizeLoop<'_, S> {
    fn run(mut self) -> Result<()> {
        let SizeSchedule { size, sweeps, descends, .. } = self.schedule;
        let mut bytes = self.set.bytes()?;
        self.expected_bytes = bytes as f64;
        let rounds = sweeps.max(rdo::MIN_SWEEPS) + rdo::EXTRA_ROUNDS;
        // Duration of a round, if it is known yet.
        let mut round_time = Duration::ZERO;
        for round in 0..rounds {
            let start = Instant::now();
            self.set.start_round(round, rounds)?;
            let is_late = self.schedule.is_over(round_time);
            if size == Size::Free && (is_late || round >= sweeps || self.quiet >= rdo::QUIET_SWEEPS) {
                break;
            }
            let error = self.set.error()?;
            if let Size::Bytes(max_bytes) = size
                && self.fits(round, error, (bytes, max_bytes), is_late)?
            {
                break;
            }
            // When the time is up, only the size is still corrected.
            if !is_late && descends {
                self.sweep(error, bytes)?;
            }
            bytes = self.set.bytes()?;
            self.shrink = rdo::SHRINK_DECAY * (1.0 - bytes as f64 / self.expected_bytes).max(0.0);
            self.expected_bytes = bytes as f64;
            if !is_late {
                round_time = start.elapsed();
            }
        }
        match size {
            Size::Bytes(max_bytes) => self.within(bytes, max_bytes),
            Size::Free => Ok(()),
        }
    }

    /// Returns whether a file of `bytes` is good enough for `max_bytes`, and corrects its size when that is due.
    fn fits(&mut self, round: u32, error: f64, (bytes, max_bytes): (u64, u64), is_late: bool) -> Result<bool> {
        let sweeps = self.schedule.sweeps;
        self.keep(error, bytes, max_bytes);
        if bytes <= max_bytes && error <= self.schedule.enough {
            return Ok(true);
        }
        if is_late && self.best.as_ref().is_some_and(|b| b.fills_size) {
            return Ok(true);
        }
        let is_settled = is_settled(bytes, max_bytes, rdo::SETTLED_PART);
        if is_settled && (round >= sweeps || self.quiet >= rdo::QUIET_SWEEPS) {
            return Ok(true);
        }
        if !is_settled && (is_late || round + rdo::CORRECTION_ROUNDS >= sweeps) {
            let max_bytes = if round >= sweeps { max_bytes - max_bytes / rdo::MARGIN_PART } else { max_bytes };
            // The savings of the next sweep are used now, because a correction after each sweep would cost another pass
            // over the whole picture.
            let taken = if is_late { 0.0 } else { self.shrink * max_bytes as f64 };
            let max_bytes = max_bytes + taken as u64;
            self.set.resize(bytes, max_bytes)?;
            self.expected_bytes = max_bytes as f64;
        }
        Ok(false)
    }

    /// Sweeps once over the integers of a file of `bytes` bytes.
    fn sweep(&mut self, error: f64, bytes: u64) -> Result<()> {
        let lambda = rdo::SLOPE * error / (8.0 * bytes as f64);
        let is_quiet = self.set.sweep(lambda)?.is_some_and(|gain| gain < rdo::QUIET_GAIN * error);
        self.quiet = if is_quiet { self.quiet + 1 } else { 0 };
        Ok(())
    }

    /// Leaves the best integers whose file takes at most `max_bytes`. The file of the current ones takes `bytes`.
    fn within(mut self, bytes: u64, max_bytes: u64) -> Result<()> {
        let error = self.set.error()?;
        self.keep(error, bytes, max_bytes);
        match self.best {
            Some(best) => self.set.restore(best.snapshot),
            None => trim(self.set, bytes, max_bytes)?,
        }
        Ok(())
    }

    /// Keeps the current integers if they are the best so far.
    fn keep(&mut self, error: f64, bytes: u64, max_bytes: u64) {
        let Some(unused) = max_bytes.checked_sub(bytes) else { return };
        let fills_size = unused <= (max_bytes / rdo::FILLED_PART).max(rdo::FILLED_BYTES);
        if self.best.as_ref().is_none_or(|b| (fills_size, b.error) > (b.fills_size, error)) {
            self.best = Some(Best { fills_size, error, snapshot: self.set.snapshot() });
        }
    }
}

/// The best integers so far whose file is not too large.
struct Best<T> {
    /// Whether the file fills its size, which takes precedence over the error.
    fills_size: bool,
    error: f64,
    snapshot: T,
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Primitives of 10 bytes each. The file has a header of 20 bytes.
    #[derive(Default)]
    struct Made {
        count: u64,
        sweeps: u32,
        /// Number of primitives by which a sweep lengthens the file.
        growth: u64,
    }

    impl IntegerSet for Made {
        type Snapshot = u64;

        fn start_round(&mut self, round: u32, rounds: u32) -> Result<()> {
            assert!(round < rounds);
            Ok(())
        }

        fn is_empty(&self) -> bool {
            self.count == 0
        }

        fn bytes(&mut self) -> Result<u64> {
            Ok(20 + 10 * self.count)
        }

        fn error(&mut self) -> Result<f64> {
            Ok(1e6 / (self.count + 1) as f64)
        }

        fn sweep(&mut self, lambda: f64) -> Result<Option<f64>> {
            assert!(lambda > 0.0);
            self.sweeps += 1;
            self.count += self.growth;
            Ok(None)
        }

        fn resize(&mut self, bytes: u64, max_bytes: u64) -> Result<()> {
            assert_eq!(bytes, 20 + 10 * self.count);
            self.count = max_bytes.saturating_sub(20) / 10;
            Ok(())
        }

        fn snapshot(&self) -> u64 {
            self.count
        }

        fn restore(&mut self, count: u64) {
            self.count = count;
        }
    }

    fn sized(count: u64, growth: u64, size: Size, deadline: Option<Instant>) -> Made {
        let mut set = Made { count, growth, ..Made::default() };
        bring_to_size(&mut set, SizeSchedule { size, sweeps: 4, descends: true, enough: 0.0, deadline }).unwrap();
        set
    }

    #[test]
    fn a_file_fills_its_size_and_never_exceeds_it_even_if_sweeps_lengthen_it() {
        for count in [0, 1, 50, 980, 5000] {
            for growth in [0, 1] {
                let bytes = sized(count, growth, Size::Bytes(10_000), None).bytes().unwrap();
                assert!((9_800..=10_000).contains(&bytes), "{count} primitives, {growth} more each time: {bytes}");
            }
        }
    }

    #[test]
    fn after_the_deadline_only_the_size_is_corrected() {
        for count in [10, 5000] {
            let mut set = sized(count, 0, Size::Bytes(10_000), Some(Instant::now()));
            assert_eq!(set.sweeps, 0);
            assert!((9_800..=10_000).contains(&set.bytes().unwrap()), "{count}");
        }
    }

    #[test]
    fn a_picture_that_is_good_enough_gets_no_more_primitives() {
        let mut set = Made { count: 50, ..Made::default() };
        let (size, enough) = (Size::Bytes(10_000), set.error().unwrap());
        bring_to_size(&mut set, SizeSchedule { size, sweeps: 4, descends: true, enough, deadline: None }).unwrap();
        assert_eq!((set.count, set.sweeps), (50, 0));
    }

    #[test]
    fn a_file_without_a_size_has_the_planned_sweeps() {
        let set = sized(70, 0, Size::Free, None);
        assert_eq!((set.sweeps, set.count), (4, 70));
        assert_eq!(sized(70, 0, Size::Free, Some(Instant::now())).sweeps, 0);
    }

    #[test]
    fn a_size_below_that_of_an_empty_file_leaves_no_primitives() {
        assert_eq!(sized(70, 3, Size::Bytes(15), None).count, 0);
    }
}
