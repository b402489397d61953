//! Finds and corrects the checksums in a file with a detail layer or an exact layer.

use std::ops::Range;

use ssplat::Limits;
use ssplat::unstable::bitstream::header::{Header, Sections};

/// The parts of a file with a detail layer.
pub struct Layout {
    /// The file's header.
    pub header: Range<usize>,
    /// The section's name, length, checksum and contents.
    pub section: Range<usize>,
    /// The contents alone.
    pub contents: Range<usize>,
    pub payload: Range<usize>,
    /// The checksums of the tiles that have a stream, and the streams.
    pub tiles: Vec<(Range<usize>, Range<usize>)>,
}

/// Finds the parts. Returns `None` if the file ends before them or has no layer. A layer whose index is broken has no
/// tiles.
pub fn layout(bytes: &[u8]) -> Option<Layout> {
    layout_of(bytes, b"Dtal")
}

/// Finds the parts of the layer whose section has this name.
fn layout_of(bytes: &[u8], name: &[u8; 4]) -> Option<Layout> {
    let mut rest = bytes;
    let head = Header::read(&mut rest, &Limits::default()).ok()?;
    if head.sections != Sections::Present {
        return None;
    }
    let mut at = bytes.len() - rest.len();
    let header = 0..at;
    let mut layer = None;
    for _ in 0..varint(bytes, &mut at)? {
        let start = at;
        at += 4;
        let length = usize::try_from(varint(bytes, &mut at)?).ok()?;
        let contents = at + 4..(at + 4).checked_add(length).filter(|&end| end <= bytes.len())?;
        at = contents.end;
        if &bytes[start..start + 4] == name {
            layer = Some((start..at, contents));
        }
    }
    let (section, contents) = layer?;
    let length = usize::try_from(varint(bytes, &mut contents.start.clone())?).ok()?;
    let payload = at..at.checked_add(length).filter(|&end| end <= bytes.len())?;
    let (mut start, mut side) = (payload.end, 256);
    if name == b"Exac" {
        let mut at = contents.start;
        varint(bytes, &mut at)?;
        at += 4;
        start = start.checked_add(usize::try_from(varint(bytes, &mut at)?).ok()?)?;
        side = 1 << bytes.get(at).filter(|side| (5..=11).contains(*side))?;
    }
    let count = u64::from(head.width).div_ceil(side) * u64::from(head.height).div_ceil(side);
    let tiles = tiles(bytes, start, count).unwrap_or_default();
    Some(Layout { header, section, contents, payload, tiles })
}

fn tiles(bytes: &[u8], mut at: usize, count: u64) -> Option<Vec<(Range<usize>, Range<usize>)>> {
    let mut entries = Vec::new();
    for _ in 0..count {
        let length = usize::try_from(varint(bytes, &mut at)?).ok()?;
        if length > 0 {
            entries.push((at..at + 2, length));
            at += 2;
        }
    }
    let mut out = Vec::new();
    for (check, length) in entries {
        let stream = at..at.checked_add(length).filter(|&end| end <= bytes.len())?;
        at = stream.end;
        out.push((check, stream));
    }
    Some(out)
}

/// Sets the checksums of tiles, payload and section to the values that a reader computes; that of the file is not
/// changed.
pub fn mend(bytes: &mut [u8]) {
    mend_layer(bytes, b"Dtal");
    mend_layer(bytes, b"Exac");
}

fn mend_layer(bytes: &mut [u8], name: &[u8; 4]) {
    let Some(Layout { header, section, contents, payload, tiles }) = layout_of(bytes, name) else { return };
    for (check, stream) in tiles {
        let right = crc32fast::hash(&bytes[stream]) as u16;
        bytes[check].copy_from_slice(&right.to_le_bytes());
    }
    let right = crc32fast::hash(&[&bytes[header.clone()], &bytes[payload]].concat());
    let mut at = contents.start;
    if varint(bytes, &mut at).is_some() && at + 4 <= contents.end {
        bytes[at..at + 4].copy_from_slice(&right.to_le_bytes());
    }
    mend_section(bytes, &header, &section, &contents);
}

/// Sets the checksum of the section alone.
pub fn mend_section(bytes: &mut [u8], header: &Range<usize>, section: &Range<usize>, contents: &Range<usize>) {
    let header = crc32fast::hash(&bytes[header.clone()]).to_le_bytes();
    let name = &bytes[section.start..section.start + 4];
    let right = crc32fast::hash(&[&header[..], name, &bytes[contents.clone()]].concat());
    bytes[contents.start - 4..contents.start].copy_from_slice(&right.to_le_bytes());
}

fn varint(bytes: &[u8], at: &mut usize) -> Option<u64> {
    let mut value = 0;
    for shift in (0..63).step_by(7) {
        let byte = *bytes.get(*at)?;
        *at += 1;
        value |= u64::from(byte & 0x7f) << shift;
        if byte < 0x80 {
            return Some(value);
        }
    }
    None
}
