//! Points in time by the system clock, or on WebAssembly without an operating system, by a clock that the program
//! provides.

#[cfg(not(all(target_family = "wasm", target_os = "unknown")))]
pub(crate) use std::time::Instant;

#[cfg(all(target_family = "wasm", target_os = "unknown"))]
pub(crate) use provided::Instant;
#[cfg(all(target_family = "wasm", target_os = "unknown"))]
pub use provided::provide_clock;

#[cfg(any(test, all(target_family = "wasm", target_os = "unknown")))]
#[cfg_attr(test, allow(dead_code, reason = "tests compile this module on all platforms and use a part of it"))]
mod provided {
    use std::ops::{Add, Sub};
    use std::sync::OnceLock;
    use std::time::Duration;

    /// Seconds since an arbitrary fixed moment.
    static CLOCK: OnceLock<fn() -> f64> = OnceLock::new();

    /// Provides the clock of this program, a function that returns the seconds since an arbitrary fixed moment. Returns
    /// whether no clock was provided before. Without a clock, time stands still: time limits never expire, and all
    /// reported durations are 0.
    pub fn provide_clock(seconds: fn() -> f64) -> bool {
        CLOCK.set(seconds).is_ok()
    }

    /// A point in time, with the methods of [`std::time::Instant`].
    #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
    pub(crate) struct Instant(Duration);

    impl Instant {
        pub(crate) fn now() -> Self {
            let seconds = CLOCK.get().map_or(0.0, |clock| clock());
            Instant(Duration::try_from_secs_f64(seconds).unwrap_or_default())
        }

        pub(crate) fn elapsed(&self) -> Duration {
            Instant::now().saturating_duration_since(*self)
        }

        pub(crate) fn saturating_duration_since(&self, earlier: Instant) -> Duration {
            self.0.saturating_sub(earlier.0)
        }

        pub(crate) fn checked_add(&self, time: Duration) -> Option<Self> {
            self.0.checked_add(time).map(Instant)
        }

        pub(crate) fn checked_sub(&self, time: Duration) -> Option<Self> {
            self.0.checked_sub(time).map(Instant)
        }
    }

    impl Add<Duration> for Instant {
        type Output = Instant;

        fn add(self, time: Duration) -> Instant {
            Instant(self.0.saturating_add(time))
        }
    }

    impl Sub for Instant {
        type Output = Duration;

        fn sub(self, earlier: Instant) -> Duration {
            self.saturating_duration_since(earlier)
        }
    }

    #[cfg(test)]
    mod tests {
        use super::*;

        #[test]
        fn time_stands_still_without_a_clock_and_never_runs_backwards() {
            assert_eq!(Instant::now(), Instant::now());
            let later = Instant::now() + Duration::from_secs(2);
            assert_eq!((later.elapsed(), later - Instant::now()), (Duration::ZERO, Duration::from_secs(2)));
            assert!(provide_clock(|| 5.0) && !provide_clock(|| 9.0));
            assert_eq!(later.elapsed(), Duration::from_secs(3));
            assert_eq!(later.checked_add(Duration::MAX), None);
            assert_eq!(later.checked_sub(Duration::from_secs(3)), None);
        }
    }
}
