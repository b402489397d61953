//! Bytes of the layer: an index of its tiles, then their streams (spec §11.2).

use super::decisions::Counted;
use super::head::DetailHead;
use super::levels::{CELL, CELLS, CodedBlock, Level, SUPERS, TILE, TileLevels, tile_area, tile_counts};
use super::model::{KINDS, Models};
use super::tile::{self, kinds};
use crate::bitstream::area::Area;
use crate::bitstream::broken::Broken;
use crate::bitstream::bytes::{Bytes, put_varint};
use crate::bitstream::checksum::hash;
use crate::bitstream::coder::range::Decoder;
use crate::bitstream::report::ONE_READER;
use crate::budget::Reservation;
use crate::error::{FormatError, Result};
use crate::gaussian::Channels;
use crate::limits::Limits;
use crate::parallel;

/// The detail layer of a picture: the levels of its tiles.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DetailLayer {
    /// Parameters from which the values of levels follow.
    pub head: DetailHead,
    /// The tiles, row by row; `None` if a tile has no levels or was not read.
    pub(crate) tiles: Vec<Option<TileLevels>>,
}

impl DetailLayer {
    /// Returns the number of nonzero levels.
    #[must_use]
    pub fn levels(&self) -> usize {
        self.tiles.iter().flatten().map(|tile| tile.levels.len()).sum()
    }

    /// Returns the number of tiles of the picture.
    #[must_use]
    pub fn of_tiles(&self) -> usize {
        self.tiles.len()
    }

    /// Returns the bytes of memory that the levels take.
    pub(crate) fn memory(&self) -> u64 {
        let lists: u64 = self.tiles.iter().flatten().map(TileLevels::memory).sum();
        lists + (self.tiles.len() * size_of::<Option<TileLevels>>()) as u64
    }

    /// Tells whether the layer belongs to a picture of this size with these channels.
    pub(crate) fn fits(&self, size: [u32; 2], channels: Channels) -> bool {
        let [across, down] = tile_counts(size);
        let mut cells = [0; KINDS];
        kinds(channels, self.head.alpha).for_each(|(kind, _)| cells[kind] = CELLS * CELLS);
        let classes = if self.head.classes > 1 { SUPERS * SUPERS } else { 0 };
        let is_whole = |tile: &TileLevels| {
            let sizes: [usize; KINDS] = std::array::from_fn(|kind| tile.sizes[kind].len());
            sizes == cells && tile.classes.len() == classes
        };
        self.tiles.len() == across * down && self.tiles.iter().flatten().all(is_whole)
    }

    /// Returns the number of tiles that have levels.
    #[must_use]
    pub fn tiles(&self) -> usize {
        self.tiles.iter().flatten().count()
    }
}

/// Entry of a tile in the index.
#[derive(Debug, Clone, Copy, Default)]
struct Entry {
    length: u64,
    /// The lower half of the stream's CRC-32.
    check: u16,
}

/// Number of streams that are read in parallel before their cost is counted.
const BATCH: usize = 64;
/// Maximum number of bytes that these streams take while they are read, unless a single one takes more.
const BATCH_MEMORY: u64 = 32 << 20;
/// Work of a pixel of a tile's plane, whatever it contains: its part of the tree and of the transform.
const PIXEL_WORK: u64 = 16;
/// Work of reading a level, including its part of the transform.
const LEVEL_WORK: u64 = 600;

/// Part of a detail layer to read, and limits on reading it.
#[derive(Debug)]
pub(crate) struct Wanted<'a> {
    pub size: [u32; 2],
    pub channels: Channels,
    /// The area to read; `None` is the whole picture.
    pub area: Option<Area>,
    pub limits: &'a Limits,
    /// Whether damaged tiles are skipped.
    pub passes_over: bool,
    /// Whether bits are counted.
    pub counts: bool,
}

/// Result of reading a detail layer.
#[derive(Debug)]
pub(crate) struct Found {
    pub layer: DetailLayer,
    /// Tiles that are missing or damaged.
    pub missing: u32,
    /// Bytes of the index.
    pub index: usize,
    /// Bits of the levels, if they are counted.
    pub bits: f64,
}

/// Appends the layer to a file.
pub(crate) fn put(layer: &DetailLayer, size: [u32; 2], channels: Channels, out: &mut Vec<u8>) {
    let streams: Vec<Vec<u8>> = parallel::map(layer.tiles.len(), |i| {
        let [_, _, width, height] = tile_area(size, i);
        let write =
            |levels| tile::write(&mut super::given::Given::new(levels), &layer.head, channels, [width, height]).0;
        layer.tiles[i].as_ref().map_or_else(Vec::new, write)
    });
    put_streams(&streams, out);
}

/// Returns the streams of the tiles that have levels, and the tiles' sizes in pixels.
#[cfg(test)]
pub(crate) fn streams(layer: &DetailLayer, size: [u32; 2], channels: Channels) -> Vec<(Vec<u8>, [usize; 2])> {
    let tiles = layer.tiles.iter().enumerate();
    let write = |(i, levels): (usize, &Option<TileLevels>)| {
        let [_, _, width, height] = tile_area(size, i);
        let levels = &mut super::given::Given::new(levels.as_ref()?);
        Some((tile::write(levels, &layer.head, channels, [width, height]).0, [width, height]))
    };
    tiles.filter_map(write).collect()
}

/// Appends index and streams; the stream of a tile without levels is empty.
pub(crate) fn put_streams(streams: &[Vec<u8>], out: &mut Vec<u8>) {
    for stream in streams {
        put_varint(stream.len() as u64, out);
        if !stream.is_empty() {
            out.extend((hash(stream) as u16).to_le_bytes());
        }
    }
    streams.iter().for_each(|stream| out.extend(stream));
}

/// Reads the layer, or those of its tiles that reach into an area, and grows `held` by the memory that they take.
pub(crate) fn read(
    bytes: &mut Bytes<'_>,
    head: DetailHead,
    wanted: &Wanted<'_>,
    held: &mut Reservation,
) -> Result<Found> {
    let [across, down] = tile_counts(wanted.size);
    let count = across as u64 * down as u64;
    // A tile takes at least one byte of the index, so that nothing is allocated for tiles that cannot exist.
    if count > bytes.left() as u64 && !wanted.passes_over {
        return Err(Broken { field: "tiles of the detail layer", value: count }.into());
    }
    held.grow((size_of::<Entry>() + size_of::<Option<TileLevels>>()) as u64 * count)?;
    let start = bytes.left();
    let mut entries = vec![Entry::default(); count as usize];
    let mut whole = true;
    for entry in &mut entries {
        match read_entry(bytes) {
            Ok(found) => *entry = found,
            Err(_) if wanted.passes_over => {
                whole = false;
                break;
            }
            Err(e) => return Err(e),
        }
    }
    if !whole {
        // The positions of the streams are unknown.
        entries.fill(Entry::default());
        bytes.rest();
    }
    let index = start - bytes.left();
    let mut streams: Vec<Option<&[u8]>> = Vec::with_capacity(entries.len());
    for entry in &entries {
        match bytes.take(entry.length, "tile of the detail layer") {
            Ok(stream) => streams.push(Some(stream)),
            Err(_) if wanted.passes_over => {
                bytes.rest();
                streams.push(None);
            }
            Err(e) => return Err(e),
        }
    }
    let planes: u64 = kinds(wanted.channels, head.alpha).map(|(_, planes)| planes.len() as u64).sum();
    let is_wanted = |i: usize| entries[i].length > 0 && wanted.area.is_none_or(|area| reaches(wanted.size, i, area));
    let chosen: Vec<usize> = (0..entries.len()).filter(|&i| is_wanted(i)).collect();
    let tiles_work = (TILE * TILE) as u64 * planes * PIXEL_WORK;
    let mut work = tiles_work.saturating_mul(chosen.len() as u64);
    Limits::check("work", work, wanted.limits.work)?;
    let mut tiles: Vec<Option<TileLevels>> = Vec::new();
    tiles.resize_with(entries.len(), || None);
    let (mut missing, mut bits) = (if whole { 0 } else { count as u32 }, 0.0);
    let samples = (TILE * TILE) as u64 * planes;
    let listed = Listed { entries: &entries, streams: &streams, head: &head, wanted };
    let likely = |i: usize| likely_levels(entries[i].length, samples);
    let mut rest = &chosen[..];
    while !rest.is_empty() {
        // Maximum memory of the batch while it is read.
        let (mut most, mut count) = (0, 0);
        for &i in rest.iter().take(BATCH) {
            let more = memory_of(likely(i), samples);
            if count > 0 && most + more > BATCH_MEMORY {
                break;
            }
            (most, count) = (most + more, count + 1);
        }
        let batch;
        (batch, rest) = rest.split_at(count);
        let mut working = held.beside(most)?;
        let read = parallel::map(count, |k| listed.tile(batch[k], likely(batch[k])));
        for (&i, read) in batch.iter().zip(read) {
            match read {
                Ok((levels, cost)) => {
                    let levels = match levels {
                        Some(levels) => levels,
                        // Only deliberately constructed files have so many levels.
                        None => {
                            let _working = held.beside(memory_of(samples, samples))?;
                            listed.tile(i, samples)?.0.expect("no more levels than samples")
                        }
                    };
                    held.grow(levels.memory())?;
                    work = work.saturating_add(LEVEL_WORK * levels.levels.len() as u64);
                    bits += cost;
                    tiles[i] = Some(levels);
                }
                Err(_) if wanted.passes_over => missing += 1,
                Err(e) => return Err(e),
            }
        }
        working.shrink(0);
        Limits::check("work", work, wanted.limits.work)?;
    }
    Ok(Found { layer: DetailLayer { head, tiles }, missing, index, bits })
}

/// The tiles of a layer as listed in the index.
struct Listed<'a> {
    entries: &'a [Entry],
    streams: &'a [Option<&'a [u8]>],
    head: &'a DetailHead,
    wanted: &'a Wanted<'a>,
}

impl Listed<'_> {
    /// Reads a tile, unless it has more than `most` levels, and returns its size in bits.
    #[inline(never)]
    fn tile(&self, i: usize, most: u64) -> Result<(Option<TileLevels>, f64)> {
        const WHAT: &str = "tile of the detail layer";
        let Wanted { size, channels, counts, .. } = *self.wanted;
        let [_, _, width, height] = tile_area(size, i);
        let shape = (self.head, channels, [width, height]);
        let stream = self.streams[i].ok_or(FormatError::Truncated { what: WHAT, offset: 0 })?;
        let (stored, computed) = (self.entries[i].check.into(), u32::from(hash(stream) as u16));
        if computed != stored {
            return Err(FormatError::Checksum { what: WHAT, stored, computed }.into());
        }
        if !counts || ONE_READER {
            // With a single reader, bits are counted by the bytes.
            return Ok((tile::read(stream, shape, most as usize)?, 8.0 * stream.len() as f64));
        }
        let mut counted = Counted { source: Decoder::new(stream)?, bits: 0.0 };
        let levels = tile::read_with(&mut counted, &mut Models::start(), shape, most as usize)?;
        counted.source.finish()?;
        Ok((levels, counted.bits))
    }
}

/// Returns a number of levels that few streams of this length exceed: one for every two bits. The bytes are no strict
/// bound, because zeros at the end of a stream are not written.
fn likely_levels(length: u64, samples: u64) -> u64 {
    length.saturating_add(4).saturating_mul(4).min(samples)
}

/// Returns the maximum memory that a tile of this many samples takes while it is read, if it has at most `levels`
/// levels.
fn memory_of(levels: u64, samples: u64) -> u64 {
    let blocks = levels.min(samples / (CELL * CELL) as u64);
    let lists = levels * size_of::<Level>() as u64 + blocks * size_of::<CodedBlock>() as u64;
    // A list grows to twice its contents, and the old one exists until the contents are moved.
    3 * lists + (KINDS * CELLS * CELLS + SUPERS * SUPERS) as u64
}

fn read_entry(bytes: &mut Bytes<'_>) -> Result<Entry> {
    let length = bytes.varint("length of a detail tile")?;
    let check = if length > 0 { bytes.u16("check of a detail tile")? } else { 0 };
    Ok(Entry { length, check })
}

/// Tells whether tile `i` lies within one pixel of `area`: enlarged views interpolate over that distance.
fn reaches(size: [u32; 2], i: usize, area: Area) -> bool {
    let [x, y, width, height] = tile_area(size, i).map(|v| v as u64);
    let meets = |start: u64, side: u64, k: usize| {
        let (from, length) = (u64::from(area.corner[k]), u64::from(area.size[k]));
        start <= from + length && from <= start + side
    };
    meets(x, width, 0) && meets(y, height, 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn streams_of_more_levels_than_there_is_memory_for_are_left() {
        let head = DetailHead::PLAIN;
        let shape = (&head, Channels::Rgb, [TILE, TILE]);
        // The levels are random.
        let (mut state, mut whole, mut dense) = (1u64, 0, 0);
        for _ in 0..2000 {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            let stream = &state.to_le_bytes()[2..];
            let all = tile::read(stream, shape, usize::MAX);
            let likely = likely_levels(stream.len() as u64, 1 << 20);
            let some = tile::read(stream, shape, likely as usize);
            match (all, some) {
                (Ok(Some(all)), Ok(some)) => {
                    whole += 1;
                    let fits = all.levels.len() as u64 <= likely;
                    dense += usize::from(!fits);
                    assert_eq!(some, fits.then_some(all));
                }
                (all, some) => assert_eq!(all, some),
            }
        }
        assert!(whole > 0 && dense > 0, "{whole} {dense}");
    }
}
