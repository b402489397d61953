//! How much work a fit spends: iterations, sampled rows and sweeps.

use std::time::Duration;

use crate::fit::model::drawing::project::Primitive;
use crate::fit::model::problem::LARGE_PIXELS;
use crate::instant::Instant;
use crate::options::{Rung, Tune};
use crate::strict_math::StrictMath;

/// Fraction of a time budget that the float fit may use.
const FIT_SHARE: f64 = 0.8;

/// Fractions of the iterations for primitives under a detail layer with perceptual tuning, by effort. At effort 5,
/// 0.35 gains 0.1 to 0.4 points of SSIMULACRA2 on Kodak and CID22 at ratios of 50 and 100, and nothing at 2.8
/// megapixels. It takes 28 % more time.
const BASE_STEPS: [f32; 9] = [0.2, 0.2, 0.2, 0.2, 0.2, 0.235, 0.6, 0.6, 0.6];
/// The same for minimum squared error: at effort 1, up to effort 6, and from effort 7 on. 1 gains 0.06 dB at ratios of
/// 20 and 50 and takes 50 % more time.
const EXACT_BASE_STEPS: [f32; 3] = [0.25, 0.5, 1.0];
/// Decay rates of the optimizer's moments under a detail layer with perceptual tuning. Compared with 0.9 and 0.95, they
/// gain 0.1 to 0.2 points of SSIMULACRA2 in these short fits.
const BASE_DECAY: [f32; 2] = [0.7, 0.9];
/// Factor on the iterations for squared error at a ratio of 20, up to effort 6. It gains 0.09 dB and nearly doubles the
/// encoding time. At a ratio of 50 it would gain about as much for the same time; that is left to higher efforts.
const FINE_BASE_STEPS: f32 = 2.5;
/// Ratio at which that factor applies in full, and ratio at which it is 1. Between them it depends on the logarithm of
/// the ratio.
const FINE_RATIOS: [f64; 2] = [20.0, 50.0];
/// Maximum number of relocations under a detail layer with perceptual tuning, and minimum number of steps between them.
/// Each costs as much as three to five steps. 16 or 26 gain nothing.
const MAX_BASE_RELOCATIONS: u32 = 10;
const MIN_BASE_RELOCATION_INTERVAL: u32 = 10;

/// Minimum number of pixels per primitive in the downscaled picture to which primitives under a detail layer are
/// fitted.
const MIN_PIXELS_EACH: f64 = 300.0;
/// Largest factor by which that picture is downscaled.
const MAX_REDUCTION: u32 = 4;
/// First steps at half size at effort 1 under a detail layer, if Gaussians span several pixels.
const EFFORT_1_BASE_HALF: HalfSize = HalfSize { share: 0.7, row_step: 3 };
/// The same without a detail layer: with perceptual tuning, and for minimum squared error. On twelve Kodak pictures
/// with perceptual tuning at a ratio of 200, it takes 0.92 of the CPU time, gains 0.2 points of SSIMULACRA2 and loses
/// 0.1 dB; at 500 and 1000 it takes 0.8 of the time and gains 0.5 and 0.3 points. On eight of them for squared error,
/// it takes 0.7 of the time and loses 0.01 dB at 500 and 1000. At 200, where it would lose 0.08 dB, the fit uses full
/// size.
const HALF: [HalfSize; 2] = [HalfSize { share: 0.5, row_step: 3 }, HalfSize { share: 0.5, row_step: 6 }];
/// Minimum effort for the first of them. At effort 1 and a ratio of 200 it would lose 0.8 points and save no time.
const MIN_PERCEPTUAL_HALF_EFFORT: u8 = 3;

/// Step sizes at the end of a fit, relative to those at the start.
pub(crate) const LAST_RATE: f32 = 0.02;
/// The same under a detail layer with perceptual tuning, up to effort 5 and from effort 6 on. The sweep over the
/// integers that follows compensates for the larger steps. With these values and [`BASE_RELOCATED_SHARES`], Kodak at a
/// ratio of 50 gains 0.6 points of SSIMULACRA2 at effort 1 and 0.3 at effort 6.
const BASE_LAST_RATES: [f32; 2] = [0.2, 0.1];
/// Maximum share of the primitives in each relocation at a steady pace.
const RELOCATED_SHARE: f32 = 0.1;
/// The same under a detail layer with perceptual tuning, up to effort 5 and from effort 6 on. Relocations are rarer
/// there.
const BASE_RELOCATED_SHARES: [f32; 2] = [0.35, 0.25];

/// Maximum number of steps between relocations.
const MAX_RELOCATION_INTERVAL: u32 = 25;

/// Number of primitives from which on a picture is among the largest.
const HUGE_COUNT: usize = 300_000;

/// The first steps of a fit, which use the picture at half size.
#[derive(Debug, Clone, Copy)]
pub(crate) struct HalfSize {
    /// Fraction of the steps.
    pub share: f32,
    /// Minimum distance of sampled rows. Gaussians span several pixels from there on.
    pub row_step: u32,
}

/// The schedule of one encode.
#[derive(Debug, Clone)]
pub(crate) struct Plan {
    /// Gradient steps of the float fit.
    pub iterations: u32,
    /// Gradient steps during freezing, where primitives are fixed at lattice points. Descent alone comes within 0.05 dB
    /// of it.
    pub freezing: u32,
    /// Maximum number of descent sweeps over the integers.
    pub sweeps: u32,
    /// Iterations between relocations.
    pub relocate_every: u32,
    /// How fast the optimizer forgets, and how many primitives are relocated when.
    pub pace: Pace,
    /// When the float fit should end.
    pub fit_deadline: Option<Instant>,
    /// When the encode should end, whatever remains to be done.
    pub deadline: Option<Instant>,
    /// Mean squared error per sample at which the float fit ends early.
    pub enough: f64,
    /// Factor on the optimizer's step sizes. It differs from 1 only in stability tests.
    pub rate: f32,
    /// Step sizes at the end, relative to those at the start.
    pub last_rate: f32,
    /// Maximum share of the primitives in each relocation at a steady pace.
    pub relocated_share: f32,
    /// Decay rates of the optimizer's moments, if the pace does not determine them.
    pub decay: Option<[f32; 2]>,
    /// Whether pixels are reweighted during the fit, by what the picture still lacks.
    pub reweighs: bool,
    /// The first steps that use half size, if the picture is not large anyway. `None` means no steps.
    pub half: Option<HalfSize>,
    /// Factor by which the picture is downscaled in all steps: a power of two.
    pub by: u32,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Primitives of a smaller fit that this one continues. If empty, the fit starts from scratch.
    pub initial: Vec<Primitive>,
    /// The last part of the method that an ablation includes.
    pub rung: Rung,
}

/// Returns the factor, a power of two, by which a picture of `pixels` pixels may be downscaled while `count` primitives
/// are fitted to it under a detail layer.
pub(crate) fn fraction(pixels: u64, count: usize) -> u32 {
    let pixels_each = pixels as f64 / count.max(1) as f64;
    let mut by = 1;
    while by < MAX_REDUCTION && pixels_each / f64::from(4 * by * by) >= MIN_PIXELS_EACH {
        by *= 2;
    }
    by
}

/// Returns the factor on the iterations for squared error in a file of the given ratio.
fn fine_step_factor(ratio: f64) -> f32 {
    let [fine, coarse] = FINE_RATIOS;
    let share = ((coarse / ratio).strict_ln() / (coarse / fine).strict_ln()).clamp(0.0, 1.0);
    FINE_BASE_STEPS.strict_powf(share as f32)
}

/// Number of primitives from which on a fit has a brisk pace.
const BRISK_COUNT: usize = 4000;

/// How fast the optimizer forgets, and how many primitives are relocated when.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Pace {
    /// For few primitives, each of which matters to the end: slowly decaying moments, and relocation of a tenth of the
    /// primitives at a time until late in the fit.
    Steady,
    /// For many primitives: faster decaying moments in short fits, and relocation of a fifth of the primitives at first
    /// and fewer later.
    Brisk,
}

impl Plan {
    /// Returns the schedule for `effort` (`1..=9`) and `count` primitives on `pixels` pixels. Fewer primitives cost
    /// less per step and need more steps to find their places.
    pub(crate) fn new(effort: u8, count: usize, pixels: u64, time: Option<Duration>, seed: u64) -> Self {
        let level = usize::from(effort) - 1;
        // With many primitives, two thirds of the steps that few of them would get are as effective, because the
        // moments decay faster and many primitives are relocated at first. `--example effort_table` measures it.
        let is_dense = count >= BRISK_COUNT;
        let base = match is_dense {
            true => [57.0, 94.0, 165.0, 280.0, 500.0, 750.0, 1310.0, 2250.0, 3750.0f32][level],
            false => [66.0, 130.0, 220.0, 350.0, 590.0, 880.0, 1540.0, 2640.0, 4400.0f32][level],
        };
        let density = count.max(1) as f32 / 5500.0;
        // In a short fit of a large picture, a step gains more than the sweep that would take its place.
        let dense_exponent = match level {
            0..3 => -0.1,
            3 => -0.2,
            _ => -0.3,
        };
        let patience = density.strict_powf(if density < 1.0 { -0.95 } else { dense_exponent }).clamp(0.25, 9.0);
        // On small pictures, 50 % more steps gain 0.1 dB and take only seconds.
        let share = |from: f32, to: f32| ((count as f32 - from) / (to - from)).clamp(0.0, 1.0);
        let extra = if pixels < LARGE_PIXELS { 0.5 * share(8000.0, 12_000.0) * share(40_000.0, 25_000.0) } else { 0.0 };
        let iterations = (base * patience * (1.0 + extra)) as u32;
        // Small pictures can afford more sweeps. The first sweeps gain most.
        let sweeps = match count {
            ..2000 => [4, 5, 5, 6, 7, 9, 13, 17, 20][level],
            2000..40_000 => [1, 2, 2, 3, 5, 7, 10, 14, 20][level],
            40_000..HUGE_COUNT => [1, 1, 2, 2, 4, 5, 6, 8, 12][level],
            _ => [1, 1, 2, 2, 3, 4, 6, 8, 12][level],
        };
        let freezing = if effort >= 7 && count > 2000 { iterations / 4 } else { 0 };
        let now = Instant::now();
        let deadline = time.and_then(|t| now.checked_add(t));
        let fit_deadline = time.and_then(|t| now.checked_add(t.mul_f64(FIT_SHARE)));
        let pace = if is_dense { Pace::Brisk } else { Pace::Steady };
        Plan { freezing, sweeps, pace, fit_deadline, deadline, ..Plan::steps(iterations, seed) }
    }

    /// Returns the schedule for primitives under a detail layer, which corrects what a short fit leaves. `ratio` is
    /// that of the complete file. Without it, the fit is that of small files. `patience` is a factor on the iterations
    /// with perceptual tuning.
    pub(crate) fn for_base(self, effort: u8, tune: Tune, ratio: Option<f64>, patience: f32) -> Self {
        let is_exact = tune == Tune::Psnr;
        let share = match (effort, is_exact) {
            (_, false) => BASE_STEPS[usize::from(effort) - 1] * patience,
            (1, true) => EXACT_BASE_STEPS[0],
            (2..7, true) => EXACT_BASE_STEPS[1] * ratio.map_or(1.0, fine_step_factor),
            (_, true) => EXACT_BASE_STEPS[2],
        };
        let iterations = (self.iterations as f32 * share) as u32;
        let relocate_every = match is_exact {
            true => Plan::steps(iterations, self.seed).relocate_every,
            false => (iterations / MAX_BASE_RELOCATIONS).clamp(MIN_BASE_RELOCATION_INTERVAL, MAX_RELOCATION_INTERVAL),
        };
        let sweeps = self.sweeps.min(match effort {
            1 if !is_exact => 0,
            1 => 1,
            2 if !is_exact => 1,
            2..7 if !is_exact => 2,
            // After longer fits, the third sweep gains another 0.01 dB.
            _ => 3,
        });
        let half = (effort == 1).then_some(EFFORT_1_BASE_HALF);
        let is_long = usize::from(effort >= 6);
        let (last_rate, relocated_share, decay) = if is_exact {
            (LAST_RATE, RELOCATED_SHARE, None)
        } else {
            (BASE_LAST_RATES[is_long], BASE_RELOCATED_SHARES[is_long], Some(BASE_DECAY))
        };
        Plan { iterations, relocate_every, sweeps, freezing: 0, half, last_rate, relocated_share, decay, ..self }
    }

    /// Returns the schedule for a file without a detail layer.
    pub(crate) fn alone(self, effort: u8, tune: Tune) -> Self {
        let is_late = tune == Tune::Psnr || effort < MIN_PERCEPTUAL_HALF_EFFORT;
        Plan { half: Some(HALF[usize::from(is_late)]), ..self }
    }

    /// Returns the schedule of a float fit of `iterations` steps, without freezing or sweeps.
    pub(crate) fn steps(iterations: u32, seed: u64) -> Self {
        Plan {
            iterations,
            freezing: 0,
            sweeps: 0,
            relocate_every: (iterations / 24).clamp(8, MAX_RELOCATION_INTERVAL),
            pace: Pace::Steady,
            fit_deadline: None,
            deadline: None,
            enough: 0.0,
            rate: 1.0,
            last_rate: LAST_RATE,
            relocated_share: RELOCATED_SHARE,
            decay: None,
            reweighs: false,
            half: None,
            by: 1,
            seed,
            initial: Vec::new(),
            rung: Rung::default(),
        }
    }

    /// Returns the schedule of a float fit with a fraction of the steps and of the remaining time.
    pub(crate) fn part(&self, share: f32) -> Self {
        let now = Instant::now();
        let fit_deadline = self.fit_deadline.map(|end| now + end.saturating_duration_since(now).mul_f32(share));
        let steps = Plan::steps((self.iterations as f32 * share) as u32, self.seed);
        Plan { fit_deadline, relocate_every: steps.relocate_every, iterations: steps.iterations, ..self.clone() }
    }

    /// Returns the fraction of the time budget that is used up; 0 without a budget.
    pub(crate) fn spent(&self, since: Instant) -> f32 {
        match self.fit_deadline {
            Some(end) => {
                let all = end.saturating_duration_since(since).as_secs_f32().max(1e-3);
                (since.elapsed().as_secs_f32() / all).min(1.0)
            }
            None => 0.0,
        }
    }

    pub(crate) fn is_fit_over(&self) -> bool {
        self.fit_deadline.is_some_and(|d| Instant::now() >= d)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_are_downscaled_only_while_each_primitive_has_enough_pixels() {
        let sizes =
            [(393_216, 2000, 1), (2_400_000, 2000, 2), (9_599_999, 2000, 2), (9_600_000, 2000, 4), (1 << 40, 0, 4)];
        for (pixels, count, by) in sizes {
            assert_eq!(fraction(pixels, count), by, "{pixels} pixels, {count} primitives");
        }
    }

    #[test]
    fn fits_under_a_layer_are_longest_for_squared_error_in_large_files() {
        let steps = |effort, tune, ratio| {
            let plan = Plan::new(effort, 2000, 393_216, None, 0);
            plan.for_base(effort, tune, ratio, 1.0).iterations
        };
        for (ratio, extra) in [(20.0, 2.5), (31.6, 1.58), (50.0, 1.0), (100.0, 1.0)] {
            let [usual, asked] = [None, Some(ratio)].map(|ratio| steps(5, Tune::Psnr, ratio) as f32);
            assert!((asked / usual - extra).abs() < 0.01, "{asked} steps at a ratio of {ratio}, {usual} without one");
            assert_eq!(steps(5, Tune::Iq, Some(ratio)), steps(5, Tune::Iq, None));
        }
    }
}
