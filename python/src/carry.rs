//! Choice of the metadata of a picture that its file carries.

use image::metadata::Orientation;
use pyo3::prelude::*;
use pyo3::types::PyBytes;

use ssplat::Cicp;

use crate::failure::parameter;
use crate::names;

/// A block of metadata, where there is one.
type Block<'py> = Option<Bound<'py, PyBytes>>;

/// `(code points, ICC profile, EXIF block)` that a file carries by the rule `which` of what its picture has.
#[pyfunction]
pub fn carried<'py>(
    py: Python<'py>,
    which: &str,
    cicp: Option<[u8; 4]>,
    icc: Option<Vec<u8>>,
    exif: Option<Vec<u8>>,
) -> PyResult<(Option<(u8, u8, u8, u8)>, Block<'py>, Block<'py>)> {
    let which = names::value("metadata", &names::CARRIES, which)?;
    let orientation = exif.as_deref().and_then(Orientation::from_exif_chunk).unwrap_or(Orientation::NoTransforms);
    let carried = which.of((cicp.map(code_points).transpose()?, icc), exif, orientation);
    let bytes = |block: Option<Vec<u8>>| block.map(|block| PyBytes::new(py, &block));
    Ok((carried.cicp.map(numbers), bytes(carried.icc), bytes(carried.exif)))
}

/// Returns the code points of four numbers.
pub fn code_points(bytes: [u8; 4]) -> PyResult<Cicp> {
    Cicp::from_bytes(&bytes).map_err(|error| parameter("cicp", error.to_string()))
}

/// Returns code points as four numbers: primaries, transfer characteristics, matrix coefficients, full range.
pub fn numbers(cicp: Cicp) -> (u8, u8, u8, u8) {
    cicp.to_bytes().into()
}
