//! Finds the flat cells on which a coded tile rings, so that its blocks can be chosen again.

use super::flat_cells::{Ground, Ringing};
use super::residual::TileResidual;
use crate::bitstream::detail::DetailHead;
use crate::bitstream::detail::levels::{CELL, CELLS, TILE, TileLevels};
use crate::constants::detail;
use crate::detail::tile::{Scratch, TilePlanes, UNIT, reconstruct};
use crate::gaussian::Channels;

/// Values of a plane of a residual in a code value.
const PARTS: f32 = 16.0;

/// Returns the cells that ring, and the cells beside them, if `levels` are coded over the Gaussians of `tile`. Only
/// luma counts.
pub(super) fn ringing_cells(
    tile: &TileResidual,
    ground: &Ground,
    (levels, head, channels): (&TileLevels, &DetailHead, Channels),
    ringing: Ringing,
) -> Vec<bool> {
    let mut cells = vec![false; CELLS * CELLS];
    let (mut scratch, mut added) = (Scratch::default(), TilePlanes::default());
    reconstruct(levels, (head, channels, tile.size), &mut scratch, &mut added);
    if added.channels() == 0 {
        return cells;
    }
    let weights: &[f32] = if channels.count() >= 3 { &[0.25, 0.5, 0.25] } else { &[1.0] };
    let [width, height] = tile.size;
    let (mut with, mut without) = (vec![0.0; TILE * TILE], vec![0.0; TILE * TILE]);
    for y in 0..height {
        let rows = y * TILE..y * TILE + width;
        let (with, without) = (&mut with[rows.clone()], &mut without[rows.clone()]);
        for ((with, without), rest) in with.iter_mut().zip(without.iter_mut()).zip(&tile.planes[0][rows]) {
            *without = rest / PARTS;
            *with = *without;
        }
        for (c, weight) in weights.iter().enumerate() {
            for (with, value) in with.iter_mut().zip(added.row(c, [0, y])) {
                *with -= weight * UNIT * f32::from(value);
            }
        }
    }
    for y in 0..height / CELL {
        for x in 0..width / CELL {
            if !ground.is_flat([x, y]) {
                continue;
            }
            let error = deviation(&with, tile.size, [x, y]);
            if error > ringing.least && deviation(&without, tile.size, [x, y]) < detail::MAX_BASE_ERROR_SHARE * error {
                // Lapping spreads the values of the blocks beside it into the cell.
                for row in [y.saturating_sub(1), y, (y + 1).min(CELLS - 1)] {
                    let columns = if row == y { x.saturating_sub(1)..(x + 2).min(CELLS) } else { x..x + 1 };
                    cells[row * CELLS..][columns].fill(true);
                }
            }
        }
    }
    cells
}

/// Returns the root of the mean squared difference between the errors in a cell and their mean in and around it.
fn deviation(errors: &[f32], size: [usize; 2], cell: [usize; 2]) -> f32 {
    let [columns, rows] = [0, 1].map(|i| cell[i] * CELL..(cell[i] + 1) * CELL);
    let [wide, high] = [(&columns, size[0]), (&rows, size[1])].map(|(range, end)| {
        range.start.saturating_sub(detail::RINGING_BORDER)..(range.end + detail::RINGING_BORDER).min(end)
    });
    let count = wide.len() * high.len();
    let sum: f32 = high.map(|row| errors[row * TILE..][wide.clone()].iter().sum::<f32>()).sum();
    let mean = sum / count as f32;
    let square =
        |row: usize| errors[row * TILE..][columns.clone()].iter().map(|e| (e - mean) * (e - mean)).sum::<f32>();
    (rows.map(square).sum::<f32>() / (CELL * CELL) as f32).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bitstream::detail::block::Block;
    use crate::bitstream::detail::scan::at;
    use crate::bitstream::detail::tile::push;

    #[test]
    fn only_flat_cells_that_the_layer_makes_worse_ring() {
        let head = DetailHead { step: 2000, ..DetailHead::PLAIN };
        let ringing = Ringing { least: 3.0, factor: 2.0, rounds: 1 };
        // Waves in a block of 16 pixels at the cell [4, 4].
        let (mut levels, mut block) = (TileLevels::default(), Block::default());
        block.levels[at(5, 0)] = 3;
        block.found.push(at(5, 0) as u16);
        push(&mut levels, 0, [4, 4], 2, &block);
        levels.sizes = std::array::from_fn(|_| vec![2; CELLS * CELLS]);
        let cells_of = |rest: f32, is_flat: bool| {
            let stripes = |i: usize| if i.is_multiple_of(2) { rest } else { -rest };
            let planes = [(0..TILE * TILE).map(stripes).collect(), Vec::new(), Vec::new(), Vec::new()];
            let luma = (0..TILE * TILE).map(|i| if is_flat { 90.0 } else { (i * 31 % 97) as f32 }).collect();
            let tile = TileResidual { size: [64, 64], planes, luma };
            ringing_cells(&tile, &Ground::of(&tile, 4.0), (&levels, &head, Channels::Grey), ringing)
        };
        let found = cells_of(0.0, true);
        let inside = |i: usize| (3..9).contains(&(i % CELLS)) && (3..9).contains(&(i / CELLS));
        assert!(found.iter().enumerate().all(|(i, &rings)| !rings || inside(i)));
        assert!(found[5 * CELLS + 5] && found[5 * CELLS + 3] && !found[3 * CELLS + 3]);
        // Busy cells do not count, nor cells in which the Gaussians are as bad.
        assert!([cells_of(0.0, false), cells_of(16.0 * 40.0, true)].iter().flatten().all(|rings| !rings));
    }
}
