//! Defines how the layer's quantizer steps grow with frequency, and the steps of chroma: in coarser layers, steps grow
//! faster and chroma has relatively finer steps.

use crate::bitstream::detail::DetailHead;
use crate::constants::detail::Knot;
use crate::strict_math::StrictMath;

/// Slopes for every step, interpolated between the knots linearly in the logarithm of the step.
#[derive(Debug, Clone, Copy)]
pub(super) struct Slopes(pub &'static [Knot]);

impl Slopes {
    /// Sets the slopes and the steps of chroma that belong to the step of `head`.
    pub(super) fn apply(self, head: &mut DetailHead) {
        let Knot { slopes, chroma, .. } = self.at(head.step);
        (head.slopes, head.chroma) = (slopes, chroma);
    }

    /// Returns the knot at `step`.
    fn at(self, step: u16) -> Knot {
        let next = self.0.iter().position(|knot| knot.step > step).unwrap_or(self.0.len());
        let [a, b] = [next.max(1) - 1, next.min(self.0.len() - 1)].map(|i| self.0[i]);
        if a.step >= b.step || step <= a.step {
            return Knot { step, ..a };
        }
        let ln = |step: u16| f32::from(step).strict_ln();
        let share = (ln(step) - ln(a.step)) / (ln(b.step) - ln(a.step));
        let between = |a: u8, b: u8| (f32::from(a) + share * (f32::from(b) - f32::from(a))).round() as u8;
        let both = |a: [u8; 2], b: [u8; 2]| [0, 1].map(|i| between(a[i], b[i]));
        Knot { step, slopes: both(a.slopes, b.slopes), chroma: both(a.chroma, b.chroma) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_between_knots_are_linear_in_the_logarithm_of_the_step() {
        const KNOTS: &[Knot] = &[
            Knot { step: 500, slopes: [40, 30], chroma: [80, 40] },
            Knot { step: 2000, slopes: [80, 50], chroma: [60, 32] },
        ];
        let all = Slopes(KNOTS);
        let of = |slopes: Slopes, step| {
            let mut head = DetailHead { step, ..DetailHead::PLAIN };
            slopes.apply(&mut head);
            assert_eq!(head.step, step);
            (head.slopes, head.chroma)
        };
        let [first, middle, last] = [([40, 30], [80, 40]), ([60, 40], [70, 36]), ([80, 50], [60, 32])];
        for (step, found) in [(1, first), (500, first), (1000, middle), (1999, last), (2000, last), (u16::MAX, last)] {
            assert_eq!(of(all, step), found, "{step}");
        }
        let one = Slopes(&KNOTS[..1]);
        assert_eq!([1, 500, 9000].map(|step| of(one, step)), [first; 3]);
    }
}
