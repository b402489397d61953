//! The index of a layer's tiles: the length and the checksum of the stream of each tile, before the streams (spec §11.2,
//! §12.2).

use super::broken::Broken;
use super::bytes::{Bytes, put_varint};
use super::checksum::hash;
use crate::budget::Reservation;
use crate::error::{FormatError, Result};

/// Number of streams that are read in parallel before their cost is counted.
const BATCH: usize = 64;

/// Entry of a tile.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Entry {
    /// Bytes of the stream; 0 if the tile has none.
    pub length: u64,
    /// The lower half of the stream's CRC-32.
    pub check: u16,
}

/// Names of an index in errors.
#[derive(Debug, Clone, Copy)]
pub(super) struct Names {
    pub tiles: &'static str,
    pub length: &'static str,
    pub check: &'static str,
}

/// Appends index and streams; the stream of a tile without contents is empty.
pub(super) fn put_streams(streams: &[Vec<u8>], out: &mut Vec<u8>) {
    for stream in streams {
        put_varint(stream.len() as u64, out);
        if !stream.is_empty() {
            out.extend((hash(stream) as u16).to_le_bytes());
        }
    }
    streams.iter().for_each(|stream| out.extend(stream));
}

/// Reads the index of `count` tiles, and grows `held` by the memory of the result.
pub(super) fn read(bytes: &mut Bytes<'_>, count: u64, names: Names, held: &mut Reservation) -> Result<Vec<Entry>> {
    // A tile takes at least one byte of the index, so that nothing is allocated for tiles that cannot exist.
    if count > bytes.left() as u64 {
        return Err(Broken { field: names.tiles, value: count }.into());
    }
    held.grow(size_of::<Entry>() as u64 * count)?;
    let mut entries = Vec::with_capacity(count as usize);
    for _ in 0..count {
        let length = bytes.varint(names.length)?;
        let check = if length > 0 { bytes.u16(names.check)? } else { 0 };
        entries.push(Entry { length, check });
    }
    Ok(entries)
}

/// Reads the index of `count` tiles, and returns the bytes of all streams.
pub(super) fn length(bytes: &mut Bytes<'_>, count: u64, names: Names, held: &mut Reservation) -> Result<u64> {
    if count > bytes.left() as u64 {
        // The index itself is incomplete.
        return Err(FormatError::Truncated { what: names.tiles, offset: bytes.offset() + bytes.left() as u64 }.into());
    }
    let entries = read(bytes, count, names, held)?;
    Ok(entries.iter().fold(0, |sum: u64, entry| sum.saturating_add(entry.length)))
}

/// Takes the streams of `entries`. Returns what follows the index, in which a damaged file may lack some of them if
/// `passes_over`.
pub(super) fn take<'a>(
    bytes: &mut Bytes<'a>,
    entries: &[Entry],
    what: &'static str,
    passes_over: bool,
) -> Result<&'a [u8]> {
    let streams = bytes.clone().rest();
    for entry in entries {
        match bytes.take(entry.length, what) {
            Ok(_) => {}
            Err(_) if passes_over => {
                bytes.rest();
            }
            Err(e) => return Err(e),
        }
    }
    Ok(streams)
}

/// A stream to read.
#[derive(Debug, Clone, Copy)]
pub(super) struct Stream<'a> {
    pub tile: usize,
    /// The lower half of its CRC-32, as the index has it.
    check: u16,
    /// Its bytes; `None` if the file ends before the stream does.
    bytes: Option<&'a [u8]>,
}

impl<'a> Stream<'a> {
    /// Returns the bytes if they are intact.
    pub(super) fn intact(self, what: &'static str) -> Result<&'a [u8]> {
        let bytes = self.bytes.ok_or(FormatError::Truncated { what, offset: 0 })?;
        let (stored, computed) = (self.check.into(), u32::from(hash(bytes) as u16));
        if computed != stored {
            return Err(FormatError::Checksum { what, stored, computed }.into());
        }
        Ok(bytes)
    }
}

/// Position of the next stream.
#[derive(Debug, Default)]
pub(super) struct Cursor {
    tile: usize,
    /// Offset of this stream from the first one, in bytes.
    at: u64,
}

impl Cursor {
    /// Returns the next streams to read in parallel, of tiles for which `memory` is not `None`, and the sum of their
    /// `memory`, which exceeds `max_memory` only for a single stream.
    pub(super) fn batch<'a>(
        &mut self,
        entries: &[Entry],
        streams: &'a [u8],
        max_memory: u64,
        memory: impl Fn(usize) -> Option<u64>,
    ) -> (Vec<Stream<'a>>, u64) {
        let (mut batch, mut most) = (Vec::new(), 0);
        while self.tile < entries.len() && batch.len() < BATCH {
            let Cursor { tile, at } = *self;
            let Entry { length, check } = entries[tile];
            let end = at.saturating_add(length);
            if let Some(more) = memory(tile).filter(|_| length > 0) {
                if !batch.is_empty() && most + more > max_memory {
                    break;
                }
                most += more;
                let bytes = (end <= streams.len() as u64).then(|| &streams[at as usize..end as usize]);
                batch.push(Stream { tile, check, bytes });
            }
            *self = Cursor { tile: tile + 1, at: end };
        }
        (batch, most)
    }
}
