//! Frames by zstd.

use crate::error::Result;

/// zstd's level; the layout is for reading fast, so writing may take its time.
const LEVEL: i32 = 19;

/// Binary logarithm of the largest window that zstd has on every machine.
const MOST_WINDOW: u32 = 30;

/// The frame of `plane`, without its size and without a checksum, in a window that just holds it; none where there is no such window.
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

/// Fills `plane` from the one frame that `frame` is, straight and without a window; `None` if it is anything else.
pub fn decompress(frame: &[u8], plane: &mut [u8]) -> Option<()> {
    // One frame and nothing behind it.
    if zstd::zstd_safe::find_frame_compressed_size(frame).ok() != Some(frame.len()) {
        return None;
    }
    let written = zstd::bulk::Decompressor::new().ok()?.decompress_to_buffer(frame, plane).ok()?;
    (written == plane.len()).then_some(())
}
