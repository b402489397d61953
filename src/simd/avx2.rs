//! Eight lanes in AVX2 registers, through `pulp`'s proof that the machine supports AVX2.

use pulp::x86::V3;
use std::arch::x86_64::{__m128i, __m256, _CMP_GT_OQ};

use super::{LANES, Simd, Task};

/// A task for AVX2.
pub(super) struct OnAvx2<T>(pub V3, pub T);

impl<T: Task> pulp::NullaryFnOnce for OnAvx2<T> {
    type Output = T::Output;

    #[inline(always)]
    fn call(self) -> T::Output {
        self.1.run(self.0)
    }
}

impl Simd for V3 {
    const NAME: &'static str = "avx2";

    type Vector = __m256;

    #[inline(always)]
    fn call<T: Task>(self, task: T) -> T::Output {
        self.vectorize(OnAvx2(self, task))
    }

    #[inline(always)]
    fn vector(self, values: [f32; LANES]) -> __m256 {
        bytemuck::cast(values)
    }

    #[inline(always)]
    fn to_array(self, v: __m256) -> [f32; LANES] {
        bytemuck::cast(v)
    }

    #[inline(always)]
    fn splat(self, value: f32) -> __m256 {
        self.avx._mm256_set1_ps(value)
    }

    #[inline(always)]
    fn add(self, a: __m256, b: __m256) -> __m256 {
        self.avx._mm256_add_ps(a, b)
    }

    #[inline(always)]
    fn sub(self, a: __m256, b: __m256) -> __m256 {
        self.avx._mm256_sub_ps(a, b)
    }

    #[inline(always)]
    fn mul(self, a: __m256, b: __m256) -> __m256 {
        self.avx._mm256_mul_ps(a, b)
    }

    #[inline(always)]
    fn div(self, a: __m256, b: __m256) -> __m256 {
        self.avx._mm256_div_ps(a, b)
    }

    #[inline(always)]
    fn sqrt(self, a: __m256) -> __m256 {
        self.avx._mm256_sqrt_ps(a)
    }

    #[inline(always)]
    fn max(self, a: __m256, b: __m256) -> __m256 {
        self.avx._mm256_max_ps(a, b)
    }

    #[inline(always)]
    fn min(self, a: __m256, b: __m256) -> __m256 {
        self.avx._mm256_min_ps(a, b)
    }

    #[inline(always)]
    fn keep_above(self, v: __m256, a: __m256, b: __m256) -> __m256 {
        self.avx._mm256_and_ps(v, self.avx._mm256_cmp_ps::<_CMP_GT_OQ>(a, b))
    }

    #[inline(always)]
    fn scale(self, p: __m256, shifted: __m256) -> __m256 {
        let exponent = self.avx2._mm256_slli_epi32::<23>(self.avx._mm256_castps_si256(shifted));
        self.avx._mm256_castsi256_ps(self.avx2._mm256_add_epi32(exponent, self.avx._mm256_castps_si256(p)))
    }

    #[inline(always)]
    fn floor(self, v: __m256) -> [u32; LANES] {
        bytemuck::cast(self.avx._mm256_cvttps_epi32(v))
    }

    #[inline(always)]
    fn store_rgb(self, to: &mut [u8; 3 * LANES], v: [__m256; 3]) {
        let r = self.avx._mm256_cvttps_epi32(v[0]);
        let g = self.avx._mm256_cvttps_epi32(v[1]);
        let b = self.avx._mm256_cvttps_epi32(v[2]);
        let gb = self.avx2._mm256_or_si256(self.avx2._mm256_slli_epi32::<8>(g), self.avx2._mm256_slli_epi32::<16>(b));
        let pixels = self.avx2._mm256_or_si256(r, gb);
        // Pick three bytes of each pixel within each half, then join the three words of both halves.
        const DROP: [i8; 32] = [
            0, 1, 2, 4, 5, 6, 8, 9, 10, 12, 13, 14, -1, -1, -1, -1, 0, 1, 2, 4, 5, 6, 8, 9, 10, 12, 13, 14, -1, -1, -1,
            -1,
        ];
        const JOIN: [i32; 8] = [0, 1, 2, 4, 5, 6, 3, 7];
        let bytes = self.avx2._mm256_shuffle_epi8(pixels, bytemuck::cast(DROP));
        let bytes = self.avx2._mm256_permutevar8x32_epi32(bytes, bytemuck::cast(JOIN));
        let low: [u8; 16] = bytemuck::cast(self.avx._mm256_castsi256_si128(bytes));
        let high: __m128i = self.avx2._mm256_extracti128_si256::<1>(bytes);
        let high: [u64; 2] = bytemuck::cast(high);
        to[..16].copy_from_slice(&low);
        to[16..].copy_from_slice(&high[0].to_ne_bytes());
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::check_properties;

    #[test]
    fn avx2_lanes_keep_their_promises() {
        match pulp::x86::V3::try_new() {
            Some(simd) => check_properties(simd),
            None => eprintln!("skipped: this machine has no AVX2"),
        }
    }
}
