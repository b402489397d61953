//! Elementary functions that return the same bits on every platform, for the encoder. The functions of the system
//! libraries differ in the last bit, which is enough for a fit to produce a different file.

use crate::simd::EXP2;

/// Methods of the standard library, with the prefix `strict_`, in one implementation for all platforms.
pub(crate) trait StrictMath: Sized {
    fn strict_exp(self) -> Self;
    fn strict_exp2(self) -> Self;
    fn strict_ln(self) -> Self;
    fn strict_log2(self) -> Self;
    fn strict_log10(self) -> Self;
    fn strict_cos(self) -> Self;
    fn strict_sin_cos(self) -> (Self, Self);
    fn strict_powf(self, exponent: Self) -> Self;
    fn strict_atan2(self, x: Self) -> Self;
    fn strict_hypot(self, other: Self) -> Self;
}

/// `x^exponent` with a relative error of 3·10⁻⁷ for normal `x` from 10⁻⁶ to 10⁶ and exponents from −1 to 1. It takes a
/// sixth of the time of [`StrictMath::strict_powf`] and returns the same bits on every platform as well.
pub(crate) fn quick_powf(x: f32, exponent: f32) -> f32 {
    const SQRT_HALF: u32 = 0x3f35_04f3;
    let bits = x.to_bits();
    let octave = (bits.wrapping_sub(SQRT_HALF) as i32) >> 23;
    // The mantissa is between √½ and √2. The series of the inverse hyperbolic tangent is used up to the seventh power.
    let mantissa = f32::from_bits(bits.wrapping_sub((octave << 23) as u32));
    let t = (mantissa - 1.0) / (mantissa + 1.0);
    let square = t * t;
    let series = t * (1.0 + square * (1.0 / 3.0 + square * (1.0 / 5.0 + square * (1.0 / 7.0))));
    let y = exponent * (octave as f32 + 2.0 * std::f32::consts::LOG2_E * series);
    // Adding 1.5·2²³ leaves the nearest integer in the low bits, as in `Simd::exp2`.
    let shifted = y.clamp(-126.0, 126.0) + 12_582_912.0;
    let f = y - (shifted - 12_582_912.0);
    let p = EXP2.into_iter().fold(0.0, |p, c| p * f + c);
    f32::from_bits(p.to_bits().wrapping_add(shifted.to_bits() << 23))
}

macro_rules! strict_math {
    ($float:ty: $exp:ident $exp2:ident $ln:ident $log2:ident $log10:ident $cos:ident $sin_cos:ident $pow:ident $atan2:ident $hypot:ident) => {
        impl StrictMath for $float {
            fn strict_exp(self) -> Self {
                libm::$exp(self)
            }
            fn strict_exp2(self) -> Self {
                libm::$exp2(self)
            }
            fn strict_ln(self) -> Self {
                libm::$ln(self)
            }
            fn strict_log2(self) -> Self {
                libm::$log2(self)
            }
            fn strict_log10(self) -> Self {
                libm::$log10(self)
            }
            fn strict_cos(self) -> Self {
                libm::$cos(self)
            }
            fn strict_sin_cos(self) -> (Self, Self) {
                libm::$sin_cos(self)
            }
            fn strict_powf(self, exponent: Self) -> Self {
                libm::$pow(self, exponent)
            }
            fn strict_atan2(self, x: Self) -> Self {
                libm::$atan2(self, x)
            }
            fn strict_hypot(self, other: Self) -> Self {
                libm::$hypot(self, other)
            }
        }
    };
}

strict_math!(f32: expf exp2f logf log2f log10f cosf sincosf powf atan2f hypotf);
strict_math!(f64: exp exp2 log log2 log10 cos sincos pow atan2 hypot);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quick_powers_match_f64() {
        for i in 0..4000 {
            let x = 10f32.powf(i as f32 * 0.003 - 6.0);
            for exponent in [-1.0, -0.6, -0.25, 0.0, 0.1, 0.5, 1.0] {
                let want = f64::from(x).powf(f64::from(exponent));
                let error = (f64::from(quick_powf(x, exponent)) / want - 1.0).abs();
                // The logarithm is up to 20. f32 rounds it and its product with the exponent to 2⁻²⁴ of that each, and
                // `exp2` adds 2·10⁻⁷.
                let tolerance = 2.0 * 20.0 * std::f64::consts::LN_2 * 2f64.powi(-24) + 2e-7;
                assert!(error < tolerance, "{x}^{exponent}: {error}");
            }
        }
    }

    /// FNV-1a hash of the bits of every function at 4000 arguments.
    #[test]
    fn functions_have_the_same_bits_on_every_machine() {
        let mut hash = 0xcbf2_9ce4_8422_2325u64;
        let mut add = |bits: u64| {
            for byte in bits.to_le_bytes() {
                hash = (hash ^ u64::from(byte)).wrapping_mul(0x100_0000_01b3);
            }
        };
        for i in 1..=4000u32 {
            let x = f64::from(i) * 0.013_7;
            let (sin, cos) = x.strict_sin_cos();
            let logs = [x.strict_ln(), x.strict_log2(), x.strict_log10(), sin, x.strict_cos()];
            let others =
                [(-x).strict_exp(), (-x).strict_exp2(), x.strict_powf(1.7), x.strict_atan2(3.0), x.strict_hypot(2.0)];
            logs.into_iter().chain(others).chain([sin, cos]).for_each(|v| add(v.to_bits()));
            let x = x as f32;
            let (sin, cos) = x.strict_sin_cos();
            let logs = [x.strict_ln(), x.strict_log2(), x.strict_log10(), sin, x.strict_cos()];
            let others =
                [(-x).strict_exp(), (-x).strict_exp2(), x.strict_powf(1.7), x.strict_atan2(3.0), x.strict_hypot(2.0)];
            logs.into_iter().chain(others).chain([sin, cos]).for_each(|v| add(v.to_bits().into()));
        }
        assert_eq!(hash, 0xe95a_b5d6_b802_6c10);
    }
}
