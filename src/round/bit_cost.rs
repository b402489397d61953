//! The bits that the integers of a primitive cost, for rate–distortion decisions: as the entropy coder expects them, and
//! from how often they occur where it expects nothing.

use crate::bitstream::coder::expect::{Angles, PredictedCost};
use crate::bitstream::lattice::Lattice;
use crate::bitstream::splats::PackedGaussian;
use crate::strict_math::StrictMath;

/// Factor on the bits of a colour where they are those that the coder takes: a colour near its neighbours' makes theirs
/// cheaper, too. Of 1, 1.3 and 1.6 this was best on Kodak 05, 13, 15 and 23 at ratios of 50 and 200; what others would win
/// is measured by `cargo run --release -p ssplat-lab --example rate_distortion -- PICTURES`.
const SHARED: f32 = 1.3;

/// Bits of each symbol under order-0 statistics of one set of primitives, and what the coder expects of each of them.
#[derive(Debug, Clone)]
pub(crate) struct BitCosts<'a> {
    expected: &'a [PredictedCost],
    major: Vec<f32>,
    difference: Vec<f32>,
    color: [Vec<f32>; 4],
    channels: usize,
}

/// Colour integers are counted within `±COLOR_REACH`; beyond they cost the same as at the end.
const COLOR_REACH: i32 = 512;

impl<'a> BitCosts<'a> {
    /// `expected` tells what the coder expects of each of `gaussians`, or is empty.
    pub(crate) fn measure(gaussians: &[PackedGaussian], channels: usize, expected: &'a [PredictedCost]) -> Self {
        let mut major = vec![0.05f32; 256];
        let mut difference = vec![0.05f32; 256];
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

    /// Returns what integers of the primitive at `index` cost.
    #[inline(always)]
    pub(crate) fn of(&self, index: usize) -> Cost<'_> {
        Cost { common: self, expected: self.expected.get(index) }
    }
}

/// Cost in bits of the integers of one primitive.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Cost<'a> {
    common: &'a BitCosts<'a>,
    expected: Option<&'a PredictedCost>,
}

impl Cost<'_> {
    /// Returns what geometry of these scales costs.
    #[inline(always)]
    pub(crate) fn of_scales(&self, [major, minor]: [u8; 2], lattice: &Lattice) -> GeometryCost {
        let angles = lattice.angles(major, minor);
        let common = self.common.major[usize::from(major)];
        let (bits, angles) = match self.expected {
            Some(e) => (common + e.aspect(major, minor), e.angles(angles)),
            None => {
                let difference = self.common.difference[usize::from(major.saturating_sub(minor))];
                (common + difference + f32::from(angles).strict_log2(), None)
            }
        };
        GeometryCost { scales: [major, minor], bits, angles }
    }

    /// Bits of scales and angle, and of the position up to a constant.
    #[inline(always)]
    pub(crate) fn geometry(&self, g: &PackedGaussian, lattice: &Lattice) -> f32 {
        self.of_scales([g.major, g.minor], lattice).bits(g.angle, lattice.exponents(g.major, g.minor, g.angle))
    }

    /// Bits of the whole colour.
    #[inline(always)]
    pub(crate) fn colors(&self, c: [i16; 4]) -> f32 {
        match self.expected {
            Some(e) => SHARED * e.color(c, self.common.channels),
            None => (0..self.common.channels).map(|k| self.common.color[k][BitCosts::slot(c[k])]).sum(),
        }
    }

    /// Bits that no colour is below.
    #[inline(always)]
    pub(crate) fn least_colors(&self) -> f32 {
        self.expected.map_or(0.0, |e| SHARED * e.least_color(self.common.channels))
    }
}

/// Cost in bits of geometry with given scales.
#[derive(Debug, Clone, Copy)]
pub(crate) struct GeometryCost {
    pub scales: [u8; 2],
    /// Bits of the scales, and of the angle where nothing is expected of it.
    bits: f32,
    angles: Option<Angles>,
}

impl GeometryCost {
    /// Bits of the scales and an angle, and of the position, whose steps are `2^exponents`, up to a constant.
    #[inline(always)]
    pub(crate) fn bits(&self, angle: u16, [ex, ey]: [i32; 2]) -> f32 {
        self.bits + self.angles.map_or(0.0, |a| a.bits(angle)) - (ex + ey) as f32
    }
}

/// Spreads counts over neighbours: colours are samples of a smooth density.
fn smooth(counts: &[f32]) -> Vec<f32> {
    let n = counts.len();
    (0..n)
        .map(|i| {
            let mut s = 0.02;
            for d in -2i32..=2 {
                let j = i as i32 + d;
                if (0..n as i32).contains(&j) {
                    s += counts[j as usize] * [0.4, 0.2, 0.1][d.unsigned_abs() as usize];
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
