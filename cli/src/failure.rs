//! Error messages of the program, and their exit statuses.

use std::path::Path;

use image::ImageError;
use ssplat::Error;

/// Whose fault it is; each kind has its own exit status.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// The program itself, or something that has no status of its own.
    Other,
    /// The command line. Also what clap exits with.
    Usage,
    /// Reading or writing.
    Io,
    /// The file is broken.
    Format,
    /// The file may be sound, but its format, version or colour type is not supported.
    Unsupported,
    /// The file asks for more than the limits allow.
    Limit,
}

impl Kind {
    /// The exit status.
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

/// Reason why a command stopped.
#[derive(Debug)]
pub struct Failure {
    pub kind: Kind,
    pub message: String,
}

impl Failure {
    pub fn usage(message: impl Into<String>) -> Self {
        Failure { kind: Kind::Usage, message: message.into() }
    }

    /// An error of the library while at work on `path`.
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
        Failure { kind, message: format!("{}: {error}", Failure::input(path)) }
    }

    /// An error of the `image` crate while at work on `path`.
    pub fn image(path: &Path, error: &ImageError) -> Self {
        let kind = match error {
            // A cut-off file shows as the world's error in `image`; the world is not at fault.
            ImageError::IoError(e) if e.kind() == std::io::ErrorKind::UnexpectedEof => Kind::Format,
            ImageError::IoError(_) => Kind::Io,
            ImageError::Decoding(_) | ImageError::Encoding(_) => Kind::Format,
            ImageError::Unsupported(_) => Kind::Unsupported,
            ImageError::Limits(_) => Kind::Limit,
            ImageError::Parameter(_) => Kind::Usage,
        };
        Failure { kind, message: format!("{}: {error}", Failure::input(path)) }
    }

    /// A panic of this program while at work on `path`.
    pub fn bug(path: &Path, panic: &str) -> Self {
        let message = format!("{}: a bug of ssplat: {panic}", Failure::input(path));
        Failure { kind: Kind::Other, message }
    }

    pub fn io(path: &Path, error: &std::io::Error) -> Self {
        Failure { kind: Kind::Io, message: format!("{}: {error}", Failure::input(path)) }
    }

    /// The path for a message; `-` has a name of its own. Outputs are named by their sink.
    pub fn input(path: &Path) -> String {
        if path == Path::new("-") { "standard input".into() } else { path.display().to_string() }
    }
}
