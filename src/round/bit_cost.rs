//! The bits that the integers of a primitive cost, estimated from how often they occur; for rate–distortion decisions.

use crate::bitstream::lattice::Lattice;
use crate::bitstream::splats::PackedGaussian;

/// Bits of each symbol under order-0 statistics of one set of primitives.
#[derive(Debug, Clone)]
pub(crate) struct BitCosts {
    major: Vec<f32>,
    difference: Vec<f32>,
    color: [Vec<f32>; 4],
    channels: usize,
}

/// Colour integers are counted within `±COLOR_REACH`; beyond they cost the same as at the end.
const COLOR_REACH: i32 = 512;

impl BitCosts {
    pub(crate) fn measure(gaussians: &[PackedGaussian], channels: usize) -> Self {
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
        BitCosts { major: bits(&major), difference: bits(&difference), color: color.map(|c| bits(&c)), channels }
    }

    fn slot(value: i16) -> usize {
        (i32::from(value).clamp(-COLOR_REACH, COLOR_REACH) + COLOR_REACH) as usize
    }

    /// Bits of scales and angle, and of the position up to a constant.
    #[inline(always)]
    pub(crate) fn geometry(&self, g: &PackedGaussian, lattice: &Lattice) -> f32 {
        let [ex, ey] = lattice.exponents(g.major, g.minor, g.angle);
        self.major[usize::from(g.major)]
            + self.difference[usize::from(g.major.saturating_sub(g.minor))]
            + f32::from(lattice.angles(g.major, g.minor)).log2()
            - (ex + ey) as f32
    }

    /// Bits of the colour integer `k`.
    #[inline(always)]
    pub(crate) fn color(&self, k: usize, value: i16) -> f32 {
        self.color[k][Self::slot(value)]
    }

    /// Bits of the whole colour.
    #[inline(always)]
    pub(crate) fn colors(&self, c: [i16; 4]) -> f32 {
        (0..self.channels).map(|k| self.color(k, c[k])).sum()
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
    counts.iter().map(|c| if *c > 0.0 { -(c / total).log2() } else { 24.0 }).collect()
}
