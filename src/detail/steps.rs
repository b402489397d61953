//! Quantizer steps and the values of levels (spec §11.5).

use crate::bitstream::detail::head::DetailHead;
use crate::bitstream::detail::model::CLASSES;

/// Step of each class relative to a picture without classes, in 1/64.
pub(crate) const CLASS_STEPS: [u32; CLASSES] = [38, 54, 76, 108, 152, 215, 304, 430];

/// The steps of one plane for blocks of one class.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PlaneSteps {
    base: u32,
    slope: u32,
    biases: [i32; 2],
}

impl PlaneSteps {
    /// Returns the steps of `plane` in superblocks of `class`.
    pub(crate) fn new(head: &DetailHead, plane: usize, class: u8) -> Self {
        let mut base = u32::from(head.step);
        if let 1 | 2 = plane {
            base = base * u32::from(head.chroma[plane - 1]) / 16;
        }
        if head.classes > 1 {
            base = base * CLASS_STEPS[usize::from(class)] / 64;
        }
        let slope = head.slopes[usize::from(plane == 1 || plane == 2)].into();
        PlaneSteps { base, slope, biases: head.biases.map(i32::from) }
    }

    /// Returns the step of a frequency in blocks of side `4 << size`, in 1/64 of a code value.
    #[inline(always)]
    pub(crate) fn step(&self, size: usize, u: usize, v: usize) -> u32 {
        let frequency = ((u * u + v * v) as u64) << (6 - 2 * size);
        let more = (u64::from(self.base) * u64::from(self.slope) * frequency) >> 14;
        (self.base + more as u32).max(1)
    }

    /// Returns the coefficient of a level, in 1/16 of a code value.
    #[inline(always)]
    pub(crate) fn value(&self, size: usize, u: usize, v: usize, level: i16) -> i32 {
        let magnitude = i32::from(level).abs();
        let units = magnitude * 32 - self.biases[usize::from(magnitude > 1)];
        let value = units.wrapping_mul(self.step(size, u, v) as i32).wrapping_add(64) >> 7;
        if level < 0 { value.wrapping_neg() } else { value }
    }
}
