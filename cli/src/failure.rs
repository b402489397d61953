//! Error messages of the program, and their exit statuses.

use std::path::Path;

use image::ImageError;
use ssplat::{Error, FormatError};

/// The kind of a failure; each has its own exit status.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// A bug of the program, or a cause without an exit status of its own.
    Other,
    /// The command line is wrong. clap exits with the same status.
    Usage,
    /// Reading or writing failed.
    Io,
    /// The file is broken.
    Format,
    /// The format, version or colour type of the file is not supported.
    Unsupported,
    /// The file exceeds the limits.
    Limit,
}

impl Kind {
    /// Returns the exit status.
    pub fn code(self) -> u8 {
        match self {
            Kind::Other => 1,
            Kind::Usage => 2,
            Kind::Io => 3,
            Kind::Format => 4,
            Kind::Unsupported => 5,
            Kind::Limit => 6,
        }
    }
}

/// The reason why a command failed.
#[derive(Debug)]
pub struct Failure {
    pub kind: Kind,
    pub message: String,
}

impl Failure {
    pub fn usage(message: impl Into<String>) -> Self {
        Failure { kind: Kind::Usage, message: message.into() }
    }

    /// An error of the library for the file `path`.
    pub fn library(path: &Path, error: &Error) -> Self {
        let kind = match error {
            Error::Io(_) => Kind::Io,
            Error::Format(_) => Kind::Format,
            Error::UnsupportedVersion { .. } => Kind::Unsupported,
            Error::LimitExceeded { .. } => Kind::Limit,
            Error::Parameter { .. } | Error::TooSmall { .. } => Kind::Usage,
            Error::Source { error, .. } => return Failure::image(path, error),
            _ => Kind::Other,
        };
        let text = match error {
            Error::Format(cut @ FormatError::CutOff { partial: true, .. }) => {
                format!("{cut}; decode --partial shows what is there")
            }
            Error::Format(cut @ FormatError::CutOff { .. }) => cut.to_string(),
            error => error.to_string(),
        };
        Failure { kind, message: format!("{}: {text}", Failure::input(path)) }
    }

    /// An error of the `image` crate for the file `path`.
    pub fn image(path: &Path, error: &ImageError) -> Self {
        let kind = match error {
            // `image` reports a truncated file as an I/O error.
            ImageError::IoError(e) if e.kind() == std::io::ErrorKind::UnexpectedEof => Kind::Format,
            ImageError::IoError(_) => Kind::Io,
            ImageError::Decoding(_) | ImageError::Encoding(_) => Kind::Format,
            ImageError::Unsupported(_) => Kind::Unsupported,
            ImageError::Limits(_) => Kind::Limit,
            ImageError::Parameter(_) => Kind::Usage,
        };
        // Some messages of decoders end with a line feed.
        Failure { kind, message: format!("{}: {}", Failure::input(path), error.to_string().trim_end()) }
    }

    /// A panic of this program while it processed `path`.
    pub fn bug(path: &Path, panic: &str) -> Self {
        let message = format!("{}: a bug of ssplat: {panic}", Failure::input(path));
        Failure { kind: Kind::Other, message }
    }

    pub fn io(path: &Path, error: &std::io::Error) -> Self {
        Failure { kind: Kind::Io, message: format!("{}: {error}", Failure::input(path)) }
    }

    /// Returns the path of an input for messages; `-` becomes "standard input". The sink has the names of outputs.
    pub fn input(path: &Path) -> String {
        if path == Path::new("-") { "standard input".into() } else { path.display().to_string() }
    }
}
