//! How far two arrays are apart.

use pyo3::prelude::*;
use ssplat::unstable::metrics;

use crate::{array, work};

/// `(PSNR, SSIM, MS-SSIM)`.
#[pyfunction]
pub fn compare<'py>(
    py: Python<'py>,
    a: &Bound<'py, PyAny>,
    b: &Bound<'py, PyAny>,
    threads: Option<i128>,
) -> PyResult<(f64, Option<f64>, Option<f64>)> {
    let (a, b) = (array::pixels("a", a)?, array::pixels("b", b)?);
    let found =
        work::run(py, work::threads(threads, usize::MAX)?, &work::Calls::default(), move |_| metrics::compare(&a, &b))?;
    Ok((found.psnr, found.ssim, found.ms_ssim))
}

/// PSNR alone.
#[pyfunction]
pub fn psnr<'py>(
    py: Python<'py>,
    a: &Bound<'py, PyAny>,
    b: &Bound<'py, PyAny>,
    threads: Option<i128>,
) -> PyResult<f64> {
    let (a, b) = (array::pixels("a", a)?, array::pixels("b", b)?);
    work::run(py, work::threads(threads, usize::MAX)?, &work::Calls::default(), move |_| metrics::psnr(&a, &b))
}

/// SSIMULACRA2.
#[pyfunction]
pub fn ssimulacra2<'py>(
    py: Python<'py>,
    a: &Bound<'py, PyAny>,
    b: &Bound<'py, PyAny>,
    threads: Option<i128>,
) -> PyResult<f64> {
    let (a, b) = (array::pixels("a", a)?, array::pixels("b", b)?);
    work::run(py, work::threads(threads, usize::MAX)?, &work::Calls::default(), move |_| metrics::ssimulacra2(&a, &b))
}
