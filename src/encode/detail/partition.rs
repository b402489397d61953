//! Chooses the blocks of a tile from an estimate of their cost, without the entropy coder.
//!
//! The tile is lapped once for each block size, and the quadtree with the lowest estimated cost is chosen.

use super::coefficients::AllSizes;
use super::flat_cells::Ground;
use super::residual::TileResidual;
use super::scaled::{Factors, rough_cost};
use super::settings::{Setting, planes};
use crate::bitstream::detail::levels::{CELL, CELLS, SUPER, SUPERS};
use crate::bitstream::detail::model::KINDS;
use crate::bitstream::detail::tile::{ROOT, TileState, kinds};

/// Returns the size of the block that each cell of `tile` lies in, by kind.
pub(super) fn blocks(tile: &TileResidual, (classes, ground): (&[u8], &Ground), setting: &Setting) -> [Vec<u8>; KINDS] {
    blocks_among(&AllSizes::new(tile, setting.head), tile, (classes, ground), setting)
}

/// Returns the same, given the coefficients of `tile` in blocks of all sizes, its classes and its flat cells.
pub(super) fn blocks_among(
    all: &AllSizes,
    tile: &TileResidual,
    (classes, ground): (&[u8], &Ground),
    setting: &Setting,
) -> [Vec<u8>; KINDS] {
    let sizes = std::array::from_fn(|_| vec![0; CELLS * CELLS]);
    let factors = Factors::new(setting.head, setting.gain);
    let mut chooser = BlockChooser { setting, classes, all, factors, ground, sizes };
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
    ground: &'a Ground,
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
        let factor = self.ground.factor(kind, cell, size, self.setting.mixed.estimate);
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
    use crate::encode::detail::flat_cells::MixedBlocks;
    use crate::encode::detail::settings::{BlockChoice, LevelSearch};
    use crate::encode::detail::trellis::priced_blocks;
    use crate::gaussian::Channels;

    /// Returns the block sizes of luma by the estimate and by prices.
    fn sizes_of(residual: impl Fn(usize, usize) -> f32) -> [Vec<u8>; 2] {
        sizes_over(residual, |_, _| 0.0, MixedBlocks::PLAIN)
    }

    /// Returns the same for a picture with this luma.
    fn sizes_over(
        residual: impl Fn(usize, usize) -> f32,
        luma: impl Fn(usize, usize) -> f32,
        mixed: MixedBlocks,
    ) -> [Vec<u8>; 2] {
        let mut planes: [Vec<f32>; PLANES] = Default::default();
        planes[0] = (0..TILE * TILE).map(|i| residual(i % TILE, i / TILE)).collect();
        let luma = (0..TILE * TILE).map(|i| luma(i % TILE, i / TILE)).collect();
        let tile = TileResidual { size: [TILE, TILE], planes, luma };
        let head = DetailHead { step: 640, ..DetailHead::PLAIN };
        let (level_search, blocks_by) = (LevelSearch::Thorough, BlockChoice::Rough);
        let setting =
            Setting { head, channels: Channels::Grey, lambda: 0.1, gain: 1.0, level_search, blocks: blocks_by, mixed };
        let ground = Ground::of(&tile, mixed.flat_range);
        let [[estimated, ..], [priced, ..]] = [
            blocks(&tile, (&[], &ground), &setting),
            priced_blocks(&tile, (&[], &ground), &Setting { blocks: BlockChoice::Priced, ..setting }),
        ];
        [estimated, priced]
    }

    /// Returns the fraction of the cells that lie in the largest blocks.
    fn large(sizes: &[u8]) -> f32 {
        sizes.iter().filter(|&&size| size == 3).count() as f32 / sizes.len() as f32
    }

    #[test]
    fn waves_get_large_blocks_and_a_dot_gets_a_small_one() {
        let wave = |x: usize| 2000.0 * (std::f32::consts::PI * (x % 32 * 2 + 1) as f32 * 5.0 / 64.0).cos();
        let dot = |x: usize, y: usize| if [x, y] == [66, 66] { 3000.0 } else { 0.0 };
        for (sizes, dotted) in std::iter::zip(sizes_of(|x, _| wave(x)), sizes_of(dot)) {
            assert!(large(&sizes) > 0.9, "{} of the cells are in blocks of 32", large(&sizes));
            assert_eq!(dotted[66 / CELL * CELLS + 66 / CELL], 0);
            assert_eq!(dotted[CELLS * CELLS - 1], 3);
        }
    }

    #[test]
    fn blocks_with_many_levels_are_as_large_as_estimated() {
        // Each block of 32 has more than a hundred levels: a plane wave with each of the frequencies.
        let wave = |at: usize, k: usize| (std::f32::consts::PI * ((at % 32 * 2 + 1) * k) as f32 / 64.0).cos();
        let sum = |at: usize| (3..14).map(|k| if k * k % 7 > 2 { wave(at, k) } else { -wave(at, k) }).sum::<f32>();
        let [estimated, priced] = sizes_of(|x, y| 300.0 * sum(x) * sum(y));
        assert!(large(&estimated) > 0.9, "{} of the cells are in blocks of 32", large(&estimated));
        assert_eq!(priced, estimated);
    }

    #[test]
    fn blocks_across_the_edge_of_flat_ground_are_small_if_they_cost_more() {
        let wave = |x: usize| 2000.0 * (std::f32::consts::PI * (x % 32 * 2 + 1) as f32 * 5.0 / 64.0).cos();
        let luma = |x: usize, y: usize| if x < 48 { (x + y) as f32 % 3.0 } else { (x * 31 + y * 13) as f32 % 90.0 };
        let sizes = |estimate, price| {
            let mixed = MixedBlocks { flat_range: 4.0, estimate, price, ringing: None };
            // Blocks on flat ground, across its edge, and beside it.
            sizes_over(|x, _| wave(x), luma, mixed).map(|sizes| [0, 8, 16].map(|cell| sizes[cell]))
        };
        assert_eq!(sizes(1.0, 1.0), [[3; 3]; 2]);
        let small = sizes(9.0, 9.0);
        assert!(small.iter().all(|&[flat, across, beside]| flat == 3 && across < 3 && beside == 3), "{small:?}");
        assert_eq!([sizes(9.0, 1.0)[1], sizes(1.0, 9.0)[0]], [[3; 3]; 2]);
    }
}
