//! From fitted floats to integers of a requested file size: rounds of descent over the integers and corrections of the
//! number of primitives.

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

// `cargo run --release -p ssplat-lab --example rate_distortion -- PICTURES` measures the effect of other values of
// these constants, and the example `tiny_files` does so for small files.

/// Squared error that a bit must save, relative to the mean squared error per bit: the slope of the rate–distortion
/// curve, where doubling the bytes gains two to three decibels.
pub(crate) const SLOPE: f64 = 0.7;
/// Minimum number of sweeps from which the rounds are counted. One lets the integers settle, and one shows that they
/// have.
const MIN_SWEEPS: u32 = 2;
/// Rounds after the last planned sweep in which the file may still be brought to its size. One or two are usually
/// enough.
const EXTRA_ROUNDS: u32 = 6;
/// Number of rounds before the last planned sweep from which on the size is corrected. The remaining sweeps settle what
/// was added. Earlier, each sweep shortens the file by more than a correction would.
const CORRECTION_ROUNDS: u32 = 3;
/// A sweep that lowers the objective by a smaller share of the error is quiet: it has found almost nothing.
const QUIET_GAIN: f64 = 2e-4;
/// Number of consecutive quiet sweeps that end the descent. A single one may be caused by a correction of the size.
const QUIET_SWEEPS: u32 = 2;
/// A file is settled if it is below its size by at most one part in this many, or by a few bytes.
const SETTLED_PART: u64 = 400;
/// After the last planned sweep, a file that is too long is cut to one part in this many below its size, because each
/// sweep may lengthen it slightly again.
const MARGIN_PART: u64 = 1000;
/// Share of a file's bytes that the first sweep is expected to save: 1 to 3.5 % on photographs of 0.4 to 14 megapixels.
const FIRST_SHRINK: f64 = 0.02;
/// Savings of a sweep relative to those of the previous one: 0.3 to 0.7 on the same photographs.
const SHRINK_DECAY: f64 = 0.45;
/// A file fills its size if it is below it by at most one part in this many, or by [`FILLED_BYTES`].
const FILLED_PART: u64 = 50;
/// Bytes by which a file that fills its size may always be too short: about ten primitives.
const FILLED_BYTES: u64 = 40;

/// A rounding job: the problem, the layout, the size to reach and the schedule.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Rounding<'a> {
    pub problem: Problem<'a>,
    pub layout: Layout,
    pub size: Size,
    pub plan: &'a Plan,
}

/// The caller, which writes the file and knows its length.
pub(crate) trait Client {
    /// Called before every round with the fraction of the work that is done (0..=1). An error stops the rounding.
    fn step(&mut self, done: f32, now: &mut dyn Snapshot) -> Result<()>;
    /// Returns the length of the file with these integers. May sort them into the order of the file.
    fn bytes(&mut self, rounded: &mut Rounded) -> Result<u64>;
    /// Returns the coder's prediction for each primitive, or nothing. May sort the primitives into the order of the
    /// file.
    fn expected(&mut self, rounded: &mut Rounded) -> Result<Vec<PredictedCost>>;
}

/// The result of rounding.
#[derive(Debug)]
pub(crate) struct Finished {
    pub rounded: Rounded,
    /// Squared error of the primitives before rounding.
    pub float_error: f64,
}

/// Rounds the primitives of `state` and refines the integers until the file has the requested size.
///
/// # Errors
/// Returns an error of the client.
pub(crate) fn finish(task: &Rounding<'_>, mut state: State, client: &mut dyn Client) -> Result<Finished> {
    let Rounding { problem, layout, plan, .. } = *task;
    let float_error = float_error(&problem, &state.primitives);
    let mut rounded = Rounded::of_error(&problem, layout, &state.primitives, float_error);
    let quantizer = quantizer(&problem, layout, &rounded.steps);
    // From here on, the background is that of the file.
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
        expected_bytes: 0.0,
        shrink: FIRST_SHRINK,
    }
    .run(client)?;
    Ok(Finished { rounded, float_error })
}

/// The state of the descent from round to round.
struct Rounds<'a> {
    task: &'a Rounding<'a>,
    quantizer: &'a Quantizer,
    descent: Descent<'a>,
    rounded: Rounded,
    best: Option<Best>,
    /// Number of consecutive quiet sweeps.
    quiet: u32,
    /// Expected bytes of the file before the last sweep.
    expected_bytes: f64,
    /// Share of the bytes that the next sweep is expected to save.
    shrink: f64,
}

impl Rounds<'_> {
    fn run(mut self, client: &mut dyn Client) -> Result<Rounded> {
        let Rounding { size, plan, .. } = *self.task;
        let mut bytes = client.bytes(&mut self.rounded)?;
        self.expected_bytes = bytes as f64;
        let rounds = plan.sweeps.max(MIN_SWEEPS) + EXTRA_ROUNDS;
        // Duration of a round, if it is known yet.
        let mut round_time = Duration::ZERO;
        for round in 0..rounds {
            let start = Instant::now();
            self.report(round as f32 / rounds as f32, client)?;
            let is_late = plan.is_over(round_time);
            if size == Size::Free && (is_late || round >= plan.sweeps || self.quiet >= QUIET_SWEEPS) {
                break;
            }
            let error = self.descent.error(&self.rounded.gaussians);
            if let Size::Bytes(max_bytes) = size
                && self.fits(round, error, (bytes, max_bytes), is_late)
            {
                break;
            }
            // When the time is up, only the size is still corrected.
            if !is_late && plan.rung >= Rung::Descent {
                let expected = client.expected(&mut self.rounded)?;
                self.sweep(&expected, error, bytes);
            }
            bytes = client.bytes(&mut self.rounded)?;
            self.shrink = SHRINK_DECAY * (1.0 - bytes as f64 / self.expected_bytes).max(0.0);
            self.expected_bytes = bytes as f64;
            if !is_late {
                round_time = start.elapsed();
            }
        }
        match size {
            Size::Bytes(max_bytes) => self.within(bytes, max_bytes, client),
            Size::Free => Ok(self.rounded),
        }
    }

    fn report(&self, done: f32, client: &mut dyn Client) -> Result<()> {
        let problem = &self.descent.problem;
        let project = || projected(self.quantizer, &self.rounded.gaussians, problem.scene.height);
        client.step(0.5 + 0.5 * done, &mut StaticSnapshot { problem, project: &project })
    }

    /// Returns whether a file of `bytes` is good enough for `max_bytes`, and corrects its size when that is due.
    fn fits(&mut self, round: u32, error: f64, (bytes, max_bytes): (u64, u64), is_late: bool) -> bool {
        let plan = self.task.plan;
        self.keep(error, bytes, max_bytes);
        if is_late && self.best.as_ref().is_some_and(|b| b.fills_size) {
            return true;
        }
        let is_settled = is_settled(bytes, max_bytes, SETTLED_PART);
        if is_settled && (round >= plan.sweeps || self.quiet >= QUIET_SWEEPS) {
            return true;
        }
        if !is_settled && (is_late || round + CORRECTION_ROUNDS >= plan.sweeps) {
            let max_bytes = if round >= plan.sweeps { max_bytes - max_bytes / MARGIN_PART } else { max_bytes };
            // The savings of the next sweep are used now, because a correction after each sweep would cost another pass
            // over the whole picture.
            let taken = if is_late { 0.0 } else { self.shrink * max_bytes as f64 };
            let max_bytes = max_bytes + taken as u64;
            resize(&mut self.descent, &mut self.rounded.gaussians, bytes, max_bytes);
            self.expected_bytes = max_bytes as f64;
        }
        false
    }

    /// Sweeps once over the integers of a file of `bytes` bytes.
    fn sweep(&mut self, expected: &[PredictedCost], error: f64, bytes: u64) {
        let bits = 8.0 * bytes as f64;
        let lambda = (SLOPE * error / bits) as f32;
        let swept = self.descent.sweep(&mut self.rounded.gaussians, expected, lambda);
        self.quiet = if swept < QUIET_GAIN * error { self.quiet + 1 } else { 0 };
    }

    /// Returns the best integers whose file takes at most `max_bytes`. The current ones take `bytes`.
    fn within(mut self, mut bytes: u64, max_bytes: u64, client: &mut dyn Client) -> Result<Rounded> {
        let error = self.descent.error(&self.rounded.gaussians);
        self.keep(error, bytes, max_bytes);
        if let Some(best) = self.best {
            return Ok(Rounded { gaussians: best.gaussians, ..self.rounded });
        }
        while bytes > max_bytes && !self.rounded.gaussians.is_empty() {
            resize(&mut self.descent, &mut self.rounded.gaussians, bytes, max_bytes);
            bytes = client.bytes(&mut self.rounded)?;
        }
        Ok(self.rounded)
    }

    /// Keeps the current integers if they are the best so far.
    fn keep(&mut self, error: f64, bytes: u64, max_bytes: u64) {
        let Some(unused) = max_bytes.checked_sub(bytes) else { return };
        let fills_size = unused <= (max_bytes / FILLED_PART).max(FILLED_BYTES);
        if self.best.as_ref().is_none_or(|b| (fills_size, b.error) > (b.fills_size, error)) {
            self.best = Some(Best { fills_size, error, gaussians: self.rounded.gaussians.clone() });
        }
    }
}

/// The best integers so far whose file is not too large.
struct Best {
    /// Whether the file fills its size, which takes precedence over the error.
    fills_size: bool,
    error: f64,
    gaussians: Vec<PackedGaussian>,
}
