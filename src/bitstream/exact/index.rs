//! The index of the exact layer: where the stream of each tile lies (spec §12.2). Reads the requested tiles in
//! parallel, within the limits.

use super::head::ExactHead;
use super::tile::{self, Shape};
use super::{ExactLayer, ExactTile, tile_area, tile_counts};
use crate::bitstream::broken::Broken;
use crate::bitstream::bytes::Bytes;
use crate::bitstream::checksum::hash;
use crate::bitstream::detail::index::put_streams;
use crate::budget::Reservation;
use crate::error::{Error, FormatError, Result};
use crate::gaussian::Channels;
use crate::limits::Limits;
use crate::parallel;
use crate::parameter::Limit;
use crate::pixels::Depth;
use crate::rect::Rect;

/// Bytes that tiles take while they are read in parallel, unless a single one takes more.
const BATCH_MEMORY: u64 = 256 << 20;
/// Number of streams that are read in parallel.
const BATCH: usize = 64;
/// Name of a tile's stream in errors.
const STREAM: &str = "tile of the exact layer";

/// Part of an exact layer to read, and limits on reading it.
#[derive(Debug)]
pub(crate) struct Wanted<'a> {
    pub size: [u32; 2],
    pub channels: Channels,
    pub depth: Depth,
    /// The area to read; `None` is the whole picture.
    pub area: Option<Rect>,
    pub limits: &'a Limits,
    /// Whether damaged tiles are skipped.
    pub passes_over: bool,
}

/// Result of reading an exact layer.
#[derive(Debug)]
pub(crate) struct Found {
    /// The layer; `None` if the index cannot be read.
    pub layer: Option<ExactLayer>,
    /// Tiles that are missing or damaged.
    pub missing: u32,
    /// Number of tiles of the picture.
    pub of: u32,
    /// Bytes of the index.
    pub index: usize,
}

/// A tile in the index.
#[derive(Debug, Clone, Copy)]
struct Entry {
    length: u64,
    /// Offset of the stream from the first one, in bytes.
    start: u64,
    /// The lower half of the stream's CRC-32.
    check: u16,
}

impl Wanted<'_> {
    fn shape(&self, side: u8, tile: usize) -> Shape {
        let [_, _, width, height] = tile_area(self.size, side, tile);
        Shape { size: [width, height], channels: self.channels, depth: self.depth }
    }

    /// Returns whether a tile lies in the area, or touches it.
    fn reaches(&self, side: u8, tile: usize) -> bool {
        let Some(area) = self.area else { return true };
        let [x, y, width, height] = tile_area(self.size, side, tile).map(|v| v as u64);
        let meets = |start: u64, length: u64, k: usize| {
            let (from, count) = (u64::from(area.corner()[k]), u64::from(area.size()[k]));
            start <= from + count && from <= start + length
        };
        meets(x, width, 0) && meets(y, height, 1)
    }
}

/// Appends the layer to a file.
pub(crate) fn put(layer: &ExactLayer, size: [u32; 2], channels: Channels, depth: Depth, out: &mut Vec<u8>) {
    let streams: Vec<Vec<u8>> = parallel::map(layer.tiles.len(), |i| {
        let [_, _, width, height] = tile_area(size, layer.side, i);
        let shape = Shape { size: [width, height], channels, depth };
        layer.tiles[i].as_ref().map_or_else(Vec::new, |tile| tile::write(tile, &shape))
    });
    put_streams(&streams, out);
}

/// Reads the layer, or those of its tiles that reach into an area, and grows `held` by the memory that they take.
pub(crate) fn read(
    bytes: &mut Bytes<'_>,
    head: &ExactHead,
    wanted: &Wanted<'_>,
    held: &mut Reservation,
) -> Result<Found> {
    let [across, down] = tile_counts(wanted.size, head.side);
    let count = across as u64 * down as u64;
    let (start, mut index) = (bytes.left(), held.reserve(0)?);
    let entries = match read_index(bytes, count, &mut index) {
        Ok(entries) => entries,
        Err(Error::Format(_)) if wanted.passes_over => {
            let index = start - bytes.left();
            bytes.rest();
            return Ok(Found { layer: None, missing: count as u32, of: count as u32, index });
        }
        Err(e) => return Err(e),
    };
    let index = start - bytes.left();
    let streams = bytes.clone().rest();
    let total = entries.last().map_or(0, |last| last.start.saturating_add(last.length));
    match bytes.take(total, STREAM) {
        Ok(_) => {}
        Err(_) if wanted.passes_over => drop(bytes.rest()),
        Err(e) => return Err(e),
    }
    held.grow(count * size_of::<Option<ExactTile>>() as u64)?;
    let mut tiles: Vec<Option<ExactTile>> = Vec::new();
    tiles.resize_with(entries.len(), || None);
    let chosen: Vec<usize> =
        (0..entries.len()).filter(|&i| entries[i].length > 0 && wanted.reaches(head.side, i)).collect();
    let (mut missing, mut work, mut next) = (0, 0u64, 0);
    while next < chosen.len() {
        let (mut batch, mut memory) = (next..next, 0);
        while batch.end < chosen.len() && batch.len() < BATCH {
            let shape = wanted.shape(head.side, chosen[batch.end]);
            let samples = shape.size[0] * shape.size[1] * wanted.channels.count() * wanted.depth.bytes();
            let more = tile::working_memory(shape.size) + samples as u64;
            if !batch.is_empty() && memory + more > BATCH_MEMORY {
                break;
            }
            (batch.end, memory) = (batch.end + 1, memory + more);
        }
        let mut working = held.reserve(memory)?;
        let most = wanted.limits.work.saturating_sub(work);
        let read = parallel::map(batch.len(), |k| {
            let tile = chosen[batch.start + k];
            stream(streams, &entries[tile]).and_then(|s| tile::read(s, &wanted.shape(head.side, tile), most))
        });
        working.shrink(0);
        for (k, tile) in read.into_iter().enumerate() {
            match tile {
                Ok((tile, spent)) => {
                    work = work.saturating_add(spent);
                    held.grow(tile.memory())?;
                    tiles[chosen[batch.start + k]] = Some(tile);
                }
                Err(Error::Format(_)) if wanted.passes_over => missing += 1,
                Err(e) => return Err(e),
            }
        }
        Limits::check(Limit::Work, work, wanted.limits.work)?;
        next = batch.end;
    }
    Ok(Found { layer: Some(ExactLayer { side: head.side, tiles }), missing, of: count as u32, index })
}

/// Returns the bytes of a stream if they are intact.
fn stream<'a>(streams: &'a [u8], entry: &Entry) -> Result<&'a [u8]> {
    let end = entry.start.saturating_add(entry.length);
    let bytes = (end <= streams.len() as u64).then(|| &streams[entry.start as usize..end as usize]);
    let bytes = bytes.ok_or(FormatError::Truncated { what: STREAM, offset: 0 })?;
    let (stored, computed) = (entry.check.into(), u32::from(hash(bytes) as u16));
    if computed != stored {
        return Err(FormatError::Checksum { what: STREAM, stored, computed }.into());
    }
    Ok(bytes)
}

/// Reads the index of `count` tiles, and grows `held` by the memory of the result.
fn read_index(bytes: &mut Bytes<'_>, count: u64, held: &mut Reservation) -> Result<Vec<Entry>> {
    // A tile takes at least one byte of the index, so that nothing is allocated for tiles that cannot exist.
    if count > bytes.left() as u64 {
        return Err(Broken { field: "tiles of the exact layer", value: count }.into());
    }
    held.grow(size_of::<Entry>() as u64 * count)?;
    let (mut entries, mut start) = (Vec::with_capacity(count as usize), 0u64);
    for _ in 0..count {
        let length = bytes.varint("length of an exact tile")?;
        let check = if length > 0 { bytes.u16("check of an exact tile")? } else { 0 };
        entries.push(Entry { length, start, check });
        start = start.saturating_add(length);
    }
    Ok(entries)
}
