//! Bytes of the layer: an index of its tiles, then their streams (spec §11.2).

use super::decisions::Counted;
use super::head::DetailHead;
use super::levels::{CELL, CELLS, CodedBlock, Level, SUPERS, TILE, TileLevels, tile_area, tile_counts};
use super::model::{KINDS, Models};
use super::tile::{self, Count, kinds};
use crate::bitstream::bytes::Bytes;
use crate::bitstream::coder::range::Decoder;
use crate::bitstream::coder::range::ONE_READER;
use crate::bitstream::tile_index::{self, Cursor, Entry, Names, Stream, put_streams};
use crate::budget::Reservation;
use crate::error::{Error, Result};
use crate::gaussian::Channels;
use crate::limits::Limits;
use crate::parallel;
use crate::parameter::Limit;
use crate::rect::Rect;

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
    #[cfg(any(test, feature = "unstable"))]
    #[must_use]
    pub fn of_tiles(&self) -> usize {
        self.tiles.len()
    }

    /// Returns the bytes of memory that the levels take.
    pub(crate) fn memory(&self) -> u64 {
        let lists: u64 = self.tiles.iter().flatten().map(TileLevels::memory).sum();
        lists + (self.tiles.len() * size_of::<Option<TileLevels>>()) as u64
    }

    /// Returns whether the layer belongs to a picture of this size with these channels.
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

/// Maximum number of bytes that streams take while they are read in parallel, unless a single one takes more.
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
    pub area: Option<Rect>,
    pub limits: &'a Limits,
    /// Whether damaged tiles are skipped.
    pub passes_over: bool,
    /// Whether bits are counted.
    pub counts: bool,
}

/// Result of reading a detail layer.
#[derive(Debug)]
pub(crate) struct Found {
    /// The layer; `None` if the index cannot be read.
    pub layer: Option<DetailLayer>,
    /// Tiles that are missing or damaged.
    pub missing: u32,
    /// Number of tiles of the picture.
    pub of: u32,
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

/// Reads the layer, or those of its tiles that reach into an area, and grows `held` by the memory that they take.
pub(crate) fn read(
    bytes: &mut Bytes<'_>,
    head: DetailHead,
    wanted: &Wanted<'_>,
    held: &mut Reservation,
) -> Result<Found> {
    let [across, down] = tile_counts(wanted.size);
    let count = across as u64 * down as u64;
    let (start, mut index) = (bytes.left(), held.reserve(0)?);
    let entries = match tile_index::read(bytes, count, NAMES, &mut index) {
        Ok(entries) => entries,
        Err(Error::Format(_)) if wanted.passes_over => {
            // The positions of the streams are unknown, and nothing is allocated for them.
            let index = start - bytes.left();
            bytes.rest();
            return Ok(Found { layer: None, missing: count as u32, of: count as u32, index, bits: 0.0 });
        }
        Err(e) => return Err(e),
    };
    let index = start - bytes.left();
    let streams = tile_index::take(bytes, &entries, STREAM, wanted.passes_over)?;
    let listed = Listed { entries: &entries, streams, head: &head, wanted };
    let (tiles, missing, bits) = listed.read(held)?;
    Ok(Found { layer: Some(DetailLayer { head, tiles }), missing, of: count as u32, index, bits })
}

/// Reads the index, and returns the bytes of all streams after it.
pub(crate) fn streams_length(bytes: &mut Bytes<'_>, size: [u32; 2], held: &mut Reservation) -> Result<u64> {
    let [across, down] = tile_counts(size);
    tile_index::length(bytes, across as u64 * down as u64, NAMES, held)
}

/// Name of a tile's stream in errors.
const STREAM: &str = "tile of the detail layer";

/// Names of the index in errors.
const NAMES: Names =
    Names { tiles: "tiles of the detail layer", length: "length of a detail tile", check: "check of a detail tile" };

/// Result of reading a tile.
struct Tile {
    /// The levels; `Ok(None)` if there are more than requested.
    levels: Result<Option<TileLevels>>,
    /// Number of levels read, including those of an invalid stream.
    read: usize,
    /// Size of the stream in bits.
    bits: f64,
}

/// The tiles of a layer as listed in the index.
struct Listed<'a> {
    entries: &'a [Entry],
    /// The streams after the index, and the bytes that follow them.
    streams: &'a [u8],
    head: &'a DetailHead,
    wanted: &'a Wanted<'a>,
}

impl<'a> Listed<'a> {
    /// Reads the requested tiles, and grows `held` by their memory. Returns them with the number of tiles that are
    /// missing or damaged, and the bits of all others.
    fn read(&self, held: &mut Reservation) -> Result<(Vec<Option<TileLevels>>, u32, f64)> {
        let (samples, limit) = (self.samples(), self.wanted.limits.work);
        let chosen = (0..self.entries.len()).filter(|&i| self.is_wanted(i)).count();
        let mut work = (samples * PIXEL_WORK).saturating_mul(chosen as u64);
        Limits::check(Limit::Work, work, limit)?;
        held.grow((size_of::<Option<TileLevels>>() * self.entries.len()) as u64)?;
        let mut tiles: Vec<Option<TileLevels>> = Vec::new();
        tiles.resize_with(self.entries.len(), || None);
        let (mut missing, mut bits, mut cursor) = (0, 0.0, Cursor::default());
        loop {
            let (batch, most) = self.batch(&mut cursor);
            if batch.is_empty() {
                return Ok((tiles, missing, bits));
            }
            let mut working = held.reserve(most)?;
            let read = parallel::map(batch.len(), |k| self.tile(batch[k], self.likely(batch[k].tile)));
            for (&stream, mut tile) in batch.iter().zip(read) {
                if let Ok(None) = tile.levels {
                    // Only deliberately constructed files have so many levels.
                    let _working = held.reserve(memory_of(samples, samples))?;
                    tile = self.tile(stream, samples);
                }
                work = work.saturating_add(LEVEL_WORK * tile.read as u64);
                match tile.levels {
                    Ok(levels) => {
                        let levels = levels.expect("no more levels than samples");
                        held.grow(levels.memory())?;
                        bits += tile.bits;
                        tiles[stream.tile] = Some(levels);
                    }
                    Err(_) if self.wanted.passes_over => missing += 1,
                    Err(e) => return Err(e),
                }
            }
            working.shrink(0);
            Limits::check(Limit::Work, work, limit)?;
        }
    }

    /// Returns the number of samples of a tile in all planes.
    fn samples(&self) -> u64 {
        let planes: usize = kinds(self.wanted.channels, self.head.alpha).map(|(_, planes)| planes.len()).sum();
        (TILE * TILE * planes) as u64
    }

    fn is_wanted(&self, tile: usize) -> bool {
        let Wanted { size, area, .. } = *self.wanted;
        self.entries[tile].length > 0 && area.is_none_or(|area| reaches(size, tile, area))
    }

    /// Returns a number of levels that few tiles exceed.
    fn likely(&self, tile: usize) -> u64 {
        likely_levels(self.entries[tile].length, self.samples())
    }

    /// Returns the next streams to read in parallel, and the maximum memory that this takes.
    fn batch(&self, cursor: &mut Cursor) -> (Vec<Stream<'a>>, u64) {
        cursor.batch(self.entries, self.streams, BATCH_MEMORY, |tile| {
            self.is_wanted(tile).then(|| memory_of(self.likely(tile), self.samples()))
        })
    }

    /// Reads a tile, unless it has more than `most` levels.
    #[inline(never)]
    fn tile(&self, stream: Stream<'_>, most: u64) -> Tile {
        let mut count = Count::up_to(most as usize);
        let mut bits = 0.0;
        let levels = self.levels(stream, &mut count, &mut bits);
        Tile { levels, read: count.read, bits }
    }

    fn levels(&self, stream: Stream<'_>, count: &mut Count, bits: &mut f64) -> Result<Option<TileLevels>> {
        let Wanted { size, channels, counts, .. } = *self.wanted;
        let [_, _, width, height] = tile_area(size, stream.tile);
        let shape = (self.head, channels, [width, height]);
        let bytes = stream.intact(STREAM)?;
        if !counts || ONE_READER {
            // With a single reader, bits are counted by the bytes.
            *bits = 8.0 * bytes.len() as f64;
            return Ok(tile::read(bytes, shape, count)?);
        }
        let mut counted = Counted { source: Decoder::new(bytes)?, bits: 0.0 };
        let levels = tile::read_with(&mut counted, &mut Models::start(), shape, count)?;
        counted.source.finish()?;
        *bits = counted.bits;
        Ok(levels)
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

/// Returns whether tile `i` lies within one pixel of `area`, because enlarged views interpolate over that distance.
/// Outside the picture, its border pixels are repeated (spec §11.6).
fn reaches(size: [u32; 2], i: usize, area: Rect) -> bool {
    let [x, y, width, height] = tile_area(size, i).map(|v| v as u64);
    let meets = |start: u64, side: u64, k: usize| {
        let (from, length) = (u64::from(area.corner()[k]), u64::from(area.size()[k]));
        start <= from + length && from.min(size[k].into()) <= start + side
    };
    meets(x, width, 0) && meets(y, height, 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn streams_with_too_many_levels_for_the_memory_are_skipped() {
        let head = DetailHead::PLAIN;
        let shape = (&head, Channels::Rgb, [TILE, TILE]);
        // The levels are random.
        let (mut state, mut whole, mut dense) = (1u64, 0, 0);
        for _ in 0..2000 {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            let stream = &state.to_le_bytes()[2..];
            let read = |most| tile::read(stream, shape, &mut Count::up_to(most));
            let all = read(usize::MAX);
            let likely = likely_levels(stream.len() as u64, 1 << 20);
            let some = read(likely as usize);
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
