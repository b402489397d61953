//! Eight lanes in plain arrays: the reference for the other instruction sets, and the fallback.

use super::{LANES, Simd};

/// Plain arrays, in loops that compilers may vectorize: the reference for the other instruction sets.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Plain;

/// Evaluates an expression for each lane. It is written out, because nested closures make builds slower.
macro_rules! each_lane {
    ($i:ident => $value:expr) => {
        each_lane!($i, $value, 0 1 2 3 4 5 6 7)
    };
    ($i:ident, $value:expr, $($lane:literal)*) => {
        [$({
            const $i: usize = $lane;
            $value
        }),*]
    };
}

impl Simd for Plain {
    const NAME: &'static str = "plain";

    type Vector = [f32; LANES];

    #[inline(always)]
    fn vector(self, values: [f32; LANES]) -> Self::Vector {
        values
    }

    #[inline(always)]
    fn to_array(self, v: Self::Vector) -> [f32; LANES] {
        v
    }

    #[inline(always)]
    fn splat(self, value: f32) -> Self::Vector {
        [value; LANES]
    }

    #[inline(always)]
    fn add(self, a: Self::Vector, b: Self::Vector) -> Self::Vector {
        each_lane!(I => a[I] + b[I])
    }

    #[inline(always)]
    fn sub(self, a: Self::Vector, b: Self::Vector) -> Self::Vector {
        each_lane!(I => a[I] - b[I])
    }

    #[inline(always)]
    fn mul(self, a: Self::Vector, b: Self::Vector) -> Self::Vector {
        each_lane!(I => a[I] * b[I])
    }

    #[inline(always)]
    fn div(self, a: Self::Vector, b: Self::Vector) -> Self::Vector {
        each_lane!(I => a[I] / b[I])
    }

    #[inline(always)]
    fn sqrt(self, a: Self::Vector) -> Self::Vector {
        each_lane!(I => a[I].sqrt())
    }

    #[inline(always)]
    fn max(self, a: Self::Vector, b: Self::Vector) -> Self::Vector {
        each_lane!(I => if a[I] > b[I] { a[I] } else { b[I] })
    }

    #[inline(always)]
    fn min(self, a: Self::Vector, b: Self::Vector) -> Self::Vector {
        each_lane!(I => if a[I] < b[I] { a[I] } else { b[I] })
    }

    #[inline(always)]
    fn keep_above(self, v: Self::Vector, a: Self::Vector, b: Self::Vector) -> Self::Vector {
        each_lane!(I => if a[I] > b[I] { v[I] } else { 0.0 })
    }

    #[inline(always)]
    fn scale(self, p: Self::Vector, shifted: Self::Vector) -> Self::Vector {
        each_lane!(I => f32::from_bits((shifted[I].to_bits() << 23).wrapping_add(p[I].to_bits())))
    }

    #[inline(always)]
    fn floor(self, v: Self::Vector) -> [u32; LANES] {
        // A cast saturates, and its range checks would prevent vectorization.
        const MAGIC: f32 = 8_388_608.0;
        each_lane!(I => {
            let shifted = v[I] + MAGIC;
            (shifted.to_bits() & 0x7F_FFFF).wrapping_sub(u32::from(shifted - MAGIC > v[I]))
        })
    }

    #[inline(always)]
    fn store_rgb(self, to: &mut [u8; 3 * LANES], v: [Self::Vector; 3]) {
        let codes = v.map(|v| self.floor(v));
        for i in 0..LANES {
            for c in 0..3 {
                to[3 * i + c] = codes[c][i] as u8;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::check_properties;
    use super::Plain;

    #[test]
    fn plain_lanes_have_the_required_properties() {
        check_properties(Plain);
    }
}
