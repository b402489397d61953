//! Encoding of pixels to a file.

use std::time::Duration;

use pyo3::prelude::*;
use pyo3::pybacked::PyBackedBytes;
use pyo3::types::PyBytes;
use ssplat::unstable::EncodeOptions;
use ssplat::{Detail, Encoder, HiddenColors, PixelSource, Progress, Target, Thumbnail, Workers};

use crate::failure::{integer, parameter};
use crate::work::{Calls, Reporter};
use crate::{array, carry, names, work};

/// Maximum number of unfinished tasks.
const MOST_TASKS: i128 = 1 << 16;

/// All options of `ssplat.encode`.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct Options {
    ratio: Option<f64>,
    bytes: Option<i128>,
    psnr: Option<f64>,
    gaussians: Option<i128>,
    quality: Option<f64>,
    lossless: bool,
    effort: i128,
    time: Option<f64>,
    seed: i128,
    threads: Option<i128>,
    layout: String,
    blend: Option<String>,
    tune: Option<String>,
    needs: String,
    backend: String,
    detail: Division,
    levels: i128,
    tiles: Option<i128>,
    thumbnail: Option<Carried>,
    cicp: Option<[u8; 4]>,
    icc_profile: Option<PyBackedBytes>,
    exif: Option<PyBackedBytes>,
    keep_hidden: bool,
}

/// `"auto"`, or the maximum size of a thumbnail in bytes.
#[derive(FromPyObject)]
enum Carried {
    Bytes(i128),
    Name(String),
}

/// `"auto"`, `"off"`, or the share of the bytes for the Gaussians.
#[derive(FromPyObject)]
enum Division {
    Share(f64),
    Name(String),
}

impl Division {
    fn parse(&self) -> PyResult<Detail> {
        match self {
            Division::Share(share) if *share > 0.0 && *share < 1.0 => Ok(Detail::GaussianShare(*share)),
            Division::Share(share) => Err(parameter("detail", format!("{share} is not above 0 and below 1"))),
            Division::Name(name) => names::value("detail", &names::DETAILS, name),
        }
    }
}

impl Options {
    fn target(&self) -> PyResult<Target> {
        let asked = [
            self.ratio.map(|ratio| Ok(Target::Ratio(ratio))),
            self.bytes.map(|bytes| integer("bytes", bytes).map(Target::Bytes)),
            self.psnr.map(|psnr| Ok(Target::Psnr(psnr))),
            self.gaussians.map(|count| integer("gaussians", count).map(Target::Gaussians)),
            self.quality.map(|quality| Ok(Target::Quality(quality))),
            self.lossless.then_some(Ok(Target::Lossless)),
        ];
        let mut asked = asked.into_iter().flatten();
        match (asked.next(), asked.next()) {
            (None, _) => Ok(Target::Auto),
            (Some(target), None) => target,
            _ => {
                Err(parameter("ratio", "only one of ratio, bytes, psnr, gaussians, quality and lossless can be given"))
            }
        }
    }

    fn parse(&self) -> PyResult<EncodeOptions> {
        let mut o = EncodeOptions::default();
        o.target = self.target()?;
        o.effort = integer("effort", self.effort)?;
        o.seed = integer("seed", self.seed)?;
        o.levels = integer("levels", self.levels)?;
        o.tiles = self.tiles.map(|side| integer("tiles", side)).transpose()?;
        o.thumbnail = match &self.thumbnail {
            None => Thumbnail::Never,
            Some(Carried::Bytes(most)) => Thumbnail::Bytes(integer("thumbnail", *most)?),
            Some(Carried::Name(name)) if name == "auto" => Thumbnail::Auto,
            Some(Carried::Name(name)) => {
                return Err(parameter(
                    "thumbnail",
                    format!("{name:?} is neither 'auto' nor a number of bytes nor None"),
                ));
            }
        };
        o.time = match self.time {
            Some(s) => Some(Duration::try_from_secs_f64(s).map_err(|e| parameter("time", format!("{s}: {e}")))?),
            None => None,
        };
        o.layout = names::value("layout", &names::LAYOUTS, &self.layout)?;
        o.blend = self.blend.as_deref().map(|b| names::value("blend", &names::BLENDS, b)).transpose()?;
        o.tune = self.tune.as_deref().map(|t| names::value("tune", &names::TUNES, t)).transpose()?;
        o.detail = self.detail.parse()?;
        o.needs = names::value("needs", &names::NEEDS, &self.needs)?;
        o.backend = names::value("backend", &names::BACKENDS, &self.backend)?;
        o.cicp = self.cicp.map(carry::code_points).transpose()?;
        o.icc = self.icc_profile.as_ref().map(|b| b.to_vec());
        o.exif = self.exif.as_ref().map(|b| b.to_vec());
        o.hidden = if self.keep_hidden { HiddenColors::Keep } else { HiddenColors::Continue };
        Ok(o)
    }
}

/// Encodes a contiguous array of uint8 or uint16, or a memory map. Returns the file, its quality if one was requested,
/// and its PSNR in dB. `workers` is the function that starts a task elsewhere, and the maximum number of unfinished
/// tasks.
#[pyfunction]
pub fn encode<'py>(
    py: Python<'py>,
    image: &Bound<'py, PyAny>,
    options: Options,
    progress: Option<&Bound<'py, PyAny>>,
    workers: Option<(Bound<'py, PyAny>, i128)>,
) -> PyResult<(Bound<'py, PyBytes>, Option<f64>, f64)> {
    let threads = work::threads(options.threads, usize::MAX)?;
    let parsed = options.parse()?;
    let (start, at_once) = workers.unzip();
    let at_once = match at_once {
        Some(n @ 1..=MOST_TASKS) => Some(n as usize),
        Some(n) => return Err(parameter("at_once", format!("{n} is outside 1..={MOST_TASKS}"))),
        None => None,
    };
    let source = source(image)?;
    let calls = Calls { progress, start: start.as_ref() };
    let encoder = Encoder::from(parsed);
    let encoded = work::run(py, threads, &calls, move |reporter| {
        let mut progress = |p: &Progress| reporter.step(p);
        match at_once {
            Some(at_once) => {
                let mut others = Others { reporter, at_once };
                encoder.encode_divided(&*source, &mut others, &mut progress)
            }
            None => encoder.encode_with_progress(&*source, &mut progress),
        }
    })?;
    Ok((PyBytes::new(py, &encoded.bytes), encoded.report.quality, encoded.report.psnr))
}

/// Processes a task and returns the result.
#[pyfunction]
pub fn work_on_tile<'py>(
    py: Python<'py>,
    task: PyBackedBytes,
    threads: Option<i128>,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyBytes>> {
    let threads = work::threads(threads, usize::MAX)?;
    let calls = Calls { progress, start: None };
    let answer =
        work::run(py, threads, &calls, move |reporter| ssplat::work_on_tile(&task, &mut |p| reporter.step(p)))?;
    Ok(PyBytes::new(py, &answer))
}

/// The pixels of an array. A memory map is read when its pixels are needed; other arrays are copied.
fn source(image: &Bound<'_, PyAny>) -> PyResult<Box<dyn PixelSource + Send>> {
    let is_mapped = image.is_instance(&image.py().import("numpy")?.getattr("memmap")?)?;
    Ok(match is_mapped {
        true => Box::new(array::Mapped::new("image", image)?),
        false => Box::new(array::pixels("image", image)?),
    })
}

/// Workers that are reached through the calling thread.
struct Others<'a> {
    reporter: &'a Reporter,
    at_once: usize,
}

impl Workers for Others<'_> {
    fn submit(&mut self, task: Vec<u8>) -> ssplat::Result<()> {
        self.reporter.start(task);
        Ok(())
    }

    fn receive(&mut self) -> ssplat::Result<Vec<u8>> {
        self.reporter.wait()
    }

    fn capacity(&self) -> usize {
        self.at_once
    }
}
