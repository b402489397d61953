//! One measurement: a picture encoded with one set of options and decoded, with all results. It is stored as a JSON
//! file, so that an interrupted report can be continued.

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::time::Instant;

use serde_json::{Value, json};
use ssplat::unstable::EncodeOptions;
use ssplat::unstable::Recipe;
use ssplat::unstable::bitstream::splats::Layout;
use ssplat::{Backend, Blend, Limits, Pixels, Rect, Target, Tune};
use ssplat::{Renderer, View};

use crate::smartsplat::Ablation;
use crate::trace::{TracePoint, traced};

use ssplat_cli::compare;
use ssplat_cli::failure::Failure;
use ssplat_cli::source;

/// Longest side of the thumbnail whose decoding is timed, pixels.
const THUMBNAIL: u32 = 160;
/// Side of the region whose decoding is timed, pixels, if the picture is large enough.
const REGION: u32 = 256;
/// Repetitions of a decode; the fastest counts.
const REPEATS: usize = 7;

/// A picture of the report.
pub struct Subject {
    pub name: String,
    pub pixels: Pixels,
}

/// Returns the name of `backend` on the command line.
pub fn backend_name(backend: Backend) -> &'static str {
    match backend {
        Backend::Cpu => "cpu",
        Backend::Gpu => "gpu",
        _ => "auto",
    }
}

/// Settings that differ between cells.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Setup {
    pub ratio: f64,
    pub effort: u8,
    /// SmartSplat's method with these parts, instead of ours.
    pub smartsplat: Option<&'static Ablation>,
    pub blend: Option<Blend>,
    pub backend: Backend,
}

impl Setup {
    /// Returns the name of the setup in a chart and in the cache.
    pub fn recipe_name(&self) -> String {
        let recipe = match self.smartsplat {
            None => "ssplat",
            Some(Ablation::Random) => "SmartSplat: random start",
            Some(Ablation::Means) => "SmartSplat: + means",
            Some(Ablation::Scales) => "SmartSplat: + scales",
            Some(Ablation::Colors) => "SmartSplat: + colours (whole)",
        };
        match (self.smartsplat, self.blend) {
            (None, Some(Blend::Sum)) => format!("{recipe}, sum"),
            (Some(_), Some(Blend::Normalized)) => format!("{recipe}, normalized"),
            _ => recipe.into(),
        }
    }

    pub fn backend_name(&self) -> &'static str {
        backend_name(self.backend)
    }

    fn name(&self) -> String {
        format!("ratio {} effort {} {} {}", self.ratio, self.effort, self.recipe_name(), self.backend_name())
    }

    fn options(&self) -> EncodeOptions {
        let mut o = EncodeOptions::default();
        o.target = Target::Ratio(self.ratio);
        o.effort = self.effort;
        o.recipe = self.smartsplat.map_or(Recipe::Ssplat, |parts| Recipe::Other(parts));
        o.blend = self.blend;
        o.backend = self.backend;
        o.layout = Layout::Coded;
        // The pages compare squared errors.
        o.tune = Some(Tune::Psnr);
        o
    }
}

/// A setup on a picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Job {
    pub subject: usize,
    pub setup: Setup,
}

/// Result of a job.
pub struct Cell {
    pub job: Job,
    /// The measurements; only `error` if the encoder failed.
    pub values: Value,
    /// The file; empty if the encoder failed.
    pub bytes: Vec<u8>,
}

impl Cell {
    /// Returns a value of the cell by its key; NaN if it has none.
    pub fn number(&self, key: &str) -> f64 {
        self.values[key].as_f64().unwrap_or(f64::NAN)
    }

    pub fn failed(&self) -> Option<&str> {
        self.values["error"].as_str()
    }

    /// Returns the pairs of a name and a number under `key`.
    pub fn pairs(&self, key: &str) -> Vec<(String, f64)> {
        let list = self.values[key].as_array().map(Vec::as_slice).unwrap_or_default();
        list.iter().map(|p| (p[0].as_str().unwrap_or("").into(), p[1].as_f64().unwrap_or(0.0))).collect()
    }

    /// Returns `measure` during the encode, against its seconds.
    pub fn trace(&self, measure: &str) -> Vec<(f64, f64)> {
        let list = self.values["trace"].as_array().map(Vec::as_slice).unwrap_or_default();
        list.iter().filter_map(|p| Some((p["seconds"].as_f64()?, p[measure].as_f64()?))).collect()
    }
}

/// Returns the path of a job's results. The name depends on the samples, the setup and the program's version.
pub fn path(folder: &Path, subject: &Subject, setup: &Setup) -> PathBuf {
    let mut hash = crc32fast::Hasher::new();
    match subject.pixels.samples() {
        ssplat::Samples::U8(v) => hash.update(v),
        ssplat::Samples::U16(v) => v.iter().for_each(|v| hash.update(&v.to_le_bytes())),
    }
    hash.update(format!("{} {} {}", subject.pixels.width(), setup.name(), env!("CARGO_PKG_VERSION")).as_bytes());
    folder.join(format!("{}-{:08x}.json", stem(&subject.name), hash.finalize()))
}

fn stem(name: &str) -> String {
    let stem = Path::new(name).file_stem().unwrap_or_default().to_string_lossy().into_owned();
    stem.chars().map(|c| if c.is_ascii_alphanumeric() || c == '-' || c == '_' { c } else { '_' }).collect()
}

/// Reads a finished job.
pub fn load(path: &Path, job: Job) -> Option<Cell> {
    let values: Value = serde_json::from_slice(&std::fs::read(path).ok()?).ok()?;
    if values["error"].is_string() {
        return Some(Cell { job, values, bytes: Vec::new() });
    }
    let bytes = std::fs::read(path.with_extension("ssplat")).ok()?;
    (values["bytes"].as_u64()? == bytes.len() as u64).then_some(Cell { job, values, bytes })
}

/// Runs the job and stores its results. `progress` is called with the fraction that is done.
pub fn run(path: &Path, job: Job, subject: &Subject, progress: &mut dyn FnMut(f32)) -> Result<Cell, Failure> {
    let options = job.setup.options();
    let (encoded, trace) = traced(&options, |options| {
        ssplat::unstable::encode_with_progress(&subject.pixels, options, &mut |p| {
            progress(if p.stage == "fit" { 0.8 * p.done } else { 0.8 + 0.2 * p.done });
            ControlFlow::Continue(())
        })
    });
    let cell = match encoded {
        Ok(encoded) => {
            let values = measure(&encoded, &trace, &job, subject)?;
            Cell { job, values, bytes: encoded.bytes }
        }
        Err(e) => Cell { job, values: json!({ "error": e.to_string() }), bytes: Vec::new() },
    };
    // The JSON is written last: a job is finished only if its file exists as well.
    let io = |e| Failure::io(path, &e);
    std::fs::write(path.with_extension("ssplat"), &cell.bytes).map_err(io)?;
    std::fs::write(path, cell.values.to_string()).map_err(io)?;
    Ok(cell)
}

fn measure(encoded: &ssplat::Encoded, trace: &[TracePoint], job: &Job, subject: &Subject) -> Result<Value, Failure> {
    let path = Path::new(&subject.name);
    let failed = |e| Failure::library(path, &e);
    let limits = Limits::default();
    let (splats, report) = ssplat::unstable::bitstream::inspect(&encoded.bytes, &limits).map_err(failed)?;
    let decoded = source::decode(path, &encoded.bytes)?;
    let found = compare::measure(&subject.pixels, &decoded.pixels).map_err(failed)?;
    let (width, height) = (splats.width, splats.height);
    let full = View::new(width, height);
    let side = [width.min(REGION), height.min(REGION)];
    let region =
        full.crop(Rect::new((width - side[0]) / 2, (height - side[1]) / 2, side[0], side[1])).map_err(failed)?;
    let scale = f64::from(THUMBNAIL) / f64::from(width.max(height));
    let small = |v: u32| (f64::from(v) * scale).round().max(1.0) as u32;
    let thumbnail = full.resized(small(width), small(height)).map_err(failed)?;
    let time = |view: &View| -> Result<f64, Failure> {
        let mut best = f64::INFINITY;
        for _ in 0..REPEATS {
            let clock = Instant::now();
            let splats = ssplat::unstable::bitstream::read(&encoded.bytes[..], &limits).map_err(failed)?;
            let renderer = Renderer::new(&splats.to_gaussians(), view, &limits).map_err(failed)?;
            std::hint::black_box(renderer.render(splats.depth).map_err(failed)?);
            best = best.min(clock.elapsed().as_secs_f64());
        }
        Ok(1e3 * best)
    };
    let r = &encoded.report;
    let parts: Vec<Value> = report.parts.iter().map(|p| json!([p.name, p.bytes])).collect();
    let fields: Vec<Value> = report.fields.iter().map(|f| json!([f.name, f.bits / 8.0])).collect();
    let left_out: Vec<Value> = r
        .skipped
        .iter()
        .map(|l| json!({ "what": l.what.to_string(), "bytes": l.bytes, "seconds": l.seconds }))
        .collect();
    let trace: Vec<Value> = trace
        .iter()
        .map(|p| {
            json!({
                "stage": p.stage, "seconds": p.seconds, "step": p.step, "primitives": p.primitives,
                "psnr": p.psnr.min(compare::IDENTICAL), "ssim": p.ssim, "ms_ssim": p.ms_ssim,
            })
        })
        .collect();
    Ok(json!({
        "image": subject.name,
        "width": width,
        "height": height,
        "channels": splats.channels.count(),
        "ratio_asked": job.setup.ratio,
        "effort": job.setup.effort,
        "recipe": job.setup.recipe_name(),
        "backend": job.setup.backend_name(),
        "device": r.chosen.device,
        "bytes": encoded.bytes.len(),
        "primitives": r.gaussians,
        "psnr": found.psnr.min(compare::IDENTICAL),
        "ssim": found.ssim,
        "ms_ssim": found.ms_ssim,
        "ssimulacra2": found.perceived.ssimulacra2,
        "butteraugli": found.perceived.butteraugli,
        "float_psnr": r.float_psnr.min(compare::IDENTICAL),
        "seconds": r.seconds,
        "decode_ms_full": time(&full)?,
        "decode_ms_region": time(&region)?,
        "decode_ms_thumbnail": time(&thumbnail)?,
        "stages": r.stages.iter().map(|s| json!([s.name, s.seconds])).collect::<Vec<_>>(),
        "parts": parts,
        "fields": fields,
        "left_out": left_out,
        "trace": trace,
    }))
}
