//! Pixels to a file.

use std::time::Duration;

use pyo3::prelude::*;
use pyo3::pybacked::PyBackedBytes;
use pyo3::types::PyBytes;
use ssplat::{EncodeOptions, Target, Thumbnail};

use crate::failure::{integer, parameter};
use crate::{array, names, work};

/// The options of `ssplat.encode`, all of them.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct Options {
    ratio: Option<f64>,
    bytes: Option<i128>,
    psnr: Option<f64>,
    primitives: Option<i128>,
    effort: i128,
    time: Option<f64>,
    seed: i128,
    threads: Option<i128>,
    layout: String,
    blend: Option<String>,
    tune: Option<String>,
    needs: String,
    backend: String,
    levels: i128,
    tiles: Option<i128>,
    thumbnail: Option<Carried>,
    icc_profile: Option<PyBackedBytes>,
    exif: Option<PyBackedBytes>,
}

/// `"auto"`, or the most bytes of a thumbnail.
#[derive(FromPyObject)]
enum Carried {
    Bytes(i128),
    Name(String),
}

impl Options {
    fn target(&self) -> PyResult<Target> {
        match (self.ratio, self.bytes, self.psnr, self.primitives) {
            (None, None, None, None) => Ok(Target::Auto),
            (Some(ratio), None, None, None) => Ok(Target::Ratio(ratio)),
            (None, Some(bytes), None, None) => Ok(Target::Bytes(integer("bytes", bytes)?)),
            (None, None, Some(psnr), None) => Ok(Target::Psnr(psnr)),
            (None, None, None, Some(count)) => Ok(Target::Primitives(integer("primitives", count)?)),
            _ => Err(parameter("ratio", "only one of ratio, bytes, psnr and primitives can be asked for")),
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
        o.needs = names::value("needs", &names::NEEDS, &self.needs)?;
        o.backend = names::value("backend", &names::BACKENDS, &self.backend)?;
        o.icc = self.icc_profile.as_ref().map(|b| b.to_vec());
        o.exif = self.exif.as_ref().map(|b| b.to_vec());
        Ok(o)
    }
}

/// The file of a contiguous array of uint8 or uint16.
#[pyfunction]
pub fn encode<'py>(
    py: Python<'py>,
    image: &Bound<'py, PyAny>,
    options: Options,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyBytes>> {
    let threads = work::threads(options.threads, usize::MAX)?;
    let parsed = options.parse()?;
    let pixels = array::pixels("image", image)?;
    let encoded = work::run(py, threads, progress, move |reporter| {
        ssplat::encode_with_progress(&pixels, &parsed, &mut |p| reporter.step(p))
    })?;
    Ok(PyBytes::new(py, &encoded.bytes))
}
