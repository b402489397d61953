//! Accounting of memory: bytes are reserved before they are allocated, and released when their owner is dropped.
//!
//! A [`Budget`] belongs to one opened file and to everything that is rendered from it. Reservations are made on the
//! caller's thread, one after the other, so that whether a reservation succeeds does not depend on the number of
//! threads.

use std::sync::{Arc, Mutex, MutexGuard};

use crate::error::Result;
use crate::limits::Limits;
use crate::parameter::Limit;

/// Number of bytes that may be allocated in total. Clones share one account.
#[derive(Debug, Clone)]
pub(crate) struct Budget(Arc<Mutex<Account>>);

#[derive(Debug)]
struct Account {
    allowed: u64,
    reserved: u64,
}

/// A part of a [`Budget`], held until it is dropped.
#[derive(Debug)]
pub(crate) struct Reservation {
    budget: Budget,
    bytes: u64,
}

impl Budget {
    /// Opens an account with the allowance of `limits`.
    pub(crate) fn of(limits: &Limits) -> Self {
        Budget(Arc::new(Mutex::new(Account { allowed: most(limits.alloc), reserved: 0 })))
    }

    fn account(&self) -> MutexGuard<'_, Account> {
        self.0.lock().expect("no holder panics")
    }

    /// Returns the number of bytes that are free.
    pub(crate) fn left(&self) -> u64 {
        let account = self.account();
        account.allowed - account.reserved
    }

    /// Checks that `bytes` could be reserved.
    ///
    /// # Errors
    /// [`Error::LimitExceeded`](crate::Error::LimitExceeded) with the number of free bytes if they could not.
    pub(crate) fn check(&self, bytes: u64) -> Result<()> {
        Limits::check(Limit::Alloc, bytes, self.left())
    }

    /// Reserves `bytes`.
    ///
    /// # Errors
    /// As [`Budget::check`].
    pub(crate) fn reserve(&self, bytes: u64) -> Result<Reservation> {
        let mut reservation = Reservation { budget: self.clone(), bytes: 0 };
        reservation.grow(bytes)?;
        Ok(reservation)
    }

    /// Sets the total allowance to `alloc` bytes.
    ///
    /// # Errors
    /// [`Error::LimitExceeded`](crate::Error::LimitExceeded) if more is already reserved; nothing changes in this
    /// case.
    pub(crate) fn allow(&self, alloc: u64) -> Result<()> {
        let mut account = self.account();
        Limits::check(Limit::Alloc, account.reserved, most(alloc))?;
        account.allowed = most(alloc);
        Ok(())
    }
}

impl Reservation {
    /// Reserves `more` bytes in addition.
    ///
    /// # Errors
    /// As [`Budget::check`]; the existing reservation is kept.
    pub(crate) fn grow(&mut self, more: u64) -> Result<()> {
        let mut account = self.budget.account();
        Limits::check(Limit::Alloc, more, account.allowed - account.reserved)?;
        account.reserved += more;
        self.bytes += more;
        Ok(())
    }

    /// Makes another reservation of `bytes` in the same budget.
    ///
    /// # Errors
    /// As [`Budget::check`].
    pub(crate) fn reserve(&self, bytes: u64) -> Result<Reservation> {
        self.budget.reserve(bytes)
    }

    /// Releases all but `bytes`, which must not exceed the reservation.
    pub(crate) fn shrink(&mut self, bytes: u64) {
        debug_assert!(bytes <= self.bytes, "{bytes} of {}", self.bytes);
        let bytes = bytes.min(self.bytes);
        self.budget.account().reserved -= self.bytes - bytes;
        self.bytes = bytes;
    }
}

impl Drop for Reservation {
    fn drop(&mut self) {
        self.shrink(0);
    }
}

/// Caps an allowance at the size of the largest possible allocation.
fn most(alloc: u64) -> u64 {
    alloc.min(isize::MAX as u64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::error::Error;

    fn budget(alloc: u64) -> Budget {
        Budget::of(&Limits { alloc, ..Limits::default() })
    }

    #[test]
    fn dropped_reservations_are_free_again() {
        let budget = budget(100);
        let mut first = budget.reserve(60).unwrap();
        assert!(matches!(budget.reserve(41), Err(Error::LimitExceeded { requested: 41, allowed: 40, .. })));
        let second = budget.clone().reserve(40).unwrap();
        assert_eq!(budget.left(), 0);
        drop(second);
        first.shrink(10);
        assert_eq!(budget.left(), 90);
        assert!(first.grow(91).is_err() && first.grow(90).is_ok());
        drop(first);
        assert_eq!(budget.left(), 100);
    }

    #[test]
    fn a_smaller_allowance_must_cover_existing_reservations() {
        let budget = budget(u64::MAX);
        assert_eq!(budget.left(), isize::MAX as u64);
        let held = budget.reserve(50).unwrap();
        assert!(matches!(budget.allow(49), Err(Error::LimitExceeded { requested: 50, allowed: 49, .. })));
        budget.allow(51).unwrap();
        assert!(budget.check(2).is_err() && budget.check(1).is_ok());
        drop(held);
        assert_eq!(budget.left(), 51);
    }
}
