//! Frames by zstd; in WebAssembly planes are written as they are.

use crate::error::Result;

/// zstd's level; the layout is for reading fast, so writing may take its time.
#[cfg(not(target_family = "wasm"))]
const LEVEL: i32 = 19;

/// Binary logarithm of the largest window that zstd has on every machine.
#[cfg(not(target_family = "wasm"))]
const MOST_WINDOW: u32 = 30;

/// The frame of `plane`, without its size and without a checksum, in a window that just holds it; none where there is no such window.
#[cfg(not(target_family = "wasm"))]
pub fn compress(plane: &[u8]) -> Result<Option<Vec<u8>>> {
    let window = plane.len().next_power_of_two().ilog2().max(10);
    if window > MOST_WINDOW {
        return Ok(None);
    }
    let mut compressor = zstd::bulk::Compressor::new(LEVEL)?;
    compressor.window_log(window)?;
    compressor.include_contentsize(false)?;
    compressor.include_checksum(false)?;
    Ok(Some(compressor.compress(plane)?))
}

/// Never a frame: every plane is stored as it is, which is legal.
#[cfg(target_family = "wasm")]
#[expect(clippy::unnecessary_wraps, reason = "the twin of a compressor that can fail")]
pub fn compress(_plane: &[u8]) -> Result<Option<Vec<u8>>> {
    Ok(None)
}
