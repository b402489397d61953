//! Computes the forward transform of a tile's residual, in blocks of one size or in the chosen blocks.

use super::residual::TileResidual;
use crate::bitstream::detail::DetailHead;
use crate::bitstream::detail::levels::{CELL, CELLS, SUPER, TILE};
use crate::bitstream::detail::model::PLANES;
use crate::bitstream::detail::scan::SIZES;
use crate::detail::{lap, transform};
use crate::simd::{self, Simd, Task};

/// Coefficients of the planes of a tile in 1/16 code value, each at its position in its block. Rows are [`TILE`] values
/// apart.
pub(super) type Coefficients = [Vec<f32>; PLANES];

/// Division of a plane into blocks.
#[derive(Debug, Clone, Copy)]
pub(super) enum Division<'a> {
    /// All blocks have this size.
    Even(u8),
    /// Each cell lies in a block of the given size.
    Chosen(&'a [u8]),
}

impl Division<'_> {
    #[inline(always)]
    fn size(self, cell: usize) -> u8 {
        match self {
            Division::Even(size) => size,
            Division::Chosen(sizes) => sizes[cell],
        }
    }
}

struct Transform<'a> {
    plane: &'a mut [f32],
    /// Width and height in cells.
    cells: [usize; 2],
    division: Division<'a>,
}

impl Task for Transform<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, _: S) {
        let Transform { plane, cells: [across, down], division } = self;
        lap::apply(plane, [across, down], |cell| division.size(cell));
        for y in 0..down {
            for x in 0..across {
                let size = division.size(y * CELLS + x);
                let n = 1usize << size;
                if x % n == 0 && y % n == 0 {
                    transform::forward(size.into(), &mut plane[y * CELL * TILE + x * CELL..], TILE);
                }
            }
        }
    }
}

/// Returns the coefficients of one plane of `tile` in the blocks of `division`.
pub(super) fn plane(tile: &TileResidual, plane: usize, division: Division<'_>) -> Vec<f32> {
    let mut values = tile.planes[plane].clone();
    if !values.is_empty() {
        let cells = tile.size.map(|side| side.div_ceil(SUPER) * (SUPER / CELL));
        simd::dispatch(Transform { plane: &mut values, cells, division });
    }
    values
}

/// The coefficients of a tile in blocks of every size that the planes may use. They are empty for sizes that a plane
/// does not use.
#[derive(Debug)]
pub(super) struct AllSizes([Coefficients; SIZES]);

impl AllSizes {
    /// Transforms `tile` in blocks of all sizes that `head` allows.
    pub(super) fn new(tile: &TileResidual, head: DetailHead) -> Self {
        AllSizes(std::array::from_fn(|size| {
            std::array::from_fn(|k| {
                let [least, most] = head.sizes([0, 1, 1, 2][k]);
                if (least..=most).contains(&size) { plane(tile, k, Division::Even(size as u8)) } else { Vec::new() }
            })
        }))
    }

    pub(super) fn plane(&self, size: usize, plane: usize) -> &[f32] {
        &self.0[size][plane]
    }
}
