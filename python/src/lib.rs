//! The codec as the Python module `ssplat._ssplat`, for which `package/ssplat` is a wrapper.
//!
//! Input arrays are copied once, so that other threads may change them in the meantime; memory maps are read when they
//! are needed. Output arrays are not copied. All work runs without the GIL, on separate threads; see [`work`].

mod array;
mod carry;
mod decode;
mod encode;
mod failure;
mod gaussians;
mod info;
mod metrics;
mod names;
mod work;

use pyo3::prelude::*;

/// Everything else is in `package/ssplat`.
#[pymodule(gil_used = false)]
fn _ssplat(m: &Bound<'_, PyModule>) -> PyResult<()> {
    m.add("__version__", env!("CARGO_PKG_VERSION"))?;
    m.add("FORMAT_VERSION", ssplat::unstable::bitstream::header::VERSION)?;
    m.add("MAGIC", pyo3::types::PyBytes::new(m.py(), &ssplat::unstable::bitstream::header::MAGIC))?;
    m.add_function(wrap_pyfunction!(carry::carried, m)?)?;
    m.add_function(wrap_pyfunction!(encode::encode, m)?)?;
    m.add_function(wrap_pyfunction!(encode::work_on_tile, m)?)?;
    m.add_function(wrap_pyfunction!(decode::decode, m)?)?;
    m.add_function(wrap_pyfunction!(info::header, m)?)?;
    m.add_function(wrap_pyfunction!(info::info, m)?)?;
    m.add_function(wrap_pyfunction!(info::metadata, m)?)?;
    m.add_function(wrap_pyfunction!(gaussians::gaussians, m)?)?;
    m.add_function(wrap_pyfunction!(gaussians::from_gaussians, m)?)?;
    m.add_function(wrap_pyfunction!(metrics::compare, m)?)?;
    m.add_function(wrap_pyfunction!(metrics::psnr, m)?)?;
    m.add_function(wrap_pyfunction!(metrics::ssimulacra2, m)?)
}
