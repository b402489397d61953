//! The levels of a tile as integers, as stored between reading and rendering (spec §11.2).

use super::model::KINDS;

/// Side of a tile, pixels.
pub(crate) const TILE: usize = 256;
/// Side of a superblock, pixels. Each has its own trees and step class.
pub(crate) const SUPER: usize = 32;
/// Side of a cell, the smallest block, pixels.
pub(crate) const CELL: usize = 4;
/// Cells in a row of a tile, whatever its width.
pub(crate) const CELLS: usize = TILE / CELL;
/// Superblocks in a row of a tile, whatever its width.
pub(crate) const SUPERS: usize = TILE / SUPER;

/// A nonzero level.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Level {
    /// Horizontal and vertical frequency in the block.
    pub u: u8,
    pub v: u8,
    pub value: i16,
}

/// A block that has levels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct CodedBlock {
    /// Column and row of its first cell.
    pub cell: [u8; 2],
    pub plane: u8,
    /// Size of the block, whose side is `4 << size` pixels.
    pub size: u8,
    /// End of its levels in the list.
    pub end: u32,
}

/// The levels of a tile.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub(crate) struct TileLevels {
    /// Sizes of the blocks that contain each cell, [`CELLS`] per row, by kind of planes; empty for kinds that are not
    /// coded.
    pub sizes: [Vec<u8>; KINDS],
    /// Step classes of the superblocks, [`SUPERS`] per row.
    pub classes: Vec<u8>,
    pub blocks: Vec<CodedBlock>,
    pub levels: Vec<Level>,
}

impl TileLevels {
    /// Returns the bytes of memory that the levels take.
    pub(crate) fn memory(&self) -> u64 {
        let sizes: usize = self.sizes.iter().map(Vec::capacity).sum();
        let lists = self.blocks.capacity() * size_of::<CodedBlock>() + self.levels.capacity() * size_of::<Level>();
        (sizes + self.classes.capacity() + lists + size_of::<Self>()) as u64
    }
}

/// Returns left, top, width and height of tile `index`, pixels.
pub(crate) fn tile_area(size: [u32; 2], index: usize) -> [usize; 4] {
    let [width, height] = size.map(|side| side as usize);
    let across = width.div_ceil(TILE);
    let [x, y] = [index % across * TILE, index / across * TILE];
    [x, y, TILE.min(width - x), TILE.min(height - y)]
}

/// Returns the number of tiles along x and y.
pub(crate) fn tile_counts(size: [u32; 2]) -> [usize; 2] {
    size.map(|side| (side as usize).div_ceil(TILE))
}
