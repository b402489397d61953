//! Facts about a file.

use std::collections::BTreeMap;

use pyo3::prelude::*;
use pyo3::pybacked::PyBackedBytes;
use pyo3::types::{PyBytes, PyDict};
use ssplat::unstable::bitstream;
use ssplat::unstable::bitstream::header::{Header, Sections};
use ssplat::unstable::bitstream::report::Report;
use ssplat::unstable::bitstream::splats::{Metadata, PackedSplats, Steps};
use ssplat::{Limits, Reader};

use crate::failure::exception;
use crate::{carry, decode, names, work};

/// `(width, height, channels, bits, whether there is metadata)` from the first bytes of a file; 32 are enough.
#[pyfunction]
pub fn header(data: &[u8]) -> PyResult<(u32, u32, usize, usize, bool)> {
    let h = Header::read(&mut &data[..], &Limits::default()).map_err(exception)?;
    Ok((h.width, h.height, h.channels.count(), 8 * h.depth.bytes(), h.sections == Sections::Present))
}

/// Returns the bytes of a section, if it exists.
type Section = Option<Py<PyBytes>>;

/// Returns `(code points, ICC profile, EXIF block)` without reading the picture.
#[pyfunction]
#[pyo3(signature = (data, limits = None))]
pub fn metadata(
    py: Python<'_>,
    data: PyBackedBytes,
    limits: Option<BTreeMap<String, i128>>,
) -> PyResult<(Option<(u8, u8, u8, u8)>, Section, Section)> {
    let limits = decode::limits(limits.as_ref())?;
    let Metadata { cicp, icc, exif, .. } =
        work::run(py, 1, &work::Calls::default(), move |_| Reader::new(&data, &limits)?.metadata())?;
    let bytes = |v: Option<Vec<u8>>| v.map(|v| PyBytes::new(py, &v).unbind());
    Ok((cicp.map(carry::numbers), bytes(icc), bytes(exif)))
}

/// Returns all properties except the Gaussians.
#[pyfunction]
#[pyo3(signature = (data, limits = None))]
pub fn info<'py>(
    py: Python<'py>,
    data: PyBackedBytes,
    limits: Option<BTreeMap<String, i128>>,
) -> PyResult<Bound<'py, PyDict>> {
    let limits = decode::limits(limits.as_ref())?;
    let (splats, report) = work::run(py, 1, &work::Calls::default(), move |_| bitstream::inspect(&data, &limits))?;
    let h = &report.header;
    let d = PyDict::new(py);
    d.set_item("width", h.width)?;
    d.set_item("height", h.height)?;
    d.set_item("channels", h.channels.count())?;
    d.set_item("bits", 8 * h.depth.bytes())?;
    d.set_item("bytes", report.bytes)?;
    d.set_item("gaussians", h.gaussians)?;
    d.set_item("layout", names::word(&names::LAYOUTS, h.layout))?;
    d.set_item("blend", names::word(&names::BLENDS, h.blend))?;
    d.set_item("levels", if report.levels.is_empty() { vec![h.gaussians] } else { report.levels.clone() })?;
    d.set_item("groups", report.groups)?;
    d.set_item("codebook", splats.codebook.as_ref().map(Vec::len))?;
    d.set_item("detail", detail(py, &splats, &report)?)?;
    d.set_item("exact", exact(py, &splats, &report)?)?;
    d.set_item("steps", steps(py, &h.steps)?)?;
    let parts = PyDict::new(py);
    for part in &report.parts {
        parts.set_item(part.name, part.bytes)?;
    }
    d.set_item("parts", parts)?;
    let bytes = |v: &Option<Vec<u8>>| v.as_ref().map(|v| PyBytes::new(py, v));
    d.set_item("cicp", splats.metadata.cicp.map(carry::numbers))?;
    d.set_item("icc_profile", bytes(&splats.metadata.icc))?;
    d.set_item("exif", bytes(&splats.metadata.exif))?;
    d.set_item("thumbnail", bytes(&splats.metadata.thumbnail))?;
    Ok(d)
}

/// Returns the facts about the detail layer, if there is one.
fn detail<'py>(py: Python<'py>, splats: &PackedSplats, report: &Report) -> PyResult<Option<Bound<'py, PyDict>>> {
    let Some(layer) = &splats.detail else { return Ok(None) };
    let d = PyDict::new(py);
    d.set_item("bytes", report.layer_bytes())?;
    d.set_item("bits", report.layer_bits)?;
    d.set_item("levels", layer.levels())?;
    d.set_item("tiles", layer.tiles())?;
    d.set_item("of_tiles", layer.of_tiles())?;
    Ok(Some(d))
}

/// Returns the facts about the exact layer, if there is one.
fn exact<'py>(py: Python<'py>, splats: &PackedSplats, report: &Report) -> PyResult<Option<Bound<'py, PyDict>>> {
    let Some(layer) = &splats.exact else { return Ok(None) };
    let d = PyDict::new(py);
    d.set_item("bytes", report.exact_bytes())?;
    d.set_item("covered_pixels", layer.covered([splats.width, splats.height]))?;
    d.set_item("tile_side", layer.tile_side())?;
    Ok(Some(d))
}

/// The step indices of the header.
pub fn steps<'py>(py: Python<'py>, s: &Steps) -> PyResult<Bound<'py, PyDict>> {
    let d = PyDict::new(py);
    d.set_item("scale", s.scale)?;
    d.set_item("angle", s.angle)?;
    d.set_item("position", s.position)?;
    d.set_item("coarsest", s.coarsest)?;
    d.set_item("range", s.range)?;
    d.set_item("luma", s.luma)?;
    d.set_item("chroma", s.chroma)?;
    Ok(d)
}
