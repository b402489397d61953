//! Vectors of eight floats for any instruction set, with a plain implementation that runs on every machine.
//!
//! Each operation is one IEEE operation per lane and none is fused, so that every instruction set gives the same bits.
//! Sixteen lanes of AVX-512, two rows of a strip, are hardly faster.

#[cfg(any(target_arch = "x86_64", target_arch = "aarch64"))]
mod native;
#[cfg(not(all(target_family = "wasm", target_feature = "simd128")))]
mod plain;
#[cfg(all(target_family = "wasm", target_feature = "simd128"))]
mod wasm;

#[cfg(any(target_arch = "x86_64", target_arch = "aarch64"))]
use std::sync::OnceLock;

#[cfg(test)]
pub(crate) use self::plain::Plain;

/// Coefficients of `2^f` for |f| ≤ ½, the highest power first: a minimax polynomial with the coefficients 1 and ln 2
/// fixed, so that results near 0 are exact.
pub(crate) const EXP2: [f32; 6] =
    [1.330_026_5e-3, 9.669_709e-3, 5.550_56e-2, 2.402_228_1e-1, std::f32::consts::LN_2, 1.0];

/// Lanes of a vector.
pub const LANES: usize = 8;

/// Eight floats in memory.
#[derive(Debug, Clone, Copy, PartialEq)]
#[repr(align(32))]
pub struct Lanes(pub [f32; LANES]);

/// Work that is compiled for each instruction set.
///
/// A task is a struct rather than a closure, because the body of a closure would not be inlined into the function that
/// is compiled for AVX2, and would run without AVX2.
pub trait Task {
    type Output;

    /// Implementations must be `#[inline(always)]`, and so must everything that they call in their inner loops.
    fn run<S: Simd>(self, simd: S) -> Self::Output;
}

/// Environment variable that selects the plain instructions.
#[cfg(any(target_arch = "x86_64", target_arch = "aarch64"))]
const VARIABLE: &str = "SSPLAT_SIMD";

/// Returns whether [`VARIABLE`] was `plain` when this function was first called.
#[cfg(any(target_arch = "x86_64", target_arch = "aarch64"))]
fn is_plain_asked_for() -> bool {
    static ASKED: OnceLock<bool> = OnceLock::new();
    *ASKED.get_or_init(|| std::env::var_os(VARIABLE).is_some_and(|value| value == "plain"))
}

/// Runs `task` with the best instructions that the machine supports, or with the plain ones if the environment asks
/// for them.
pub fn dispatch<T: Task>(task: T) -> T::Output {
    #[cfg(any(target_arch = "x86_64", target_arch = "aarch64"))]
    if !is_plain_asked_for()
        && let Some(simd) = native::supported()
    {
        return simd.call(task);
    }
    #[cfg(all(target_family = "wasm", target_feature = "simd128"))]
    return task.run(wasm::Simd128);
    #[cfg(not(all(target_family = "wasm", target_feature = "simd128")))]
    task.run(plain::Plain)
}

/// Returns the instruction set for fitting and rendering on the CPU: `"avx2"`; `"neon"` on ARM;
/// `"simd128"` in WebAssembly compiled for it; or `"plain"`, the baseline for which the crate is compiled.
///
/// Files and pixels are the same with all of them. The environment variable `SSPLAT_SIMD=plain`, read once per
/// process, selects the plain instructions, to compare them or to rule out the others as the cause of a wrong result.
#[must_use]
#[cfg_attr(not(any(test, feature = "unstable")), allow(dead_code, reason = "for tools"))]
pub fn instruction_set() -> &'static str {
    struct Name;
    impl Task for Name {
        type Output = &'static str;

        fn run<S: Simd>(self, _: S) -> &'static str {
            S::NAME
        }
    }
    dispatch(Name)
}

/// Operations on vectors of eight floats.
///
/// Code that uses them must be inlined into the function that is compiled for the instruction set, and therefore
/// cannot use closures.
pub trait Simd: Copy {
    /// Name of the instruction set, as returned by [`instruction_set`].
    const NAME: &'static str;

    /// Eight floats, in a register if there is one.
    type Vector: Copy;

    /// Runs `task` as a separate function with its own registers. If several tasks were inlined into one large
    /// function, their inner loops would spill each other's constants.
    #[cfg_attr(target_family = "wasm", inline(never))]
    #[cfg_attr(not(target_family = "wasm"), inline(always))]
    fn call<T: Task>(self, task: T) -> T::Output {
        task.run(self)
    }

    fn vector(self, values: [f32; LANES]) -> Self::Vector;
    fn to_array(self, v: Self::Vector) -> [f32; LANES];
    fn splat(self, value: f32) -> Self::Vector;
    fn add(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    fn sub(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    fn mul(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    fn div(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    /// Square root.
    fn sqrt(self, a: Self::Vector) -> Self::Vector;
    /// The larger; `b` where either is NaN.
    fn max(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    /// The smaller; `b` where either is NaN.
    fn min(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    /// `v` where `a > b`, else 0.
    fn keep_above(self, v: Self::Vector, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    /// `p · 2ⁿ` where the low bits of `shifted`'s mantissa are `n`.
    fn scale(self, p: Self::Vector, shifted: Self::Vector) -> Self::Vector;
    /// `floor(v)` for `0 ≤ v < 2²²`.
    fn floor(self, v: Self::Vector) -> [u32; LANES];
    /// Writes `floor(v)` for `0 ≤ v < 256` of three vectors, interleaved.
    fn store_rgb(self, to: &mut [u8; 3 * LANES], v: [Self::Vector; 3]);

    #[inline(always)]
    fn load(self, from: &Lanes) -> Self::Vector {
        self.vector(from.0)
    }

    #[inline(always)]
    fn store(self, to: &mut Lanes, v: Self::Vector) {
        to.0 = self.to_array(v);
    }

    /// Loads the first eight values of `from`.
    #[inline(always)]
    fn read(self, from: &[f32]) -> Self::Vector {
        self.vector(*from.first_chunk().expect("eight floats"))
    }

    /// Loads the first eight values of `from` as floats.
    #[inline(always)]
    fn widen(self, from: &[i16]) -> Self::Vector {
        let (from, mut to) = (from.first_chunk::<LANES>().expect("eight integers"), [0.0; LANES]);
        for k in 0..LANES {
            to[k] = f32::from(from[k]);
        }
        self.vector(to)
    }

    /// Stores `v` to the first eight values of `to`.
    #[inline(always)]
    fn write(self, to: &mut [f32], v: Self::Vector) {
        *to.first_chunk_mut().expect("eight floats") = self.to_array(v);
    }

    /// Returns the sum of all lanes; the halves are added first.
    #[inline(always)]
    fn sum(self, v: Self::Vector) -> f32 {
        let v = self.to_array(v);
        let [a, b, c, d] = [v[0] + v[4], v[1] + v[5], v[2] + v[6], v[3] + v[7]];
        (a + c) + (b + d)
    }

    /// 0, 1, 2, …
    #[inline(always)]
    fn index(self) -> Self::Vector {
        self.load(&Lanes([0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]))
    }

    /// `2^x` with a relative error of 2·10⁻⁷ for `−126 ≤ x ≤ 126`; below that range, `2^−126`.
    #[inline(always)]
    fn exp2(self, x: Self::Vector) -> Self::Vector {
        // Adding 1.5·2²³ leaves the nearest integer in the low bits.
        let magic = self.splat(12_582_912.0);
        let x = self.max(x, self.splat(-126.0));
        let shifted = self.add(x, magic);
        let f = self.sub(x, self.sub(shifted, magic));
        let [first, rest @ ..] = EXP2;
        let mut p = self.splat(first);
        for c in rest {
            p = self.add(self.mul(p, f), self.splat(c));
        }
        self.scale(p, shifted)
    }

    /// `e^x` with a relative error of 10⁻⁶ for magnitudes up to 40.
    #[inline(always)]
    fn exp(self, x: Self::Vector) -> Self::Vector {
        self.exp2(self.mul(x, self.splat(std::f32::consts::LOG2_E)))
    }

    /// Sine and cosine within 2·10⁻⁷, for up to a few hundred turns.
    #[inline(always)]
    fn sin_cos(self, x: Self::Vector) -> [Self::Vector; 2] {
        // π in three parts. The first two have few digits, so that their multiples are exact.
        const PI: [f32; 3] = [3.140_625, 9.670_257_6e-4, 6.277_114e-7];
        const HALF_PI: [f32; 2] = [std::f32::consts::FRAC_PI_2, -4.371_139e-8];
        // Adding 1.5·2²³ rounds to the nearest integer.
        let (magic, zero, one) = (self.splat(12_582_912.0), self.splat(0.0), self.splat(1.0));
        let turns = self.mul(x, self.splat(std::f32::consts::FRAC_1_PI));
        let k = self.sub(self.add(turns, magic), magic);
        let pairs = self.sub(self.add(self.mul(k, self.splat(0.5)), magic), magic);
        let odd = self.sub(k, self.add(pairs, pairs));
        let odd = self.mul(odd, odd);
        let sign = self.sub(one, self.add(odd, odd));
        let mut r = x;
        for part in PI {
            r = self.sub(r, self.mul(k, self.splat(part)));
        }
        let magnitude = self.max(r, self.sub(zero, r));
        let rest = self.add(self.sub(self.splat(HALF_PI[0]), magnitude), self.splat(HALF_PI[1]));
        let mut out = [r, rest];
        for v in &mut out {
            let square = self.mul(*v, *v);
            let mut p = self.splat(2.608_316e-6);
            for c in [-1.981_069e-4, 8.333_079e-3, -1.666_666e-1] {
                p = self.add(self.mul(p, square), self.splat(c));
            }
            *v = self.mul(sign, self.add(*v, self.mul(self.mul(p, square), *v)));
        }
        out
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// Checks the properties that every instruction set must have.
    pub fn check_properties(simd: impl Simd) {
        let out = |v| {
            let mut lanes = Lanes([0.0; LANES]);
            simd.store(&mut lanes, v);
            lanes.0
        };
        let mut worst = 0f64;
        for i in -126 * 512..126 * 512 {
            let x = i as f32 / 512.0 + 0.000_7;
            let got = f64::from(out(simd.exp2(simd.splat(x)))[3]);
            worst = worst.max((got / f64::from(x).exp2() - 1.0).abs());
        }
        assert!(worst < 2e-7, "{worst}");
        assert_eq!(out(simd.exp2(simd.splat(0.0))), [1.0; LANES]);
        for i in -4000..4000 {
            let x = i as f32 * 0.01;
            let got = f64::from(out(simd.exp(simd.splat(x)))[5]);
            assert!((got / f64::from(x).exp() - 1.0).abs() < 3e-6, "{x}");
            let (sin, cos) = f64::from(x).sin_cos();
            let [s, c] = simd.sin_cos(simd.splat(x)).map(|v| f64::from(out(v)[2]));
            assert!((s - sin).abs() < 2e-7 && (c - cos).abs() < 2e-7, "{x}: {s} {c} for {sin} {cos}");
        }
        assert_eq!(out(simd.exp2(simd.splat(-1e9))), [f32::MIN_POSITIVE; LANES]);
        for i in 0..=65536u32 {
            let x = i as f32;
            assert_eq!(simd.floor(simd.splat(x)), [i; LANES]);
            assert_eq!(simd.floor(simd.splat(x.next_up())), [i; LANES]);
            if i > 0 {
                assert_eq!(simd.floor(simd.splat(x.next_down())), [i - 1; LANES]);
            }
        }
        let rgb: [_; 3] = std::array::from_fn(|c| simd.add(simd.index(), simd.splat(c as f32 * 100.0 + 0.9)));
        let mut bytes = [0; 24];
        simd.store_rgb(&mut bytes, rgb);
        let want: [u8; 24] = std::array::from_fn(|i| (i / 3 + i % 3 * 100) as u8);
        assert_eq!(bytes, want);
        let nan = simd.splat(f32::NAN);
        let kept = simd.keep_above(simd.splat(7.0), simd.index(), simd.splat(3.0));
        assert_eq!(out(kept), [0.0, 0.0, 0.0, 0.0, 7.0, 7.0, 7.0, 7.0]);
        assert_eq!(out(simd.keep_above(simd.splat(7.0), nan, simd.splat(3.0))), [0.0; LANES]);
        assert_eq!(simd.sum(simd.index()), 28.0);
        let mut floats = [9.0; 12];
        simd.write(&mut floats[2..], simd.index());
        assert_eq!(floats, [9.0, 9.0, 0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 9.0, 9.0]);
        assert_eq!(out(simd.read(&floats[3..])), [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 9.0]);
        assert_eq!(out(simd.max(nan, simd.splat(0.0))), [0.0; LANES]);
        assert_eq!(out(simd.min(nan, simd.splat(1.0))), [1.0; LANES]);
    }
}
