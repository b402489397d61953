//! The samples of a tile, and the cells of it that they cover.

use crate::pixels::Samples;

/// Side of the cells that are covered or not, pixels.
pub(crate) const CELL: usize = 8;

/// The samples of a tile.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct ExactTile {
    /// Row by row, channels interleaved; 0 where the tile is not covered.
    pub samples: Samples,
    /// Whether each cell is covered, row by row; `None` if all are.
    pub cells: Option<Vec<bool>>,
}

impl ExactTile {
    /// Returns the pixels from column `x` on that are alike covered or not, up to column `end`: whether they are
    /// covered, and where they end. `width` is that of the tile.
    pub(crate) fn run(&self, [x, y]: [usize; 2], end: usize, width: usize) -> (bool, usize) {
        let Some(cells) = &self.cells else { return (true, end) };
        let row = &cells[y / CELL * width.div_ceil(CELL)..];
        let is_covered = row[x / CELL];
        let mut next = (x / CELL + 1) * CELL;
        while next < end && row[next / CELL] == is_covered {
            next += CELL;
        }
        (is_covered, next.min(end))
    }

    /// Returns the bytes of memory that the tile takes.
    pub(super) fn memory(&self) -> u64 {
        let samples = match &self.samples {
            Samples::U8(v) => v.len(),
            Samples::U16(v) => 2 * v.len(),
        };
        (samples + self.cells.as_ref().map_or(0, Vec::len)) as u64
    }
}
