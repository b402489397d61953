//! The door for input files: a path, standard input, a pipe or a device to a reader that can seek, within bounds.

use std::fs::File;
use std::io::{self, BufRead, BufReader, Cursor, Read, Seek, SeekFrom};
use std::path::Path;

use image::ImageFormat;
use ssplat::Limits;
use ssplat::unstable::bitstream::header::MAGIC;

use crate::failure::{Failure, Kind};

/// Bytes at the beginning of a file by which formats are told apart, at most.
pub const LONGEST_MAGIC: u64 = 32;

/// An input file that is read anywhere in it.
pub enum Input {
    File(BufReader<File>),
    /// What cannot seek is read into memory as a whole.
    Memory(Cursor<Vec<u8>>),
}

impl Input {
    /// Opens `path`, or standard input for `-`. Of what cannot seek no more than [`Limits::alloc`] bytes are read, and of what is no
    /// picture no more than its beginning.
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

    /// The first bytes, which stay to be read; none where the file is empty.
    pub fn start(&mut self) -> io::Result<&[u8]> {
        self.fill_buf()
    }

    /// Bytes of the whole file.
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

/// Reads a .ssplat file, or standard input for `-`; of anything else only the start, so that it is refused whatever its length.
pub fn read_splats(path: &Path) -> Result<Vec<u8>, Failure> {
    read(path, Limits::default().alloc, |start| start.starts_with(&MAGIC))
}

/// Reads the whole of `path`, or of standard input for `-`; refuses more than `most` bytes.
pub fn read_at_most(path: &Path, most: u64) -> Result<Vec<u8>, Failure> {
    read(path, most, |_| true)
}

/// Reads all of `input`, which came from `path`; refuses more than `most` bytes.
pub fn all(path: &Path, input: Input, most: u64) -> Result<Vec<u8>, Failure> {
    let mut input = input;
    let length = input.length().map_err(|e| Failure::io(path, &e))?;
    bounded(path, input, Some(length), Bounds { most, goes_on: |_: &[u8]| true })
}

/// Whether `path` is a file whose beginning can be looked at and is still there for who reads it next: no pipe, no device.
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
    let is_picture = |start: &[u8]| is_named || start.starts_with(&MAGIC) || image::guess_format(start).is_ok();
    // Anything else may be without end, and its beginning is enough to say what it is not.
    let bounds = Bounds { most: Limits::default().alloc, goes_on: is_picture };
    bounded(path, reader, None, bounds).map(|bytes| Input::Memory(Cursor::new(bytes)))
}

fn read(path: &Path, most: u64, goes_on: impl FnOnce(&[u8]) -> bool) -> Result<Vec<u8>, Failure> {
    let bounds = Bounds { most, goes_on };
    let Some(file) = open_file(path)? else { return bounded(path, io::stdin().lock(), None, bounds) };
    let found = file.metadata().map_err(|e| Failure::io(path, &e))?;
    bounded(path, file, found.is_file().then_some(found.len()), bounds)
}

/// How much of an input is read.
struct Bounds<F> {
    /// Bytes; of more the input is refused.
    most: u64,
    /// Whether anything but the start matters, by the start.
    goes_on: F,
}

/// Reads all of `reader`, which has `length` bytes if that is known, or only its start where nothing else of it matters.
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
