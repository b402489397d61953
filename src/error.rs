//! The crate's error type. Each variant says what is at fault and carries the offending value.

use std::fmt;
use std::path::{Path, PathBuf};

use crate::parameter::{Limit, Parameter};
use crate::target::Target;

/// Result type of this crate.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// Errors of this crate, by cause.
#[derive(Debug)]
#[non_exhaustive]
pub enum Error {
    /// Reading or writing failed.
    Io(std::io::Error),
    /// The file breaks the specification.
    Format(FormatError),
    /// The file has a format version that this crate does not support, for example a newer one.
    UnsupportedVersion {
        /// Version stated in the file.
        found: u8,
    },
    /// The file may be valid but exceeds one of the [`Limits`](crate::Limits).
    LimitExceeded {
        /// The limit.
        limit: Limit,
        /// Amount that the file needs.
        requested: u64,
        /// Amount that is allowed.
        allowed: u64,
    },
    /// An option or argument is outside its documented range.
    Parameter {
        /// The parameter.
        parameter: Parameter,
        /// The offending value and the allowed values.
        problem: String,
    },
    /// A file of the requested size cannot hold the picture and its metadata.
    TooSmall {
        /// Target that was requested.
        asked: Target,
        /// File size that the target allows, bytes.
        allowed: u64,
        /// File size without any Gaussian, bytes.
        needed: u64,
        /// Size of the ICC profile, bytes; included in `needed`.
        icc: u64,
        /// Size of the EXIF block, bytes; included in `needed`.
        exif: u64,
    },
    /// A picture in another format cannot be read.
    #[cfg(feature = "image")]
    Source {
        /// Path of the picture, if it is known.
        path: Option<PathBuf>,
        /// Error of the `image` crate.
        error: image::ImageError,
    },
    /// The progress callback stopped the encoder.
    Cancelled,
    /// The GPU is missing, failed or has too little memory.
    Gpu(GpuError),
}

/// Errors of a GPU: finding, opening or using it.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub enum GpuError {
    /// This build of the crate has no `gpu` feature.
    NotBuilt,
    /// No adapter was found.
    NoAdapter,
    /// The only adapters are software renderers, which the options do not allow.
    SoftwareOnly {
        /// Name of the preferred one among them.
        name: String,
    },
    /// The adapter could not be opened.
    Refused {
        /// Message of the driver.
        problem: String,
    },
    /// The device was unplugged, reset by its driver or destroyed by the program.
    Lost {
        /// Message of the driver.
        problem: String,
    },
    /// The device does not have enough memory.
    OutOfMemory {
        /// Message of the driver.
        problem: String,
    },
    /// The device refused a call.
    Validation {
        /// Message of the driver.
        problem: String,
    },
    /// A list on the device is longer than a binding can be.
    Overflow {
        /// Name of the list's items.
        what: &'static str,
        /// Number of items; a lower bound if counting stopped early.
        requested: u64,
        /// Number of items that a list can hold.
        allowed: u64,
    },
    /// The GPU does not support an option.
    Unsupported {
        /// The option.
        what: &'static str,
    },
}

/// Where and how a file breaks the specification. `offset` fields count bytes from the file's start.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub enum FormatError {
    /// The first four bytes are not the signature (spec §2).
    BadMagic {
        /// The bytes found.
        found: [u8; 4],
    },
    /// The file ends before the end of `what`. [`Reader`](crate::Reader), [`Decoder`](crate::Decoder) and
    /// [`SsplatDecoder`](crate::SsplatDecoder) return [`FormatError::CutOff`] instead.
    Truncated {
        /// The part that is truncated.
        what: &'static str,
        /// Length of the file in bytes.
        offset: u64,
    },
    /// The file ends too early: it was cut off, or has not arrived completely.
    #[doc(alias("truncated", "incomplete", "eof"))]
    CutOff {
        /// Length of the file in bytes.
        bytes: u64,
        /// Length of the whole file in bytes, if the bytes that are present state it.
        of: Option<u64>,
        /// Whether [`Damage::Accept`](crate::Damage::Accept) decodes the part of the picture that is present.
        partial: bool,
    },
    /// The checksum of the file, or of a group, does not match.
    Checksum {
        /// The part that the checksum covers.
        what: &'static str,
        /// Stored value.
        stored: u32,
        /// Value computed from the bytes.
        computed: u32,
    },
    /// A field holds a value that the specification does not allow.
    BadValue {
        /// Name of the field in the specification.
        field: &'static str,
        /// The value found.
        value: u64,
    },
    /// A critical section is unknown (spec §3).
    UnknownCriticalSection {
        /// The section's four-byte name.
        name: [u8; 4],
    },
    /// Bytes follow the last part of the file.
    TrailingBytes {
        /// Number of these bytes.
        count: u64,
    },
    /// The zstd stream of a plane is invalid.
    Compression {
        /// Name of the plane.
        what: &'static str,
    },
}

impl Error {
    /// Returns an I/O error whose message names `path`. The original error is its source.
    pub(crate) fn at(path: &Path, error: std::io::Error) -> Self {
        Error::Io(std::io::Error::new(error.kind(), AtPath { path: path.into(), error }))
    }
}

/// An I/O error and the path of its file.
#[derive(Debug)]
struct AtPath {
    path: PathBuf,
    error: std::io::Error,
}

impl fmt::Display for AtPath {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.path.display(), self.error)
    }
}

impl std::error::Error for AtPath {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        Some(&self.error)
    }
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Error::Io(e) => write!(f, "input or output failed: {e}"),
            Error::Format(e @ FormatError::CutOff { partial, .. }) => {
                let hint = if *partial { "; Damage::Accept decodes what is there" } else { "" };
                write!(f, "the file is {e}{hint}")
            }
            Error::Format(e @ FormatError::BadMagic { found }) if other_kind(*found).is_some() => {
                write!(f, "not an ssplat file: {e}")
            }
            Error::Format(e) => write!(f, "not a valid ssplat file: {e}"),
            Error::UnsupportedVersion { found } => write!(f, "format version {found} is not supported"),
            Error::LimitExceeded { limit, requested, allowed } => {
                write!(f, "limit exceeded: {limit} {requested} over the allowed {allowed}")
            }
            Error::Parameter { parameter, problem } => write!(f, "bad parameter {parameter}: {problem}"),
            Error::TooSmall { asked, allowed, needed, icc, exif } => {
                match asked {
                    Target::Ratio(ratio) => {
                        write!(f, "a ratio of {} leaves {allowed} bytes, which cannot", Thousandths(ratio))?;
                    }
                    _ => write!(f, "{allowed} bytes cannot")?,
                }
                write!(f, " hold the picture: {needed} are needed without any Gaussian")?;
                match (icc, exif) {
                    (0, 0) => Ok(()),
                    (0, exif) => write!(f, ", {exif} of them for the EXIF block"),
                    (icc, 0) => write!(f, ", {icc} of them for the ICC profile"),
                    (icc, exif) => write!(f, ", {icc} of them for the ICC profile and {exif} for the EXIF block"),
                }
            }
            #[cfg(feature = "image")]
            Error::Source { path: Some(path), error } => write!(f, "{}: {error}", path.display()),
            #[cfg(feature = "image")]
            Error::Source { path: None, error } => write!(f, "the picture cannot be read: {error}"),
            Error::Cancelled => write!(f, "cancelled"),
            Error::Gpu(e) => write!(f, "GPU: {e}"),
        }
    }
}

impl fmt::Display for GpuError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            GpuError::NotBuilt => write!(f, "this build has no GPU support"),
            GpuError::NoAdapter => write!(f, "no adapter found"),
            GpuError::SoftwareOnly { name } => write!(f, "no hardware adapter found, only {name}"),
            GpuError::Refused { problem } => write!(f, "the adapter could not be opened: {problem}"),
            GpuError::Lost { problem } => write!(f, "device lost: {problem}"),
            GpuError::OutOfMemory { problem } => write!(f, "out of memory: {problem}"),
            GpuError::Validation { problem } => write!(f, "call refused: {problem}"),
            GpuError::Overflow { what, requested, allowed } => {
                write!(f, "{requested} {what} are needed, but only {allowed} fit")
            }
            GpuError::Unsupported { what } => write!(f, "{what} is not supported"),
        }
    }
}

impl fmt::Display for FormatError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            // Without `Debug`, which prints nothing in WebAssembly (`web/build`).
            FormatError::BadMagic { found: found @ [a, b, c, d] } => match other_kind(*found) {
                Some(kind) => write!(f, "it is {kind}"),
                None => write!(f, "bad magic [{a:02x}, {b:02x}, {c:02x}, {d:02x}]"),
            },
            FormatError::Truncated { what, offset } => write!(f, "{what} is cut off at byte {offset}"),
            FormatError::CutOff { bytes: 0, .. } => write!(f, "empty (0 bytes), not an ssplat file"),
            FormatError::CutOff { bytes, of: Some(of), .. } => write!(f, "cut off after {bytes} of {of} bytes"),
            FormatError::CutOff { bytes, of: None, .. } => write!(f, "cut off after {bytes} bytes"),
            FormatError::Checksum { what, stored, computed } => {
                write!(f, "checksum of {what} is {stored:08x} but the bytes give {computed:08x}")
            }
            FormatError::BadValue { field, value } => write!(f, "{field} has the illegal value {value}"),
            FormatError::UnknownCriticalSection { name } => {
                write!(f, "unknown critical section \"{}\"", name.escape_ascii())
            }
            FormatError::TrailingBytes { count } => write!(f, "{count} bytes left over after the picture"),
            FormatError::Compression { what } => write!(f, "compressed stream of {what} is broken"),
        }
    }
}

/// Returns what a file is that begins with `start`, for files that are often given instead of an ssplat file. JavaScript
/// knows more of them, with the same words (`web/machine.js`).
fn other_kind(start: [u8; 4]) -> Option<&'static str> {
    Some(match start {
        [b'<', ..] | [b' ' | b'\t' | b'\r' | b'\n', b'<', ..] => "HTML or XML; is the path right?",
        [0x89, b'P', b'N', b'G'] => "a PNG picture",
        [0xFF, 0xD8, 0xFF, _] => "a JPEG picture",
        [b'G', b'I', b'F', b'8'] => "a GIF picture",
        [b'v', b'e', b'r', b's'] => "a pointer of Git LFS",
        [0x1F, 0x8B, ..] => "compressed with gzip",
        _ => return None,
    })
}

/// Prints a non-negative number with at most three decimals, using integer arithmetic. The standard formatting of
/// floats would make up a fifteenth of the WebAssembly module.
struct Thousandths<'a>(&'a f64);

impl fmt::Display for Thousandths<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // Casts saturate.
        let thousandths = (self.0 * 1000.0).round() as u64;
        write!(f, "{}", thousandths / 1000)?;
        let (mut part, mut digits) = (thousandths % 1000, 3);
        if part == 0 {
            return Ok(());
        }
        while part % 10 == 0 {
            (part, digits) = (part / 10, digits - 1);
        }
        write!(f, ".{part:0digits$}")
    }
}

impl std::error::Error for Error {
    /// Returns the wrapped error. The message of this error contains its message, so that a program that prints only
    /// this error is complete, and one that prints the whole chain repeats it.
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        match self {
            Error::Io(e) => Some(e),
            Error::Format(e) => Some(e),
            Error::Gpu(e) => Some(e),
            #[cfg(feature = "image")]
            Error::Source { error, .. } => Some(error),
            _ => None,
        }
    }
}

impl std::error::Error for FormatError {}

impl std::error::Error for GpuError {}

impl From<GpuError> for Error {
    fn from(e: GpuError) -> Self {
        Error::Gpu(e)
    }
}

impl From<std::io::Error> for Error {
    fn from(e: std::io::Error) -> Self {
        Error::Io(e)
    }
}

impl From<FormatError> for Error {
    fn from(e: FormatError) -> Self {
        Error::Format(e)
    }
}

#[cfg(test)]
mod tests {
    use std::error::Error as _;

    use super::*;

    /// Returns whether an error of type `E` is among the sources of `error`.
    fn has_source<E: std::error::Error + 'static>(error: &Error) -> bool {
        std::iter::successors(error.source(), |&e| e.source()).any(|e| e.is::<E>())
    }

    #[test]
    fn the_wrapped_error_is_a_source_and_part_of_the_message() {
        let inner = FormatError::TrailingBytes { count: 3 };
        let wrapped = Error::Io(std::io::Error::other(inner.clone()));
        let at_path = Error::at(Path::new("a.ssplat"), std::io::Error::from(std::io::ErrorKind::NotFound));
        assert!(at_path.to_string().contains("a.ssplat: "), "{at_path}");
        assert!(has_source::<std::io::Error>(&wrapped) && has_source::<std::io::Error>(&at_path));
        assert!(has_source::<FormatError>(&Error::Format(inner)));
        assert!(has_source::<GpuError>(&Error::Gpu(GpuError::NoAdapter)));
        for error in [wrapped, at_path, Error::Format(FormatError::TrailingBytes { count: 3 })] {
            for source in std::iter::successors(error.source(), |&e| e.source()) {
                assert!(error.to_string().contains(&source.to_string()), "{error} {source}");
            }
        }
    }

    #[test]
    fn files_of_other_kinds_are_named() {
        let told = |found: &[u8; 4]| Error::from(FormatError::BadMagic { found: *found }).to_string();
        assert_eq!(told(b"\x89PNG"), "not an ssplat file: it is a PNG picture");
        assert_eq!(told(b"\n<!d"), "not an ssplat file: it is HTML or XML; is the path right?");
        assert_eq!(told(b"\x09SSP"), "not a valid ssplat file: bad magic [09, 53, 53, 50]");
        let empty = FormatError::CutOff { bytes: 0, of: None, partial: false };
        assert_eq!(Error::from(empty).to_string(), "the file is empty (0 bytes), not an ssplat file");
        let name = *b"Newx";
        assert_eq!(FormatError::UnknownCriticalSection { name }.to_string(), "unknown critical section \"Newx\"");
    }

    #[test]
    fn too_small_errors_name_the_target_and_the_metadata_sizes() {
        let too_small = |asked, icc, exif| Error::TooSmall { asked, allowed: 40, needed: 3000, icc, exif }.to_string();
        assert_eq!(
            too_small(Target::Bytes(40), 0, 0),
            "40 bytes cannot hold the picture: 3000 are needed without any Gaussian"
        );
        assert_eq!(
            too_small(Target::Ratio(50.0), 0, 2900),
            "a ratio of 50 leaves 40 bytes, which cannot hold the picture: 3000 are needed without any Gaussian, 2900 of \
             them for the EXIF block"
        );
        for (ratio, said) in [(12.5, "a ratio of 12.5 "), (2000.0, "a ratio of 2000 "), (0.05, "a ratio of 0.05 ")] {
            assert!(too_small(Target::Ratio(ratio), 0, 0).starts_with(said), "{ratio}");
        }
        let both = too_small(Target::Ratio(50.0), 1000, 1900);
        assert!(both.ends_with("1000 of them for the ICC profile and 1900 for the EXIF block"), "{both}");
    }
}
