//! How much work a fit spends: iterations, sampled rows, sweeps.

use std::time::Duration;

use crate::fit::model::drawing::project::Primitive;
use crate::fit::model::problem::LARGE_PIXELS;
use crate::instant::Instant;
use crate::options::{Rung, Tune};
use crate::strict_math::StrictMath;

/// Share of a time budget that the float fit may take.
const FIT_SHARE: f64 = 0.75;

/// Shares of the steps that primitives get which a detail layer is laid over, up to effort 6 and from 7 on: for eyes, and for the least
/// squared error. Kodak at effort 5: with .6 for eyes files are .05 points of SSIMULACRA2 better at 20 and .1 at 50, and take a fifth more
/// time; with 1 for squared error .06 dB at 20 and at 50, and half as much time again.
const BASE_STEPS: [f32; 2] = [0.35, 0.6];
const EXACT_BASE_STEPS: [f32; 2] = [0.5, 1.0];
/// The same at effort 1, whatever is favoured.
const HASTY_BASE_STEPS: f32 = 0.25;
/// How many times as many steps there are for squared error in a file of ratio 20, up to effort 6: they win .09 dB there, and an encode takes nearly
/// twice the time. At 50 they would win as much for as much, and are left to higher efforts.
const FINE_BASE_STEPS: f32 = 2.5;
/// Ratios at which there are as many more, and no more; between them the number goes with the logarithm of the ratio.
const FINE_RATIOS: [f64; 2] = [20.0, 50.0];
/// Relocations of such primitives at most, and the steps between them at least, where eyes are favoured.
const BASE_RELOCATIONS: u32 = 16;
const BASE_RELOCATED: u32 = 10;

/// Pixels of a smaller picture for each primitive, at least, that primitives are fitted to which a detail layer is laid over.
const ROOM: f64 = 300.0;
/// How many times smaller that picture may be.
const MOST_SHRUNK: u32 = 4;
/// First steps that see half the size at effort 1, if Gaussians span several pixels.
const HASTY_BASE_HALF: HalfSize = HalfSize { share: 0.7, row_step: 3 };
/// The same of primitives that no layer is laid over, for eyes, and for the least squared error. Twelve pictures of Kodak at 200, for eyes: .92 of the
/// CPU time, .2 points of SSIMULACRA2 more and .1 dB less; at 500 and 1000 .8 of the time and .5 and .3 points more. Eight of them for
/// squared error: .7 of the time and .01 dB less at 500 and 1000; at 200, where it would lose .08 dB, they see the whole.
const HALF: [HalfSize; 2] = [HalfSize { share: 0.5, row_step: 3 }, HalfSize { share: 0.5, row_step: 6 }];
/// The least effort at which the first of them holds: at effort 1 and 200 it would lose .8 points for nothing.
const HALF_FOR_EYES: u8 = 3;

/// Step sizes at the end of a fit, in units of those at the start.
pub(crate) const LAST_RATE: f32 = 0.02;
/// The same for primitives that a detail layer is laid over where eyes are favoured, up to effort 3, and from 4 on. A sweep over the integers
/// follows, which ends what such steps leave: Kodak at 50 gains .6 points of SSIMULACRA2 at effort 1 and .3 at 5 by these and [`BASE_MOVED`].
const BASE_LAST_RATES: [f32; 2] = [0.2, 0.1];
/// Share of the primitives that may be relocated at a time, at a steady pace.
const MOVED: f32 = 0.1;
/// The same for primitives that a detail layer is laid over where eyes are favoured, up to effort 3, and from 4 on: they are relocated more rarely.
const BASE_MOVED: [f32; 2] = [0.35, 0.25];

/// Steps between relocations at most.
const LONGEST_WAIT: u32 = 25;

/// Primitives of the largest pictures.
const HUGE_COUNT: usize = 300_000;

/// First steps that see a picture at half its size.
#[derive(Debug, Clone, Copy)]
pub(crate) struct HalfSize {
    /// Share of the steps.
    pub share: f32,
    /// Distance of sampled rows from which on they do: Gaussians span several pixels then.
    pub row_step: u32,
}

/// The schedule of one encode.
#[derive(Debug, Clone)]
pub(crate) struct Plan {
    /// Gradient steps of the float fit.
    pub iterations: u32,
    /// Gradient steps while primitives freeze on their lattice; the descent alone comes within 0.05 dB of it.
    pub freezing: u32,
    /// Most sweeps of descent over the integers.
    pub sweeps: u32,
    /// Iterations between relocations.
    pub relocate_every: u32,
    /// How fast the optimizer forgets, and how many primitives are relocated when.
    pub pace: Pace,
    /// When the float fit should be through.
    pub fit_deadline: Option<Instant>,
    /// When to stop, whatever is left.
    pub deadline: Option<Instant>,
    /// Mean squared error of a sample at which the float fit is through, whatever is left.
    pub enough: f64,
    /// Factor of the optimizer's steps; other than 1 only in tests of stability.
    pub rate: f32,
    /// Step sizes at the end, in units of those at the start.
    pub last_rate: f32,
    /// Share of the primitives that may be relocated at a time, at a steady pace.
    pub moved: f32,
    /// Whether the pixels are weighed anew on the way, by what the picture lacks.
    pub reweighs: bool,
    /// Which first steps see a picture at half its size that is not large; none: no steps.
    pub half: Option<HalfSize>,
    /// How many times smaller the picture is that all steps see: a power of two.
    pub by: u32,
    /// Seed of everything random.
    pub seed: u64,
    /// Primitives of a fit of fewer that this one goes on from; none: it starts by itself.
    pub initial: Vec<Primitive>,
    /// Where an ablation stops.
    pub rung: Rung,
}

/// Returns how many times smaller a picture of so many pixels may be while `count` primitives are fitted to it, for a detail layer to be
/// laid over them: a power of two.
pub(crate) fn fraction(pixels: u64, count: usize) -> u32 {
    let room = pixels as f64 / count.max(1) as f64;
    let mut by = 1;
    while by < MOST_SHRUNK && room / f64::from(4 * by * by) >= ROOM {
        by *= 2;
    }
    by
}

/// Returns how many times as many steps the primitives of a file of such a ratio get, where squared error is favoured.
fn finer(ratio: f64) -> f32 {
    let [fine, coarse] = FINE_RATIOS;
    let share = ((coarse / ratio).strict_ln() / (coarse / fine).strict_ln()).clamp(0.0, 1.0);
    FINE_BASE_STEPS.strict_powf(share as f32)
}

/// Primitives from which on a fit goes at a brisk pace.
const DENSE: usize = 4000;

/// How fast the optimizer forgets, and how many primitives are relocated when.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Pace {
    /// For few primitives, each of which matters to the end: long memory, a tenth relocated each time, for long.
    Steady,
    /// For many: moments that forget sooner in short fits; a fifth relocated at first, fewer and fewer later.
    Brisk,
}

impl Plan {
    /// Returns the schedule for `effort`, which is within `1..=9`, and `count` primitives on so many pixels: fewer cost
    /// less, and need more steps to find their places.
    pub(crate) fn new(effort: u8, count: usize, pixels: u64, time: Option<Duration>, seed: u64) -> Self {
        let level = usize::from(effort) - 1;
        // Many primitives: two thirds of the steps that few of them would get bring as much, since the moments forget
        // sooner, and many primitives move at first. `--example effort_table` measures it.
        let is_dense = count >= DENSE;
        let base = match is_dense {
            true => [57.0, 94.0, 165.0, 280.0, 500.0, 750.0, 1310.0, 2250.0, 3750.0f32][level],
            false => [66.0, 130.0, 220.0, 350.0, 590.0, 880.0, 1540.0, 2640.0, 4400.0f32][level],
        };
        let crowd = count.max(1) as f32 / 5500.0;
        // In a short fit of a large picture a step brings more than the sweep that would do its work.
        let haste = match level {
            0..3 => -0.1,
            3 => -0.2,
            _ => -0.3,
        };
        let patience = crowd.strict_powf(if crowd < 1.0 { -0.95 } else { haste }).clamp(0.25, 9.0);
        // On small pictures it takes only seconds to get the tenth of a decibel that half as many again win.
        let share = |from: f32, to: f32| ((count as f32 - from) / (to - from)).clamp(0.0, 1.0);
        let more = if pixels < LARGE_PIXELS { 0.5 * share(8000.0, 12_000.0) * share(40_000.0, 25_000.0) } else { 0.0 };
        let iterations = (base * patience * (1.0 + more)) as u32;
        // Small pictures can afford more; the first sweeps bring most.
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

    /// Returns the schedule of `effort` for primitives that a detail layer is laid over: it mends what a short fit leaves. `ratio` is that of
    /// the file of both; without it the fit is as for small files.
    pub(crate) fn for_base(self, effort: u8, tune: Tune, ratio: Option<f64>) -> Self {
        let is_exact = tune == Tune::Psnr;
        let share = match (effort, is_exact) {
            (1, _) => HASTY_BASE_STEPS,
            (2..7, true) => EXACT_BASE_STEPS[0] * ratio.map_or(1.0, finer),
            (_, true) => EXACT_BASE_STEPS[1],
            (2..7, false) => BASE_STEPS[0],
            (_, false) => BASE_STEPS[1],
        };
        let iterations = (self.iterations as f32 * share) as u32;
        let relocate_every = match is_exact {
            true => Plan::steps(iterations, self.seed).relocate_every,
            false => (iterations / BASE_RELOCATIONS).clamp(BASE_RELOCATED, LONGEST_WAIT),
        };
        let sweeps = self.sweeps.min(match effort {
            1 => 1,
            2..7 if !is_exact => 2,
            // Beside longer fits the third wins another .01 dB.
            _ => 3,
        });
        let half = (effort == 1).then_some(HASTY_BASE_HALF);
        let is_long = usize::from(effort >= 4);
        let (last_rate, moved) =
            if is_exact { (LAST_RATE, MOVED) } else { (BASE_LAST_RATES[is_long], BASE_MOVED[is_long]) };
        Plan { iterations, relocate_every, sweeps, freezing: 0, half, last_rate, moved, ..self }
    }

    /// Returns the schedule of `effort` for primitives that nothing is laid over.
    pub(crate) fn alone(self, effort: u8, tune: Tune) -> Self {
        let is_late = tune == Tune::Psnr || effort < HALF_FOR_EYES;
        Plan { half: Some(HALF[usize::from(is_late)]), ..self }
    }

    /// Returns the schedule of a float fit of `iterations` steps, and nothing after it.
    pub(crate) fn steps(iterations: u32, seed: u64) -> Self {
        Plan {
            iterations,
            freezing: 0,
            sweeps: 0,
            relocate_every: (iterations / 24).clamp(8, LONGEST_WAIT),
            pace: Pace::Steady,
            fit_deadline: None,
            deadline: None,
            enough: 0.0,
            rate: 1.0,
            last_rate: LAST_RATE,
            moved: MOVED,
            reweighs: false,
            half: None,
            by: 1,
            seed,
            initial: Vec::new(),
            rung: Rung::default(),
        }
    }

    /// Returns the schedule of a float fit that takes such a part of the steps, and of the time that is left for them.
    pub(crate) fn part(&self, share: f32) -> Self {
        let now = Instant::now();
        let fit_deadline = self.fit_deadline.map(|end| now + end.saturating_duration_since(now).mul_f32(share));
        let steps = Plan::steps((self.iterations as f32 * share) as u32, self.seed);
        Plan { fit_deadline, relocate_every: steps.relocate_every, iterations: steps.iterations, ..self.clone() }
    }

    /// Returns the share of the time budget that is gone, 0 without one.
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

    /// Tells whether the time is over before work that takes `next` is through.
    pub(crate) fn is_over(&self, next: Duration) -> bool {
        self.deadline.is_some_and(|d| d.saturating_duration_since(Instant::now()) <= next)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn few_primitives_are_fitted_to_a_picture_that_leaves_each_enough_pixels() {
        let sizes =
            [(393_216, 2000, 1), (2_400_000, 2000, 2), (9_599_999, 2000, 2), (9_600_000, 2000, 4), (1 << 40, 0, 4)];
        for (pixels, count, by) in sizes {
            assert_eq!(fraction(pixels, count), by, "{pixels} pixels, {count} primitives");
        }
    }

    #[test]
    fn fits_under_a_layer_are_longest_where_squared_error_is_to_be_small_in_large_files() {
        let steps = |effort, tune, ratio| {
            let plan = Plan::new(effort, 2000, 393_216, None, 0);
            plan.for_base(effort, tune, ratio).iterations
        };
        for (ratio, more) in [(20.0, 2.5), (31.6, 1.58), (50.0, 1.0), (100.0, 1.0)] {
            let [usual, asked] = [None, Some(ratio)].map(|ratio| steps(5, Tune::Psnr, ratio) as f32);
            assert!((asked / usual - more).abs() < 0.01, "{asked} steps at {ratio}, {usual} else");
            assert_eq!(steps(5, Tune::Iq, Some(ratio)), steps(5, Tune::Iq, None));
        }
    }
}
