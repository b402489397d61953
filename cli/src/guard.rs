//! Converts panics to errors, so that a decoder that panics on one file does not end a batch.

use std::any::Any;
use std::cell::Cell;
use std::panic::{AssertUnwindSafe, PanicHookInfo, catch_unwind, set_hook, take_hook};
use std::sync::Once;

thread_local! {
    /// Whether the panic hook prints nothing for this thread.
    static IS_QUIET: Cell<bool> = const { Cell::new(false) };
}

/// Calls `work`. Returns the message of a panic as an error, without printing it.
///
/// State that `work` has changed before a panic must not be used afterwards.
pub fn quietly<T>(work: impl FnOnce() -> T) -> Result<T, String> {
    static HOOK: Once = Once::new();
    HOOK.call_once(|| {
        let told = take_hook();
        set_hook(Box::new(move |info: &PanicHookInfo| {
            if !IS_QUIET.get() {
                told(info);
            }
        }));
    });
    let before = IS_QUIET.replace(true);
    let outcome = aloud(work);
    IS_QUIET.set(before);
    outcome
}

/// Calls `work`. Returns the message of a panic as an error; the panic hook prints it as usual.
pub fn aloud<T>(work: impl FnOnce() -> T) -> Result<T, String> {
    catch_unwind(AssertUnwindSafe(work)).map_err(|panic| message(&*panic))
}

fn message(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<&str>().map(|text| (*text).to_owned());
    text.or_else(|| panic.downcast_ref::<String>().cloned()).unwrap_or_else(|| "a panic".into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_is_an_error_with_its_message() {
        assert_eq!(quietly(|| 5), Ok(5));
        let number = 7;
        assert_eq!(quietly(|| -> u8 { panic!("no {number}") }), Err("no 7".into()));
        assert_eq!(aloud(|| -> u8 { panic!("plain") }), Err("plain".into()));
        assert!(!IS_QUIET.get());
    }
}
