//! Defines how the layer's quantizer steps grow with frequency: faster in coarser layers.

use crate::strict_math::StrictMath;
/// The slopes at one quantizer step of the layer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Knot {
    /// The layer's step, in 1/64 code value.
    pub step: u16,
    /// Slopes for luma, grey and alpha, and for chroma.
    pub slopes: [u8; 2],
}

/// Slopes for every step, interpolated between the knots linearly in the logarithm of the step.
#[derive(Debug, Clone, Copy)]
pub(super) struct Slopes(pub &'static [Knot]);

impl Slopes {
    /// Returns the slopes for a layer with this step.
    pub(super) fn at(self, step: u16) -> [u8; 2] {
        let next = self.0.iter().position(|knot| knot.step > step).unwrap_or(self.0.len());
        let [a, b] = [next.max(1) - 1, next.min(self.0.len() - 1)].map(|i| self.0[i]);
        if a.step >= b.step || step <= a.step {
            return a.slopes;
        }
        let ln = |step: u16| f32::from(step).strict_ln();
        let share = (ln(step) - ln(a.step)) / (ln(b.step) - ln(a.step));
        let between = |[a, b]: [u8; 2]| (f32::from(a) + share * (f32::from(b) - f32::from(a))).round() as u8;
        [0, 1].map(|kind| between([a, b].map(|knot| knot.slopes[kind])))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slopes_between_knots_are_linear_in_the_logarithm_of_the_step() {
        const KNOTS: &[Knot] = &[Knot { step: 500, slopes: [40, 30] }, Knot { step: 2000, slopes: [80, 50] }];
        let all = Slopes(KNOTS);
        for (step, slopes) in
            [(1, [40, 30]), (500, [40, 30]), (1000, [60, 40]), (1999, [80, 50]), (2000, [80, 50]), (u16::MAX, [80, 50])]
        {
            assert_eq!(all.at(step), slopes, "{step}");
        }
        let one = Slopes(&KNOTS[..1]);
        assert_eq!([1, 500, 9000].map(|step| one.at(step)), [[40, 30]; 3]);
    }
}
