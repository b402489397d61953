//! Synthetic detail layers for vectors and tests, which must not change with the encoder.

use super::head::{self, DetailHead};
use super::index::DetailLayer;
use super::levels::{CELL, CELLS, CodedBlock, Level, SUPER, SUPERS, TileLevels, tile_area, tile_counts};
use super::scan::{at, scan};
use super::tile::{ROOT, kinds};
use crate::error::Result;
use crate::gaussian::Channels;

/// Source of synthetic levels. Tiles, superblocks, blocks and planes are visited in the order of the file.
pub trait Maker {
    /// Returns the step class of a superblock, below the number of classes; not called if there is one class.
    fn class(&mut self, tile: usize, superblock: [usize; 2]) -> u8;

    /// Returns whether a square of side `4 << size` at a cell is divided, if the format leaves the choice.
    fn is_divided(&mut self, tile: usize, kind: usize, cell: [usize; 2], size: usize) -> bool;

    /// Returns the levels of a block: horizontal and vertical frequency, and the level; levels of 0 are ignored.
    fn levels(&mut self, tile: usize, plane: usize, cell: [usize; 2], size: usize) -> Vec<(u8, u8, i16)>;
}

impl DetailLayer {
    /// Returns a layer for a picture with these channels and this size in pixels.
    ///
    /// # Errors
    /// [`Error::Format`](crate::Error::Format) if `head` breaks the format.
    ///
    /// # Panics
    /// If a level lies outside its block.
    pub fn made(head: DetailHead, channels: Channels, size: [u32; 2], maker: &mut impl Maker) -> Result<Self> {
        head::check(&head)?;
        let [across, down] = tile_counts(size);
        let tiles = (0..across * down).map(|i| {
            let [_, _, width, height] = tile_area(size, i);
            let mut builder = TileBuilder { head: &head, index: i, tile: TileLevels::default(), maker };
            builder.run(channels, [width, height]);
            (!builder.tile.levels.is_empty()).then_some(builder.tile)
        });
        Ok(DetailLayer { head, tiles: tiles.collect() })
    }
}

/// Builds one tile from the levels of a [`Maker`].
struct TileBuilder<'a, M> {
    head: &'a DetailHead,
    index: usize,
    tile: TileLevels,
    maker: &'a mut M,
}

impl<M: Maker> TileBuilder<'_, M> {
    fn run(&mut self, channels: Channels, size: [usize; 2]) {
        let [across, down] = size.map(|side| side.div_ceil(SUPER));
        if self.head.classes > 1 {
            self.tile.classes = vec![0; SUPERS * SUPERS];
        }
        for (kind, _) in kinds(channels, self.head.alpha) {
            self.tile.sizes[kind] = vec![0; CELLS * CELLS];
        }
        for (y, x) in (0..down).flat_map(|y| (0..across).map(move |x| (y, x))) {
            if self.head.classes > 1 {
                self.tile.classes[y * SUPERS + x] = self.maker.class(self.index, [x, y]);
            }
            for (kind, planes) in kinds(channels, self.head.alpha) {
                self.square(kind, planes, [x, y].map(|c| c * (SUPER / CELL)), ROOT);
            }
        }
    }

    fn square(&mut self, kind: usize, planes: std::ops::Range<usize>, [x, y]: [usize; 2], size: usize) {
        let [least, most] = self.head.sizes(kind);
        if size > most || (size > least && self.maker.is_divided(self.index, kind, [x, y], size)) {
            let half = 1 << (size - 1);
            for [i, j] in [[0, 0], [1, 0], [0, 1], [1, 1]] {
                self.square(kind, planes.clone(), [x + i * half, y + j * half], size - 1);
            }
            return;
        }
        for row in y..y + (1 << size) {
            self.tile.sizes[kind][row * CELLS + x..][..1 << size].fill(size as u8);
        }
        for plane in planes {
            let mut levels = self.maker.levels(self.index, plane, [x, y], size);
            levels.retain(|level| level.2 != 0);
            if levels.is_empty() {
                continue;
            }
            levels.sort_by_key(|level| {
                let (u, v) = (usize::from(level.0), usize::from(level.1));
                let place = scan(size).iter().position(|place| usize::from(place.at) == at(u, v));
                place.expect("a place of the block")
            });
            self.tile.levels.extend(levels.into_iter().map(|(u, v, value)| Level { u, v, value }));
            let (cell, end) = ([x as u8, y as u8], self.tile.levels.len() as u32);
            self.tile.blocks.push(CodedBlock { cell, plane: plane as u8, size: size as u8, end });
        }
    }
}
