//! Runs a single fit of a whole picture and rounds the result to a file.

use super::file;
use super::input::widened_file;
use super::report::Stage;
use super::session::{FitRequest, Outcome, UnderLayer};
use super::skipped::SkipReason;
use super::whole::WholeSession;
use crate::bitstream::coder::expect::PredictedCost;
use crate::bitstream::{self, splats::PackedSplats};
use crate::error::Result;
use crate::fit::Fitted;
use crate::fit::engine::{Ending, Snapshot, Watcher};
use crate::fit::job::Job;
use crate::fit::model::drawing::project::Primitive;
use crate::fit::model::objective::{masking, structure};
use crate::fit::model::problem::Problem;
use crate::fit::plan::{Plan, fraction};
use crate::gaussian::Channels;
use crate::options::{Needs, Recipe, Tune};
use crate::pixels::Depth;
use crate::round::finish::{self, Client, Rounding};
use crate::round::rounded::Rounded;
use crate::round::size::Size;
use crate::strict_math::StrictMath;
use crate::target::Target;

/// Minimum number of steps of a fit that is reweighted. For a fit of about 60 steps at 14 megapixels, the measurements
/// add half of the work again. They gain 0.05 dB and one point of SSIMULACRA2. Large pictures are therefore not
/// reweighted.
const MIN_REWEIGHED_STEPS: u32 = 150;

impl WholeSession<'_> {
    /// Sets the error weights for the requested tuning. If parts of the encode may be skipped, uniform weights are
    /// cleared.
    fn weigh(&mut self, count: usize) {
        let options = self.input.options;
        self.planes.amplitude = match options.favoured() {
            Tune::Psnr => Vec::new(),
            Tune::Ssim => structure::amplitudes(&self.planes, count),
            Tune::Iq => masking::amplitudes(&self.planes, count),
        };
        if options.favoured() == Tune::Iq {
            self.planes.channel_amplitude = masking::channel_amplitude(self.planes.channels);
        }
        let is_weighted = !self.planes.amplitude.is_empty();
        if is_weighted && options.needs == Needs::Measured && self.planes.is_even() {
            self.planes.amplitude.clear();
            self.report.note(SkipReason::StructureWeights, 0, 0.0);
        }
    }

    /// Fits about `count` primitives and rounds them to a file of the requested size, in which the channels that were
    /// left out are restored.
    pub(super) fn fitted(&mut self, count: usize, request: &FitRequest) -> Result<Outcome> {
        let &FitRequest { size, time, under_layer, ref initial } = request;
        self.weigh(count);
        let (input, planes) = (self.input, &self.planes);
        let options = input.options;
        let area = u64::from(input.pixels.width()) * u64::from(input.pixels.height());
        let time = self.clock.left().map(|left| time.map_or(left, |time| time.min(left)));
        let mut plan = Plan::new(options.effort, count, area, time, options.seed);
        if let Some(UnderLayer { ratio, patience }) = under_layer {
            plan = plan.for_base(options.effort, options.favoured(), ratio, patience);
            plan.by = fraction(area, count);
        } else {
            plan = plan.alone(options.effort, options.favoured());
        }
        plan.iterations = (plan.iterations as f32 * input.iterations) as u32;
        plan.initial.clone_from(initial);
        plan.rung = options.rung;
        if options.needs == Needs::Measured {
            plan.enough = sufficient_error(options.target, input.pixels.depth());
        }
        let scene = input.scene(planes.mean);
        let is_worth_it = plan.iterations >= MIN_REWEIGHED_STEPS && !scene.is_large() && !planes.amplitude.is_empty();
        plan.reweighs = is_worth_it && options.favoured() == Tune::Iq && options.recipe == Recipe::Ssplat;
        let problem = Problem { scene, target: planes };
        let job = Job { problem, count, plan: &plan };

        let clock = self.report.seconds();
        let stage = Stage { name: "fit", report: &mut self.report, input, planes };
        let mut watcher = FitWatcher { stage, job, size, draft: self.blank.clone(), steps: 0 };
        let Fitted { by: state, ending, amplitude } = match options.recipe {
            Recipe::Ssplat => self.device.fit(&job, input.pixels.depth(), &mut watcher)?,
            #[cfg(feature = "smartsplat")]
            Recipe::SmartSplat(parts) => {
                let by = crate::fit::smartsplat::fit(&job, parts, &mut watcher)?;
                Fitted { by, ending: Ending::Scheduled, amplitude: None }
            }
        };
        let steps = watcher.steps;
        if let Some(amplitude) = amplitude {
            self.planes.amplitude = amplitude;
        }
        let planes = &self.planes;
        let problem = Problem { scene, target: planes };
        let seconds = self.report.stage("fit", clock);
        if let Ending::Enough { left } = ending {
            self.report.note(SkipReason::Iterations, 0, seconds / f64::from(steps) * f64::from(left));
        }
        if let Some(reason) = self.device.passed_over() {
            self.report.note(SkipReason::Gpu { reason }, 0, 0.0);
        }

        let clock = self.report.seconds();
        let stage = Stage { name: "finish", report: &mut self.report, input, planes };
        let (splats, channels) = (self.blank.clone(), input.channels());
        let mut writer = FileWriter { stage, splats, channels, levels: options.levels };
        // Under a detail layer, the bytes of the Gaussians are not limited: the layer uses the bytes that remain.
        let size = if under_layer.is_some() { Size::Free } else { size };
        let rounding = Rounding { problem, layout: options.layout, size, plan: &plan };
        let mut finished = finish::finish(&rounding, state, &mut writer)?;
        let bytes = writer.write(&mut finished.rounded)?;
        let FileWriter { mut splats, .. } = writer;
        splats.gaussians = finished.rounded.gaussians;
        self.report.stage("finish", clock);
        Ok(Outcome { bytes, splats, float_error: finished.float_error, quality: None, pruned_bytes: 0 })
    }
}

/// Returns the mean squared error per sample at which further iterations gain nothing. That is the error of rounding to
/// code values or, if it is larger, the error of the target PSNR with a margin for quantization.
pub(super) fn sufficient_error(target: Target, depth: Depth) -> f64 {
    // Maximum observed loss by quantization before descent recovers some of it, decibels.
    const LOSS: f64 = 3.0;
    match target {
        Target::Psnr(p) => depth.rounding_error().max(10f64.strict_powf(-0.1 * (p + LOSS))),
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
        let each = ((all - fixed) / primitives.len().max(1) as f64).max(MIN_PRICE);
        Ok(((max_bytes as f64 * excess(primitives.len()) - fixed) / each).max(0.0) as usize)
    }
}

/// Minimum assumed cost of a primitive, bytes. Without it, a few similar primitives would suggest that any number fits.
const MIN_PRICE: f64 = 0.5;

/// Returns the over-allocation factor of a fit of this many primitives. Descent makes the primitives cheaper, and
/// pruning removes the remaining excess.
pub(super) fn excess(primitives: usize) -> f64 {
    // On twelve Kodak pictures, 1.05 gains 0.02 to 0.07 dB over 1.008 at ratios from 50 to 1000. With 15 000 primitives
    // at a ratio of 20, it gained nothing and lost 0.0003 of MS-SSIM. `cargo run --release -p ssplat-lab --example
    // rate_distortion -- PICTURES` measures it.
    if primitives < 10_000 { 1.05 } else { 1.008 }
}

/// Writes the file for which the primitives are rounded.
struct FileWriter<'a, 'b> {
    stage: Stage<'a, 'b>,
    /// The integers, without the channels that were left out.
    splats: PackedSplats,
    /// The channels of the file.
    channels: Channels,
    levels: u8,
}

impl Client for FileWriter<'_, '_> {
    fn step(&mut self, done: f32, now: &mut dyn Snapshot) -> Result<()> {
        self.stage.step(done, now)
    }

    fn bytes(&mut self, rounded: &mut Rounded) -> Result<u64> {
        Ok(self.write(rounded)?.len() as u64)
    }

    fn expected(&mut self, rounded: &mut Rounded) -> Result<Vec<PredictedCost>> {
        self.with(rounded, file::expected)
    }
}

impl FileWriter<'_, '_> {
    /// Writes the file and sorts the primitives into its order.
    fn write(&mut self, rounded: &mut Rounded) -> Result<Vec<u8>> {
        let channels = self.channels;
        self.with(rounded, |splats, levels| match file::smallest(splats, levels) {
            Ok(_) if splats.channels != channels => widened_file(splats, channels),
            bytes => bytes,
        })
    }

    /// Calls `look` with the integers of the file and its number of levels.
    fn with<T>(&mut self, rounded: &mut Rounded, look: impl FnOnce(&mut PackedSplats, u8) -> T) -> T {
        let splats = &mut self.splats;
        (splats.steps, splats.background) = (rounded.steps, rounded.background);
        std::mem::swap(&mut splats.gaussians, &mut rounded.gaussians);
        let seen = look(splats, self.levels);
        std::mem::swap(&mut splats.gaussians, &mut rounded.gaussians);
        seen
    }
}
