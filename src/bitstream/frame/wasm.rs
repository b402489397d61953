//! Frames by ruzstd, which reads only: planes are written as they are.

use ruzstd::decoding::{BlockDecodingStrategy, FrameDecoder};

use crate::error::Result;

/// Blocks are drained when so many bytes of them wait.
const DRAINED: usize = 1 << 17;

/// Never a frame: every plane is stored as it is, which is legal.
#[expect(clippy::unnecessary_wraps, reason = "the twin of a compressor that can fail")]
pub fn compress(_plane: &[u8]) -> Result<Option<Vec<u8>>> {
    Ok(None)
}

/// Fills `plane` from the one frame that `frame` is; `None` if it is anything else. Its window is refused by ruzstd
/// above 100 MiB.
pub fn decompress(mut frame: &[u8], plane: &mut [u8]) -> Option<()> {
    let mut decoder = FrameDecoder::new();
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
