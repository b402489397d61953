//! Compresses planes with zstd; in WebAssembly, and without the feature `encode`, planes are stored uncompressed.

use crate::error::Result;

/// zstd's compression level; the layout favours fast reading, so writing may be slow.
#[cfg(all(feature = "encode", not(target_family = "wasm")))]
const LEVEL: i32 = 19;

/// Binary logarithm of the largest window that zstd supports on every machine.
#[cfg(all(feature = "encode", not(target_family = "wasm")))]
const MAX_WINDOW_LOG: u32 = 30;

/// Returns the frame of `plane`, without content size and checksum, in the smallest window that holds it; `None` if
/// there is no such window.
#[cfg(all(feature = "encode", not(target_family = "wasm")))]
pub(crate) fn compress(plane: &[u8]) -> Result<Option<Vec<u8>>> {
    let window = plane.len().next_power_of_two().ilog2().max(10);
    if window > MAX_WINDOW_LOG {
        return Ok(None);
    }
    let mut compressor = zstd::bulk::Compressor::new(LEVEL)?;
    compressor.window_log(window)?;
    compressor.include_contentsize(false)?;
    compressor.include_checksum(false)?;
    Ok(Some(compressor.compress(plane)?))
}

/// Returns no frame: every plane is stored uncompressed, which the format allows.
#[cfg(not(all(feature = "encode", not(target_family = "wasm"))))]
#[expect(clippy::unnecessary_wraps, reason = "the twin of a compressor that can fail")]
pub fn compress(_plane: &[u8]) -> Result<Option<Vec<u8>>> {
    Ok(None)
}
