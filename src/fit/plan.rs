//! How much work a fit spends: iterations, sampled rows and sweeps.

use std::time::Duration;

use crate::constants::fit;
use crate::effort::{BaseFitSettings, FitSettings, HalfSize, Reduction};
use crate::fit::method::FitMethod;
use crate::fit::model::drawing::project::Primitive;
use crate::instant::Instant;
use crate::options::{Rung, Tune};
use crate::strict_math::StrictMath;

/// The schedule of one encode.
#[derive(Debug, Clone)]
pub(crate) struct Plan {
    /// Gradient steps of the float fit.
    pub iterations: u32,
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
    /// Method whose start is used instead of that of this crate.
    pub start_of: Option<&'static dyn FitMethod>,
}

/// Returns the factor, a power of two, by which a picture of `pixels` pixels may be downscaled while `count` primitives
/// are fitted to it under a detail layer.
pub(crate) fn reduction(settings: &Reduction, pixels: u64, count: usize) -> u32 {
    let ([small, large], [least, most]) = (fit::REDUCTION_PIXELS, settings.min_pixels_each);
    let share = ((pixels as f64 / small).strict_ln() / (large / small).strict_ln()).clamp(0.0, 1.0);
    let min_pixels_each = least * (most / least).strict_powf(share);
    let pixels_each = pixels as f64 / count.max(1) as f64;
    let mut by = 1;
    while by < settings.max_factor && pixels_each / f64::from(4 * by * by) >= min_pixels_each {
        by *= 2;
    }
    by
}

/// Returns the factor on the iterations for squared error in a file of the given ratio.
fn fine_step_factor(ratio: f64) -> f32 {
    let [fine, coarse] = fit::EXACT_FIT_RATIOS;
    let share = ((coarse / ratio).strict_ln() / (coarse / fine).strict_ln()).clamp(0.0, 1.0);
    fit::MAX_EXACT_FIT_FACTOR.strict_powf(share as f32)
}

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
    /// Returns the schedule for `count` primitives on `pixels` pixels. Fewer primitives cost less per step and need more
    /// steps to find their places.
    pub(crate) fn new(settings: &FitSettings, count: usize, pixels: u64, time: Option<Duration>, seed: u64) -> Self {
        let is_dense = count >= fit::BRISK_COUNT;
        let density = count.max(1) as f32 / fit::REFERENCE_COUNT;
        let exponent = if density < 1.0 { fit::SPARSE_EXPONENT } else { settings.dense_exponent };
        let patience = density.strict_powf(exponent).clamp(fit::DENSITY_FACTORS[0], fit::DENSITY_FACTORS[1]);
        let share = |from: f32, to: f32| ((count as f32 - from) / (to - from)).clamp(0.0, 1.0);
        let [none, all, still_all, no_more] = fit::EXTRA_COUNTS;
        let extra = match pixels < fit::LARGE_PIXELS {
            true => fit::EXTRA_ITERATIONS * share(none, all) * share(no_more, still_all),
            false => 0.0,
        };
        let iterations = (settings.iterations[usize::from(is_dense)] * patience * (1.0 + extra)) as u32;
        let sweeps = settings.sweeps[fit::SWEEP_COUNTS.iter().filter(|&&limit| count >= limit).count()];
        let now = Instant::now();
        let deadline = time.and_then(|t| now.checked_add(t));
        let fit_deadline = time.and_then(|t| now.checked_add(t.mul_f64(fit::FIT_TIME_SHARE)));
        let pace = if is_dense { Pace::Brisk } else { Pace::Steady };
        Plan { sweeps, pace, fit_deadline, deadline, ..Plan::steps(iterations, seed) }
    }

    /// Returns the schedule for primitives under a detail layer, which corrects what a short fit leaves. `ratio` is
    /// that of the complete file. Without it, the fit is that of small files. `patience` is a factor on the iterations
    /// with perceptual tuning.
    pub(crate) fn for_base(self, settings: &BaseFitSettings, tune: Tune, ratio: Option<f64>, patience: f32) -> Self {
        let is_exact = tune == Tune::Psnr;
        let share = match ratio {
            _ if !is_exact => settings.iterations * patience,
            Some(ratio) if settings.is_longer_in_large_files => settings.exact_iterations * fine_step_factor(ratio),
            _ => settings.exact_iterations,
        };
        let iterations = (self.iterations as f32 * share) as u32;
        let relocate_every = match is_exact {
            true => Plan::steps(iterations, self.seed).relocate_every,
            false => (iterations / fit::MAX_BASE_RELOCATIONS)
                .clamp(fit::MIN_BASE_RELOCATION_INTERVAL, fit::MAX_RELOCATION_INTERVAL),
        };
        let [few, many, exact] = settings.sweeps;
        let sweeps = self.sweeps.min(match self.pace {
            _ if is_exact => exact,
            Pace::Steady => few,
            Pace::Brisk => many,
        });
        let (last_rate, relocated_share, decay) = if is_exact {
            (fit::LAST_RATE, fit::RELOCATED_SHARE, None)
        } else {
            (settings.last_rate, settings.relocated_share, Some(fit::BASE_DECAY))
        };
        let half = settings.half;
        Plan { iterations, relocate_every, sweeps, half, last_rate, relocated_share, decay, ..self }
    }

    /// Returns the schedule for a file without a detail layer.
    pub(crate) fn alone(self, settings: &FitSettings, tune: Tune) -> Self {
        Plan { half: Some(if tune == Tune::Psnr { HalfSize::LATE } else { settings.half }), ..self }
    }

    /// Returns the schedule of a float fit of `iterations` steps, without sweeps.
    pub(crate) fn steps(iterations: u32, seed: u64) -> Self {
        Plan {
            iterations,
            sweeps: 0,
            relocate_every: (iterations / 24).clamp(8, fit::MAX_RELOCATION_INTERVAL),
            pace: Pace::Steady,
            fit_deadline: None,
            deadline: None,
            enough: 0.0,
            rate: 1.0,
            last_rate: fit::LAST_RATE,
            relocated_share: fit::RELOCATED_SHARE,
            decay: None,
            reweighs: false,
            half: None,
            by: 1,
            seed,
            initial: Vec::new(),
            rung: Rung::default(),
            start_of: None,
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
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effort::EffortSettings;

    #[test]
    fn pictures_are_downscaled_only_while_each_primitive_has_enough_pixels() {
        let sizes = [
            (1, [(393_216, 2000, 2), (393_216, 300, 8)]),
            (5, [(393_216, 400, 1), (393_216, 300, 2)]),
            (5, [(1_049_000, 1500, 2), (1_049_000, 2000, 1)]),
            (5, [(2_800_000, 9300, 2), (2_800_000, 9400, 1)]),
            (5, [(2_400_000, 1000, 4), (1 << 40, 0, 4)]),
        ];
        for (effort, cases) in sizes {
            let settings = EffortSettings::from_preset(effort).fit.base.reduction;
            for (pixels, count, by) in cases {
                let found = reduction(&settings, pixels, count);
                assert_eq!(found, by, "{pixels} pixels, {count} primitives, effort {effort}");
            }
        }
    }

    #[test]
    fn fits_under_a_layer_are_longest_for_squared_error_in_large_files() {
        let steps = |effort, tune, ratio| {
            let settings = EffortSettings::from_preset(effort).fit;
            let plan = Plan::new(&settings, 2000, 393_216, None, 0);
            plan.for_base(&settings.base, tune, ratio, 1.0).iterations
        };
        for (ratio, extra) in [(20.0, 2.5), (31.6, 1.58), (50.0, 1.0), (100.0, 1.0)] {
            let [usual, asked] = [None, Some(ratio)].map(|ratio| steps(5, Tune::Psnr, ratio) as f32);
            assert!((asked / usual - extra).abs() < 0.01, "{asked} steps at a ratio of {ratio}, {usual} without one");
            assert_eq!(steps(5, Tune::Iq, Some(ratio)), steps(5, Tune::Iq, None));
        }
    }
}
