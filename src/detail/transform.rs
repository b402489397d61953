//! Inverse cosine transform in integers (spec §11.5).

use std::sync::OnceLock;

use crate::angle::sin_cos;
use crate::bitstream::detail::scan::LARGEST;

/// Row `k` of the matrix of side `N`: `round(2048·cos(…))`.
pub(crate) type Matrix = [[i32; LARGEST]; LARGEST];

/// Returns the matrices of blocks with sides of 4, 8, 16 and 32.
pub(crate) fn matrices() -> &'static [Matrix; 4] {
    static MATRICES: OnceLock<[Matrix; 4]> = OnceLock::new();
    MATRICES.get_or_init(|| {
        let cosine = |j: usize| (sin_cos(j as f64 * std::f64::consts::PI / 64.0).1 * 2048.0).round() as i32;
        std::array::from_fn(|size| {
            let side = 4usize << size;
            let mut matrix = [[0; LARGEST]; LARGEST];
            for (k, row) in matrix.iter_mut().enumerate().take(side) {
                for (i, entry) in row.iter_mut().enumerate().take(side) {
                    *entry = cosine(if k == 0 { 16 } else { (2 * i + 1) * k * (32 / side) % 128 });
                }
            }
            matrix
        })
    })
}

/// A coefficient and its position.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Coefficient {
    pub u: u8,
    pub v: u8,
    pub value: i32,
}

/// Bits dropped after the first pass: half of the scale of both matrices.
const FIRST_PASS_SHIFT: u32 = 11;

/// Writes the block of side `N` with these `coefficients` to `out`, whose rows are `stride` apart.
#[cfg(not(target_family = "wasm"))]
#[inline(always)]
fn sided<const N: usize>(matrix: &Matrix, coefficients: &[Coefficient], out: &mut [i32], stride: usize) {
    // First pass: the columns that have coefficients.
    let mut columns = [[0i32; N]; N];
    let mut used = 0u32;
    for c in coefficients {
        let (u, v) = (usize::from(c.u) % N, usize::from(c.v) % N);
        used |= 1 << u;
        let (column, row) = (&mut columns[u], &matrix[v]);
        for i in 0..N {
            column[i] = column[i].wrapping_add(c.value.wrapping_mul(row[i]));
        }
    }
    let shift = FIRST_PASS_SHIFT - 1 + N.trailing_zeros();
    let half = 1i32 << (shift - 1);
    for first in (0..N).step_by(ROWS) {
        let mut sums = [[half; N]; ROWS];
        let mut left = used;
        while left != 0 {
            let u = left.trailing_zeros() as usize % N;
            left &= left - 1;
            let row = &matrix[u];
            for k in 0..ROWS {
                let c = rounded(columns[u][first + k]);
                for j in 0..N {
                    sums[k][j] = sums[k][j].wrapping_add(c.wrapping_mul(row[j]));
                }
            }
        }
        for k in 0..ROWS {
            let row = &mut out[(first + k) * stride..][..N];
            for j in 0..N {
                row[j] = sums[k][j] >> shift;
            }
        }
    }
}

/// Rows that the second pass computes at a time.
#[cfg(not(target_family = "wasm"))]
const ROWS: usize = 4;

/// Does the same as [`sided`] for large blocks, with half of the multiplications; `H` is half of `N`.
///
/// Cosines of even frequencies are symmetric about the middle of a block, and those of odd ones are antisymmetric. Both
/// passes sum the two kinds apart over the first half of the samples. All sums wrap, so their order does not matter.
#[cfg(not(target_family = "wasm"))]
#[inline(always)]
fn folded<const N: usize, const H: usize>(
    matrix: &Matrix,
    coefficients: &[Coefficient],
    out: &mut [i32],
    stride: usize,
) {
    // First pass: the columns that have coefficients. Their halves are the sums of even and of odd frequencies.
    let mut columns = [[0i32; N]; N];
    let mut used = 0u32;
    for c in coefficients {
        let (u, v) = (usize::from(c.u) % N, usize::from(c.v) % N);
        used |= 1 << u;
        let (column, row) = (&mut columns[u].as_chunks_mut::<H>().0[v % 2], &matrix[v]);
        for i in 0..H {
            column[i] = column[i].wrapping_add(c.value.wrapping_mul(row[i]));
        }
    }
    let mut left = used;
    while left != 0 {
        let column = &mut columns[left.trailing_zeros() as usize % N];
        left &= left - 1;
        let sums = *column;
        for i in 0..H {
            column[i] = rounded(sums[i].wrapping_add(sums[H + i]));
            column[N - 1 - i] = rounded(sums[i].wrapping_sub(sums[H + i]));
        }
    }
    let shift = FIRST_PASS_SHIFT - 1 + N.trailing_zeros();
    for first in (0..N).step_by(ROWS) {
        let even = frequencies::<N, H>(matrix, &columns, used & 0x5555_5555, (first, 1 << (shift - 1)));
        let odd = frequencies::<N, H>(matrix, &columns, used & 0xAAAA_AAAA, (first, 0));
        for k in 0..ROWS {
            let row = &mut out[(first + k) * stride..][..N];
            for j in 0..H {
                row[j] = even[k][j].wrapping_add(odd[k][j]) >> shift;
            }
            for j in 0..H {
                row[N - 1 - j] = even[k][j].wrapping_sub(odd[k][j]) >> shift;
            }
        }
    }
}

/// Returns `start` plus the sums of some frequencies in the rows from `first` on, over the first half of the samples.
#[cfg(not(target_family = "wasm"))]
#[inline(always)]
fn frequencies<const N: usize, const H: usize>(
    matrix: &Matrix,
    columns: &[[i32; N]; N],
    mut left: u32,
    (first, start): (usize, i32),
) -> [[i32; H]; ROWS] {
    let mut sums = [[start; H]; ROWS];
    while left != 0 {
        let u = left.trailing_zeros() as usize % N;
        left &= left - 1;
        let row = &matrix[u];
        for k in 0..ROWS {
            let c = columns[u][first + k];
            for j in 0..H {
                sums[k][j] = sums[k][j].wrapping_add(c.wrapping_mul(row[j]));
            }
        }
    }
    sums
}

/// Rounds a result of the first pass.
#[cfg(not(target_family = "wasm"))]
#[inline(always)]
fn rounded(sum: i32) -> i32 {
    sum.wrapping_add(1 << (FIRST_PASS_SHIFT - 1)) >> FIRST_PASS_SHIFT
}

/// Inverse transform of a block whose side is known only at run time. In WebAssembly all sizes share this function,
/// which keeps the module small.
#[cfg(target_family = "wasm")]
#[inline(never)]
fn of_any_side(side: usize, matrix: &Matrix, coefficients: &[Coefficient], out: &mut [i32], stride: usize) {
    let mut columns = [[0i32; LARGEST]; LARGEST];
    let mut used = 0u32;
    for c in coefficients {
        let (u, v) = (usize::from(c.u) % LARGEST, usize::from(c.v) % LARGEST);
        used |= 1 << u;
        for (sum, &entry) in columns[u].iter_mut().zip(&matrix[v]) {
            *sum = sum.wrapping_add(c.value.wrapping_mul(entry));
        }
    }
    let shift = FIRST_PASS_SHIFT - 1 + side.trailing_zeros();
    for i in 0..side {
        let mut sums = [1i32 << (shift - 1); LARGEST];
        let mut left = used;
        while left != 0 {
            let u = left.trailing_zeros() as usize % LARGEST;
            left &= left - 1;
            let c = columns[u][i % LARGEST].wrapping_add(1 << (FIRST_PASS_SHIFT - 1)) >> FIRST_PASS_SHIFT;
            for (sum, &entry) in sums.iter_mut().zip(&matrix[u]) {
                *sum = sum.wrapping_add(c.wrapping_mul(entry));
            }
        }
        for (out, sum) in out[i * stride..i * stride + side].iter_mut().zip(sums) {
            *out = sum >> shift;
        }
    }
}

/// Writes the block of side `4 << size` with these `coefficients` to `out`, whose rows are `stride` apart.
#[inline(always)]
pub(crate) fn inverse(size: usize, coefficients: &[Coefficient], out: &mut [i32], stride: usize) {
    let matrix = &matrices()[size];
    #[cfg(target_family = "wasm")]
    of_any_side(4 << size, matrix, coefficients, out, stride);
    #[cfg(not(target_family = "wasm"))]
    match size {
        0 => sided::<4>(matrix, coefficients, out, stride),
        1 => sided::<8>(matrix, coefficients, out, stride),
        2 => folded::<16, 8>(matrix, coefficients, out, stride),
        _ => folded::<32, 16>(matrix, coefficients, out, stride),
    }
}

/// Replaces the block of side `N` at the start of `block`, whose rows are `stride` apart, by its orthonormal
/// transform.
#[inline(always)]
fn forward_block<const N: usize>(matrix: &FloatMatrix, block: &mut [f32], stride: usize) {
    // Along the rows: sums of columns of the matrix, so that all frequencies are computed in parallel lanes.
    let mut rows = [[0f32; N]; N];
    for (i, row) in rows.iter_mut().enumerate() {
        let samples = &block[i * stride..i * stride + N];
        for j in 0..N {
            let (sample, column) = (samples[j], &matrix.columns[j]);
            for u in 0..N {
                row[u] += sample * column[u];
            }
        }
    }
    for v in 0..N {
        let mut sums = [0f32; N];
        for i in 0..N {
            let (weight, row) = (matrix.columns[i][v], &rows[i]);
            for u in 0..N {
                sums[u] += weight * row[u];
            }
        }
        block[v * stride..v * stride + N].copy_from_slice(&sums);
    }
}

/// Orthonormal float matrix of a block size; `columns[i][k]` for sample `i` and frequency `k`.
#[derive(Debug)]
struct FloatMatrix {
    columns: [[f32; LARGEST]; LARGEST],
}

fn float_matrices() -> &'static [FloatMatrix; 4] {
    static MATRICES: OnceLock<[FloatMatrix; 4]> = OnceLock::new();
    MATRICES.get_or_init(|| {
        std::array::from_fn(|size| {
            let side = 4usize << size;
            let scale = (2.0 / side as f32).sqrt() / 2048.0;
            let mut columns = [[0.0; LARGEST]; LARGEST];
            for k in 0..side {
                for (i, column) in columns.iter_mut().enumerate().take(side) {
                    column[k] = matrices()[size][k][i] as f32 * scale;
                }
            }
            FloatMatrix { columns }
        })
    })
}

/// Transforms the block of side `4 << size` at the start of `block`, whose rows are `stride` apart, in place. This is
/// the float inverse of [`inverse`].
#[inline(always)]
pub(crate) fn forward(size: usize, block: &mut [f32], stride: usize) {
    let matrix = &float_matrices()[size];
    match size {
        0 => forward_block::<4>(matrix, block, stride),
        1 => forward_block::<8>(matrix, block, stride),
        2 => forward_block::<16>(matrix, block, stride),
        _ => forward_block::<32>(matrix, block, stride),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    #[test]
    fn cosines_are_symmetric_or_antisymmetric_about_the_middle_of_a_block() {
        for (size, matrix) in matrices().iter().enumerate() {
            let n = 4usize << size;
            for (k, row) in matrix.iter().enumerate().take(n) {
                let sign = if k % 2 == 0 { 1 } else { -1 };
                assert!((0..n).all(|i| row[n - 1 - i] == sign * row[i]), "size {size}, frequency {k}");
            }
        }
    }

    #[test]
    fn folded_transforms_have_the_bits_of_plain_ones() {
        let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(7);
        for most in [40, 4000, i32::MAX] {
            for count in [1, 3, 20, 300] {
                let coefficients: Vec<Coefficient> = (0..count)
                    .map(|_| Coefficient {
                        u: rng.random_range(0..32),
                        v: rng.random_range(0..32),
                        value: rng.random_range(-most..most),
                    })
                    .collect();
                let mut out = [[0; 32 * 40]; 4];
                let [plain, folded_16, plain_32, folded_32] = &mut out;
                sided::<16>(&matrices()[2], &coefficients, plain, 40);
                folded::<16, 8>(&matrices()[2], &coefficients, folded_16, 40);
                sided::<32>(&matrices()[3], &coefficients, plain_32, 40);
                folded::<32, 16>(&matrices()[3], &coefficients, folded_32, 40);
                assert!(plain == folded_16 && plain_32 == folded_32, "{count} values up to {most}");
            }
        }
    }

    #[test]
    fn the_inverse_is_the_cosine_transform_within_its_rounding() {
        for size in 0..4 {
            let n = 4usize << size;
            for (u, v, value) in [(0, 0, 4000), (1, 0, -3000), (n - 1, n - 1, 2000), (2, 3, 1600)] {
                let mut out = vec![0; n * n];
                let c = Coefficient { u: u as u8, v: v as u8, value };
                inverse(size, &[c], &mut out, n);
                let basis = |k: usize, i: usize| {
                    let scale = if k == 0 { 1.0 / n as f64 } else { 2.0 / n as f64 }.sqrt();
                    scale * ((2 * i + 1) as f64 * k as f64 * std::f64::consts::PI / (2 * n) as f64).cos()
                };
                for (i, &got) in out.iter().enumerate() {
                    let want = f64::from(value) * basis(u, i % n) * basis(v, i / n);
                    // Each of the two roundings contributes a half, and rounding of the cosines 1/4096 of the value.
                    let most = 1.0 + f64::from(value.abs()) / 2048.0;
                    assert!((f64::from(got) - want).abs() <= most, "{size} {u} {v} {i}: {got} for {want}");
                }
            }
        }
    }
}
