//! Errors of the C interface: a kind and a message.

use std::fmt::Display;

use ssplat::{Error, FormatError};

/// Result of a call. Later versions may add kinds.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ssplat_status {
    /// The call did what it was asked to.
    Ok = 0,
    /// A file could not be read, or a callback could not read or write.
    Io = 1,
    /// The file is damaged or is no .ssplat file.
    Format = 2,
    /// The file is of a format version that this library does not know.
    Version = 3,
    /// The file may be valid but exceeds a limit.
    Limit = 4,
    /// An argument is NULL or out of its range.
    Parameter = 5,
    /// The callback asked to stop.
    Cancelled = 6,
    /// Memory ran out.
    Memory = 7,
    /// The buffer is too small.
    Buffer = 8,
    /// No file has been opened.
    Closed = 9,
    /// Another call is using the decoder or the encoder.
    Busy = 10,
    /// The library failed; this is a bug. A decoder's file was closed.
    Internal = 11,
    /// A file of the size that was asked for cannot hold the picture.
    Size = 12,
    /// The file ends before its end: ssplat_decoder_set_partial() draws what is there, and a file whose bytes arrive by
    /// ssplat_decoder_append() may not be complete yet.
    Truncated = 13,
}

/// What a call could not do: its kind and its words.
#[derive(Debug)]
pub struct Failure {
    pub status: ssplat_status,
    pub message: String,
}

impl Failure {
    pub fn new(status: ssplat_status, message: impl Display) -> Self {
        Failure { status, message: message.to_string() }
    }

    /// An argument that cannot be used.
    pub fn parameter(message: impl Display) -> Self {
        Failure::new(ssplat_status::Parameter, message)
    }

    /// A buffer that is too small.
    pub fn short(size: usize, needed: usize) -> Self {
        Failure::new(ssplat_status::Buffer, format_args!("the buffer has {size} bytes where {needed} are needed"))
    }
}

impl From<Error> for Failure {
    fn from(error: Error) -> Self {
        let status = match &error {
            Error::Io(_) => ssplat_status::Io,
            Error::Format(FormatError::CutOff { .. }) => ssplat_status::Truncated,
            Error::Format(_) => ssplat_status::Format,
            Error::UnsupportedVersion { .. } => ssplat_status::Version,
            Error::LimitExceeded { .. } => ssplat_status::Limit,
            Error::Parameter { .. } => ssplat_status::Parameter,
            Error::Cancelled => ssplat_status::Cancelled,
            Error::TooSmall { .. } => ssplat_status::Size,
            _ => ssplat_status::Internal,
        };
        match &error {
            Error::Format(cut @ FormatError::CutOff { partial: true, .. }) => {
                let hint = "ssplat_decoder_set_partial() draws what is there";
                Failure::new(status, format_args!("the file is {cut}; {hint}"))
            }
            error => Failure::new(status, error),
        }
    }
}

/// Shorthand for results of this package.
pub type Outcome<T> = Result<T, Failure>;
