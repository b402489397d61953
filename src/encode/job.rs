//! A single fit of a whole picture, and the rounding to a file.

use super::detail::error::{self, Counted};
use super::file;
use super::input::stored_scene;
use super::report::Stage;
use super::session::Outcome;
use super::skipped::SkipReason;
use super::whole::{Base, WholeSession};
use crate::bitstream::coder::expect::PredictedCost;
use crate::bitstream::{self, splats::PackedSplats};
use crate::error::Result;
use crate::fit::Fitted;
use crate::fit::engine::{Ending, Snapshot, Watcher};
use crate::fit::job::Job;
use crate::fit::model::drawing::field::squared_error;
use crate::fit::model::drawing::project::Primitive;
use crate::fit::model::objective::planes::Planes;
use crate::fit::model::objective::{masking, structure};
use crate::fit::model::problem::Problem;
use crate::fit::plan::{Plan, fraction};
use crate::gaussian::Channels;
use crate::options::{Needs, Recipe, Tune};
use crate::pixels::Depth;
use crate::round::finish::{self, Client, Rounding};
use crate::round::rounded::{Rounded, projected};
use crate::round::size::Size;
use crate::strict_math::StrictMath;
use crate::target::Target;

/// Steps of the shortest fits that are weighed anew on the way. The looks that this takes are half as much work again
/// in a fit of some sixty steps of 14 megapixels, for .05 dB and a point of SSIMULACRA2; large pictures do without.
const MIN_REWEIGHED_STEPS: u32 = 150;

impl WholeSession<'_> {
    /// Weighs the errors by structure, where that is asked for and weighs anything.
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

    /// Fits about `count` primitives and rounds them to a file of `size`, both without the channels that are left out.
    pub(super) fn fitted(&mut self, count: usize, size: Size) -> Result<Outcome> {
        self.weigh(count);
        let (input, planes) = (self.input, &self.planes);
        let options = input.options;
        let area = u64::from(input.pixels.width()) * u64::from(input.pixels.height());
        let time = self.clock.left().map(|left| self.share.map_or(left, |share| share.min(left)));
        let mut plan = Plan::new(options.effort, count, area, time, options.seed);
        if let Some(Base { ratio }) = self.base {
            plan = plan.for_base(options.effort, options.favoured(), ratio);
            plan.by = fraction(area, count);
        } else {
            plan = plan.alone(options.effort, options.favoured());
        }
        plan.initial = std::mem::take(&mut self.initial);
        plan.rung = options.rung;
        if options.needs == Needs::Measured {
            plan.enough = enough(options.target, input.pixels.depth());
        }
        let scene = input.scene(planes.mean);
        let is_worth_it = plan.iterations >= MIN_REWEIGHED_STEPS && !scene.is_large() && !planes.amplitude.is_empty();
        plan.reweighs = is_worth_it && options.favoured() == Tune::Iq && options.recipe == Recipe::Ssplat;
        let problem = Problem { scene, target: planes };
        let job = Job { problem, count, plan: &plan };

        let clock = self.report.seconds();
        let stage = Stage { name: "fit", report: &mut self.report, input, planes };
        let mut fitting = Fitting { stage, job, size, draft: input.empty(), steps: 0 };
        let Fitted { by: state, ending, amplitude } = match options.recipe {
            Recipe::Ssplat => self.device.fit(&job, input.pixels, &mut fitting)?,
            #[cfg(feature = "smartsplat")]
            Recipe::SmartSplat(parts) => {
                let by = crate::fit::smartsplat::fit(&job, parts, &mut fitting)?;
                Fitted { by, ending: Ending::Scheduled, amplitude: None }
            }
        };
        let steps = fitting.steps;
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
        let mut making = Making { stage, splats: input.empty(), levels: options.levels };
        // The layer takes what such Gaussians leave of the bytes, few or many.
        let size = if self.base.is_some() { Size::Free } else { size };
        let rounding = Rounding { problem, layout: options.layout, size, plan: &plan };
        let mut finished = finish::finish(&rounding, state, &mut making)?;
        let bytes = making.write(&mut finished.rounded)?;
        let Making { mut splats, .. } = making;
        splats.gaussians = finished.rounded.gaussians;
        self.report.stage("finish", clock);
        Ok(Outcome { bytes, splats, float_error: finished.float_error, quality: None })
    }
}

/// Returns the squared error of a stored picture over the samples of `planes`; the file has `channels`.
pub(super) fn stored_error(splats: &PackedSplats, planes: &Planes, channels: Channels) -> f64 {
    let projected = projected(&splats.quantizer(), &splats.gaussians, splats.height);
    if let Some(layer) = &splats.detail {
        return error::squared_error((stored_scene(splats), planes), &projected, (layer, channels), Counted::Alike);
    }
    squared_error(&Problem { scene: stored_scene(splats), target: planes }, &projected)
}

/// Mean squared error of a sample at which more iterations bring nothing: rounding makes as much, or the target is
/// passed by more than what the integers lose.
pub(super) fn enough(target: Target, depth: Depth) -> f64 {
    // Decibels that quantization has been seen to lose at most, before the descent wins some back.
    const LOSS: f64 = 3.0;
    match target {
        Target::Psnr(p) => depth.rounding_error().max(10f64.strict_powf(-0.1 * (p + LOSS))),
        _ => depth.rounding_error(),
    }
}

/// Watches the fit, and corrects the number of its primitives by what their file takes.
struct Fitting<'a, 'b> {
    stage: Stage<'a, 'b>,
    job: Job<'a>,
    size: Size,
    /// The file so far, without primitives.
    draft: PackedSplats,
    /// Steps so far.
    steps: u32,
}

impl Watcher for Fitting<'_, '_> {
    fn step(&mut self, done: f32, now: &mut dyn Snapshot) -> Result<()> {
        self.steps += 1;
        self.stage.step(done, now)
    }

    fn recount(&mut self, primitives: &[Primitive]) -> Result<usize> {
        let count = self.job.count;
        match self.size {
            Size::Bytes(most) => Ok(self.count_for(primitives, most)?.clamp(count.min(1), count * 2)),
            Size::Free => Ok(count),
        }
    }
}

impl Fitting<'_, '_> {
    /// Returns how many primitives of this kind fit into `most` bytes: those that there are, rounded and written, set
    /// the price.
    fn count_for(&mut self, primitives: &[Primitive], most: u64) -> Result<usize> {
        let rounded = Rounded::nearest(&self.job.problem, self.draft.layout, primitives);
        (self.draft.steps, self.draft.gaussians) = (rounded.steps, rounded.gaussians);
        let all = bitstream::to_bytes(&self.draft)?.len() as f64;
        self.draft.gaussians.clear();
        let fixed = bitstream::to_bytes(&self.draft)?.len() as f64;
        let each = ((all - fixed) / primitives.len().max(1) as f64).max(MIN_PRICE);
        // Metadata take the same bytes for any number of primitives.
        let metadata = &self.draft.metadata;
        let carried =
            [&metadata.icc, &metadata.exif].map(|block| block.as_ref().map_or(0, Vec::len)).iter().sum::<usize>();
        let (most, fixed) = (most.saturating_sub(carried as u64) as f64, (fixed - carried as f64).max(0.0));
        Ok(((most * excess(primitives.len()) - fixed) / each).max(0.0) as usize)
    }
}

/// Bytes that a primitive is taken to cost at least, so that a few alike ones do not promise room for any number.
const MIN_PRICE: f64 = 0.5;

/// Returns the over-allocation factor of a fit with so many primitives; descent shrinks them, pruning removes the rest.
pub(super) fn excess(primitives: usize) -> f64 {
    // Kodak, twelve pictures, against 1.008: .02 to .07 dB better at ratios from 50 to 1000. With 15 000 primitives at
    // ratio 20 it won nothing and lost .0003 of MS-SSIM. `cargo run --release -p ssplat-lab --example rate_distortion
    // -- PICTURES` measures it.
    if primitives < 10_000 { 1.05 } else { 1.008 }
}

/// Makes the file that the primitives are rounded for.
struct Making<'a, 'b> {
    stage: Stage<'a, 'b>,
    splats: PackedSplats,
    levels: u8,
}

impl Client for Making<'_, '_> {
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

impl Making<'_, '_> {
    /// Writes the file, and brings the primitives into its order.
    fn write(&mut self, rounded: &mut Rounded) -> Result<Vec<u8>> {
        self.with(rounded, file::smallest)
    }

    /// Calls `look` with the integers as a file of so many levels.
    fn with<T>(&mut self, rounded: &mut Rounded, look: impl FnOnce(&mut PackedSplats, u8) -> T) -> T {
        let splats = &mut self.splats;
        (splats.steps, splats.background) = (rounded.steps, rounded.background);
        std::mem::swap(&mut splats.gaussians, &mut rounded.gaussians);
        let seen = look(splats, self.levels);
        std::mem::swap(&mut splats.gaussians, &mut rounded.gaussians);
        seen
    }
}
