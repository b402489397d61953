//! Eight lanes in AVX2 registers, or in pairs of NEON registers on ARM, through `fearless_simd`'s proof that the machine
//! supports the instructions.

#[cfg(target_arch = "aarch64")]
pub(super) use fearless_simd::aarch64::Neon as Native;
use fearless_simd::prelude::{Bytes as _, SimdInto as _};
#[cfg(target_arch = "x86_64")]
pub(super) use fearless_simd::x86::Avx2 as Native;
use fearless_simd::{Level, Simd as _, f32x8, i32x8, u8x32};

use super::{LANES, Simd, Task};

/// Returns the instructions if the machine supports them.
pub(super) fn supported() -> Option<Native> {
    #[cfg(target_arch = "x86_64")]
    return Level::new().as_avx2();
    #[cfg(target_arch = "aarch64")]
    return Level::new().as_neon();
}

/// Returns the larger value of each lane; `b` where either is NaN, and where both are equal.
#[inline(always)]
fn larger(simd: Native, a: f32x8<Native>, b: f32x8<Native>) -> f32x8<Native> {
    // The instruction of AVX2 does so. That of NEON returns NaN where either is NaN.
    #[cfg(target_arch = "x86_64")]
    return simd.max_f32x8(a, b);
    #[cfg(target_arch = "aarch64")]
    return simd.select_f32x8(simd.simd_gt_f32x8(a, b), a, b);
}

/// Returns the smaller value of each lane; `b` where either is NaN, and where both are equal.
#[inline(always)]
fn smaller(simd: Native, a: f32x8<Native>, b: f32x8<Native>) -> f32x8<Native> {
    #[cfg(target_arch = "x86_64")]
    return simd.min_f32x8(a, b);
    #[cfg(target_arch = "aarch64")]
    return simd.select_f32x8(simd.simd_lt_f32x8(a, b), a, b);
}

impl Simd for Native {
    #[cfg(target_arch = "x86_64")]
    const NAME: &'static str = "avx2";
    #[cfg(target_arch = "aarch64")]
    const NAME: &'static str = "neon";

    type Vector = f32x8<Native>;

    #[inline(always)]
    fn call<T: Task>(self, task: T) -> T::Output {
        self.vectorize(
            #[inline(always)]
            || task.run(self),
        )
    }

    #[inline(always)]
    fn vector(self, values: [f32; LANES]) -> f32x8<Native> {
        values.simd_into(self)
    }

    #[inline(always)]
    fn to_array(self, v: f32x8<Native>) -> [f32; LANES] {
        v.into()
    }

    #[inline(always)]
    fn splat(self, value: f32) -> f32x8<Native> {
        self.splat_f32x8(value)
    }

    #[inline(always)]
    fn add(self, a: f32x8<Native>, b: f32x8<Native>) -> f32x8<Native> {
        self.add_f32x8(a, b)
    }

    #[inline(always)]
    fn sub(self, a: f32x8<Native>, b: f32x8<Native>) -> f32x8<Native> {
        self.sub_f32x8(a, b)
    }

    #[inline(always)]
    fn mul(self, a: f32x8<Native>, b: f32x8<Native>) -> f32x8<Native> {
        self.mul_f32x8(a, b)
    }

    #[inline(always)]
    fn div(self, a: f32x8<Native>, b: f32x8<Native>) -> f32x8<Native> {
        self.div_f32x8(a, b)
    }

    #[inline(always)]
    fn sqrt(self, a: f32x8<Native>) -> f32x8<Native> {
        self.sqrt_f32x8(a)
    }

    #[inline(always)]
    fn max(self, a: f32x8<Native>, b: f32x8<Native>) -> f32x8<Native> {
        larger(self, a, b)
    }

    #[inline(always)]
    fn min(self, a: f32x8<Native>, b: f32x8<Native>) -> f32x8<Native> {
        smaller(self, a, b)
    }

    #[inline(always)]
    fn keep_above(self, v: f32x8<Native>, a: f32x8<Native>, b: f32x8<Native>) -> f32x8<Native> {
        self.select_f32x8(self.simd_gt_f32x8(a, b), v, self.splat_f32x8(0.0))
    }

    #[inline(always)]
    fn scale(self, p: f32x8<Native>, shifted: f32x8<Native>) -> f32x8<Native> {
        let exponent = self.shl_i32x8(shifted.bitcast(), 23);
        let scaled: i32x8<Native> = self.add_i32x8(exponent, p.bitcast());
        scaled.bitcast()
    }

    #[inline(always)]
    fn floor(self, v: f32x8<Native>) -> [u32; LANES] {
        bytemuck::cast(<[i32; LANES]>::from(self.cvt_i32_f32x8(v)))
    }

    #[inline(always)]
    fn store_rgb(self, to: &mut [u8; 3 * LANES], v: [f32x8<Native>; 3]) {
        let r = self.cvt_i32_f32x8(v[0]);
        let g = self.shl_i32x8(self.cvt_i32_f32x8(v[1]), 8);
        let b = self.shl_i32x8(self.cvt_i32_f32x8(v[2]), 16);
        let pixels: u8x32<Native> = self.or_i32x8(r, self.or_i32x8(g, b)).bitcast();
        // Pick three bytes of each pixel: twelve at the end of the lower half, twelve at the start of the upper one.
        const PICK: [u8; 32] = [
            255, 255, 255, 255, 0, 1, 2, 4, 5, 6, 8, 9, 10, 12, 13, 14, 0, 1, 2, 4, 5, 6, 8, 9, 10, 12, 13, 14, 255,
            255, 255, 255,
        ];
        let (low, high) = self.split_u8x32(self.swizzle_dyn_within_blocks_u8x32(pixels, PICK.simd_into(self)));
        let first: [u8; 16] = self.slide_u8x16::<4>(low, high).into();
        let last: [u8; 16] = self.slide_u8x16::<12>(low, high).into();
        to[..16].copy_from_slice(&first);
        to[8..].copy_from_slice(&last);
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::check_properties;

    #[test]
    fn native_lanes_have_the_required_properties() {
        match super::supported() {
            Some(simd) => check_properties(simd),
            None => eprintln!("skipped: this machine does not have these instructions"),
        }
    }
}
