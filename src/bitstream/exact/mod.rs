//! The exact layer: sample values of a part of the picture, or of all of it, without loss (spec §12).
//!
//! `head` has the layer's parameters, `index` the position of each tile's stream. `tile` codes one tile: `mask` says
//! which cells it covers, `colors` predicts whole colours from hashed contexts, and `literal` codes the samples of
//! colours that were not predicted. `arithmetic` has the integer functions that they share.

mod arithmetic;
mod colors;
mod covered;
pub(crate) mod head;
pub(crate) mod index;
mod literal;
mod mask;
#[cfg(feature = "encode")]
pub(crate) mod near;
mod neighbours;
mod packed;
pub(crate) mod tile;

pub(crate) use self::covered::{CELL, ExactTile};
#[cfg(any(test, feature = "unstable"))]
use self::tile::Shape;
#[cfg(any(test, feature = "unstable"))]
use crate::error::Result;
use crate::gaussian::Channels;
#[cfg(any(feature = "encode", feature = "unstable"))]
use crate::pixels::Pixels;
use crate::pixels::{Depth, Samples};

/// Exact sample values, tile by tile.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ExactLayer {
    /// `5..=11`: tiles have `2^side` pixels a side.
    pub(crate) side: u8,
    /// Row by row; `None` for tiles that the layer does not cover.
    pub(crate) tiles: Vec<Option<ExactTile>>,
}

impl ExactLayer {
    /// Returns the bytes of memory that the samples take.
    pub(crate) fn memory(&self) -> u64 {
        let tiles: u64 = self.tiles.iter().flatten().map(ExactTile::memory).sum();
        tiles + (self.tiles.len() * size_of::<Option<ExactTile>>()) as u64
    }

    /// Returns the side of the tiles, pixels.
    #[must_use]
    #[cfg(any(test, feature = "unstable"))]
    pub fn tile_side(&self) -> u32 {
        1 << self.side
    }

    /// Returns the number of pixels that the layer covers, of a picture of this size.
    #[must_use]
    #[cfg(any(test, feature = "unstable"))]
    pub fn covered(&self, size: [u32; 2]) -> u64 {
        let [width, height] = size.map(|length| length as usize);
        let across = width.div_ceil(CELL);
        let cell = |k: usize| CELL.min(width - k % across * CELL) * CELL.min(height - k / across * CELL);
        self.cells(size).iter().enumerate().filter(|&(_, &is_covered)| is_covered).map(|(k, _)| cell(k) as u64).sum()
    }

    /// Returns which cells of 8 x 8 pixels the layer covers, row by row, of a picture of this size.
    #[must_use]
    #[cfg(any(test, feature = "unstable"))]
    pub fn cells(&self, size: [u32; 2]) -> Vec<bool> {
        let [across, down] = size.map(|length| (length as usize).div_ceil(CELL));
        let mut all = vec![false; across * down];
        for (i, tile) in self.tiles.iter().enumerate() {
            let Some(tile) = tile else { continue };
            let [left, top, width, height] = tile_area(size, self.side, i);
            let columns = width.div_ceil(CELL);
            for y in 0..height.div_ceil(CELL) {
                let row = &mut all[(top / CELL + y) * across + left / CELL..][..columns];
                match &tile.cells {
                    Some(cells) => row.copy_from_slice(&cells[y * columns..][..columns]),
                    None => row.fill(true),
                }
            }
        }
        all
    }

    /// Returns whether the layer belongs to a picture of this size with these channels and this depth.
    pub(crate) fn fits(&self, size: [u32; 2], channels: Channels, depth: Depth) -> bool {
        let [across, down] = tile_counts(size, self.side);
        let is_whole = |(i, tile): (usize, &Option<ExactTile>)| {
            let Some(tile) = tile else { return true };
            let [_, _, width, height] = tile_area(size, self.side, i);
            let (count, found) = match &tile.samples {
                Samples::U8(v) => (v.len(), Depth::Eight),
                Samples::U16(v) => (v.len(), Depth::Sixteen),
            };
            let cells = width.div_ceil(CELL) * height.div_ceil(CELL);
            let is_mask = |mask: &Vec<bool>| mask.len() == cells && mask.contains(&true) && mask.contains(&false);
            found == depth && count == width * height * channels.count() && tile.cells.as_ref().is_none_or(is_mask)
        };
        self.tiles.len() == across * down && self.tiles.iter().enumerate().all(is_whole)
    }
}

#[cfg(any(feature = "encode", feature = "unstable"))]
impl ExactLayer {
    /// Returns the layer of a picture in tiles of `2^side` pixels that covers the cells for which `is_covered` returns
    /// true; it receives the position of a cell's first pixel.
    #[must_use]
    pub fn of(pixels: &Pixels, side: u8, is_covered: impl Fn(usize, usize) -> bool) -> Self {
        let size = [pixels.width(), pixels.height()];
        let (row, count) = (size[0] as usize, pixels.channels().count());
        let [across, down] = tile_counts(size, side);
        let tile = |i: usize| {
            let [left, top, width, height] = tile_area(size, side, i);
            let starts = |length: usize| (0..length).step_by(CELL);
            let cells: Vec<bool> = starts(height)
                .flat_map(|y| starts(width).map(move |x| (x, y)))
                .map(|(x, y)| is_covered(left + x, top + y))
                .collect();
            let at = |y: usize, x: usize| {
                let is_covered = cells[y / CELL * width.div_ceil(CELL) + x / CELL];
                is_covered.then_some(((top + y) * row + left + x) * count)
            };
            fn cut<T: Copy + Default>(v: &[T], at: impl Iterator<Item = Option<usize>>, count: usize) -> Vec<T> {
                at.flat_map(|at| (0..count).map(move |k| at.map_or(T::default(), |at| v[at + k]))).collect()
            }
            let all = (0..height).flat_map(|y| (0..width).map(move |x| (y, x))).map(|(y, x)| at(y, x));
            let samples = match pixels.samples() {
                Samples::U8(v) => Samples::U8(cut(v, all, count)),
                Samples::U16(v) => Samples::U16(cut(v, all, count)),
            };
            let is_whole = !cells.contains(&false);
            cells.contains(&true).then(|| ExactTile { samples, cells: (!is_whole).then_some(cells) })
        };
        ExactLayer { side, tiles: (0..across * down).map(tile).collect() }
    }
}

#[cfg(any(test, feature = "unstable"))]
impl ExactLayer {
    /// Reads the stream of a tile that is a whole picture, with at most `most_work` work.
    ///
    /// # Errors
    ///
    /// [`Error::Format`](crate::Error::Format) if the stream is invalid, and
    /// [`Error::LimitExceeded`](crate::Error::LimitExceeded) if it takes more work.
    pub fn from_stream(
        stream: &[u8],
        size: [u32; 2],
        channels: Channels,
        depth: Depth,
        most_work: u64,
    ) -> Result<Self> {
        let shape = Shape { size: size.map(|length| length as usize), channels, depth };
        let (tile, _) = tile::read(stream, &shape, most_work)?;
        let side = size[0].max(size[1]).next_power_of_two().ilog2().clamp(5, 11) as u8;
        Ok(ExactLayer { side, tiles: vec![Some(tile)] })
    }

    /// Returns the stream of the first tile, which is a whole picture.
    ///
    /// # Panics
    ///
    /// If the layer does not cover the tile.
    #[must_use]
    pub fn to_stream(&self, size: [u32; 2], channels: Channels, depth: Depth) -> Vec<u8> {
        let shape = Shape { size: size.map(|length| length as usize), channels, depth };
        tile::write(self.tiles[0].as_ref().expect("a covered tile"), &shape)
    }

    /// Returns the samples of a pixel, 1 is white, if the layer covers it. Unused channels are 0.
    #[must_use]
    pub fn pixel(&self, size: [u32; 2], channels: Channels, [x, y]: [usize; 2]) -> Option<[f64; 4]> {
        let [across, _] = tile_counts(size, self.side);
        let i = (y >> self.side) * across + (x >> self.side);
        let [left, top, width, _] = tile_area(size, self.side, i);
        let (tile, [x, y]) = (self.tiles[i].as_ref()?, [x - left, y - top]);
        if tile.cells.as_ref().is_some_and(|cells| !cells[y / CELL * width.div_ceil(CELL) + x / CELL]) {
            return None;
        }
        let at = (y * width + x) * channels.count();
        Some(std::array::from_fn(|k| match &tile.samples {
            _ if k >= channels.count() => 0.0,
            Samples::U8(v) => f64::from(v[at + k]) / 255.0,
            Samples::U16(v) => f64::from(v[at + k]) / 65_535.0,
        }))
    }
}

/// Returns the numbers of tiles along both axes.
pub(crate) fn tile_counts(size: [u32; 2], side: u8) -> [usize; 2] {
    size.map(|length| (length as usize).div_ceil(1 << side))
}

/// Returns the corner, the width and the height of tile `i`, pixels.
pub(crate) fn tile_area(size: [u32; 2], side: u8, i: usize) -> [usize; 4] {
    let [across, _] = tile_counts(size, side);
    let [x, y] = [i % across, i / across].map(|at| at << side);
    let end = |start: usize, length: u32| (1usize << side).min(length as usize - start);
    [x, y, end(x, size[0]), end(y, size[1])]
}
