//! Pixels to bytes: the whole encoder behind one function.

use std::ops::ControlFlow;

use crate::backend::{Choice, Chosen};
use crate::bitstream::splats::{Layout, Metadata, PackedSplats, Steps};
use crate::error::{Error, Result};
use crate::fit;
use crate::fit::field::Scene;
use crate::fit::finish::{self, Size};
use crate::fit::plan::Plan;
use crate::fit::project::Primitive;
use crate::fit::smartsplat;
use crate::fit::structure;
use crate::fit::target::Target as Planes;
use crate::gaussian::{Blend, Channels};
use crate::leave_out;
use crate::options::{EncodeOptions, Needs, Recipe, Target, Tune};
use crate::pixels::Pixels;
use crate::trace::{TracePoint, Tracer};

/// Most primitives that an encode will fit.
const MAX_PRIMITIVES: u64 = 16 << 20;

/// An encoded picture.
#[derive(Debug, Clone)]
pub struct Encoded {
    /// The file.
    pub bytes: Vec<u8>,
    /// What was done.
    pub report: EncodeReport,
}

/// What an encode did and what it cost.
#[derive(Debug, Clone, Default)]
#[non_exhaustive]
pub struct EncodeReport {
    /// Primitives in the file.
    pub primitives: usize,
    /// PSNR of the stored picture against the source, decibels, before rounding to code values; infinite when equal.
    pub psnr: f64,
    /// PSNR before quantization, decibels.
    pub float_psnr: f64,
    /// Wall-clock seconds, those that a trace takes not counted.
    pub seconds: f64,
    /// Seconds of each stage, in order.
    pub stages: Vec<(&'static str, f64)>,
    /// What the picture did not need.
    pub left_out: Vec<LeftOut>,
    /// The device that fitted the picture, and why that one.
    pub chosen: Chosen,
    /// Quality along the way; empty unless [`EncodeOptions::trace`] asks for it.
    pub trace: Vec<TracePoint>,
}

/// Something that the encoder did without, because the picture or the options do not need it or it was not to be had.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct LeftOut {
    /// What it is, a colon, and why.
    pub what: String,
    /// Bytes saved; 0 where it saves only time, which then buys quality, or nothing that was measured.
    pub bytes: u64,
    /// Seconds saved, estimated from the cost of one iteration with and without it; 0 where that is not known.
    pub seconds: f64,
}

/// How far an encode is.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct Progress {
    /// The stage's name.
    pub stage: &'static str,
    /// Share of the stage that is done, `0..=1`.
    pub done: f32,
    /// PSNR when it was last measured, dB; only with [`EncodeOptions::trace`].
    pub psnr: Option<f64>,
}

/// Encodes `pixels`.
///
/// # Errors
/// [`Error::Parameter`] when an option is out of range or the asked size cannot hold the picture.
pub fn encode(pixels: &Pixels, options: &EncodeOptions) -> Result<Encoded> {
    encode_with_progress(pixels, options, &mut |_| ControlFlow::Continue(()))
}

/// Encodes `pixels` and calls `progress` a few hundred times on the way.
///
/// # Errors
/// As [`encode`], and [`Error::Cancelled`] when `progress` returns [`ControlFlow::Break`].
pub fn encode_with_progress(
    pixels: &Pixels,
    options: &EncodeOptions,
    progress: &mut dyn FnMut(&Progress) -> ControlFlow<()>,
) -> Result<Encoded> {
    check(options)?;
    let tracer = Tracer::new(options.trace);
    let blend = options.blend.unwrap_or(match options.recipe {
        Recipe::Ssplat => Blend::Normalized,
        Recipe::SmartSplat(_) => Blend::Sum,
    });
    // Only the coded layout stores a constant channel in next to nothing.
    let measured = options.needs == Needs::Measured && options.layout == Layout::Coded;
    let narrow = if measured { leave_out::narrow(pixels) } else { None };
    let narrowed = narrow.as_ref().map_or(pixels, |n| &n.pixels);
    let planes = Planes::new(narrowed);
    let choice = Choice::new(options, narrowed)?;
    let mut session = Session {
        original: pixels,
        pixels: narrowed,
        channels: pixels.channels(),
        options,
        blend,
        planes,
        choice,
        progress,
        tracer,
        stages: Vec::new(),
        left_out: Vec::new(),
    };
    let constant = if measured { session.constant()? } else { None };
    let is_fitted = constant.is_none();
    let (bytes, splats, float_error) = match options.target {
        _ if constant.is_some() => constant.expect("just seen"),
        Target::Ratio(ratio) => {
            let raw = session.samples();
            session.at_size(Size::Bytes((raw / ratio).floor() as u64))?
        }
        Target::Bytes(bytes) => session.at_size(Size::Bytes(bytes))?,
        Target::Primitives(count) => session.at_count(count as usize, Size::Free)?,
        Target::Psnr(psnr) => session.at_psnr(psnr)?,
    };
    session.trace_end(&splats);
    if let Some(narrow) = &narrow {
        let seconds = session.seconds_of_channels(pixels, &splats);
        session.left_out.insert(0, LeftOut { what: narrow.what.to_owned(), bytes: 0, seconds });
    }
    session.note_codebook(&bytes, &splats)?;
    if let Some(what) = session.choice.left_out().filter(|_| is_fitted) {
        note(&mut session.left_out, &what, 0, 0.0);
    }
    let error = session.error(&splats);
    let samples = session.samples();
    // The floats were measured on what was fitted: the channels that were left out weigh as they do in the file.
    let weight = error / session.fitted_error(&splats);
    let float_error = float_error * if weight.is_finite() { weight } else { 1.0 };
    let report = EncodeReport {
        primitives: splats.gaussians.len(),
        psnr: decibels(error, samples),
        float_psnr: decibels(float_error, samples),
        seconds: session.tracer.seconds(),
        stages: session.stages,
        left_out: session.left_out,
        chosen: session.choice.chosen,
        trace: session.tracer.into_points(),
    };
    Ok(Encoded { bytes, report })
}

/// Notes what was left out, in place of what an earlier attempt left out for the same reason.
fn note(list: &mut Vec<LeftOut>, what: &str, bytes: u64, seconds: f64) {
    list.retain(|l| l.what != what);
    list.push(LeftOut { what: what.to_owned(), bytes, seconds });
}

fn decibels(error: f64, samples: f64) -> f64 {
    -10.0 * (error / samples).log10()
}

fn check(options: &EncodeOptions) -> Result<()> {
    let bad = |name, problem| Err(Error::Parameter { name, problem });
    if !(1..=9).contains(&options.effort) {
        return bad("effort", format!("{} is outside 1..=9", options.effort));
    }
    if !(1..=8).contains(&options.levels) || (options.levels > 1 && options.layout != Layout::Coded) {
        return bad("levels", format!("{} is outside 1..=8, or above 1 without the coded layout", options.levels));
    }
    match options.target {
        Target::Ratio(r) if !(r.is_finite() && r > 0.0) => bad("ratio", format!("{r} is not a positive number")),
        Target::Psnr(p) if !(p.is_finite() && p > 0.0) => bad("psnr", format!("{p} is not a positive number")),
        Target::Primitives(n) if u64::from(n) > MAX_PRIMITIVES => {
            bad("primitives", format!("{n} is over {MAX_PRIMITIVES}"))
        }
        _ => Ok(()),
    }
}

struct Session<'a> {
    /// What the caller gave.
    original: &'a Pixels,
    /// What is fitted.
    pixels: &'a Pixels,
    /// What the file has.
    channels: Channels,
    options: &'a EncodeOptions,
    blend: Blend,
    planes: Planes,
    choice: Choice,
    progress: &'a mut dyn FnMut(&Progress) -> ControlFlow<()>,
    tracer: Tracer,
    stages: Vec<(&'static str, f64)>,
    left_out: Vec<LeftOut>,
}

/// The file, the integers that were fitted, and the squared error of the floats.
type Outcome = (Vec<u8>, PackedSplats, f64);

impl Session<'_> {
    fn samples(&self) -> f64 {
        f64::from(self.pixels.width()) * f64::from(self.pixels.height()) * self.channels.count() as f64
    }

    fn empty(&self) -> PackedSplats {
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
            metadata: self.metadata(),
        }
    }

    fn metadata(&self) -> Metadata {
        let mut m = Metadata::default();
        m.icc.clone_from(&self.options.icc);
        m.exif.clone_from(&self.options.exif);
        m
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

    fn at_size(&mut self, size: Size) -> Result<Outcome> {
        let Size::Bytes(most) = size else { return self.at_count(0, size) };
        let fixed = self.file(&self.empty())?.len() as u64;
        if most < fixed {
            let problem = format!("{most} bytes cannot hold the picture: {fixed} are needed without any primitive");
            return Err(Error::Parameter { name: "bytes", problem });
        }
        // What a primitive costs before anything is known; the size is corrected while the integers settle.
        let bits = match self.options.layout {
            Layout::Packed => 56.0,
            Layout::Planes => 46.0,
            Layout::Coded => 34.5,
        };
        // More primitives than samples bring nothing.
        let count = (((most - fixed) as f64 * 8.0 / bits) as u64).min(MAX_PRIMITIVES).min(self.samples() as u64);
        self.at_count(count as usize, size)
    }

    fn at_psnr(&mut self, wanted: f64) -> Result<Outcome> {
        let raw = self.samples();
        let mut bytes = raw / 50.0;
        let mut best: Option<Outcome> = None;
        let mut reached: f64 = 0.0;
        let (mut low, mut high) = (0.0f64, raw);
        for _ in 0..6 {
            let outcome = self.at_size(Size::Bytes(bytes.max(64.0) as u64))?;
            let got = decibels(self.error(&outcome.1), raw);
            reached = reached.max(got);
            if got >= wanted {
                high = bytes;
                let close = got - wanted < 0.1;
                if best.as_ref().is_none_or(|b| outcome.0.len() < b.0.len()) {
                    best = Some(outcome);
                }
                if close {
                    break;
                }
            } else {
                low = bytes;
            }
            // Doubling the bytes wins about 2.5 dB.
            bytes *= ((wanted - got + 0.05) / 2.5).exp2().clamp(0.05, 20.0);
            if bytes <= low || bytes >= high {
                bytes = (low.max(64.0) * high).sqrt();
            }
            if high / low.max(1.0) < 1.01 {
                break;
            }
        }
        let Some((mut file, mut splats, float_error)) = best else {
            let problem = format!("{wanted} dB cannot be reached: the best fit has {reached:.2} dB");
            return Err(Error::Parameter { name: "psnr", problem });
        };
        // Where channels were left out, what they add to the error is not known here.
        if self.options.needs == Needs::Measured && self.channels == self.pixels.channels() {
            self.prune(&mut file, &mut splats, raw * 10f64.powf(-0.1 * wanted))?;
        }
        Ok((file, splats, float_error))
    }

    /// The file of a picture of one colour, where that is what there is and the file may be as large.
    fn constant(&mut self) -> Result<Option<Outcome>> {
        let most = match self.options.target {
            Target::Ratio(ratio) => (self.samples() / ratio).floor() as u64,
            Target::Bytes(bytes) => bytes,
            Target::Primitives(0) => 0,
            _ => u64::MAX,
        };
        if self.blend != Blend::Normalized || !leave_out::is_constant(self.pixels) {
            return Ok(None);
        }
        let mut splats = self.empty();
        leave_out::constant(&mut splats, self.planes.mean);
        let bytes = self.file(&splats)?;
        if bytes.len() as u64 > most {
            return Ok(None);
        }
        note(&mut self.left_out, "the fit: the picture is one colour", 0, 0.0);
        let error = self.fitted_error(&splats);
        Ok(Some((bytes, splats, error)))
    }

    /// Fits a picture of `size` with about `count` primitives to begin with, and puts back what was left out.
    fn at_count(&mut self, count: usize, size: Size) -> Result<Outcome> {
        let whole = self.channels == self.pixels.channels();
        let most = match size {
            Size::Bytes(most) => most,
            Size::Free => u64::MAX,
        };
        // What the constant channels may take; corrected where that is too little.
        let mut spare = if whole { 0 } else { 6 + most.min(1 << 30) / 400 };
        loop {
            let narrow = match size {
                Size::Bytes(most) => Size::Bytes(most.saturating_sub(spare)),
                Size::Free => Size::Free,
            };
            let (mut bytes, mut splats, float_error) = self.fitted(count, narrow)?;
            if !whole {
                bytes = self.file(&splats)?;
            }
            if self.options.needs == Needs::Measured {
                let enough = leave_out::rounding(self.pixels.depth()) * self.fitted_samples();
                self.prune(&mut bytes, &mut splats, enough)?;
            }
            // Whatever a fit came to, it is not worse than one colour.
            let alone = PackedSplats { gaussians: Vec::new(), codebook: None, levels: Vec::new(), ..splats.clone() };
            let error = self.fitted_error(&splats);
            if error.is_nan() || error > self.fitted_error(&alone) {
                (bytes, splats) = (self.file(&alone)?, alone);
            }
            let over = (bytes.len() as u64).saturating_sub(most);
            if over == 0 {
                return Ok((bytes, splats, float_error));
            }
            if splats.gaussians.is_empty() {
                let problem = format!("{most} bytes cannot hold the picture: {} are needed", bytes.len());
                return Err(Error::Parameter { name: "bytes", problem });
            }
            spare += over + 4;
        }
    }

    /// The file, with the channels that were left out put back.
    fn file(&self, splats: &PackedSplats) -> Result<Vec<u8>> {
        match self.channels == splats.channels {
            true => crate::bitstream::to_bytes(splats),
            false => crate::bitstream::to_bytes(&leave_out::widen(splats, self.channels)),
        }
    }

    /// Takes out the primitives without which the squared error of what was fitted stays within `enough`.
    fn prune(&mut self, bytes: &mut Vec<u8>, splats: &mut PackedSplats, enough: f64) -> Result<()> {
        let clock = self.tracer.seconds();
        let scene = self.stored_scene(splats);
        let Some(pruned) = leave_out::pruned(&scene, &self.planes, splats, enough) else { return Ok(()) };
        let file = self.file(&pruned)?;
        if file.len() < bytes.len() {
            let what = "primitives without which the error stays below that of rounding, or of the target";
            note(&mut self.left_out, what, (bytes.len() - file.len()) as u64, 0.0);
            (*bytes, *splats) = (file, pruned);
        }
        self.stages.push(("prune", self.tracer.seconds() - clock));
        Ok(())
    }

    /// Notes what a codebook saved, from a file written without it.
    fn note_codebook(&mut self, bytes: &[u8], splats: &PackedSplats) -> Result<()> {
        if splats.codebook.is_some() {
            let direct = self.file(&PackedSplats { codebook: None, ..splats.clone() })?;
            let what = "a colour of its own for each primitive: a codebook is smaller";
            note(&mut self.left_out, what, direct.len().saturating_sub(bytes.len()) as u64, 0.0);
        }
        Ok(())
    }

    /// Samples of what is fitted.
    fn fitted_samples(&self) -> f64 {
        self.samples() / self.channels.count() as f64 * self.pixels.channels().count() as f64
    }

    /// Weighs the errors by structure, where that is asked for and weighs anything.
    fn weigh(&mut self, count: usize) {
        // The recipe of the paper has its own terms.
        if self.options.tune == Tune::Psnr && self.options.recipe == Recipe::Ssplat {
            note(&mut self.left_out, "SSIM terms: the fit is tuned for PSNR", 0, 0.0);
        }
        if self.options.tune == Tune::Ssim {
            self.planes.amplitude = structure::amplitudes(&self.planes, count);
            if self.options.needs == Needs::Measured && leave_out::is_even(&self.planes) {
                self.planes.amplitude.clear();
                note(&mut self.left_out, "SSIM terms: the picture is so even that all pixels weigh the same", 0, 0.0);
            }
        }
    }

    /// Fits the narrow picture.
    fn fitted(&mut self, count: usize, size: Size) -> Result<Outcome> {
        let mut plan = Plan::new(self.options.effort, count, self.options.time, self.options.seed);
        plan.levels = self.options.levels;
        if self.options.needs == Needs::Measured {
            plan.enough = leave_out::enough(self.options.target, self.pixels.depth());
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
                self.choice.fit(&scene, self.pixels, planes, count, &plan, &mut recount, &mut watch_fit)?
            }
            Recipe::SmartSplat(parts) => {
                smartsplat::fit(&scene, planes, count, parts, &plan, &mut recount, &mut watch_fit)?
            }
        };
        let seconds = tracer.seconds() - clock;
        self.stages.push(("fit", seconds));
        if state.is_enough {
            let each = seconds / f64::from(iterations);
            let seconds = each * f64::from(plan.iterations - iterations);
            let what = "iterations: the error is below that of rounding, or well below the target";
            note(&mut self.left_out, what, 0, seconds);
        }
        let float_error = finish::float_error(&scene, planes, &state.primitives);
        clock = tracer.seconds();
        let bytes = finish::finish(&scene, planes, state, &mut splats, size, &plan, &mut |done, now| {
            watch(tracer, "finish", done, now)
        })?;
        self.stages.push(("finish", tracer.seconds() - clock));
        Ok((bytes, splats, float_error))
    }

    /// Makes the stored picture the trace's last point.
    fn trace_end(&mut self, splats: &PackedSplats) {
        let scene = self.stored_scene(splats);
        let drawing = || (scene, finish::projected(&splats.quantizer(), &splats.gaussians, splats.height));
        self.tracer.step("written", self.original, &self.planes, &drawing);
    }

    fn stored_scene(&self, splats: &PackedSplats) -> Scene {
        Scene { background: splats.quantizer().dequantize_color(splats.background), ..self.scene() }
    }

    /// Seconds that the channels that were left out would have taken: one iteration with them and one without tell.
    fn seconds_of_channels(&self, pixels: &Pixels, splats: &PackedSplats) -> f64 {
        let scene = self.stored_scene(splats);
        let projected = finish::projected(&splats.quantizer(), &splats.gaussians, splats.height);
        let seconds = |planes: &Planes| {
            let draw = || leave_out::drawing_seconds(&scene, planes, &projected);
            draw().min(draw())
        };
        let spent: f64 = self.stages.iter().map(|s| s.1).sum();
        spent * (seconds(&Planes::new(pixels)) / seconds(&self.planes).max(1e-9) - 1.0).max(0.0)
    }

    /// Squared error of the stored picture over the samples of the caller's channels.
    fn error(&self, splats: &PackedSplats) -> f64 {
        if self.channels == self.pixels.channels() {
            return self.fitted_error(splats);
        }
        let wide = leave_out::widen(splats, self.channels);
        let planes = Planes::new(self.original);
        let scene = Scene { background: wide.quantizer().dequantize_color(wide.background), ..self.scene() };
        finish::packed_error(&scene, &planes, &wide.quantizer(), &wide.gaussians)
    }

    /// Squared error of the stored picture over the samples that were fitted.
    fn fitted_error(&self, splats: &PackedSplats) -> f64 {
        let (quantizer, scene) = (splats.quantizer(), self.stored_scene(splats));
        finish::packed_error(&scene, &self.planes, &quantizer, &splats.gaussians)
    }
}
