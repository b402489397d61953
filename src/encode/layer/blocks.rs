//! Chooses the blocks of a tile from an estimate of their cost, without the entropy coder.
//!
//! The tile is lapped once for each block size, and the quadtree with the lowest estimated cost is chosen. Pricing the
//! blocks with the entropy coder takes about fifteen times as long and loses 0.1 SSIMULACRA2 points.

use super::choose::{Setting, planes};
use super::coefficients::AllSizes;
use super::ground::Ground;
use super::in_steps::{Factors, rough_cost};
use super::residual::TileResidual;
use crate::bitstream::detail::levels::{CELL, CELLS, SUPER, SUPERS};
use crate::bitstream::detail::model::KINDS;
use crate::bitstream::detail::tile::{ROOT, TileState, kinds};

/// Returns the size of the block that each cell of `tile` lies in, by kind.
pub(super) fn blocks(tile: &TileResidual, classes: &[u8], setting: &Setting) -> [Vec<u8>; KINDS] {
    let all = AllSizes::new(tile, |plane| setting.head.sizes([0, 1, 1, 2][plane]));
    let sizes = std::array::from_fn(|_| vec![0; CELLS * CELLS]);
    let (factors, ground) = (Factors::new(setting.head), Ground::of(tile));
    let mut chooser = BlockChooser { setting, classes, all: &all, factors, ground, sizes };
    for at in TileState::new(tile.size).superblocks() {
        for (kind, _) in kinds(setting.channels, setting.head.alpha) {
            chooser.tree(kind, at, ROOT);
        }
    }
    chooser.sizes
}

struct BlockChooser<'a> {
    setting: &'a Setting,
    classes: &'a [u8],
    all: &'a AllSizes,
    factors: Factors,
    ground: Ground,
    sizes: [Vec<u8>; KINDS],
}

impl BlockChooser<'_> {
    /// Chooses the blocks of a square and returns their cost.
    fn tree(&mut self, kind: usize, cell: [usize; 2], size: usize) -> f32 {
        let [least, most] = self.setting.head.sizes(kind);
        if size > most {
            return self.quarters(kind, cell, size);
        }
        let one = self.cost(kind, cell, size);
        if size > least {
            let four = self.quarters(kind, cell, size);
            if four < one {
                return four;
            }
        }
        let n = 1 << size;
        for row in 0..n {
            self.sizes[kind][(cell[1] + row) * CELLS + cell[0]..][..n].fill(size as u8);
        }
        one
    }

    fn quarters(&mut self, kind: usize, [x, y]: [usize; 2], size: usize) -> f32 {
        let half = 1 << (size - 1);
        let quarters = [[0, 0], [1, 0], [0, 1], [1, 1]];
        quarters.map(|[i, j]| self.tree(kind, [x + i * half, y + j * half], size - 1)).iter().sum()
    }

    fn cost(&mut self, kind: usize, cell: [usize; 2], size: usize) -> f32 {
        let [x, y] = cell.map(|c| c / (SUPER / CELL));
        let class = self.classes.get(y * SUPERS + x).copied().unwrap_or(0);
        // Flat regions are those of luma. Alpha has its own edges.
        let factor = if kind < 2 && self.ground.is_mixed(cell, size) { self.setting.mixed_cost } else { 1.0 };
        let cost =
            |plane: usize| rough_cost(self.all.plane(size, plane), cell, size, self.factors.of(class, plane, size));
        factor * planes(kind).map(cost).sum::<f32>()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bitstream::detail::head::DetailHead;
    use crate::bitstream::detail::levels::TILE;
    use crate::bitstream::detail::model::PLANES;
    use crate::encode::layer::choose::{BlockChoice, LevelSearch};
    use crate::gaussian::Channels;

    fn sizes_of(luma: impl Fn(usize, usize) -> f32) -> Vec<u8> {
        let mut planes: [Vec<f32>; PLANES] = Default::default();
        planes[0] = (0..TILE * TILE).map(|i| luma(i % TILE, i / TILE)).collect();
        let tile = TileResidual { size: [TILE, TILE], planes, luma: vec![0.0; TILE * TILE] };
        let head = DetailHead { step: 640, ..DetailHead::PLAIN };
        let (level_search, blocks_by) = (LevelSearch::Thorough, BlockChoice::Rough);
        let setting =
            Setting { head, channels: Channels::Grey, lambda: 0.1, level_search, blocks: blocks_by, mixed_cost: 1.0 };
        let [sizes, ..] = blocks(&tile, &[], &setting);
        sizes
    }

    #[test]
    fn waves_get_large_blocks_and_a_dot_gets_a_small_one() {
        let wave = |x: usize| 2000.0 * (std::f32::consts::PI * (x % 32 * 2 + 1) as f32 * 5.0 / 64.0).cos();
        let sizes = sizes_of(|x, _| wave(x));
        let large = sizes.iter().filter(|&&size| size == 3).count();
        assert!(large > sizes.len() * 9 / 10, "{large} of {} cells are in blocks of 32", sizes.len());
        let dot = |x: usize, y: usize| if [x, y] == [66, 66] { 3000.0 } else { 0.0 };
        let sizes = sizes_of(dot);
        assert_eq!(sizes[66 / CELL * CELLS + 66 / CELL], 0);
        assert_eq!(sizes[CELLS * CELLS - 1], 3);
    }
}
