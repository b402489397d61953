//! Bit costs of the integers of a primitive, for rate–distortion decisions: the entropy coder's predictions, and symbol
//! frequencies where it predicts nothing.

use crate::bitstream::coder::expect::{Angles, PredictedCost};
use crate::bitstream::lattice::Lattice;
use crate::bitstream::splats::PackedGaussian;
use crate::constants::rdo;
use crate::strict_math::StrictMath;

/// Bits of each symbol under order-0 statistics of one set of primitives, and the entropy coder's predictions.
#[derive(Debug, Clone)]
pub(crate) struct BitCosts<'a> {
    expected: &'a [PredictedCost],
    major: Vec<f32>,
    difference: Vec<f32>,
    color: [Vec<f32>; 4],
    channels: usize,
}

/// Colour integers are counted within `±COLOR_REACH`. Beyond that range they cost as much as at its ends.
const COLOR_REACH: i32 = 512;

impl<'a> BitCosts<'a> {
    /// Measures the symbol frequencies of `gaussians`. `expected` holds the coder's prediction for each of them, or is
    /// empty.
    pub(crate) fn measure(gaussians: &[PackedGaussian], channels: usize, expected: &'a [PredictedCost]) -> Self {
        let mut major = vec![rdo::SCALE_COUNT_FLOOR; 256];
        let mut difference = vec![rdo::SCALE_COUNT_FLOOR; 256];
        let mut color: [Vec<f32>; 4] = std::array::from_fn(|_| vec![0.0; 2 * COLOR_REACH as usize + 1]);
        for g in gaussians {
            major[usize::from(g.major)] += 1.0;
            difference[usize::from(g.major.saturating_sub(g.minor))] += 1.0;
            for k in 0..channels {
                color[k][Self::slot(g.color[k])] += 1.0;
            }
        }
        for counts in color.iter_mut().take(channels) {
            *counts = smooth(counts);
        }
        BitCosts {
            expected,
            major: bits(&major),
            difference: bits(&difference),
            color: color.map(|c| bits(&c)),
            channels,
        }
    }

    fn slot(value: i16) -> usize {
        (i32::from(value).clamp(-COLOR_REACH, COLOR_REACH) + COLOR_REACH) as usize
    }

    /// Returns the cost model of the primitive at `index`.
    #[inline(always)]
    pub(crate) fn of(&self, index: usize) -> Cost<'_> {
        Cost { shared: self, expected: self.expected.get(index) }
    }
}

/// Cost model of the integers of one primitive, in bits.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Cost<'a> {
    shared: &'a BitCosts<'a>,
    expected: Option<&'a PredictedCost>,
}

impl Cost<'_> {
    /// Returns the cost of geometry with these scales.
    #[inline(always)]
    pub(crate) fn of_scales(&self, [major, minor]: [u8; 2], lattice: &Lattice) -> GeometryCost {
        let angles = lattice.angles(major, minor);
        let shared = self.shared.major[usize::from(major)];
        let (bits, angles) = match self.expected {
            Some(e) => (shared + e.aspect(major, minor), e.angles(angles)),
            None => {
                let difference = self.shared.difference[usize::from(major.saturating_sub(minor))];
                (shared + difference + f32::from(angles).strict_log2(), None)
            }
        };
        GeometryCost { scales: [major, minor], bits, angles }
    }

    /// Returns the bits of the scales and the angle, and those of the position up to a constant.
    #[inline(always)]
    pub(crate) fn geometry(&self, g: &PackedGaussian, lattice: &Lattice) -> f32 {
        self.of_scales([g.major, g.minor], lattice).bits(g.angle, lattice.exponents(g.major, g.minor, g.angle))
    }

    /// Returns the bits of all channels of a colour.
    #[inline(always)]
    pub(crate) fn colors(&self, c: [i16; 4]) -> f32 {
        match self.expected {
            Some(e) => rdo::COLOR_BITS_FACTOR * e.color(c, self.shared.channels),
            None => (0..self.shared.channels).map(|k| self.shared.color[k][BitCosts::slot(c[k])]).sum(),
        }
    }

    /// Returns a lower bound on the bits of any colour.
    #[inline(always)]
    pub(crate) fn min_color_bits(&self) -> f32 {
        self.expected.map_or(0.0, |e| rdo::COLOR_BITS_FACTOR * e.least_color(self.shared.channels))
    }
}

/// Cost model of geometry with given scales, in bits.
#[derive(Debug, Clone, Copy)]
pub(crate) struct GeometryCost {
    pub scales: [u8; 2],
    /// Bits of the scales, and of the angle if there is no prediction for it.
    bits: f32,
    angles: Option<Angles>,
}

impl GeometryCost {
    /// Returns the bits of the scales and an angle, and those of the position up to a constant. The steps of the
    /// position are `2^exponents`.
    #[inline(always)]
    pub(crate) fn bits(&self, angle: u16, [ex, ey]: [i32; 2]) -> f32 {
        self.bits + self.angles.map_or(0.0, |a| a.bits(angle)) - (ex + ey) as f32
    }
}

/// Spreads counts over neighbouring values, because colours are samples of a smooth density.
fn smooth(counts: &[f32]) -> Vec<f32> {
    let n = counts.len();
    (0..n)
        .map(|i| {
            let mut s = rdo::COLOR_COUNT_FLOOR;
            for d in -2i32..=2 {
                let j = i as i32 + d;
                if (0..n as i32).contains(&j) {
                    s += counts[j as usize] * rdo::COLOR_COUNT_KERNEL[d.unsigned_abs() as usize];
                }
            }
            s
        })
        .collect()
}

fn bits(counts: &[f32]) -> Vec<f32> {
    let total: f32 = counts.iter().sum();
    counts.iter().map(|c| if *c > 0.0 { -(c / total).strict_log2() } else { 24.0 }).collect()
}
