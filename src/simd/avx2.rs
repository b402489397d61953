//! Eight lanes in AVX2 registers, through `fearless_simd`'s proof that the machine supports AVX2.

use fearless_simd::prelude::{Bytes as _, SimdInto as _};
use fearless_simd::x86::Avx2;
use fearless_simd::{Simd as _, f32x8, i32x8, u8x32};

use super::{LANES, Simd, Task};

impl Simd for Avx2 {
    const NAME: &'static str = "avx2";

    type Vector = f32x8<Avx2>;

    #[inline(always)]
    fn call<T: Task>(self, task: T) -> T::Output {
        self.vectorize(
            #[inline(always)]
            || task.run(self),
        )
    }

    #[inline(always)]
    fn vector(self, values: [f32; LANES]) -> f32x8<Avx2> {
        values.simd_into(self)
    }

    #[inline(always)]
    fn to_array(self, v: f32x8<Avx2>) -> [f32; LANES] {
        v.into()
    }

    #[inline(always)]
    fn splat(self, value: f32) -> f32x8<Avx2> {
        self.splat_f32x8(value)
    }

    #[inline(always)]
    fn add(self, a: f32x8<Avx2>, b: f32x8<Avx2>) -> f32x8<Avx2> {
        self.add_f32x8(a, b)
    }

    #[inline(always)]
    fn sub(self, a: f32x8<Avx2>, b: f32x8<Avx2>) -> f32x8<Avx2> {
        self.sub_f32x8(a, b)
    }

    #[inline(always)]
    fn mul(self, a: f32x8<Avx2>, b: f32x8<Avx2>) -> f32x8<Avx2> {
        self.mul_f32x8(a, b)
    }

    #[inline(always)]
    fn div(self, a: f32x8<Avx2>, b: f32x8<Avx2>) -> f32x8<Avx2> {
        self.div_f32x8(a, b)
    }

    #[inline(always)]
    fn sqrt(self, a: f32x8<Avx2>) -> f32x8<Avx2> {
        self.sqrt_f32x8(a)
    }

    // Unlike the precise methods, these return `b` if either is NaN.
    #[inline(always)]
    fn max(self, a: f32x8<Avx2>, b: f32x8<Avx2>) -> f32x8<Avx2> {
        self.max_f32x8(a, b)
    }

    #[inline(always)]
    fn min(self, a: f32x8<Avx2>, b: f32x8<Avx2>) -> f32x8<Avx2> {
        self.min_f32x8(a, b)
    }

    #[inline(always)]
    fn keep_above(self, v: f32x8<Avx2>, a: f32x8<Avx2>, b: f32x8<Avx2>) -> f32x8<Avx2> {
        self.select_f32x8(self.simd_gt_f32x8(a, b), v, self.splat_f32x8(0.0))
    }

    #[inline(always)]
    fn scale(self, p: f32x8<Avx2>, shifted: f32x8<Avx2>) -> f32x8<Avx2> {
        let exponent = self.shl_i32x8(shifted.bitcast(), 23);
        let scaled: i32x8<Avx2> = self.add_i32x8(exponent, p.bitcast());
        scaled.bitcast()
    }

    #[inline(always)]
    fn floor(self, v: f32x8<Avx2>) -> [u32; LANES] {
        bytemuck::cast(<[i32; LANES]>::from(self.cvt_i32_f32x8(v)))
    }

    #[inline(always)]
    fn store_rgb(self, to: &mut [u8; 3 * LANES], v: [f32x8<Avx2>; 3]) {
        let r = self.cvt_i32_f32x8(v[0]);
        let g = self.shl_i32x8(self.cvt_i32_f32x8(v[1]), 8);
        let b = self.shl_i32x8(self.cvt_i32_f32x8(v[2]), 16);
        let pixels: u8x32<Avx2> = self.or_i32x8(r, self.or_i32x8(g, b)).bitcast();
        // Pick three bytes of each pixel in each half.
        const DROP: [u8; 32] = [
            0, 1, 2, 4, 5, 6, 8, 9, 10, 12, 13, 14, 255, 255, 255, 255, 0, 1, 2, 4, 5, 6, 8, 9, 10, 12, 13, 14, 255,
            255, 255, 255,
        ];
        let bytes = self.swizzle_dyn_within_blocks_u8x32(pixels, DROP.simd_into(self));
        let (low, high) = self.split_u8x32(bytes);
        let (low, high): ([u8; 16], [u8; 16]) = (low.into(), high.into());
        // The next copy overwrites the bytes after the first twelve.
        to[..16].copy_from_slice(&low);
        to[12..].copy_from_slice(&high[..12]);
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::check_properties;

    #[test]
    fn avx2_lanes_have_the_required_properties() {
        match fearless_simd::Level::new().as_avx2() {
            Some(simd) => check_properties(simd),
            None => eprintln!("skipped: this machine has no AVX2"),
        }
    }
}
