//! Frames by zstd.

use crate::error::Result;

/// zstd's level; the layout is for reading fast, so writing may take its time.
const LEVEL: i32 = 19;

/// The frame of `plane`, without its size and without a checksum.
pub fn compress(plane: &[u8]) -> Result<Option<Vec<u8>>> {
    let mut compressor = zstd::bulk::Compressor::new(LEVEL)?;
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
