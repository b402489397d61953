//! Decoding of files to pixels.

use std::collections::BTreeMap;

use pyo3::prelude::*;
use pyo3::pybacked::PyBackedBytes;
use ssplat::View;
use ssplat::unstable::bitstream::MissingParts;
use ssplat::{Damage, Depth, Error, Layers, Limits, Pixels, Reader, Rect, Result};

use crate::failure::{exception, integer, parameter};
use crate::{array, work};

/// Minimum number of output pixels per thread.
const PIXELS_A_THREAD: u64 = 1 << 16;

/// All options of `ssplat.decode`.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct Options {
    region: Option<[i128; 4]>,
    size: Option<[i128; 2]>,
    bits: Option<i128>,
    partial: bool,
    detail: bool,
    threads: Option<i128>,
    limits: Option<BTreeMap<String, i128>>,
}

/// The part of the file to render, and how to render it.
struct Job {
    view: View,
    depth: Depth,
    damage: Damage,
    limits: Limits,
}

impl Job {
    fn new(data: &[u8], options: &Options) -> PyResult<Self> {
        let limits = limits(options.limits.as_ref())?;
        let opening = Reader::new(data, &limits).map_err(exception)?;
        let layers = if options.detail { Layers::Both } else { Layers::Gaussians };
        let mut view = opening.view().layers(layers);
        if let Some(region) = options.region {
            let [x, y, width, height] = whole("region", region)?;
            view = view.crop(Rect::new(x, y, width, height)).map_err(|e| wrong("region", e))?;
        }
        if let Some(size) = options.size {
            let [width, height] = whole("size", size)?;
            view = view.resized(width, height).map_err(|e| wrong("size", e))?;
        }
        let depth = match options.bits {
            None => opening.header().depth,
            Some(8) => Depth::Eight,
            Some(16) => Depth::Sixteen,
            Some(bits) => return Err(parameter("bits", format!("{bits} is neither 8 nor 16"))),
        };
        let damage = if options.partial { Damage::Accept } else { Damage::Refuse };
        Ok(Job { view, depth, damage, limits })
    }

    fn run(&self, data: &[u8]) -> Result<(Pixels, MissingParts)> {
        let opened = Reader::new(data, &self.limits)?.damage(self.damage).read_for(&self.view)?;
        let missing = opened.missing();
        let renderer = opened.renderer(&self.view)?;
        // The integers are dropped to free memory for the pixels.
        drop(opened);
        Ok((renderer.render(self.depth)?, missing))
    }
}

/// Returns the exception for an error of the library about the value of the argument `name`.
fn wrong(name: &'static str, error: Error) -> PyErr {
    match error {
        Error::Parameter { problem, .. } => parameter(name, problem),
        error => exception(error),
    }
}

fn whole<const N: usize>(name: &'static str, values: [i128; N]) -> PyResult<[u32; N]> {
    let mut out = [0; N];
    for (out, value) in out.iter_mut().zip(values) {
        *out = integer(name, value)?;
    }
    Ok(out)
}

/// Returns the default limits, with those of the caller replaced.
pub fn limits(changes: Option<&BTreeMap<String, i128>>) -> PyResult<Limits> {
    let mut limits = Limits::default();
    for (name, &value) in changes.into_iter().flatten() {
        match name.as_str() {
            "width" => limits.width = integer("limits", value)?,
            "height" => limits.height = integer("limits", value)?,
            "gaussians" => limits.gaussians = integer("limits", value)?,
            "tile_pairs" => limits.tile_pairs = integer("limits", value)?,
            "work" => limits.work = integer("limits", value)?,
            "overlap" => limits.overlap = integer("limits", value)?,
            "alloc" => limits.alloc = integer("limits", value)?,
            "metadata" => limits.metadata = integer("limits", value)?,
            _ => return Err(parameter("limits", format!("there is no limit {name:?}"))),
        }
    }
    Ok(limits)
}

/// Numbers of missing Gaussians, missing groups and all groups, of missing and all tiles of the detail layer, and of
/// missing and all tiles of the exact layer; and whether the file is truncated or its checksum is wrong.
type Lost = (u32, u32, u32, [u32; 2], [u32; 2], bool);

/// Returns the array, and the missing parts.
#[pyfunction]
pub fn decode<'py>(py: Python<'py>, data: PyBackedBytes, options: Options) -> PyResult<(Bound<'py, PyAny>, Lost)> {
    let job = Job::new(&data, &options)?;
    let pixels = u64::from(job.view.width()) * u64::from(job.view.height());
    let threads = work::threads(options.threads, usize::try_from(pixels / PIXELS_A_THREAD).unwrap_or(usize::MAX))?;
    let (pixels, missing) = work::run(py, threads, &work::Calls::default(), move |_| job.run(&data))?;
    let MissingParts { gaussians, groups, of_groups, tiles, of_tiles, exact_tiles, of_exact_tiles, damaged, .. } =
        missing;
    let detail = [tiles - exact_tiles, of_tiles - of_exact_tiles];
    let lost = (gaussians, groups, of_groups, detail, [exact_tiles, of_exact_tiles], damaged);
    Ok((array::array(py, pixels)?, lost))
}
