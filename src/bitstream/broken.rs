//! Error for values that violate the format.

use crate::error::{Error, FormatError};

/// A value that violates the format.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Broken {
    pub field: &'static str,
    pub value: u64,
}

impl From<Broken> for Error {
    /// Reports the violation as an error of the file.
    fn from(b: Broken) -> Self {
        FormatError::BadValue { field: b.field, value: b.value }.into()
    }
}
