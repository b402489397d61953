//! Finds the flat regions of a tile, where ringing is visible.

use super::residual::TileResidual;
use crate::bitstream::detail::levels::{CELL, CELLS, SUPER, TILE};

/// Range of luma below which a cell is flat, code values. It is less than one step of 8-bit luma.
const FLAT: f32 = 0.2;

/// The flat cells of a tile.
pub(super) struct Ground {
    flat: Vec<bool>,
}

impl Ground {
    pub(super) fn of(tile: &TileResidual) -> Self {
        // The cells cover whole superblocks, to which luma is padded.
        let [across, down] = tile.size.map(|side| side.div_ceil(SUPER) * (SUPER / CELL));
        let mut flat = vec![false; CELLS * CELLS];
        for y in 0..down {
            for x in 0..across {
                flat[y * CELLS + x] = range(tile, [x, y]) < FLAT;
            }
        }
        Ground { flat }
    }

    /// Returns whether a block contains both flat and other cells. The transform of such a block spreads the errors of
    /// the other cells over the flat ones.
    pub(super) fn is_mixed(&self, [x, y]: [usize; 2], size: usize) -> bool {
        let n = 1 << size;
        let first = self.flat[y * CELLS + x];
        (y..y + n).any(|row| self.flat[row * CELLS + x..][..n].iter().any(|&flat| flat != first))
    }
}

/// Returns the range of the picture's luma in a cell.
fn range(tile: &TileResidual, [x, y]: [usize; 2]) -> f32 {
    let (mut least, mut most) = (f32::INFINITY, f32::NEG_INFINITY);
    for row in y * CELL..(y + 1) * CELL {
        for &luma in &tile.luma[row * TILE + x * CELL..][..CELL] {
            (least, most) = (least.min(luma), most.max(luma));
        }
    }
    most - least
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tile(luma: impl Fn(usize, usize) -> f32) -> TileResidual {
        let luma = (0..TILE * TILE).map(|i| luma(i % TILE, i / TILE)).collect();
        TileResidual { size: [64, 40], planes: Default::default(), luma }
    }

    #[test]
    fn only_blocks_across_the_edge_of_a_flat_region_are_mixed() {
        // The texture starts at column 20.
        let ground = Ground::of(&tile(|x, y| if x < 20 { 200.0 } else { (x * 31 % 17 + y * 13 % 11) as f32 }));
        assert_eq!([[0, 0], [4, 0], [8, 0]].map(|cell| ground.is_mixed(cell, 2)), [false, true, false]);
        assert!(ground.is_mixed([0, 0], 3) && !ground.is_mixed([4, 0], 0) && !ground.is_mixed([5, 0], 0));
    }
}
