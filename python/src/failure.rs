//! Conversion of the library's errors to Python exceptions, with one class for each kind (`ssplat/errors.py`).

use pyo3::PyErr;
use ssplat::{Error, FormatError, Parameter, Target};

mod kinds {
    pyo3::import_exception!(ssplat.errors, CancelledError);
    pyo3::import_exception!(ssplat.errors, Error);
    pyo3::import_exception!(ssplat.errors, FormatError);
    pyo3::import_exception!(ssplat.errors, GpuError);
    pyo3::import_exception!(ssplat.errors, IoError);
    pyo3::import_exception!(ssplat.errors, LimitExceededError);
    pyo3::import_exception!(ssplat.errors, ParameterError);
    pyo3::import_exception!(ssplat.errors, TruncatedError);
    pyo3::import_exception!(ssplat.errors, UnsupportedVersionError);
}

/// Returns the exception for `error`.
pub fn exception(error: Error) -> PyErr {
    let text = match &error {
        Error::Format(cut @ FormatError::CutOff { partial: true, .. }) => {
            format!("the file is {cut}; partial=True decodes what is there")
        }
        error => error.to_string(),
    };
    match error {
        Error::Format(FormatError::CutOff { bytes, of, .. }) => kinds::TruncatedError::new_err((text, bytes, of)),
        Error::Io(_) => kinds::IoError::new_err(text),
        Error::Format(_) => kinds::FormatError::new_err(text),
        Error::UnsupportedVersion { found } => kinds::UnsupportedVersionError::new_err((text, found)),
        Error::LimitExceeded { limit, requested, allowed } => {
            kinds::LimitExceededError::new_err((text, limit.name(), requested, allowed))
        }
        Error::Parameter { parameter, .. } => kinds::ParameterError::new_err((text, parameter.name())),
        Error::TooSmall { asked, .. } => kinds::ParameterError::new_err((text, asked_by(asked))),
        Error::Cancelled => kinds::CancelledError::new_err(text),
        Error::Gpu(_) => kinds::GpuError::new_err(text),
        _ => kinds::Error::new_err(text),
    }
}

/// Returns the name of the argument that sets the target.
fn asked_by(target: Target) -> &'static str {
    if matches!(target, Target::Ratio(_)) { "ratio" } else { "bytes" }
}

/// Returns the exception for an invalid argument that does not reach the library.
pub fn parameter(name: &'static str, problem: impl Into<String>) -> PyErr {
    exception(Error::Parameter { parameter: Parameter::Other(name), problem: problem.into() })
}

/// Returns the exception for a panic of the library, which is a bug.
pub fn panicked() -> PyErr {
    kinds::Error::new_err("the library panicked; this is a bug in it")
}

/// Converts an integer argument to the type of the library.
pub fn integer<T: TryFrom<i128>>(name: &'static str, value: i128) -> Result<T, PyErr> {
    T::try_from(value).map_err(|_| parameter(name, format!("{value} is out of range")))
}
