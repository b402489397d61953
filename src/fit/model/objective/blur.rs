//! Binomial blurs of planes of cells, in one pass over memory. All instruction sets add in the same order, so the
//! results are identical.

use crate::parallel;
use crate::simd::{self, LANES, Simd, Task};

/// Weights of the outer neighbours, the inner neighbours and the cell itself.
const TAPS: [f32; 3] = [0.0625, 0.25, 0.375];

/// Rows per unit of parallel work.
const CHUNK: usize = 32;

/// A plane of cells, each of `each` adjacent floats.
#[derive(Debug, Clone, Default)]
pub(crate) struct Cells {
    pub width: usize,
    pub height: usize,
    /// Floats per cell.
    pub each: usize,
    pub values: Vec<f32>,
}

impl Cells {
    /// Returns the floats of row `y`.
    #[inline(always)]
    pub(crate) fn row(&self, y: usize) -> &[f32] {
        &self.values[y * self.width * self.each..][..self.width * self.each]
    }

    /// Applies the binomial blur (1 4 6 4 1)/16 in both directions. Borders are repeated. `spare` is scratch memory.
    pub(crate) fn blur(&mut self, spare: &mut Vec<f32>) {
        let (length, height, each) = (self.width * self.each, self.height, self.each);
        // All values are overwritten below, so there is no need to clear them.
        spare.resize(self.values.len(), 0.0);
        parallel::map_chunks(spare, (CHUNK * length).max(1), |c, out| {
            let mut across = vec![0.0f32; 5 * length];
            let mut next = (c * CHUNK).saturating_sub(2);
            for (i, out) in out.chunks_exact_mut(length).enumerate() {
                let y = c * CHUNK + i;
                while next < height.min(y + 3) {
                    let sums = &mut across[next % 5 * length..][..length];
                    simd::dispatch(HorizontalTask { row: self.row(next), sums, each });
                    next += 1;
                }
                let rows = std::array::from_fn(|t| {
                    &across[(y + t).saturating_sub(2).min(height - 1) % 5 * length..][..length]
                });
                simd::dispatch(VerticalTask { rows, out });
            }
        });
        std::mem::swap(&mut self.values, spare);
    }

    /// Halves the resolution by averaging 2 × 2 cells. Borders are repeated. `spare` is scratch memory.
    pub(crate) fn halve(&mut self, spare: &mut Vec<f32>) {
        let (width, height, each) = (self.width.div_ceil(2), self.height.div_ceil(2), self.each);
        spare.resize(width * height * each, 0.0);
        parallel::map_chunks(spare, (width * each).max(1), |y, out| {
            let (a, b) = (self.row(2 * y), self.row((2 * y + 1).min(self.height - 1)));
            for (x, out) in out.chunks_exact_mut(each).enumerate() {
                let (l, r) = (2 * x * each, (2 * x + 1).min(self.width - 1) * each);
                for (k, o) in out.iter_mut().enumerate() {
                    *o = 0.25 * (a[l + k] + a[r + k] + b[l + k] + b[r + k]);
                }
            }
        });
        (self.width, self.height) = (width, height);
        std::mem::swap(&mut self.values, spare);
    }
}

/// Returns the binomial blur of a plane of single floats.
pub(crate) fn blur(plane: &[f32], width: usize, height: usize) -> Vec<f32> {
    let mut cells = Cells { width, height, each: 1, values: plane.to_vec() };
    cells.blur(&mut Vec::new());
    cells.values
}

/// Returns the weighted sum of five values.
#[inline(always)]
fn sum([a, b, c, d, e]: [f32; 5]) -> f32 {
    TAPS[0] * (a + e) + TAPS[1] * (b + d) + TAPS[2] * c
}

/// Returns the weighted sum of five vectors, lane by lane.
#[inline(always)]
fn sum_lanes<S: Simd>(simd: S, [a, b, c, d, e]: [S::Vector; 5]) -> S::Vector {
    let far = simd.mul(simd.splat(TAPS[0]), simd.add(a, e));
    let near = simd.mul(simd.splat(TAPS[1]), simd.add(b, d));
    simd.add(simd.add(far, near), simd.mul(simd.splat(TAPS[2]), c))
}

/// Blurs one row horizontally.
struct HorizontalTask<'a> {
    row: &'a [f32],
    sums: &'a mut [f32],
    each: usize,
}

impl Task for HorizontalTask<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let HorizontalTask { row, sums, each } = self;
        let (length, border) = (row.len(), 2 * each);
        let width = length / each;
        let mut i = 0;
        while i < length {
            if i >= border && i + border + LANES <= length {
                let five = [
                    simd.read(&row[i - border..]),
                    simd.read(&row[i - each..]),
                    simd.read(&row[i..]),
                    simd.read(&row[i + each..]),
                    simd.read(&row[i + border..]),
                ];
                simd.write(&mut sums[i..], sum_lanes(simd, five));
                i += LANES;
            } else {
                let (x, k) = (i / each, i % each);
                let mut five = [0.0; 5];
                for (t, v) in five.iter_mut().enumerate() {
                    *v = row[(x + t).saturating_sub(2).min(width - 1) * each + k];
                }
                sums[i] = sum(five);
                i += 1;
            }
        }
    }
}

/// Blurs five rows vertically.
struct VerticalTask<'a> {
    rows: [&'a [f32]; 5],
    out: &'a mut [f32],
}

impl Task for VerticalTask<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let VerticalTask { rows, out } = self;
        let mut i = 0;
        while i + LANES <= out.len() {
            let [a, b, c, d, e] = rows;
            let five =
                [simd.read(&a[i..]), simd.read(&b[i..]), simd.read(&c[i..]), simd.read(&d[i..]), simd.read(&e[i..])];
            simd.write(&mut out[i..], sum_lanes(simd, five));
            i += LANES;
        }
        while i < out.len() {
            out[i] = sum([rows[0][i], rows[1][i], rows[2][i], rows[3][i], rows[4][i]]);
            i += 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simd::Plain;

    fn noise(count: usize) -> Vec<f32> {
        (0..count).map(|i| (i * 7919 % 1009) as f32 * 1e-3 - 0.4).collect()
    }

    #[test]
    fn every_cell_is_the_weighted_sum_of_its_neighbours() {
        const WEIGHTS: [f32; 5] = [0.0625, 0.25, 0.375, 0.25, 0.0625];
        for (width, height, each) in [(1, 1, 1), (3, 2, 4), (5, 40, 1), (37, 70, 4), (64, 33, 1)] {
            let before = Cells { width, height, each, values: noise(width * height * each) };
            let mut after = before.clone();
            after.blur(&mut vec![7.0; 3]);
            for i in 0..width * height * each {
                let (x, y, k) = (i / each % width, i / each / width, i % each);
                let mut want = 0.0;
                for (v, &down) in WEIGHTS.iter().enumerate() {
                    for (u, &across) in WEIGHTS.iter().enumerate() {
                        let [x, y] = [(x + u, width), (y + v, height)].map(|(p, n)| p.saturating_sub(2).min(n - 1));
                        want += down * across * before.row(y)[x * each + k];
                    }
                }
                assert!((after.values[i] - want).abs() < 1e-6, "{width} × {height} × {each}, {i}");
            }
        }
    }

    #[test]
    fn every_instruction_set_blurs_to_the_same_bits() {
        let row = noise(4 * 53);
        let [mut found, mut want] = [(); 2].map(|()| vec![0.0; row.len()]);
        simd::dispatch(HorizontalTask { row: &row, sums: &mut found, each: 4 });
        HorizontalTask { row: &row, sums: &mut want, each: 4 }.run(Plain);
        assert_eq!(found, want);
        let rows = std::array::from_fn(|t| &row[8 * t..][..53]);
        let [mut found, mut want] = [(); 2].map(|()| vec![0.0; 53]);
        simd::dispatch(VerticalTask { rows, out: &mut found });
        VerticalTask { rows, out: &mut want }.run(Plain);
        assert_eq!(found, want);
    }
}
