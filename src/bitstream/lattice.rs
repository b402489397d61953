//! Integers that are derived from other integers: angle counts and position exponents (spec §4.2, §4.3).
//!
//! Both are defined by real formulas and rounded once. `lattice_margins_hold` enumerates the domain and proves that no
//! value is so close to a rounding boundary that f64, or the short polynomial for the sine, could round it
//! differently.

use super::splats::{Layout, Steps};

/// Maximum number of angles in the coded layout.
pub const MAX_ANGLES_CODED: u16 = 4096;
/// Maximum number of angles in the packed and the planes layout, which have 7 bits.
pub const MAX_ANGLES_PACKED: u16 = 128;

/// The number of angles for each difference `major − minor` and the position exponents (spec §4.2, §4.3).
#[derive(Debug, Clone)]
pub struct Lattice {
    coarsest: i32,
    finest: i32,
    angles: [u16; 256],
    /// The reciprocals of `angles`.
    shares: [f64; 256],
    /// `r² − 1` for the aspect `r` of each difference.
    stretches: [f64; 256],
    /// `4^l` for each scale, where `l + ½` is the contribution of the scale to the exponent of its position step.
    powers: [f64; 256],
}

impl Lattice {
    /// Tabulates the counts for `steps` in `layout`.
    #[must_use]
    pub fn new(steps: &Steps, layout: Layout) -> Self {
        let delta = (f64::from(steps.scale) + 4.0) / 32.0;
        let tau = ((f64::from(steps.angle) - 1.0) / 2.0).exp2();
        let cap = match layout {
            Layout::Coded => MAX_ANGLES_CODED,
            Layout::Packed | Layout::Planes => MAX_ANGLES_PACKED,
        };
        let aspect = |difference: usize| (difference as f64 * delta).exp2();
        let mut angles = [1u16; 256];
        for (difference, count) in angles.iter_mut().enumerate().skip(1) {
            let aspect = aspect(difference);
            let step = std::f64::consts::SQRT_2 * delta * std::f64::consts::LN_2 * tau;
            let wanted = (std::f64::consts::PI * (aspect - 1.0 / aspect) / step).ceil();
            *count = wanted.clamp(1.0, f64::from(cap)) as u16;
        }
        let coarsest = i32::from(steps.coarsest);
        let fineness = -f64::from(steps.position) / 4.0 - 1.0 / 64.0;
        let stretches = std::array::from_fn(|difference| aspect(difference).powi(2) - 1.0);
        let powers = std::array::from_fn(|scale| (2.0 * (scale as f64 * delta - 2.0 + fineness + 0.5)).exp2());
        let shares = angles.map(|n| f64::from(n).recip());
        Lattice { coarsest, finest: coarsest - i32::from(steps.range), angles, shares, stretches, powers }
    }

    /// Returns the number `n` of angles for a given `major − minor`; angles are `π·t/n` for `t` in `0..n`.
    #[must_use]
    pub fn angles(&self, major: u8, minor: u8) -> u16 {
        self.angles[usize::from(major.saturating_sub(minor))]
    }

    /// Returns the exponents `[ex, ey]` of the position steps `2^ex` and `2^ey`, pixels.
    ///
    /// `2^ey` follows the standard deviation of the Gaussian's marginal distribution in y, `2^ex` that of x given y.
    #[must_use]
    pub fn exponents(&self, major: u8, minor: u8, angle: u16) -> [i32; 2] {
        if self.finest == self.coarsest {
            return [self.coarsest; 2];
        }
        let lift = self.lift(usize::from(major.saturating_sub(minor)), angle);
        let y = self.powers[usize::from(minor)] * lift;
        let x = self.powers[usize::from(major)] / lift;
        [x, y].map(|square| (floor_log2(square) >> 1).clamp(self.finest, self.coarsest))
    }

    /// Returns the squared marginal deviation in y relative to s₂, `r² sin² + cos²`, for a difference of scales.
    fn lift(&self, difference: usize, angle: u16) -> f64 {
        // The sine of an angle equals that of its supplement.
        let turns = angle.min(self.angles[difference].saturating_sub(angle));
        let sin = sin_pi(f64::from(turns) * self.shares[difference]);
        1.0 + self.stretches[difference] * (sin * sin)
    }

    /// Returns the number of positions along a side of `pixels` at exponent `e`: `ceil(pixels / 2^e)`.
    #[must_use]
    pub fn positions(pixels: u32, exponent: i32) -> u32 {
        if exponent >= 0 {
            (u64::from(pixels) + (1u64 << exponent) - 1 >> exponent) as u32
        } else {
            pixels << -exponent
        }
    }
}

/// Returns `sin(π·v)` for `v` in `0..=½`, within 3·10⁻¹¹. It is much faster than the library function and gives the
/// same bits on every machine.
fn sin_pi(v: f64) -> f64 {
    const C: [f64; 6] = [
        3.141_592_653_523_344,
        -5.167_712_762_115_779,
        2.550_163_240_317_529_4,
        -0.599_251_330_106_559_8,
        0.082_046_478_836_445_22,
        -0.007_022_163_540_331_201,
    ];
    let x = v * v;
    let xx = x * x;
    // Two independent halves.
    v * ((C[0] + C[1] * x) + xx * ((C[2] + C[3] * x) + xx * (C[4] + C[5] * x)))
}

/// Returns `⌊log₂ v⌋` of a positive normal number.
fn floor_log2(v: f64) -> i32 {
    (v.to_bits() >> 52) as i32 - 1023
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Checks every step size and shape: no angle count and no exponent is near a rounding boundary.
    #[test]
    fn lattice_margins_hold() {
        let (mut of_counts, mut of_exponents, mut of_polynomial) = (1.0f64, 1.0f64, 0.0f64);
        for (scale, angle, layout) in
            (0..16).flat_map(|s| (0..4).flat_map(move |a| [Layout::Coded, Layout::Packed].map(|l| (s, a, l))))
        {
            let steps = Steps { scale, angle, position: 0, coarsest: 0, range: 1, luma: 0, chroma: 0 };
            let lattice = Lattice::new(&steps, layout);
            let delta = (f64::from(scale) + 4.0) / 32.0;
            for difference in 1..=(22 * 32 / (u32::from(scale) + 4)).min(255) as u8 {
                let aspect = (f64::from(difference) * delta).exp2();
                let tau = ((f64::from(angle) - 1.0) / 2.0).exp2();
                let step = std::f64::consts::SQRT_2 * delta * std::f64::consts::LN_2 * tau;
                let wanted = std::f64::consts::PI * (aspect - 1.0 / aspect) / step;
                let n = lattice.angles(difference, 0);
                if wanted < f64::from(n) + 1.0 {
                    of_counts = of_counts.min((wanted - wanted.round()).abs());
                }
                for t in 0..n {
                    let sin = (std::f64::consts::PI * f64::from(t) / f64::from(n)).sin();
                    let lift = 0.5 * (1.0 + (aspect * aspect - 1.0) * sin * sin).log2();
                    // Everything else in an exponent is a multiple of 1/32 minus 1/64.
                    let place = 32.0 * lift - 0.5;
                    of_exponents = of_exponents.min((place - place.round()).abs() / 32.0);
                    let octaves = 0.5 * lattice.lift(difference.into(), t).log2();
                    of_polynomial = of_polynomial.max((octaves - lift).abs());
                }
            }
        }
        assert!(of_counts > 1e-4, "{of_counts:e}");
        assert!(of_exponents > 1e-8, "{of_exponents:e}");
        assert!(of_polynomial < 1e-10, "{of_polynomial:e}");
        println!(
            "margins: {of_counts:e} of an angle, {of_exponents:e} of an octave; errors: {of_polynomial:e} of an octave"
        );
    }

    /// Checks every shape for several step sizes.
    #[test]
    fn exponents_are_those_of_the_formula() {
        let mut seen = [0u64; 9];
        for (scale, angle, position, layout) in
            [(1, 1, 0, Layout::Packed), (4, 0, 7, Layout::Coded), (5, 3, 3, Layout::Planes), (15, 2, 15, Layout::Coded)]
        {
            let steps = Steps { scale, angle, position, coarsest: 4, range: 8, luma: 0, chroma: 0 };
            let lattice = Lattice::new(&steps, layout);
            let delta = (f64::from(scale) + 4.0) / 32.0;
            let top = (22 * 32 / (u32::from(scale) + 4)).min(255) as u8;
            let fineness = -f64::from(position) / 4.0 - 1.0 / 64.0;
            for difference in 0..=top {
                let n = lattice.angles(difference, 0);
                for t in 0..n {
                    let aspect = (f64::from(difference) * delta).exp2();
                    let sin = (std::f64::consts::PI * f64::from(t) / f64::from(n)).sin();
                    let lift = 0.5 * (1.0 + (aspect * aspect - 1.0) * sin * sin).log2();
                    for minor in 0..=top - difference {
                        let major = minor + difference;
                        let log = |scale: u8| f64::from(scale) * delta - 2.0 + fineness + 0.5;
                        let want = [log(major) - lift, log(minor) + lift].map(|e| (e.floor() as i32).clamp(-4, 4));
                        assert_eq!(lattice.exponents(major, minor, t), want, "{steps:?} {major} {minor} {t}");
                        seen[(want[0] + 4) as usize] += 1;
                    }
                }
            }
        }
        assert!(seen.iter().all(|&n| n > 1000), "{seen:?}");
    }
}
