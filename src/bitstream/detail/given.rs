//! Supplies the levels of a tile to the writer, from a list that was read.

use super::block::Block;
use super::levels::{CELLS, CodedBlock, SUPERS, TileLevels};
use super::model::PLANES;
use super::scan::at;
use super::tile::Content;

/// A tile to write.
pub(crate) struct Given<'a> {
    tile: &'a TileLevels,
    /// Index, counted from 1, of the block that begins in each cell, by plane.
    blocks: [Vec<u32>; PLANES],
}

impl<'a> Given<'a> {
    pub(crate) fn new(tile: &'a TileLevels) -> Self {
        let mut blocks = std::array::from_fn(|_| vec![0; CELLS * CELLS]);
        for (i, CodedBlock { cell, plane, .. }) in tile.blocks.iter().enumerate() {
            blocks[usize::from(*plane)][usize::from(cell[1]) * CELLS + usize::from(cell[0])] = i as u32 + 1;
        }
        Given { tile, blocks }
    }
}

impl Content for Given<'_> {
    fn is_divided(&self, kind: usize, [x, y]: [usize; 2], size: usize) -> bool {
        usize::from(self.tile.sizes[kind][y * CELLS + x]) < size
    }

    fn bring(&self, plane: usize, [x, y]: [usize; 2], _size: usize, block: &mut Block) -> u32 {
        let Some(i) = (self.blocks[plane][y * CELLS + x] as usize).checked_sub(1) else { return 0 };
        let start = i.checked_sub(1).map_or(0, |before| self.tile.blocks[before].end);
        let levels = &self.tile.levels[start as usize..self.tile.blocks[i].end as usize];
        for level in levels {
            block.levels[at(level.u.into(), level.v.into())] = level.value;
        }
        levels.len() as u32
    }

    fn take(&mut self, _plane: usize, _cell: [usize; 2], _size: usize, _block: &Block) {}

    fn class(&self, [x, y]: [usize; 2]) -> u8 {
        self.tile.classes[y * SUPERS + x]
    }
}
