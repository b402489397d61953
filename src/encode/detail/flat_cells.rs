//! Finds the flat regions of a tile, where ringing is visible.

use super::residual::TileResidual;
use crate::bitstream::detail::levels::{CELL, CELLS, SUPER, TILE};
use crate::constants::detail;

/// When and how the blocks of a tile are chosen again.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Ringing {
    /// Root of the mean squared error, without the mean around a cell, from which a flat cell rings, code values.
    pub least: f32,
    /// Factor on the cost of mixed blocks that contain or touch such a cell.
    pub factor: f32,
    /// Maximum number of times that the blocks are chosen again.
    pub rounds: u32,
}

/// How much blocks cost that contain both flat and other cells.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct MixedBlocks {
    /// Range of luma below which a cell is flat, code values.
    pub flat_range: f32,
    /// Factor on their estimated cost.
    pub estimate: f32,
    /// Factor on their cost by the prices of the entropy coder.
    pub price: f32,
    /// How the blocks of a tile are chosen again if it rings.
    pub ringing: Option<Ringing>,
}

impl MixedBlocks {
    /// They cost as much as others. Only the error counts, wherever it is.
    pub(super) const PLAIN: MixedBlocks =
        MixedBlocks { flat_range: ONE_VALUE, estimate: 1.0, price: 1.0, ringing: None };
    /// For photographs, whose flat ground has some noise.
    pub(super) const PHOTOGRAPH: MixedBlocks = MixedBlocks {
        flat_range: detail::FLAT_RANGE,
        estimate: detail::MIXED_COST,
        price: detail::MIXED_COST,
        ringing: Some(Ringing {
            least: detail::MIN_RINGING,
            factor: detail::RINGING_COST,
            rounds: detail::RINGING_ROUNDS,
        }),
    };
    /// For drawings.
    pub(super) const DRAWING: MixedBlocks = MixedBlocks { estimate: detail::DRAWING_MIXED_COST, ..MixedBlocks::PLAIN };
}

/// Kind of the plane of alpha.
const ALPHA: usize = 2;
/// Range of luma within cells of one colour, code values: less than one step of 8-bit luma.
const ONE_VALUE: f32 = 0.2;

/// The flat cells of a tile.
pub(super) struct Ground {
    flat: Vec<bool>,
    /// The cells that ring or lie beside such cells; empty if there are none.
    ringing: Vec<bool>,
    /// Factor on the cost of mixed blocks with such cells.
    ringing_factor: f32,
}

impl Ground {
    /// Finds the cells of `tile` in which the range of luma is below `flat_range` code values.
    pub(super) fn of(tile: &TileResidual, flat_range: f32) -> Self {
        // The cells cover whole superblocks, to which luma is padded.
        let [across, down] = tile.size.map(|side| side.div_ceil(SUPER) * (SUPER / CELL));
        let mut flat = vec![false; CELLS * CELLS];
        for y in 0..down {
            for x in 0..across {
                flat[y * CELLS + x] = range(tile, [x, y]) < flat_range;
            }
        }
        Ground { flat, ringing: Vec::new(), ringing_factor: 1.0 }
    }

    /// Makes mixed blocks that contain any of these cells, or of those that were added before, cost `factor` times as
    /// much. Returns whether there are new cells among them.
    pub(super) fn add_ringing(&mut self, cells: &[bool], factor: f32) -> bool {
        self.ringing.resize(cells.len(), false);
        let is_new = cells.iter().zip(&self.ringing).any(|(&found, &known)| found && !known);
        self.ringing.iter_mut().zip(cells).for_each(|(known, &found)| *known |= found);
        self.ringing_factor = factor;
        is_new
    }

    /// Returns whether a cell is flat.
    pub(super) fn is_flat(&self, [x, y]: [usize; 2]) -> bool {
        self.flat[y * CELLS + x]
    }

    /// Returns the factor on the cost of a block. `usual` is that on the cost of mixed blocks.
    pub(super) fn factor(&self, kind: usize, [x, y]: [usize; 2], size: usize, usual: f32) -> f32 {
        if !self.is_mixed(kind, [x, y], size) {
            return 1.0;
        }
        let n = 1 << size;
        let rings = |row: usize| self.ringing[row * CELLS + x..][..n].contains(&true);
        if !self.ringing.is_empty() && (y..y + n).any(rings) { self.ringing_factor } else { usual }
    }

    /// Returns whether a block of a kind of planes contains both flat and other cells. The transform of such a block
    /// spreads the errors of the other cells over the flat ones.
    pub(super) fn is_mixed(&self, kind: usize, [x, y]: [usize; 2], size: usize) -> bool {
        // Flat regions are those of luma. Alpha has its own edges.
        if kind == ALPHA {
            return false;
        }
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

    fn ground(flat_range: f32, luma: impl Fn(usize, usize) -> f32) -> Ground {
        let luma = (0..TILE * TILE).map(|i| luma(i % TILE, i / TILE)).collect();
        Ground::of(&TileResidual { size: [64, 40], planes: Default::default(), luma }, flat_range)
    }

    #[test]
    fn only_blocks_across_the_edge_of_a_flat_region_are_mixed() {
        // The texture starts at column 20.
        let ground = ground(ONE_VALUE, |x, y| if x < 20 { 200.0 } else { (x * 31 % 17 + y * 13 % 11) as f32 });
        assert_eq!([[0, 0], [4, 0], [8, 0]].map(|cell| ground.is_mixed(0, cell, 2)), [false, true, false]);
        assert!(ground.is_mixed(1, [0, 0], 3) && !ground.is_mixed(1, [4, 0], 0) && !ground.is_mixed(1, [5, 0], 0));
        assert!(!ground.is_mixed(ALPHA, [4, 0], 2));
    }

    #[test]
    fn noise_below_the_range_is_flat() {
        let noise =
            |x: usize, y: usize| if x < 20 { (x * 7 + y * 5) as f32 % 4.0 } else { (x * 31 + y * 13) as f32 % 90.0 };
        let is_mixed = |flat_range: f32| ground(flat_range, noise).is_mixed(0, [4, 0], 2);
        assert_eq!([0.2, 3.0, 3.5].map(is_mixed), [false, false, true]);
    }
}
