//! Scales the coefficients of a block to units of their quantizer steps.

use super::coefficients::Coefficients;
use crate::bitstream::detail::head::DetailHead;
use crate::bitstream::detail::levels::{CELL, TILE};
use crate::bitstream::detail::model::{CLASSES, PLANES};
use crate::bitstream::detail::scan::SIZES;
use crate::constants::detail;
use crate::detail::steps::PlaneSteps;
use crate::simd::{self, Simd, Task};

/// Number of coefficients of the largest block.
const LARGEST_BLOCK: usize = (CELL << (SIZES - 1)) * (CELL << (SIZES - 1));

/// Factors that convert coefficients to units of quantizer steps, for each class, plane and block size. They are
/// computed on first use.
pub(super) struct Factors {
    head: DetailHead,
    /// Factor on the coefficients of luma.
    gain: f32,
    factors: Vec<Vec<f32>>,
}

impl Factors {
    pub(super) fn new(head: DetailHead, gain: f32) -> Self {
        Factors { head, gain, factors: vec![Vec::new(); CLASSES * PLANES * SIZES] }
    }

    /// Returns the factors of a block of `plane` in a superblock of `class`, row by row.
    pub(super) fn of(&mut self, class: u8, plane: usize, size: usize) -> &[f32] {
        let factors = &mut self.factors[(usize::from(class) * PLANES + plane) * SIZES + size];
        if factors.is_empty() {
            let steps = PlaneSteps::new(&self.head, plane, class);
            let n = CELL << size;
            // Steps are in 1/64 code value, coefficients in 1/16.
            let scale = if plane == 0 { 4.0 * self.gain } else { 4.0 };
            *factors = (0..n * n).map(|i| scale / steps.step(size, i % n, i / n) as f32).collect();
        }
        factors
    }
}

/// The coefficients of one block in units of their steps.
pub(super) struct Values {
    values: Vec<f32>,
    /// Side of the block, in coefficients.
    side: usize,
    /// Sum of the squared values.
    pub energy: f32,
    /// Largest magnitude.
    pub largest: f32,
}

impl Default for Values {
    fn default() -> Self {
        Values { values: vec![0.0; LARGEST_BLOCK], side: 0, energy: 0.0, largest: 0.0 }
    }
}

impl Values {
    /// Loads the block at the cell `[x, y]` of a plane. Empty `coefficients` represent zeros.
    pub(super) fn take(&mut self, coefficients: &[f32], [x, y]: [usize; 2], size: usize, factors: &[f32]) {
        (self.side, self.energy, self.largest) = (CELL << size, 0.0, 0.0);
        if !coefficients.is_empty() {
            let coefficients = &coefficients[y * CELL * TILE + x * CELL..];
            let values = &mut self.values[..self.side * self.side];
            [self.energy, self.largest] = simd::dispatch(Scale { coefficients, factors, side: self.side, values });
        }
    }

    /// Calls `look` with the column, row and value of each coefficient whose magnitude exceeds `least`.
    pub(super) fn above(&self, least: f32, mut look: impl FnMut(usize, usize, f32)) {
        if self.largest <= least {
            return;
        }
        for (v, row) in self.values[..self.side * self.side].chunks_exact(self.side).enumerate() {
            for (u, four) in row.as_chunks::<4>().0.iter().enumerate() {
                // Most groups have no such coefficient.
                if four.iter().fold(0f32, |most, value| most.max(value.abs())) <= least {
                    continue;
                }
                for (k, &value) in four.iter().enumerate().filter(|(_, value)| value.abs() > least) {
                    look(4 * u + k, v, value);
                }
            }
        }
    }
}

/// Multiplies coefficients by their factors. Returns the sum of squares and the largest magnitude.
struct Scale<'a> {
    coefficients: &'a [f32],
    factors: &'a [f32],
    side: usize,
    values: &'a mut [f32],
}

impl Task for Scale<'_> {
    type Output = [f32; 2];

    #[inline(always)]
    fn run<S: Simd>(self, _: S) -> [f32; 2] {
        let Scale { coefficients, factors, side, values } = self;
        // Four partial sums, so that every instruction set adds in the same order.
        let (mut sums, mut largest) = ([0f32; 4], [0f32; 4]);
        for v in 0..side {
            let row = coefficients[v * TILE..][..side].as_chunks::<4>().0;
            let factors = factors[v * side..][..side].as_chunks::<4>().0;
            for ((c, f), out) in row.iter().zip(factors).zip(values[v * side..][..side].as_chunks_mut::<4>().0) {
                for k in 0..4 {
                    out[k] = c[k] * f[k];
                    sums[k] += out[k] * out[k];
                    let magnitude = out[k].abs();
                    largest[k] = if magnitude > largest[k] { magnitude } else { largest[k] };
                }
            }
        }
        [sums.iter().sum(), largest.iter().fold(0f32, |most, &value| most.max(value))]
    }
}

/// Returns the estimated cost of a block in squared steps. For each coefficient it adds the smaller of two costs: the
/// squared error without a level, or the cost of a level.
pub(super) fn rough_cost(coefficients: &[f32], [x, y]: [usize; 2], size: usize, factors: &[f32]) -> f32 {
    if coefficients.is_empty() {
        return 0.0;
    }
    simd::dispatch(RoughCost { coefficients: &coefficients[y * CELL * TILE + x * CELL..], factors, side: CELL << size })
}

struct RoughCost<'a> {
    coefficients: &'a [f32],
    factors: &'a [f32],
    side: usize,
}

impl Task for RoughCost<'_> {
    type Output = f32;

    #[inline(always)]
    fn run<S: Simd>(self, _: S) -> f32 {
        let RoughCost { coefficients, factors, side } = self;
        let mut sums = [0f32; 4];
        for v in 0..side {
            let row = coefficients[v * TILE..][..side].as_chunks::<4>().0;
            for (c, f) in row.iter().zip(factors[v * side..][..side].as_chunks::<4>().0) {
                for k in 0..4 {
                    let value = (c[k] * f[k]).abs();
                    let (error, level) =
                        (value * value, detail::ESTIMATED_LEVEL_COST + detail::ESTIMATED_MAGNITUDE_COST * value);
                    sums[k] += if error < level { error } else { level };
                }
            }
        }
        sums.iter().sum()
    }
}

/// Maximum number of tiles for which a search keeps the coefficients between its runs. Each takes a megabyte.
pub(super) const KEPT_TILES: usize = 64;

/// The coefficients of a tile in its chosen blocks. They are computed on first use.
pub(super) type CachedCoefficients = std::sync::OnceLock<Coefficients>;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_coefficients_divided_by_their_steps() {
        let head = DetailHead { step: 700, ..DetailHead::SEEN };
        let (plane, class, size, cell) = (1, 2, 2, [4, 8]);
        let n = CELL << size;
        let coefficients: Vec<f32> = (0..TILE * TILE).map(|i| (i * 7919 % 2001) as f32 - 1000.0).collect();
        let (mut factors, mut values) = (Factors::new(head, 1.0), Values::default());
        values.take(&coefficients, cell, size, factors.of(class, plane, size));
        let steps = PlaneSteps::new(&head, plane, class);
        let value = |u: usize, v: usize| {
            let coefficient = coefficients[(cell[1] * CELL + v) * TILE + cell[0] * CELL + u];
            coefficient * 4.0 / steps.step(size, u, v) as f32
        };
        let mut wanted: Vec<_> = (0..n * n).map(|i| (i % n, i / n, value(i % n, i / n))).collect();
        let energy: f32 = wanted.iter().map(|(_, _, value)| value * value).sum();
        assert!((values.energy / energy - 1.0).abs() < 1e-4, "{} {energy}", values.energy);
        wanted.retain(|(_, _, value)| value.abs() > 0.58);
        let mut found = Vec::new();
        values.above(0.58, |u, v, value| found.push((u, v, value)));
        assert!(!found.is_empty() && found.len() < n * n);
        assert_eq!(found.len(), wanted.len());
        for (a, b) in found.iter().zip(&wanted) {
            assert!((a.0, a.1) == (b.0, b.1) && (a.2 - b.2).abs() < 1e-4 * b.2.abs(), "{a:?} {b:?}");
        }
        values.take(&[], cell, size, factors.of(class, plane, size));
        assert_eq!([values.energy, values.largest], [0.0; 2]);
        values.above(0.0, |_, _, _| panic!("a plane without coefficients has no values"));
    }
}
