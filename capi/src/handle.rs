//! What decoders and encoders share: one call at a time, the message of the last error, no panic beyond them.

use std::ffi::{c_char, c_void};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::ptr;
use std::sync::{Mutex, MutexGuard, PoisonError, TryLockError};

use crate::failure::{Failure, Outcome, ssplat_status};

/// What the library holds for C, with the message of the last call that failed.
#[derive(Default)]
pub struct Held<T> {
    message: String,
    pub held: T,
}

/// A decoder or an encoder.
pub trait Handle {
    type Held: Default;

    /// Names it in messages.
    const NAME: &str;

    fn lock(&self) -> &Mutex<Held<Self::Held>>;

    /// Drops what a panic left half done.
    fn abandon(held: &mut Self::Held);
}

/// Moves a new handle to C, NULL if memory runs out.
pub fn give_out<H>(make: impl FnOnce() -> H) -> *mut H {
    catch_unwind(AssertUnwindSafe(|| Box::into_raw(Box::new(make())))).unwrap_or(ptr::null_mut())
}

/// Waits for nobody: a handle in use stays so.
fn try_lock<H: Handle>(handle: &H) -> Option<MutexGuard<'_, Held<H::Held>>> {
    match handle.lock().try_lock() {
        Ok(held) => Some(held),
        Err(TryLockError::Poisoned(held)) => Some(PoisonError::into_inner(held)),
        Err(TryLockError::WouldBlock) => None,
    }
}

/// Frees what `*handle` points to and sets it to NULL, unless it is in use.
///
/// # Safety
/// `handle` is NULL or points to a variable, which holds NULL or a handle of [`give_out`] that has not been freed.
pub unsafe fn free<H: Handle>(handle: *mut *mut H) -> ssplat_status {
    if handle.is_null() {
        return ssplat_status::Ok;
    }
    // SAFETY: the caller of this function vouches for the variable.
    let held = unsafe { handle.read() };
    // SAFETY: as above, and for what it holds.
    let Some(used) = (unsafe { held.as_ref() }) else { return ssplat_status::Ok };
    if try_lock(used).is_none() {
        return ssplat_status::Busy;
    }
    // SAFETY: as above; it may be written.
    unsafe { handle.write(ptr::null_mut()) };
    // SAFETY: `give_out` made it by `Box::into_raw`, and no call uses it.
    let made = unsafe { Box::from_raw(held) };
    match catch_unwind(AssertUnwindSafe(|| drop(made))) {
        Ok(()) => ssplat_status::Ok,
        Err(_) => ssplat_status::Internal,
    }
}

/// Runs `work` on what a handle holds, keeps the message of its error, and stops panics.
///
/// # Safety
/// `handle` is NULL or a handle that has not been freed.
pub unsafe fn enter<H: Handle>(handle: *const H, work: impl FnOnce(&mut H::Held) -> Outcome<()>) -> ssplat_status {
    // SAFETY: the caller of this function vouches for it.
    let Some(handle) = (unsafe { handle.as_ref() }) else { return ssplat_status::Parameter };
    let Some(mut guard) = try_lock(handle) else { return ssplat_status::Busy };
    let Held { message, held } = &mut *guard;
    let done = catch_unwind(AssertUnwindSafe(|| work(held))).unwrap_or_else(|panic| {
        H::abandon(held);
        let words = panic.downcast_ref::<String>().map(String::as_str).or(panic.downcast_ref::<&str>().copied());
        Err(Failure::new(ssplat_status::Internal, format_args!("internal error: {}", words.unwrap_or("unknown"))))
    });
    match done {
        Ok(()) => {
            message.clear();
            ssplat_status::Ok
        }
        Err(failure) => {
            *message = failure.message;
            failure.status
        }
    }
}

/// Copies the message of the last call that failed; its length.
///
/// # Safety
/// `handle` is NULL or a handle that has not been freed, and `buffer` is NULL or has `capacity` bytes.
pub unsafe fn message<H: Handle>(handle: *const H, buffer: *mut c_char, capacity: usize) -> usize {
    // SAFETY: the caller of this function vouches for it.
    let message = match unsafe { handle.as_ref() } {
        None => format!("the {} is NULL", H::NAME),
        Some(handle) => match try_lock(handle) {
            Some(held) => held.message.clone(),
            None => format!("another call is using the {}", H::NAME),
        },
    };
    if let (false, Some(most)) = (buffer.is_null(), capacity.checked_sub(1)) {
        // A character is not cut in two.
        let kept = (0..=most.min(message.len())).rev().find(|&k| message.is_char_boundary(k)).unwrap_or(0);
        // SAFETY: the caller says that `buffer` has `capacity` bytes, and `kept` is below that.
        unsafe { ptr::copy_nonoverlapping(message.as_ptr(), buffer.cast(), kept) };
        // SAFETY: as above.
        let end = unsafe { buffer.add(kept) };
        // SAFETY: as above.
        unsafe { end.write(0) };
    }
    message.len()
}

/// Writes an answer to a variable of the caller.
///
/// # Safety
/// `to` is NULL or may be written.
pub unsafe fn give<T>(name: &str, to: *mut T, value: T) -> Outcome<()> {
    if to.is_null() {
        return Err(Failure::parameter(format_args!("{name} is NULL")));
    }
    // SAFETY: the caller of this function vouches for it.
    unsafe { to.write(value) };
    Ok(())
}

/// The bytes of a caller.
///
/// # Safety
/// `size` bytes at `data` can be read, and nothing writes them while the result is used; or `data` is NULL.
pub unsafe fn bytes<'a>(name: &str, data: *const c_void, size: usize) -> Outcome<&'a [u8]> {
    match size {
        0 => Ok(&[]),
        _ if data.is_null() => Err(Failure::parameter(format_args!("{name} is NULL"))),
        _ if size > isize::MAX as usize => {
            Err(Failure::parameter(format_args!("size is {size}, more than an object can have")))
        }
        // SAFETY: the caller of this function vouches for it.
        _ => Ok(unsafe { std::slice::from_raw_parts(data.cast(), size) }),
    }
}

/// Refuses fields that a later version of the library may use.
pub fn zeros(name: &str, reserved: &[u32]) -> Outcome<()> {
    match reserved.iter().find(|&&v| v != 0) {
        Some(v) => Err(Failure::parameter(format_args!("reserved of {name} holds {v} where zeros are needed"))),
        None => Ok(()),
    }
}
