//! Lapping: a filter across each block edge, over two samples on either side, which removes visible block edges (spec
//! §11.5).
//!
//! The encoder applies the forward filter in floats before the transform; the decoder applies the inverse in integers
//! after it.

use crate::bitstream::detail::levels::{CELL, CELLS, TILE};

/// Mixing of the differences across an edge, in 1/4096: `V[j][i]` for the distances `j` and `i` from the edge.
pub(crate) const MIX: [[i32; 2]; 2] = [[MIX_00, MIX_01], [MIX_10, MIX_11]];
const MIX_00: i32 = 3784;
const MIX_01: i32 = 1567;
const MIX_10: i32 = -1567;
const MIX_11: i32 = 3784;

/// Samples on either side of an edge that a filter reads.
pub(super) const REACH: usize = 2;

/// Distance between rows of the samples that the inverse filters work on. A power of two would put the rows of a block
/// into the same few sets of the processor's cache.
pub(super) const PITCH: usize = TILE + 16;

/// Applies the inverse filter to four samples across an edge, which lies between the second and the third.
#[inline(always)]
fn inverse([x0, x1, x2, x3]: [i32; 4]) -> [i32; 4] {
    let (e0, e1) = (x1.wrapping_add(x2), x0.wrapping_add(x3));
    let (d0, d1) = (x1.wrapping_sub(x2), x0.wrapping_sub(x3));
    let mix = |i: usize| d0.wrapping_mul(MIX[0][i]).wrapping_add(d1.wrapping_mul(MIX[1][i])).wrapping_add(2048) >> 12;
    let (m0, m1) = (mix(0), mix(1));
    let half = |v: i32| v.wrapping_add(1) >> 1;
    [half(e1.wrapping_add(m1)), half(e0.wrapping_add(m0)), half(e0.wrapping_sub(m0)), half(e1.wrapping_sub(m1))]
}

/// Applies the forward filter, the inverse of [`inverse`].
#[inline(always)]
fn forward([x0, x1, x2, x3]: [f32; 4]) -> [f32; 4] {
    let (e0, e1, d0, d1) = (x1 + x2, x0 + x3, x1 - x2, x0 - x3);
    let mix = |i: usize| (d0 * MIX[i][0] as f32 + d1 * MIX[i][1] as f32) / 4096.0;
    let (m0, m1) = (mix(0), mix(1));
    [0.5 * (e1 + m1), 0.5 * (e0 + m0), 0.5 * (e0 - m0), 0.5 * (e1 - m1)]
}

/// Tells whether a block of size `size` starts at cell `at` along an axis.
#[inline(always)]
fn begins(at: usize, size: u8) -> bool {
    at.is_multiple_of(1 << size)
}

/// Returns which cells of a row are the first of their block, one bit per cell.
#[inline(always)]
fn beginnings(sizes: &[u8]) -> u64 {
    /// Largest sizes of the blocks that can begin at each of eight cells.
    const LARGEST: u64 = u64::from_le_bytes([3, 0, 1, 0, 2, 0, 1, 0]);
    const HIGH: u64 = 0x8080_8080_8080_8080;
    let mut all = 0;
    for (k, eight) in sizes.as_chunks::<8>().0.iter().enumerate() {
        // The high bit of a byte remains where the size is at most the largest. Sizes are at most 3.
        let some = ((LARGEST | HIGH) - u64::from_le_bytes(*eight)) & HIGH;
        // Collects the bits in the highest byte.
        all |= ((some >> 7).wrapping_mul(0x0102_0408_1020_4080) >> 56) << (8 * k);
    }
    all
}

/// The edges of blocks that have levels; only these edges are filtered. Each row of cells is a word with one bit per
/// cell.
#[derive(Debug)]
pub(crate) struct Edges {
    /// Cells whose upper edge is filtered.
    above: [u64; CELLS],
    /// Cells that are nonzero after the vertical filter.
    held: [u64; CELLS],
}

impl Edges {
    pub(crate) const NONE: Edges = Edges { above: [0; CELLS], held: [0; CELLS] };

    /// Records a block that has levels, `1 << size` cells wide.
    pub(crate) fn note(&mut self, [x, y]: [usize; 2], size: u8) {
        let n = 1usize << size;
        let span = ((1u64 << n) - 1) << x;
        self.above[y] |= span;
        if let Some(below) = self.above.get_mut(y + n) {
            *below |= span;
        }
        // The vertical filter spreads values at most into the next cell.
        for held in &mut self.held[y.saturating_sub(1)..(y + n + 1).min(CELLS)] {
            *held |= span;
        }
    }

    /// Tells whether there are edges above the cells of row `cy`.
    pub(crate) fn has(&self, cy: usize) -> bool {
        self.above[cy] != 0
    }

    /// Filters across the edges above the cells of row `cy`: two rows of samples above them and two below.
    #[cfg_attr(target_family = "wasm", inline(never))]
    #[cfg_attr(not(target_family = "wasm"), inline(always))]
    pub(crate) fn between_rows(&self, cy: usize, above: &mut [i32], below: &mut [i32]) {
        let ((a, b), (c, d)) = (above.split_at_mut(PITCH), below.split_at_mut(PITCH));
        let mut left = self.above[cy];
        while left != 0 {
            // A run of adjacent cells.
            let start = left.trailing_zeros() as usize;
            let end = start + (!(left >> start)).trailing_zeros() as usize;
            left &= u64::MAX.checked_shl(end as u32).unwrap_or(0);
            let span = start * CELL..end * CELL;
            let (a, b, c, d) = (&mut a[span.clone()], &mut b[span.clone()], &mut c[span.clone()], &mut d[span]);
            for i in 0..a.len().min(b.len()).min(c.len()).min(d.len()) {
                [a[i], b[i], c[i], d[i]] = inverse([a[i], b[i], c[i], d[i]]);
            }
        }
    }

    /// Filters the sample `rows` of cell row `cy` across the vertical edges. `sizes` are the block sizes of the cells;
    /// `across` is the number of cells.
    #[cfg_attr(target_family = "wasm", inline(never))]
    #[cfg_attr(not(target_family = "wasm"), inline(always))]
    pub(crate) fn between_columns(&self, cy: usize, rows: &mut [i32], sizes: &[u8], across: usize) {
        let held = self.held[cy];
        let mut left = (held | held << 1) & (u64::MAX >> (CELLS - across)) & !1;
        if left == 0 {
            return;
        }
        let rows = &mut rows[..CELL * PITCH];
        left &= beginnings(&sizes[cy * CELLS..][..CELLS]);
        while left != 0 {
            let cx = left.trailing_zeros() as usize;
            left &= left - 1;
            filter_columns(rows, cx * CELL - REACH);
        }
    }
}

/// Filters the rows of a cell across the edge between the second and the third column from `at` on.
#[inline(always)]
fn filter_columns(rows: &mut [i32], at: usize) {
    // The rows in adjacent lanes.
    let mut columns = [[0; CELL]; 2 * REACH];
    for y in 0..CELL {
        for k in 0..2 * REACH {
            columns[k][y] = rows[y * PITCH + at + k];
        }
    }
    for y in 0..CELL {
        let filtered = inverse([columns[0][y], columns[1][y], columns[2][y], columns[3][y]]);
        for k in 0..2 * REACH {
            columns[k][y] = filtered[k];
        }
    }
    for y in 0..CELL {
        for k in 0..2 * REACH {
            rows[y * PITCH + at + k] = columns[k][y];
        }
    }
}

/// Filters `x` across all block edges. The encoder does this before the transform.
pub(crate) fn apply(x: &mut [f32], cells: [usize; 2], size: impl Fn(usize) -> u8) {
    let [across, down] = cells;
    for cy in 0..down {
        for cx in 1..across {
            if !begins(cx, size(cy * CELLS + cx)) {
                continue;
            }
            for y in 0..CELL {
                let four = &mut x[(cy * CELL + y) * TILE + cx * CELL - REACH..][..2 * REACH];
                let filtered = forward([four[0], four[1], four[2], four[3]]);
                four.copy_from_slice(&filtered);
            }
        }
    }
    for cy in 1..down {
        for cx in 0..across {
            if !begins(cy, size(cy * CELLS + cx)) {
                continue;
            }
            for i in cx * CELL..(cx + 1) * CELL {
                let at: [usize; 4] = std::array::from_fn(|k| (cy * CELL - REACH + k) * TILE + i);
                let filtered = forward(at.map(|at| x[at]));
                at.iter().zip(filtered).for_each(|(&at, value)| x[at] = value);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_mix_is_the_rotation_that_the_specification_gives() {
        // V = J·C2ᵀ·C4·J for two samples on either side.
        let pi = std::f64::consts::PI;
        let c2 = |k: usize, i: usize| {
            ((if k == 0 { 1.0 } else { 2.0 }) / 2.0f64).sqrt() * ((2 * i + 1) as f64 * k as f64 * pi / 4.0).cos()
        };
        let c4 = |k: usize, i: usize| ((2 * i + 1) as f64 * (2 * k + 1) as f64 * pi / 8.0).cos();
        for i in 0..2 {
            for j in 0..2 {
                let v: f64 = (0..2).map(|k| c2(k, 1 - i) * c4(k, 1 - j)).sum();
                assert_eq!((v * 4096.0).round() as i32, MIX[i][j], "{i} {j}");
            }
        }
    }

    #[test]
    fn beginnings_are_the_cells_at_which_blocks_begin() {
        for seed in 0..64 {
            let sizes: [u8; CELLS] = std::array::from_fn(|i| ((i * (2 * seed + 1)) >> 3) as u8 % 4);
            let want = (0..CELLS).filter(|&i| begins(i, sizes[i])).fold(0, |all, i| all | 1 << i);
            assert_eq!(beginnings(&sizes), want, "{sizes:?}");
        }
    }

    #[test]
    fn what_was_lapped_comes_back() {
        let sizes: Vec<u8> = (0..CELLS * CELLS)
            .map(|i| {
                if i % CELLS < 8 {
                    3
                } else if i % CELLS < 12 {
                    0
                } else {
                    2
                }
            })
            .collect();
        let cells = [16, 16];
        let x: Vec<i32> = (0..TILE * TILE).map(|i| ((i * 7919) % 4001) as i32 - 2000).collect();
        let mut lapped: Vec<f32> = x.iter().map(|&v| v as f32).collect();
        apply(&mut lapped, cells, |i| sizes[i]);
        let mut back = vec![0; TILE * PITCH];
        for (back, lapped) in back.chunks_exact_mut(PITCH).zip(lapped.chunks_exact(TILE)) {
            back.iter_mut().zip(lapped).for_each(|(back, &v)| *back = v.round() as i32);
        }
        let mut edges = Edges::NONE;
        for (i, &size) in sizes.iter().enumerate() {
            let cell = [i % CELLS, i / CELLS];
            if cell.iter().all(|&c| begins(c, size)) {
                edges.note(cell, size);
            }
        }
        for cy in 1..cells[1] {
            let (above, below) = back.split_at_mut(cy * CELL * PITCH);
            edges.between_rows(cy, &mut above[(cy * CELL - REACH) * PITCH..], below);
        }
        for cy in 0..cells[1] {
            edges.between_columns(cy, &mut back[cy * CELL * PITCH..], &sizes, cells[0]);
        }
        for y in 0..64 {
            for x_ in 0..64 {
                let (got, want) = (back[y * PITCH + x_], x[y * TILE + x_]);
                // Values are rounded to integers in between and in each of two passes.
                assert!((got - want).abs() <= 4, "{x_} {y}: {got} for {want}");
            }
        }
    }
}
