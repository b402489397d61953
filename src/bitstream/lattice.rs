//! Integers that follow from integers: angle counts and position exponents (spec §4.2, §4.3).
//!
//! Both are defined by real formulas and rounded once. `lattice_margins_hold` enumerates the domain
//! and proves that no value comes close enough to a rounding boundary for f64 to decide differently.

use super::splats::{Layout, Steps};

/// Most angles in the coded layout.
pub const MAX_ANGLES_CODED: u16 = 4096;
/// Most angles in the packed and the planes layout: 7 bits.
pub const MAX_ANGLES_PACKED: u16 = 128;

/// The number of angles for each difference `major − minor` and the position exponents (spec §4.2, §4.3).
#[derive(Debug, Clone)]
pub struct Lattice {
    coarsest: i32,
    finest: i32,
    angles: [u16; 256],
    /// `r² − 1` for the aspect `r` of each difference.
    stretches: [f64; 256],
    /// `4^l` where `l + ½` is what a scale contributes to the exponent of its position step, for each scale.
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
        Lattice { coarsest, finest: coarsest - i32::from(steps.range), angles, stretches, powers }
    }

    /// The number `n` of angles at a given `major − minor`; angles are `π·t/n` for `t` in `0..n`.
    #[must_use]
    pub fn angles(&self, major: u8, minor: u8) -> u16 {
        self.angles[usize::from(major.saturating_sub(minor))]
    }

    /// Exponents `[ex, ey]` of the position steps `2^ex` and `2^ey`, pixels.
    ///
    /// `2^ey` follows the standard deviation of the Gaussian's marginal in y, `2^ex` that of x given y.
    #[must_use]
    pub fn exponents(&self, major: u8, minor: u8, angle: u16) -> [i32; 2] {
        if self.finest == self.coarsest {
            return [self.coarsest; 2];
        }
        let n = f64::from(self.angles(major, minor));
        let stretch = self.stretches[usize::from(major.saturating_sub(minor))];
        let sin = (std::f64::consts::PI * f64::from(angle) / n).sin();
        // The square of the marginal deviation of y over s₂: r² sin² + cos².
        let lift = 1.0 + stretch * sin * sin;
        let y = self.powers[usize::from(minor)] * lift;
        let x = self.powers[usize::from(major)] / lift;
        [x, y].map(|square| (floor_log2(square) >> 1).clamp(self.finest, self.coarsest))
    }

    /// How many positions there are along a side of `pixels` at exponent `e`: `ceil(pixels / 2^e)`.
    #[must_use]
    pub fn positions(pixels: u32, exponent: i32) -> u32 {
        if exponent >= 0 {
            (u64::from(pixels) + (1u64 << exponent) - 1 >> exponent) as u32
        } else {
            pixels << -exponent
        }
    }
}

/// `⌊log₂ v⌋` of a positive normal number.
fn floor_log2(v: f64) -> i32 {
    (v.to_bits() >> 52) as i32 - 1023
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Runs over every step size and shape: no angle count and no exponent is near a rounding boundary.
    #[test]
    fn lattice_margins_hold() {
        let (mut of_counts, mut of_exponents) = (1.0f64, 1.0f64);
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
                    // All else in an exponent is a multiple of 1/32 less 1/64.
                    let place = 32.0 * lift - 0.5;
                    of_exponents = of_exponents.min((place - place.round()).abs() / 32.0);
                }
            }
        }
        assert!(of_counts > 1e-4, "{of_counts:e}");
        assert!(of_exponents > 1e-8, "{of_exponents:e}");
        println!("margins: {of_counts:e} of an angle, {of_exponents:e} of an octave");
    }
}
