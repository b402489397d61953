//! The index of the exact layer: where the stream of each tile lies (spec §12.2). Reads the requested tiles in
//! parallel, within the limits.

use super::head::ExactHead;
use super::tile::{self, Shape};
use super::{ExactLayer, ExactTile, tile_area, tile_counts};
use crate::bitstream::bytes::Bytes;
use crate::bitstream::tile_index::{self, Cursor, Names, put_streams};
use crate::budget::Reservation;
use crate::error::{Error, Result};
use crate::gaussian::Channels;
use crate::limits::Limits;
use crate::parallel;
use crate::parameter::Limit;
use crate::pixels::Depth;
use crate::rect::Rect;

/// Bytes that tiles take while they are read in parallel, unless a single one takes more.
const BATCH_MEMORY: u64 = 256 << 20;
/// Name of a tile's stream in errors.
const STREAM: &str = "tile of the exact layer";
/// Names of the index in errors.
const NAMES: Names =
    Names { tiles: "tiles of the exact layer", length: "length of an exact tile", check: "check of an exact tile" };

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

/// Reads the index, and returns the bytes of all streams after it.
pub(crate) fn streams_length(
    bytes: &mut Bytes<'_>,
    head: &ExactHead,
    size: [u32; 2],
    held: &mut Reservation,
) -> Result<u64> {
    let [across, down] = tile_counts(size, head.side);
    tile_index::length(bytes, across as u64 * down as u64, NAMES, held)
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
    let entries = match tile_index::read(bytes, count, NAMES, &mut index) {
        Ok(entries) => entries,
        Err(Error::Format(_)) if wanted.passes_over => {
            let index = start - bytes.left();
            bytes.rest();
            return Ok(Found { layer: None, missing: count as u32, of: count as u32, index });
        }
        Err(e) => return Err(e),
    };
    let index = start - bytes.left();
    let streams = tile_index::take(bytes, &entries, STREAM, wanted.passes_over)?;
    held.grow(count * size_of::<Option<ExactTile>>() as u64)?;
    let mut tiles: Vec<Option<ExactTile>> = Vec::new();
    tiles.resize_with(entries.len(), || None);
    let (mut missing, mut work, mut cursor) = (0, 0u64, Cursor::default());
    loop {
        let (batch, memory) = cursor.batch(&entries, streams, BATCH_MEMORY, |tile| {
            wanted.reaches(head.side, tile).then(|| {
                let shape = wanted.shape(head.side, tile);
                let samples = shape.size[0] * shape.size[1] * wanted.channels.count() * wanted.depth.bytes();
                tile::working_memory(&shape) + samples as u64
            })
        });
        if batch.is_empty() {
            return Ok(Found { layer: Some(ExactLayer { side: head.side, tiles }), missing, of: count as u32, index });
        }
        let mut working = held.reserve(memory)?;
        let most = wanted.limits.work.saturating_sub(work);
        let read = parallel::map(batch.len(), |k| {
            tile::read(batch[k].intact(STREAM)?, &wanted.shape(head.side, batch[k].tile), most)
        });
        working.shrink(0);
        for (stream, tile) in batch.iter().zip(read) {
            match tile {
                Ok((tile, spent)) => {
                    work = work.saturating_add(spent);
                    held.grow(tile.memory())?;
                    tiles[stream.tile] = Some(tile);
                }
                Err(Error::Format(_)) if wanted.passes_over => missing += 1,
                Err(e) => return Err(e),
            }
        }
        Limits::check(Limit::Work, work, wanted.limits.work)?;
    }
}
