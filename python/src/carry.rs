//! Choice of the metadata of a picture that its file carries.

use image::metadata::Orientation;
use pyo3::prelude::*;
use pyo3::types::PyBytes;

use crate::names;

/// A block of metadata, where there is one.
type Block<'py> = Option<Bound<'py, PyBytes>>;

/// `(ICC profile, EXIF block)` that a file carries by the rule `which` of what its picture has.
#[pyfunction]
pub fn carried<'py>(
    py: Python<'py>,
    which: &str,
    icc: Option<Vec<u8>>,
    exif: Option<Vec<u8>>,
) -> PyResult<(Block<'py>, Block<'py>)> {
    let which = names::value("metadata", &names::CARRIES, which)?;
    let orientation = exif.as_deref().and_then(Orientation::from_exif_chunk).unwrap_or(Orientation::NoTransforms);
    let carried = which.of(icc, exif, orientation);
    let bytes = |block: Option<Vec<u8>>| block.map(|block| PyBytes::new(py, &block));
    Ok((bytes(carried.icc), bytes(carried.exif)))
}
