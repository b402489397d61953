//! Decompresses frames with ruzstd.

use ruzstd::decoding::{BlockDecodingStrategy, FrameDecoder};

/// Number of decompressed bytes after which the decoder is drained.
const DRAIN_BYTES: usize = 1 << 17;

/// Decompresses `frame` into `plane`; returns `None` unless it is exactly one frame. Its structure has been checked,
/// which bounds the window that the decoder keeps in addition to the plane.
pub(crate) fn decompress(mut frame: &[u8], plane: &mut [u8]) -> Option<()> {
    let mut decoder = FrameDecoder::new();
    // The default limit of ruzstd refuses some valid frames.
    decoder.set_max_window_size(u64::MAX);
    decoder.init(&mut frame).ok()?;
    let mut filled = 0;
    loop {
        decoder.decode_blocks(&mut frame, BlockDecodingStrategy::UptoBytes(DRAIN_BYTES)).ok()?;
        loop {
            let read = std::io::Read::read(&mut decoder, &mut plane[filled..]).ok()?;
            filled += read;
            if read == 0 {
                break;
            }
        }
        if decoder.is_finished() {
            break;
        }
        if filled == plane.len() && decoder.can_collect() > 0 {
            return None;
        }
    }
    (filled == plane.len() && decoder.can_collect() == 0 && frame.is_empty()).then_some(())
}
