//! The crate's error type: who is at fault, and with which value.

use std::fmt;

/// Shorthand for results of this crate.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// Everything that can go wrong, sorted by who is at fault.
#[derive(Debug)]
#[non_exhaustive]
pub enum Error {
    /// The world: reading or writing failed.
    Io(std::io::Error),
    /// The file: it breaks the specification.
    Format(FormatError),
    /// A newer file: its format version is not known to this crate.
    UnsupportedVersion {
        /// The version that the file names.
        found: u8,
    },
    /// Policy: the file may be sound but asks for more than [`Limits`](crate::Limits) allow.
    LimitExceeded {
        /// What was limited, in the words of [`Limits`](crate::Limits)' fields.
        what: &'static str,
        /// What the file asked for.
        requested: u64,
        /// What is allowed.
        allowed: u64,
    },
    /// The caller: an option or argument is out of its documented range.
    Parameter {
        /// The parameter's name.
        name: &'static str,
        /// The offending value and what would be right.
        problem: String,
    },
    /// The encoder stopped because the progress callback asked for it.
    Cancelled,
    /// The device: a GPU is missing, failed or is too small.
    Gpu(GpuError),
}

/// What went wrong on the way to a GPU or on it.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub enum GpuError {
    /// This build of the crate has no `gpu` feature.
    NotBuilt,
    /// No adapter was found.
    NoAdapter,
    /// The only adapters are programs, which were not asked for.
    SoftwareOnly {
        /// The best of them.
        name: String,
    },
    /// The adapter could not be opened.
    Refused {
        /// What the driver says.
        problem: String,
    },
    /// The device is gone: unplugged, reset by its driver or destroyed by the program.
    Lost {
        /// What the driver says.
        problem: String,
    },
    /// The device has not enough memory.
    OutOfMemory {
        /// What the driver says.
        problem: String,
    },
    /// The device refused a call.
    Validation {
        /// What the driver says.
        problem: String,
    },
    /// A list on the device would have to be longer than a binding can be.
    Overflow {
        /// What the list holds.
        what: &'static str,
        /// How many there are, or as many as were counted.
        requested: u64,
        /// How many it can hold.
        allowed: u64,
    },
    /// The GPU cannot do what an option asks for.
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
    /// The file ends before what `what` needs.
    Truncated {
        /// The part that is cut.
        what: &'static str,
        /// Where the file ends.
        offset: u64,
    },
    /// The checksum over the file, or over a group, does not match.
    Checksum {
        /// The part that is covered.
        what: &'static str,
        /// Stored value.
        stored: u32,
        /// Value computed over the bytes.
        computed: u32,
    },
    /// A field holds a value that the specification does not allow.
    BadValue {
        /// The field, in the specification's words.
        field: &'static str,
        /// The value found.
        value: u64,
    },
    /// A critical section is not known (spec §3).
    UnknownCriticalSection {
        /// The section's four-byte name.
        name: [u8; 4],
    },
    /// Bytes are left over after the last part.
    TrailingBytes {
        /// How many.
        count: u64,
    },
    /// The zstd stream of a plane is broken.
    Compression {
        /// The plane.
        what: &'static str,
    },
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Error::Io(e) => write!(f, "input or output failed: {e}"),
            Error::Format(e) => write!(f, "not a valid ssplat file: {e}"),
            Error::UnsupportedVersion { found } => write!(f, "format version {found} is not supported"),
            Error::LimitExceeded { what, requested, allowed } => {
                write!(f, "limit exceeded: {what} {requested} over the allowed {allowed}")
            }
            Error::Parameter { name, problem } => write!(f, "bad parameter {name}: {problem}"),
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
                write!(f, "{requested} {what} where {allowed} fit")
            }
            GpuError::Unsupported { what } => write!(f, "{what} is not supported"),
        }
    }
}

impl fmt::Display for FormatError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            FormatError::BadMagic { found } => write!(f, "bad magic {found:02x?}"),
            FormatError::Truncated { what, offset } => write!(f, "{what} is cut off at byte {offset}"),
            FormatError::Checksum { what, stored, computed } => {
                write!(f, "checksum of {what} is {stored:08x} but the bytes give {computed:08x}")
            }
            FormatError::BadValue { field, value } => write!(f, "{field} has the illegal value {value}"),
            FormatError::UnknownCriticalSection { name } => {
                write!(f, "unknown critical section {:?}", String::from_utf8_lossy(name))
            }
            FormatError::TrailingBytes { count } => write!(f, "{count} bytes left over after the picture"),
            FormatError::Compression { what } => write!(f, "compressed stream of {what} is broken"),
        }
    }
}

impl std::error::Error for Error {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        match self {
            Error::Io(e) => Some(e),
            Error::Format(e) => Some(e),
            Error::Gpu(e) => Some(e),
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
