//! From fitted floats to integers of an asked size: rounds of descent over the integers and corrections of their number.

use std::time::Duration;

use crate::bitstream::coder::expect::PredictedCost;
use crate::bitstream::splats::{Layout, PackedGaussian};
use crate::error::Result;
use crate::fit::engine::{Snapshot, StaticSnapshot};
use crate::fit::model::drawing::field::float_error;
use crate::fit::model::problem::{Problem, Scene};
use crate::fit::plan::Plan;
use crate::fit::state::State;
use crate::instant::Instant;
use crate::options::Rung;
use crate::quantize::Quantizer;
use crate::round::descend::Descent;
use crate::round::freeze;
use crate::round::rounded::{Rounded, projected, quantizer};
use crate::round::size::{Size, is_settled, resize};

// What other values of these would win or lose is measured by
// `cargo run --release -p ssplat-lab --example rate_distortion -- PICTURES`, small files by the example `tiny_files`.

/// Squared error that a bit must save, in units of the mean squared error per bit: the slope of the rate–distortion
/// curve, where doubling the bytes wins two to three decibels.
pub(crate) const SLOPE: f64 = 0.7;
/// Least number of sweeps that the rounds are counted from: one lets the integers find each other, one shows that they have.
const LEAST_SWEEPS: u32 = 2;
/// Rounds after the last planned sweep in which a file may still be brought to its size: it takes one or two.
const EXTRA_ROUNDS: u32 = 6;
/// The size is corrected from so many rounds before the last planned sweep on: the sweeps that are left settle what was
/// added. Before that each sweep shortens the file by more than a correction would.
const CORRECTING: u32 = 3;
/// A sweep that lowers the objective by a smaller share of the error has found next to nothing.
const QUIET: f64 = 2e-4;
/// So many quiet sweeps one after the other end the descent: one alone may be due to a correction of the size.
const QUIET_SWEEPS: u32 = 2;
/// A file is settled when it falls short of its size by at most this part of it, or by some bytes.
const SETTLED: u64 = 400;
/// After the last planned sweep a file that is too long is cut to this part below its size: each sweep may make it longer
/// by a little again.
const MARGIN: u64 = 1000;
/// Share of a file's bytes that the first sweep is expected to take: 1 to 3.5 % on photographs of .4 to 14 megapixels.
const FIRST_SHRINK: f64 = 0.02;
/// Share of what a sweep took that the next one is expected to take: .3 to .7 on the same.
const FADE: f64 = 0.45;
/// A file fills its size when it falls short by at most this part of it, or by [`FILLED_BYTES`].
const FILLED: u64 = 50;
/// Bytes that a file which fills its size may always be short: some ten primitives.
const FILLED_BYTES: u64 = 40;

/// A fit to round, and the size to reach.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Rounding<'a> {
    pub problem: Problem<'a>,
    pub layout: Layout,
    pub size: Size,
    pub plan: &'a Plan,
}

/// The side that makes a file of the integers, and knows its length.
pub(crate) trait Client {
    /// Is called before every round with the share of the work that is done (0..=1). An error stops the rounding.
    fn step(&mut self, done: f32, now: &mut dyn Snapshot) -> Result<()>;
    /// Returns the length of the file with these integers, which may be brought into the order of the file.
    fn bytes(&mut self, rounded: &mut Rounded) -> Result<u64>;
    /// Returns what the coder of that file expects of each primitive, or nothing; they may be brought into the file's order.
    fn expected(&mut self, rounded: &mut Rounded) -> Result<Vec<PredictedCost>>;
}

/// The result of rounding.
#[derive(Debug)]
pub(crate) struct Finished {
    pub rounded: Rounded,
    /// Squared error of the floats.
    pub float_error: f64,
}

/// Rounds the primitives of `state` and refines the integers until the file has its size.
///
/// # Errors
/// Returns an error of the client.
pub(crate) fn finish(task: &Rounding<'_>, mut state: State, client: &mut dyn Client) -> Result<Finished> {
    let Rounding { problem, layout, plan, .. } = *task;
    let float_error = float_error(&problem, &state.primitives);
    let mut rounded = Rounded::of_error(&problem, layout, &state.primitives, float_error);
    let quantizer = quantizer(&problem, layout, &rounded.steps);
    // From here on the background is the one that the file will have.
    let background = quantizer.dequantize_color(rounded.background);
    let problem = Problem { scene: Scene { background, ..problem.scene }, ..problem };
    let descends = plan.rung >= Rung::Descent;
    if descends && plan.freezing > 0 && !plan.is_fit_over() {
        freeze::freeze(&problem, &mut state, &quantizer, plan, &mut |done, now| client.step(0.5 * done, now))?;
        rounded.round(&quantizer, &state.primitives);
    }
    let field = std::mem::take(&mut state.field);
    drop(state);
    let descent = Descent::new(problem, &quantizer, field);
    let rounded = Rounds {
        task,
        quantizer: &quantizer,
        descent,
        rounded,
        best: None,
        quiet: 0,
        aimed: 0.0,
        shrink: FIRST_SHRINK,
    }
    .run(client)?;
    Ok(Finished { rounded, float_error })
}

/// Rounds of descent on their way.
struct Rounds<'a> {
    task: &'a Rounding<'a>,
    quantizer: &'a Quantizer,
    descent: Descent<'a>,
    rounded: Rounded,
    best: Option<Best>,
    /// Quiet sweeps, one after the other.
    quiet: u32,
    /// Bytes of the file before the last sweep, as far as they were known.
    aimed: f64,
    /// Share of the bytes that the next sweep is expected to take.
    shrink: f64,
}

impl Rounds<'_> {
    fn run(mut self, client: &mut dyn Client) -> Result<Rounded> {
        let Rounding { size, plan, .. } = *self.task;
        let mut bytes = client.bytes(&mut self.rounded)?;
        self.aimed = bytes as f64;
        let rounds = plan.sweeps.max(LEAST_SWEEPS) + EXTRA_ROUNDS;
        // What a round takes, as far as that is known.
        let mut takes = Duration::ZERO;
        for round in 0..rounds {
            let start = Instant::now();
            self.show(round as f32 / rounds as f32, client)?;
            let error = self.descent.error(&self.rounded.gaussians);
            let is_late = plan.is_over(takes);
            let is_through = match size {
                Size::Bytes(most) => self.fits(round, error, (bytes, most), is_late),
                Size::Free => is_late || round >= plan.sweeps || self.quiet >= QUIET_SWEEPS,
            };
            if is_through {
                break;
            }
            // When the time is over only the size is still brought right.
            if !is_late && plan.rung >= Rung::Descent {
                let expected = client.expected(&mut self.rounded)?;
                self.sweep(&expected, error, bytes);
            }
            bytes = client.bytes(&mut self.rounded)?;
            self.shrink = FADE * (1.0 - bytes as f64 / self.aimed).max(0.0);
            self.aimed = bytes as f64;
            if !is_late {
                takes = start.elapsed();
            }
        }
        match size {
            Size::Bytes(most) => self.within(bytes, most, client),
            Size::Free => Ok(self.rounded),
        }
    }

    fn show(&self, done: f32, client: &mut dyn Client) -> Result<()> {
        let problem = &self.descent.problem;
        let project = || projected(self.quantizer, &self.rounded.gaussians, problem.scene.height);
        client.step(0.5 + 0.5 * done, &mut StaticSnapshot { problem, project: &project })
    }

    /// Returns whether a file of `bytes` is good enough for `most` bytes, and corrects its size where it is time to.
    fn fits(&mut self, round: u32, error: f64, (bytes, most): (u64, u64), is_late: bool) -> bool {
        let plan = self.task.plan;
        self.keep(error, bytes, most);
        if is_late && self.best.as_ref().is_some_and(|b| b.fills) {
            return true;
        }
        let is_settled = is_settled(bytes, most, SETTLED);
        if is_settled && (round >= plan.sweeps || self.quiet >= QUIET_SWEEPS) {
            return true;
        }
        if !is_settled && (is_late || round + CORRECTING >= plan.sweeps) {
            let most = if round >= plan.sweeps { most - most / MARGIN } else { most };
            // What the next sweep takes is made room for now: a correction after each costs a look at the whole picture.
            let taken = if is_late { 0.0 } else { self.shrink * most as f64 };
            let most = most + taken as u64;
            resize(&mut self.descent, &mut self.rounded.gaussians, bytes, most);
            self.aimed = most as f64;
        }
        false
    }

    /// Sweeps once over the integers of a file of so many bytes.
    fn sweep(&mut self, expected: &[PredictedCost], error: f64, bytes: u64) {
        let bits = 8.0 * bytes as f64;
        let lambda = (SLOPE * error / bits) as f32;
        let swept = self.descent.sweep(&mut self.rounded.gaussians, expected, lambda);
        self.quiet = if swept < QUIET * error { self.quiet + 1 } else { 0 };
    }

    /// Returns the best integers whose file takes at most `most` bytes; those at hand take `bytes`.
    fn within(mut self, mut bytes: u64, most: u64, client: &mut dyn Client) -> Result<Rounded> {
        let error = self.descent.error(&self.rounded.gaussians);
        self.keep(error, bytes, most);
        if let Some(best) = self.best {
            return Ok(Rounded { gaussians: best.gaussians, ..self.rounded });
        }
        while bytes > most && !self.rounded.gaussians.is_empty() {
            resize(&mut self.descent, &mut self.rounded.gaussians, bytes, most);
            bytes = client.bytes(&mut self.rounded)?;
        }
        Ok(self.rounded)
    }

    /// Keeps the integers at hand if they are the best so far.
    fn keep(&mut self, error: f64, bytes: u64, most: u64) {
        let Some(left) = most.checked_sub(bytes) else { return };
        let fills = left <= (most / FILLED).max(FILLED_BYTES);
        if self.best.as_ref().is_none_or(|b| (fills, b.error) > (b.fills, error)) {
            self.best = Some(Best { fills, error, gaussians: self.rounded.gaussians.clone() });
        }
    }
}

/// The best integers so far whose file is not too large.
struct Best {
    /// True if the file fills its size: that goes before the error.
    fills: bool,
    error: f64,
    gaussians: Vec<PackedGaussian>,
}
