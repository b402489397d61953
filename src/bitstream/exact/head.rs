//! Contents of the exact layer's section (spec §12.1).

use crate::bitstream::broken::Broken;
use crate::bitstream::bytes::{Bytes, put_varint};
use crate::bitstream::detail::head::Spans;
use crate::error::Result;

/// Logarithms of the sides of the smallest and the largest tiles.
pub(crate) const SIDES: std::ops::RangeInclusive<u8> = 5..=11;

/// Parameters of the exact layer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct ExactHead {
    /// Length and checksum of the Gaussians' bytes.
    pub spans: Spans,
    /// Bytes of the detail layer, between the Gaussians and the exact layer.
    pub detail: u64,
    /// Logarithm of the side of the tiles.
    pub side: u8,
}

/// Returns the contents of the section.
pub(crate) fn contents(head: &ExactHead) -> Vec<u8> {
    let mut contents = Vec::new();
    put_varint(head.spans.payload, &mut contents);
    contents.extend(head.spans.checksum.to_le_bytes());
    put_varint(head.detail, &mut contents);
    contents.push(head.side);
    contents
}

/// Reads the contents of the section.
pub(crate) fn read(contents: &[u8], offset: u64) -> Result<ExactHead> {
    let mut bytes = Bytes::new(contents, offset);
    let spans = Spans { payload: bytes.varint("payload length")?, checksum: bytes.u32("payload checksum")? };
    let detail = bytes.varint("detail layer length")?;
    let [side] = bytes.array("side of the exact tiles")?;
    bytes.finish()?;
    check_side(side)?;
    Ok(ExactHead { spans, detail, side })
}

/// Checks the side of the tiles against the format.
pub(crate) fn check_side(side: u8) -> Result<(), Broken> {
    if SIDES.contains(&side) { Ok(()) } else { Err(Broken { field: "side of the exact tiles", value: side.into() }) }
}
