//! Opens input files: turns a path, standard input, a pipe or a device into a reader that can seek, with bounded
//! memory.

use std::fs::File;
use std::io::{self, BufRead, BufReader, Cursor, Read, Seek, SeekFrom};
use std::path::Path;

use image::ImageFormat;
use ssplat::unstable::bitstream::header::MAGIC;
use ssplat::{FormatError, Limits};

use crate::failure::{Failure, Kind};
use crate::sniff::{Sniffed, sniff};

/// Number of bytes at the start of a file that suffice to detect its format: `ftyp` with 60 brands.
pub const LONGEST_MAGIC: u64 = 256;

/// An input file that can seek.
pub enum Input {
    File(BufReader<File>),
    /// An input that cannot seek, read into memory.
    Memory(Cursor<Vec<u8>>),
}

impl Input {
    /// Opens `path`, or standard input for `-`. Of an input that cannot seek, at most [`Limits::alloc`] bytes are read,
    /// and only its start if that is not the start of a picture.
    pub fn open(path: &Path) -> Result<Input, Failure> {
        let io = |e| Failure::io(path, &e);
        if let Some(file) = open_file(path)? {
            if file.metadata().map_err(io)?.is_file() {
                return Ok(Input::File(BufReader::new(file)));
            }
            return in_memory(path, file);
        }
        in_memory(path, io::stdin().lock())
    }

    /// Returns the first bytes without consuming them; none if the file is empty.
    pub fn start(&mut self) -> io::Result<&[u8]> {
        self.fill_buf()
    }

    /// Returns the length of the file in bytes.
    pub fn length(&mut self) -> io::Result<u64> {
        match self {
            Input::File(file) => Ok(file.get_ref().metadata()?.len()),
            Input::Memory(bytes) => Ok(bytes.get_ref().len() as u64),
        }
    }
}

impl Read for Input {
    fn read(&mut self, buf: &mut [u8]) -> io::Result<usize> {
        match self {
            Input::File(file) => file.read(buf),
            Input::Memory(bytes) => bytes.read(buf),
        }
    }
}

impl BufRead for Input {
    fn fill_buf(&mut self) -> io::Result<&[u8]> {
        match self {
            Input::File(file) => file.fill_buf(),
            Input::Memory(bytes) => bytes.fill_buf(),
        }
    }

    fn consume(&mut self, amount: usize) {
        match self {
            Input::File(file) => file.consume(amount),
            Input::Memory(bytes) => bytes.consume(amount),
        }
    }
}

impl Seek for Input {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        match self {
            Input::File(file) => file.seek(to),
            Input::Memory(bytes) => bytes.seek(to),
        }
    }
}

/// Reads a .ssplat file, or standard input for `-`. Of other files only the start is read, so they are refused whatever
/// their length.
pub fn read_splats(path: &Path) -> Result<Vec<u8>, Failure> {
    let bytes = read(path, Limits::default().alloc, |start| start.starts_with(&MAGIC))?;
    if bytes.is_empty() {
        let empty = FormatError::CutOff { bytes: 0, of: None, partial: false };
        return Err(Failure::library(path, &empty.into()));
    }
    match other_picture(&bytes) {
        Some(kind) => {
            let message = format!("{}: not an ssplat file: it is {kind}", Failure::input(path));
            Err(Failure { kind: Kind::Format, message })
        }
        None => Ok(bytes),
    }
}

/// Returns what a file is that begins with `start`, if it is a picture that the library does not name itself, because
/// it looks at four bytes only.
fn other_picture(start: &[u8]) -> Option<&'static str> {
    Some(match sniff(start) {
        Some(Sniffed::JpegXl) => "a JPEG XL picture",
        Some(Sniffed::Avif) => "an AVIF picture",
        Some(Sniffed::Heic) => "a HEIC picture",
        None => match image::guess_format(start).ok()? {
            ImageFormat::Bmp => "a BMP picture",
            ImageFormat::Farbfeld => "a farbfeld picture",
            ImageFormat::Pnm => "a Netpbm picture",
            ImageFormat::Qoi => "a QOI picture",
            ImageFormat::Tiff => "a TIFF picture",
            ImageFormat::WebP => "a WebP picture",
            _ => return None,
        },
    })
}

/// Reads all of `path`, or of standard input for `-`; refuses more than `most` bytes.
pub fn read_at_most(path: &Path, most: u64) -> Result<Vec<u8>, Failure> {
    read(path, most, |_| true)
}

/// Reads all of `input`, which came from `path`; refuses more than `most` bytes.
pub fn all(path: &Path, input: Input, most: u64) -> Result<Vec<u8>, Failure> {
    let mut input = input;
    let length = input.length().map_err(|e| Failure::io(path, &e))?;
    bounded(path, input, Some(length), Bounds { most, goes_on: |_: &[u8]| true })
}

/// Whether a file that begins with `start` is a picture in a format that this build reads, other than ssplat.
pub fn is_known(start: &[u8]) -> bool {
    image::guess_format(start).is_ok() || sniff(start).is_some_and(Sniffed::is_read)
}

/// Whether `path` is a regular file, which can be read more than once, unlike a pipe or a device.
pub fn is_file(path: &Path) -> bool {
    std::fs::metadata(path).is_ok_and(|found| found.is_file())
}

/// Opens a file; `None` is standard input.
fn open_file(path: &Path) -> Result<Option<File>, Failure> {
    if path == Path::new("-") {
        return Ok(None);
    }
    if path.is_dir() {
        let message = format!("{}: is a folder; --out-dir DIR takes the files in it", path.display());
        return Err(Failure { kind: Kind::Io, message });
    }
    File::open(path).map(Some).map_err(|e| Failure::io(path, &e))
}

fn in_memory(path: &Path, reader: impl Read) -> Result<Input, Failure> {
    let is_named = ImageFormat::from_path(path).is_ok();
    let is_picture = |start: &[u8]| is_named || start.starts_with(&MAGIC) || is_known(start);
    // Other inputs may be endless, and their start suffices for the error message.
    let bounds = Bounds { most: Limits::default().alloc, goes_on: is_picture };
    bounded(path, reader, None, bounds).map(|bytes| Input::Memory(Cursor::new(bytes)))
}

fn read(path: &Path, most: u64, goes_on: impl FnOnce(&[u8]) -> bool) -> Result<Vec<u8>, Failure> {
    let bounds = Bounds { most, goes_on };
    let Some(file) = open_file(path)? else { return bounded(path, io::stdin().lock(), None, bounds) };
    let found = file.metadata().map_err(|e| Failure::io(path, &e))?;
    bounded(path, file, found.is_file().then_some(found.len()), bounds)
}

/// Bounds on what is read of an input.
struct Bounds<F> {
    /// Largest number of bytes; longer inputs are refused.
    most: u64,
    /// Decides by the start of the input whether the rest is read.
    goes_on: F,
}

/// Reads `reader`, which has `length` bytes if that is known, within `bounds`.
fn bounded<F: FnOnce(&[u8]) -> bool>(
    path: &Path,
    mut reader: impl Read,
    length: Option<u64>,
    Bounds { most, goes_on }: Bounds<F>,
) -> Result<Vec<u8>, Failure> {
    let io = |e| Failure::io(path, &e);
    let mut bytes = Vec::new();
    reader.by_ref().take(LONGEST_MAGIC).read_to_end(&mut bytes).map_err(io)?;
    if !goes_on(&bytes) {
        return Ok(bytes);
    }
    let is_short = length.is_none_or(|length| length <= most);
    if is_short {
        let rest = most.saturating_sub(bytes.len() as u64).saturating_add(1);
        reader.take(rest).read_to_end(&mut bytes).map_err(io)?;
    }
    if !is_short || bytes.len() as u64 > most {
        let message = format!("{}: is longer than {most} bytes", Failure::input(path));
        return Err(Failure { kind: Kind::Limit, message });
    }
    Ok(bytes)
}
