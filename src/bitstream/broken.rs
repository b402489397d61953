//! Values that break the rules of the format.

use crate::error::{Error, FormatError};

/// A value that is against the rules.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Broken {
    pub field: &'static str,
    pub value: u64,
}

impl From<Broken> for Error {
    /// The rule as a file breaks it.
    fn from(b: Broken) -> Self {
        FormatError::BadValue { field: b.field, value: b.value }.into()
    }
}
