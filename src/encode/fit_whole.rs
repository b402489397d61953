//! Fits Gaussians to a whole picture.

use super::primitive_count::{bytes_per_primitive, count_in};
use super::report::Stage;
use super::skipped::SkipReason;
use super::state::{EncodeState, FitRequest, UnderLayer};
use super::whole::WholePicture;
use crate::bitstream::{self, splats::PackedSplats};
use crate::constants::fit;
use crate::constants::rate_control;
use crate::error::Result;
use crate::fit::Fitted;
use crate::fit::engine::{Ending, Snapshot, Watcher};
use crate::fit::job::Job;
use crate::fit::model::adam::Bounds;
use crate::fit::model::drawing::project::Primitive;
use crate::fit::model::objective::masking;
use crate::fit::model::problem::{Problem, Scene};
use crate::fit::plan::{Plan, reduction};
use crate::fit::state::State;
use crate::options::{Needs, Recipe, Tune};
use crate::pixels::Depth;
use crate::rdo::rounded::Rounded;
use crate::rdo::size::Size;
use crate::strict_math::StrictMath;
use crate::target::Target;

/// Gaussians that were fitted to a whole picture, and the plan of their fit.
pub(super) struct FittedWhole {
    pub state: State,
    pub plan: Plan,
    pub scene: Scene,
}

/// Fits about `count` primitives to `picture`.
pub(super) fn fit(picture: &mut WholePicture<'_>, count: usize, request: &FitRequest) -> Result<FittedWhole> {
    if picture.state.settings.fit.base.weighs_pixels || request.under_layer.is_none() {
        weigh(picture, count);
    }
    let (input, planes, options) = (picture.input, &picture.planes, picture.state.options);
    let plan = plan(picture, count, request);
    let scene = input.scene(planes.mean);
    let job = Job { problem: Problem { scene, target: planes }, count, plan: &plan };

    let EncodeState { report, device, blank, .. } = &mut picture.state;
    let clock = report.seconds();
    let stage = Stage { name: "fit", report: &mut *report, input, planes };
    let mut watcher = FitWatcher { stage, job, size: request.size, draft: blank.clone(), steps: 0 };
    let Fitted { by: state, ending, amplitude } = match options.recipe {
        Recipe::Ssplat | Recipe::StartOf(_) => device.fit(&job, input.pixels.depth(), &mut watcher)?,
        Recipe::Other(method) => {
            let bounds = Bounds::new(planes.width, planes.height);
            let by = State::new(job.given_to(|job| method.fit(job, &mut watcher))?, bounds);
            Fitted { by, ending: Ending::Scheduled, amplitude: None }
        }
    };
    let steps = watcher.steps;
    let seconds = report.stage("fit", clock);
    if let Ending::Enough { left } = ending {
        report.note(SkipReason::Iterations, 0, seconds / f64::from(steps) * f64::from(left));
    }
    if let Some(reason) = device.passed_over() {
        report.note(SkipReason::Gpu { reason }, 0, 0.0);
    }
    if let Some(amplitude) = amplitude {
        picture.planes.amplitude = amplitude;
    }
    Ok(FittedWhole { state, plan, scene })
}

/// Returns the schedule of a fit of about `count` primitives.
fn plan(picture: &WholePicture<'_>, count: usize, request: &FitRequest) -> Plan {
    let (input, planes, options) = (picture.input, &picture.planes, picture.state.options);
    let area = picture.state.pixels();
    let time = picture.state.clock.left().map(|left| request.time.map_or(left, |time| time.min(left)));
    let settings = picture.state.settings.fit;
    let mut plan = Plan::new(&settings, count, area, time, options.seed);
    if let Some(UnderLayer { ratio, patience, .. }) = request.under_layer {
        plan = plan.for_base(&settings.base, options.favoured(), ratio, patience);
        plan.by = reduction(&settings.base.reduction, area, count);
    } else {
        plan = plan.alone(&settings, options.favoured());
    }
    plan.iterations = (plan.iterations as f32 * input.iterations) as u32;
    plan.initial.clone_from(&request.initial);
    plan.rung = options.rung;
    if let Recipe::StartOf(method) = options.recipe {
        plan.start_of = Some(method);
    }
    if options.needs == Needs::Measured {
        plan.enough = sufficient_error(options.target, input.pixels.depth());
    }
    let is_worth_it = plan.iterations >= fit::MIN_REWEIGHED_STEPS
        && !input.scene(planes.mean).is_large()
        && !planes.amplitude.is_empty();
    plan.reweighs = is_worth_it && options.favoured() == Tune::Iq && options.recipe.is_own();
    plan
}

/// Sets the error weights for the requested tuning. If parts of the encode may be skipped, uniform weights are cleared.
fn weigh(picture: &mut WholePicture<'_>, count: usize) {
    let WholePicture { state, planes, .. } = picture;
    planes.amplitude = match state.options.favoured() {
        Tune::Psnr => Vec::new(),
        Tune::Iq => masking::amplitudes(planes, count),
    };
    if state.options.favoured() == Tune::Iq {
        planes.channel_amplitude = masking::channel_amplitude(planes.channels);
    }
    let is_weighted = !planes.amplitude.is_empty();
    if is_weighted && state.options.needs == Needs::Measured && planes.is_even() {
        planes.amplitude.clear();
        state.report.note(SkipReason::StructureWeights, 0, 0.0);
    }
}

/// Returns the mean squared error per sample at which further iterations gain nothing. That is the error of rounding to
/// code values or, if it is larger, the error of the target PSNR with a margin for quantization.
pub(super) fn sufficient_error(target: Target, depth: Depth) -> f64 {
    match target {
        Target::Psnr(p) => depth.rounding_error().max(10f64.strict_powf(-0.1 * (p + rate_control::QUANTIZATION_LOSS))),
        _ => depth.rounding_error(),
    }
}

/// Watches the fit, and corrects the number of primitives by the size of their file.
struct FitWatcher<'a, 'b> {
    stage: Stage<'a, 'b>,
    job: Job<'a>,
    size: Size,
    /// The current file, without primitives.
    draft: PackedSplats,
    /// Number of steps so far.
    steps: u32,
}

impl Watcher for FitWatcher<'_, '_> {
    fn step(&mut self, done: f32, now: &mut dyn Snapshot) -> Result<()> {
        self.steps += 1;
        self.stage.step(done, now)
    }

    fn recount(&mut self, primitives: &[Primitive]) -> Result<usize> {
        let count = self.job.count;
        match self.size {
            Size::Bytes(max_bytes) => Ok(self.count_for(primitives, max_bytes)?.clamp(count.min(1), count * 2)),
            Size::Free => Ok(count),
        }
    }
}

impl FitWatcher<'_, '_> {
    /// Returns how many primitives of this kind fit into `max_bytes` bytes. The cost of each is that of the current
    /// primitives when they are rounded and written.
    fn count_for(&mut self, primitives: &[Primitive], max_bytes: u64) -> Result<usize> {
        let rounded = Rounded::nearest(&self.job.problem, self.draft.layout, primitives);
        (self.draft.steps, self.draft.gaussians) = (rounded.steps, rounded.gaussians);
        let all = bitstream::to_bytes(&self.draft)?.len() as f64;
        self.draft.gaussians.clear();
        let fixed = bitstream::to_bytes(&self.draft)?.len() as f64;
        let each = bytes_per_primitive(all - fixed, primitives.len());
        Ok(count_in(max_bytes, fixed, each, primitives.len()))
    }
}
