//! Eight lanes in two vector registers of WebAssembly.
//!
//! Compilers vectorize the plain loops only in part.

use std::arch::wasm32::{
    f32x4_add, f32x4_div, f32x4_gt, f32x4_mul, f32x4_pmax, f32x4_pmin, f32x4_splat, f32x4_sqrt, f32x4_sub,
    i8x16_shuffle, i32x4_add, i32x4_shl, i32x4_splat, v128, v128_and, v128_or,
};

use super::{LANES, Simd};

/// The `simd128` instructions.
#[derive(Debug, Clone, Copy)]
pub(super) struct Simd128;

/// Applies `f` to both registers.
#[inline(always)]
fn zip(a: [v128; 2], b: [v128; 2], f: impl Fn(v128, v128) -> v128) -> [v128; 2] {
    [f(a[0], b[0]), f(a[1], b[1])]
}

/// `floor(v)` for `0 ≤ v < 2²²` in each lane. A conversion would have to handle NaN.
#[inline(always)]
fn floors(v: v128) -> v128 {
    let magic = f32x4_splat(8_388_608.0);
    let shifted = f32x4_add(v, magic);
    // Round to the nearest integer; where the result is larger than `v`, the comparison is −1.
    let above = f32x4_gt(f32x4_sub(shifted, magic), v);
    i32x4_add(v128_and(shifted, i32x4_splat(0x7F_FFFF)), above)
}

impl Simd for Simd128 {
    const NAME: &'static str = "simd128";

    type Vector = [v128; 2];

    #[inline(always)]
    fn vector(self, values: [f32; LANES]) -> Self::Vector {
        bytemuck::cast(values)
    }

    #[inline(always)]
    fn to_array(self, v: Self::Vector) -> [f32; LANES] {
        bytemuck::cast(v)
    }

    #[inline(always)]
    fn splat(self, value: f32) -> Self::Vector {
        [f32x4_splat(value); 2]
    }

    #[inline(always)]
    fn add(self, a: Self::Vector, b: Self::Vector) -> Self::Vector {
        zip(a, b, |a, b| f32x4_add(a, b))
    }

    #[inline(always)]
    fn sub(self, a: Self::Vector, b: Self::Vector) -> Self::Vector {
        zip(a, b, |a, b| f32x4_sub(a, b))
    }

    #[inline(always)]
    fn mul(self, a: Self::Vector, b: Self::Vector) -> Self::Vector {
        zip(a, b, |a, b| f32x4_mul(a, b))
    }

    #[inline(always)]
    fn div(self, a: Self::Vector, b: Self::Vector) -> Self::Vector {
        zip(a, b, |a, b| f32x4_div(a, b))
    }

    #[inline(always)]
    fn sqrt(self, a: Self::Vector) -> Self::Vector {
        a.map(|a| f32x4_sqrt(a))
    }

    #[inline(always)]
    fn max(self, a: Self::Vector, b: Self::Vector) -> Self::Vector {
        // `b < a ? a : b`.
        zip(a, b, |a, b| f32x4_pmax(b, a))
    }

    #[inline(always)]
    fn min(self, a: Self::Vector, b: Self::Vector) -> Self::Vector {
        // `a < b ? a : b`.
        zip(a, b, |a, b| f32x4_pmin(b, a))
    }

    #[inline(always)]
    fn keep_above(self, v: Self::Vector, a: Self::Vector, b: Self::Vector) -> Self::Vector {
        zip(v, zip(a, b, |a, b| f32x4_gt(a, b)), |v, kept| v128_and(v, kept))
    }

    #[inline(always)]
    fn scale(self, p: Self::Vector, shifted: Self::Vector) -> Self::Vector {
        zip(p, shifted, |p, s| i32x4_add(i32x4_shl(s, 23), p))
    }

    #[inline(always)]
    fn floor(self, v: Self::Vector) -> [u32; LANES] {
        bytemuck::cast(v.map(floors))
    }

    #[inline(always)]
    fn store_rgb(self, to: &mut [u8; 3 * LANES], v: [Self::Vector; 3]) {
        let [r, g, b] = v.map(|v| v.map(floors));
        let pixels = zip(r, zip(g, b, |g, b| v128_or(i32x4_shl(g, 8), i32x4_shl(b, 16))), |r, gb| v128_or(r, gb));
        let [left, right] = pixels;
        // Pick three bytes of each pixel.
        let first = i8x16_shuffle::<0, 1, 2, 4, 5, 6, 8, 9, 10, 12, 13, 14, 16, 17, 18, 20>(left, right);
        let rest = i8x16_shuffle::<5, 6, 8, 9, 10, 12, 13, 14, 5, 6, 8, 9, 10, 12, 13, 14>(right, right);
        to[..16].copy_from_slice(&bytemuck::cast::<_, [u8; 16]>(first));
        to[16..].copy_from_slice(&bytemuck::cast::<_, [u8; 16]>(rest)[..8]);
    }
}
