//! The limits of pictures, and the messages for pictures that exceed them.

use std::path::Path;

use ssplat::unstable::input::MAX_ALLOC;

use crate::failure::{Failure, Kind};

/// Longest side of a picture in pixels.
pub const MAX_SIDE: u32 = 1 << 20;

/// Returns the message for a picture that exceeds the memory limit.
pub fn beyond_memory(path: &Path) -> String {
    let path = Failure::input(path);
    format!("{path}: needs more memory than is available, or than the {MAX_ALLOC} bytes that are allowed")
}

/// Returns the failure for a picture with a side beyond the format's limit.
pub fn too_long(path: &Path, [width, height]: [u32; 2]) -> Failure {
    let path = Failure::input(path);
    let message = format!(
        "{path}: has {width} × {height} pixels; a side has {MAX_SIDE} at most; --max-side {MAX_SIDE} downscales"
    );
    Failure { kind: Kind::Limit, message }
}
