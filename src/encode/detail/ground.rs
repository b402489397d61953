//! Flat ground of a tile: where ringing shows.

use super::residual::TileResidual;
use crate::bitstream::detail::levels::{CELL, CELLS, SUPER, TILE};

/// Range of luma below which a cell counts as flat: less than a step of 8-bit luma.
const FLAT: f32 = 0.2;

/// The flat cells of a tile.
pub(super) struct Ground {
    flat: Vec<bool>,
}

impl Ground {
    pub(super) fn of(tile: &TileResidual) -> Self {
        // Up to whole superblocks, as luma is.
        let [across, down] = tile.size.map(|side| side.div_ceil(SUPER) * (SUPER / CELL));
        let mut flat = vec![false; CELLS * CELLS];
        for y in 0..down {
            for x in 0..across {
                flat[y * CELLS + x] = range(tile, [x, y]) < FLAT;
            }
        }
        Ground { flat }
    }

    /// Tells whether a block has both flat cells and others: its transform spreads what the others lose over the flat
    /// ones.
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
    fn a_block_at_the_edge_of_flat_ground_is_mixed_and_others_are_not() {
        // Texture from column 20 on.
        let ground = Ground::of(&tile(|x, y| if x < 20 { 200.0 } else { (x * 31 % 17 + y * 13 % 11) as f32 }));
        assert_eq!([[0, 0], [4, 0], [8, 0]].map(|cell| ground.is_mixed(cell, 2)), [false, true, false]);
        assert!(ground.is_mixed([0, 0], 3) && !ground.is_mixed([4, 0], 0) && !ground.is_mixed([5, 0], 0));
    }
}
