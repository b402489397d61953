//! Frames by ruzstd.

use ruzstd::decoding::{BlockDecodingStrategy, FrameDecoder};

/// Blocks are drained when so many bytes of them wait.
const DRAINED: usize = 1 << 17;

/// Fills `plane` from the one frame that `frame` is; `None` if it is anything else. Its outline has been checked, which bounds the
/// window that is kept beside the plane.
pub fn decompress(mut frame: &[u8], plane: &mut [u8]) -> Option<()> {
    let mut decoder = FrameDecoder::new();
    // By itself it refuses some that are legal.
    decoder.set_max_window_size(u64::MAX);
    decoder.init(&mut frame).ok()?;
    let mut filled = 0;
    loop {
        decoder.decode_blocks(&mut frame, BlockDecodingStrategy::UptoBytes(DRAINED)).ok()?;
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
