//! From the fitted floats of a whole picture to integers of a requested file size.

use crate::bitstream::coder::expect::PredictedCost;
use crate::bitstream::splats::{Layout, PackedGaussian};
use crate::error::Result;
use crate::fit::engine::{Snapshot, StaticSnapshot};
use crate::fit::model::drawing::field::float_error;
use crate::fit::model::objective::rows::RowSet;
use crate::fit::model::problem::{Problem, Scene};
use crate::fit::plan::Plan;
use crate::fit::state::State;
use crate::options::Rung;
use crate::quantize::Quantizer;
use crate::rdo::descend::Descent;
use crate::rdo::rounded::{Rounded, projected, quantizer};
use crate::rdo::size::{Size, resize};
use crate::rdo::size_loop::{IntegerSet, SizeSchedule, bring_to_size};

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
    let Rounding { problem, layout, size, plan } = *task;
    let float_error = float_error(&problem, &state.primitives);
    let rounded = Rounded::of_error(&problem, layout, &state.primitives, float_error);
    let quantizer = quantizer(&problem, layout, &rounded.steps);
    // From here on, the background is that of the file.
    let background = quantizer.dequantize_color(rounded.background);
    let problem = Problem { scene: Scene { background, ..problem.scene }, ..problem };
    let descends = plan.rung >= Rung::Descent;
    let field = std::mem::take(&mut state.field);
    drop(state);
    let descent = Descent::new(problem, &quantizer, field);
    let mut integers = WholeIntegers { quantizer: &quantizer, descent, rounded, client };
    let sweeps = plan.sweeps;
    let enough = plan.enough * problem.samples(RowSet::ALL);
    bring_to_size(&mut integers, SizeSchedule { size, sweeps, descends, enough, deadline: plan.deadline })?;
    Ok(Finished { rounded: integers.rounded, float_error })
}

/// The integers of a whole picture.
struct WholeIntegers<'a> {
    quantizer: &'a Quantizer,
    descent: Descent<'a>,
    rounded: Rounded,
    client: &'a mut dyn Client,
}

impl IntegerSet for WholeIntegers<'_> {
    type Snapshot = Vec<PackedGaussian>;

    fn start_round(&mut self, round: u32, rounds: u32) -> Result<()> {
        let problem = &self.descent.problem;
        let project = || projected(self.quantizer, &self.rounded.gaussians, problem.scene.height);
        self.client.step(round as f32 / rounds as f32, &mut StaticSnapshot { problem, project: &project })
    }

    fn is_empty(&self) -> bool {
        self.rounded.gaussians.is_empty()
    }

    fn bytes(&mut self) -> Result<u64> {
        self.client.bytes(&mut self.rounded)
    }

    fn error(&mut self) -> Result<f64> {
        Ok(self.descent.error(&self.rounded.gaussians))
    }

    fn sweep(&mut self, lambda: f64) -> Result<Option<f64>> {
        let expected = self.client.expected(&mut self.rounded)?;
        Ok(Some(self.descent.sweep(&mut self.rounded.gaussians, &expected, lambda as f32)))
    }

    fn resize(&mut self, bytes: u64, max_bytes: u64) -> Result<()> {
        resize(&mut self.descent, &mut self.rounded.gaussians, bytes, max_bytes);
        Ok(())
    }

    fn snapshot(&self) -> Self::Snapshot {
        self.rounded.gaussians.clone()
    }

    fn restore(&mut self, snapshot: Self::Snapshot) {
        self.rounded.gaussians = snapshot;
    }
}
