//! The codec for C. `include/ssplat.h`, which is made from these files, is its documentation.
//!
//! `decoder`, `encoder` and `handle` follow C's pointers and are the only files with `unsafe`; `session`, `encoding` and
//! `format` do the work. A panic never reaches C.

mod decoder;
#[cfg(feature = "encode")]
mod encoder;
#[cfg(feature = "encode")]
mod encoding;
mod failure;
mod format;
mod handle;
mod session;

use std::ffi::{CStr, c_char, c_int};

pub use decoder::*;
#[cfg(feature = "encode")]
pub use encoder::*;
#[cfg(feature = "encode")]
pub use encoding::{ssplat_option, ssplat_target, ssplat_tune};
pub use failure::ssplat_status;
pub use format::ssplat_format;

/// Version of this header; ssplat_version() is that of the library.
pub const SSPLAT_VERSION_MAJOR: u32 = 1;
/// Version of this header.
pub const SSPLAT_VERSION_MINOR: u32 = 0;
/// Version of this header.
pub const SSPLAT_VERSION_PATCH: u32 = 0;

/// Returns the version of the library, such as "1.0.0".
#[unsafe(no_mangle)]
pub extern "C" fn ssplat_version() -> *const c_char {
    const VERSION: &str = concat!(env!("CARGO_PKG_VERSION"), "\0");
    VERSION.as_ptr().cast()
}

/// Returns a word for a status, such as "format"; "unknown" for other numbers.
#[unsafe(no_mangle)]
pub extern "C" fn ssplat_status_name(status: c_int) -> *const c_char {
    const NAMES: [&CStr; 14] = [
        c"ok",
        c"io",
        c"format",
        c"version",
        c"limit",
        c"parameter",
        c"cancelled",
        c"memory",
        c"buffer",
        c"closed",
        c"busy",
        c"internal",
        c"size",
        c"truncated",
    ];
    usize::try_from(status).ok().and_then(|k| NAMES.get(k)).unwrap_or(&c"unknown").as_ptr()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_macros_have_the_version_of_the_package() {
        let macros = [SSPLAT_VERSION_MAJOR, SSPLAT_VERSION_MINOR, SSPLAT_VERSION_PATCH].map(|v| v.to_string());
        assert_eq!(macros.join("."), env!("CARGO_PKG_VERSION"));
    }
}
