//! Pixels to bytes: the whole encoder behind one function.

use std::ops::ControlFlow;

use crate::bitstream::splats::{Layout, Metadata, PackedSplats, Steps};
use crate::error::{Error, Result};
use crate::fit;
use crate::fit::field::Scene;
use crate::fit::finish::{self, Size};
use crate::fit::plan::Plan;
use crate::fit::project::Primitive;
use crate::fit::target::Target as Planes;
use crate::gaussian::Blend;
use crate::options::{EncodeOptions, Recipe, Target};
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
    /// Quality along the way; empty unless [`EncodeOptions::trace`] asks for it.
    pub trace: Vec<TracePoint>,
}

/// Something that the encoder measured and found unnecessary.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct LeftOut {
    /// What it is.
    pub what: &'static str,
    /// Bytes saved.
    pub bytes: u64,
    /// Seconds saved.
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
    let planes = Planes::new(pixels);
    let mut session = Session { pixels, options, blend, planes, progress, tracer, stages: Vec::new() };
    let (bytes, splats, float_error) = match options.target {
        Target::Ratio(ratio) => {
            let raw = session.samples();
            session.at_size(Size::Bytes((raw / ratio).floor() as u64))?
        }
        Target::Bytes(bytes) => session.at_size(Size::Bytes(bytes))?,
        Target::Primitives(count) => session.at_count(count as usize, Size::Free)?,
        Target::Psnr(psnr) => session.at_psnr(psnr)?,
    };
    session.trace_end(&splats);
    let error = session.error(&splats);
    let samples = session.samples();
    let report = EncodeReport {
        primitives: splats.gaussians.len(),
        psnr: decibels(error, samples),
        float_psnr: decibels(float_error, samples),
        seconds: session.tracer.seconds(),
        stages: session.stages,
        left_out: Vec::new(),
        trace: session.tracer.into_points(),
    };
    Ok(Encoded { bytes, report })
}

fn decibels(error: f64, samples: f64) -> f64 {
    -10.0 * (error / samples).log10()
}

fn check(options: &EncodeOptions) -> Result<()> {
    let bad = |name, problem| Err(Error::Parameter { name, problem });
    if !(1..=9).contains(&options.effort) {
        return bad("effort", format!("{} is outside 1..=9", options.effort));
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
    pixels: &'a Pixels,
    options: &'a EncodeOptions,
    blend: Blend,
    planes: Planes,
    progress: &'a mut dyn FnMut(&Progress) -> ControlFlow<()>,
    tracer: Tracer,
    stages: Vec<(&'static str, f64)>,
}

type Outcome = (Vec<u8>, PackedSplats, f64);

impl Session<'_> {
    fn samples(&self) -> f64 {
        f64::from(self.pixels.width()) * f64::from(self.pixels.height()) * self.pixels.channels().count() as f64
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
            background: self.planes.mean,
        }
    }

    fn at_size(&mut self, size: Size) -> Result<Outcome> {
        let Size::Bytes(most) = size else { return self.at_count(0, size) };
        let fixed = crate::bitstream::to_bytes(&self.empty())?.len() as u64;
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
        best.ok_or_else(|| Error::Parameter {
            name: "psnr",
            problem: format!("{wanted} dB cannot be reached: the best fit has {reached:.2} dB"),
        })
    }

    fn at_count(&mut self, count: usize, size: Size) -> Result<Outcome> {
        let plan = Plan::new(self.options.effort, self.options.time, self.options.seed);
        let scene = self.scene();
        let mut splats = self.empty();
        let (progress, tracer) = (&mut *self.progress, &mut self.tracer);
        let (pixels, planes) = (self.pixels, &self.planes);
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
            Size::Bytes(most) => Ok(finish::count_for(primitives, &mut draft, most)?.clamp(count.min(1), count * 2)),
            Size::Free => Ok(count),
        };
        let state =
            fit::fit(&scene, planes, count, &plan, &mut recount, &mut |done, now| watch(tracer, "fit", done, now))?;
        self.stages.push(("fit", tracer.seconds() - clock));
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
        self.tracer.step("written", self.pixels, &self.planes, &drawing);
    }

    fn stored_scene(&self, splats: &PackedSplats) -> Scene {
        Scene { background: splats.quantizer().dequantize_color(splats.background), ..self.scene() }
    }

    /// Squared error of the stored picture.
    fn error(&self, splats: &PackedSplats) -> f64 {
        let (quantizer, scene) = (splats.quantizer(), self.stored_scene(splats));
        finish::packed_error(&scene, &self.planes, &quantizer, &splats.gaussians)
    }
}
