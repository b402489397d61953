//! One encode on its way: the picture, what is known of it, and a single fit with its rounding.

use std::ops::ControlFlow;

use super::Progress;
use super::channels;
use super::report::Savings;
use crate::bitstream::splats::{Metadata, PackedSplats, Steps};
use crate::encode::device::{Choice, Job};
use crate::encode::trace::Tracer;
use crate::error::{Error, Result};
use crate::fit;
use crate::fit::model::field::Scene;
use crate::fit::model::planes::Target as Planes;
use crate::fit::model::project::Primitive;
use crate::fit::model::structure;
use crate::fit::plan::Plan;
use crate::fit::smartsplat;
use crate::gaussian::{Blend, Channels};
use crate::options::{EncodeOptions, Needs, Recipe, Tune};
use crate::pixels::Pixels;
use crate::round::finish::{self, Size};

pub(super) struct Session<'a> {
    /// What the caller gave.
    pub original: &'a Pixels,
    /// What is fitted.
    pub pixels: &'a Pixels,
    pub options: &'a EncodeOptions,
    /// Whether the picture is looked at for what it does not need, and the file can do without it.
    pub measured: bool,
    pub blend: Blend,
    /// What is fitted, as planes.
    pub planes: Planes,
    pub choice: Choice,
    pub progress: &'a mut dyn FnMut(&Progress) -> ControlFlow<()>,
    pub tracer: Tracer,
    pub stages: Vec<(&'static str, f64)>,
    pub savings: Savings,
}

/// A file, the integers that were fitted, and the squared error of the floats.
pub(super) struct Outcome {
    pub bytes: Vec<u8>,
    pub splats: PackedSplats,
    pub float_error: f64,
}

pub(super) fn decibels(error: f64, samples: f64) -> f64 {
    -10.0 * (error / samples).log10()
}

impl Session<'_> {
    /// Samples of the caller's picture.
    pub(super) fn samples(&self) -> f64 {
        f64::from(self.pixels.width()) * f64::from(self.pixels.height()) * self.channels().count() as f64
    }

    /// Samples of what is fitted.
    pub(super) fn fitted_samples(&self) -> f64 {
        self.samples() / self.channels().count() as f64 * self.pixels.channels().count() as f64
    }

    /// The channels of the file.
    fn channels(&self) -> Channels {
        self.original.channels()
    }

    /// Whether all channels are fitted.
    pub(super) fn is_whole(&self) -> bool {
        self.channels() == self.pixels.channels()
    }

    /// A picture of what is fitted without primitives.
    pub(super) fn empty(&self) -> PackedSplats {
        let mut metadata = Metadata::default();
        metadata.icc.clone_from(&self.options.icc);
        metadata.exif.clone_from(&self.options.exif);
        PackedSplats {
            width: self.pixels.width(),
            height: self.pixels.height(),
            channels: self.pixels.channels(),
            depth: self.pixels.depth(),
            blend: self.blend,
            layout: self.options.layout,
            steps: Steps { scale: 2, angle: 1, position: 5, coarsest: 0, range: 0, luma: 6, chroma: 1 },
            background: [0; 4],
            codebook: None,
            gaussians: Vec::new(),
            levels: Vec::new(),
            metadata,
        }
    }

    fn scene(&self) -> Scene {
        Scene {
            width: self.pixels.width(),
            height: self.pixels.height(),
            blend: self.blend,
            background: match self.options.recipe {
                Recipe::Ssplat => self.planes.mean,
                Recipe::SmartSplat(_) => [0.0; 4],
            },
        }
    }

    pub(super) fn stored_scene(&self, splats: &PackedSplats) -> Scene {
        Scene { background: splats.quantizer().dequantize_color(splats.background), ..self.scene() }
    }

    /// The file, with the channels that were left out put back.
    pub(super) fn file(&self, splats: &PackedSplats) -> Result<Vec<u8>> {
        match self.is_whole() {
            true => crate::bitstream::to_bytes(splats),
            false => crate::bitstream::to_bytes(&channels::widen(splats, self.channels())),
        }
    }

    /// Squared error of the stored picture over the samples of the caller's channels.
    pub(super) fn error(&self, splats: &PackedSplats) -> f64 {
        match self.is_whole() {
            true => self.fitted_error(splats),
            false => self.whole_error(splats, &Planes::new(self.original)),
        }
    }

    /// The same with the planes of all channels, where some were left out.
    pub(super) fn whole_error(&self, splats: &PackedSplats, whole: &Planes) -> f64 {
        let wide = channels::widen(splats, self.channels());
        finish::packed_error(&self.stored_scene(&wide), whole, &wide.quantizer(), &wide.gaussians)
    }

    /// Squared error of the stored picture over the samples that were fitted.
    pub(super) fn fitted_error(&self, splats: &PackedSplats) -> f64 {
        finish::packed_error(&self.stored_scene(splats), &self.planes, &splats.quantizer(), &splats.gaussians)
    }

    /// Makes the stored picture the trace's last point.
    pub(super) fn trace_end(&mut self, splats: &PackedSplats) {
        let scene = self.stored_scene(splats);
        let drawing = || (scene, finish::projected(&splats.quantizer(), &splats.gaussians, splats.height));
        self.tracer.step("written", self.original, &self.planes, &drawing);
    }

    /// Weighs the errors by structure, where that is asked for and weighs anything.
    fn weigh(&mut self, count: usize) {
        // The recipe of the paper has its own terms.
        if self.options.tune == Tune::Psnr && self.options.recipe == Recipe::Ssplat {
            self.savings.note("SSIM terms: the fit is tuned for PSNR", 0, 0.0);
        }
        if self.options.tune == Tune::Ssim {
            self.planes.amplitude = structure::amplitudes(&self.planes, count);
            if self.options.needs == Needs::Measured && channels::is_even(&self.planes) {
                self.planes.amplitude.clear();
                self.savings.note("SSIM terms: the picture is so even that all pixels weigh the same", 0, 0.0);
            }
        }
    }

    /// Fits about `count` primitives and rounds them to a file of `size`, both without the channels that are left out.
    pub(super) fn fitted(&mut self, count: usize, size: Size) -> Result<Outcome> {
        let pixels = u64::from(self.pixels.width()) * u64::from(self.pixels.height());
        let mut plan = Plan::new(self.options.effort, count, pixels, self.options.time, self.options.seed);
        plan.levels = self.options.levels;
        if self.options.needs == Needs::Measured {
            plan.enough = channels::enough(self.options.target, self.pixels.depth());
        }
        let scene = self.scene();
        let mut splats = self.empty();
        self.weigh(count);
        let (progress, tracer) = (&mut *self.progress, &mut self.tracer);
        let (pixels, planes) = (self.original, &self.planes);
        let mut iterations = 0;
        let mut clock = tracer.seconds();
        let mut watch = |tracer: &mut Tracer, stage, done, drawing: fit::Drawing<'_>| {
            let psnr = tracer.step(stage, pixels, planes, drawing);
            match progress(&Progress { stage, done, psnr }) {
                ControlFlow::Continue(()) => Ok(()),
                ControlFlow::Break(()) => Err(Error::Cancelled),
            }
        };
        let mut draft = splats.clone();
        let mut recount = |primitives: &[Primitive]| match size {
            Size::Bytes(most) => {
                Ok(finish::count_for(&scene, planes, primitives, &mut draft, most)?.clamp(count.min(1), count * 2))
            }
            Size::Free => Ok(count),
        };
        let mut watch_fit = |done: f32, now: fit::Drawing<'_>| {
            iterations += 1;
            watch(tracer, "fit", done, now)
        };
        let state = match self.options.recipe {
            Recipe::Ssplat => {
                let job = Job { scene: &scene, pixels: self.pixels, target: planes, count, plan: &plan };
                self.choice.fit(&job, &mut recount, &mut watch_fit)?
            }
            Recipe::SmartSplat(parts) => {
                smartsplat::fit(&scene, planes, count, parts, &plan, &mut recount, &mut watch_fit)?
            }
        };
        let seconds = tracer.seconds() - clock;
        self.stages.push(("fit", seconds));
        if state.is_enough {
            let each = seconds / f64::from(iterations);
            let saved = each * f64::from(plan.iterations - iterations);
            self.savings.note("iterations: the error is below that of rounding, or well below the target", 0, saved);
        }
        if let Some(what) = self.choice.left_out() {
            self.savings.note(what, 0, 0.0);
        }
        clock = tracer.seconds();
        let (bytes, float_error) =
            finish::finish(&scene, planes, state, &mut splats, size, &plan, &mut |done, now| {
                watch(tracer, "finish", done, now)
            })?;
        self.stages.push(("finish", tracer.seconds() - clock));
        Ok(Outcome { bytes, splats, float_error })
    }
}
