//! Panics turned into errors: a bug in a decoder for one file does not end the work on the others.

use std::any::Any;
use std::cell::Cell;
use std::panic::{AssertUnwindSafe, PanicHookInfo, catch_unwind, set_hook, take_hook};
use std::sync::Once;

thread_local! {
    /// Whether this thread's panics are told by whoever catches them.
    static IS_QUIET: Cell<bool> = const { Cell::new(false) };
}

/// Does `work`; a panic in it is an error with its message, and nothing is printed.
///
/// What `work` has changed when it panics must not be used any more.
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

/// Does `work`; a panic in it is printed as ever, and is an error with its message.
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
