//! Pictures that do not fit into memory: their samples stay in a file and are read part by part.
//!
//! Binary PNM with a maximum of 255 or 65535 is read in place. The rows of a PNG are decoded into a temporary file.
//! Other formats, and interlaced PNG, are decoded in memory.

use std::fs::File;
use std::io::{BufRead, BufReader, BufWriter, Read, Seek, SeekFrom, Write};
use std::path::Path;
use std::sync::Mutex;
use std::time::Instant;

use image::ImageFormat;
use png::{BitDepth, ColorType, Transformations};
use ssplat::unstable::check_area;
use ssplat::unstable::colour::{MAX_PROFILE_BYTES, Overlay, Profiles};
use ssplat::{Channels, Cicp, Depth, Error, HiddenColors, PixelSource, Pixels, Rect, Samples};

use crate::failure::{Failure, Kind};
use crate::input::Input;
use crate::source::Source;
use crate::{completeness, exif_text, guard, resize, source};

/// Disk space that any PNG may take, and the space per byte of the file above that: photographs need 2 to 5, drawings
/// up to 200.
const FREE_SPOOL: u64 = 1 << 30;
const MOST_UNPACKED: u64 = 1000;

/// Samples in a file, in rows with interleaved channels; samples of 16 bits are big-endian.
pub struct Spooled {
    file: Mutex<File>,
    /// Offset of the first sample.
    start: u64,
    width: u32,
    height: u32,
    channels: Channels,
    depth: Depth,
    pub cicp: Option<Cicp>,
    pub icc: Option<Vec<u8>>,
    pub exif: Option<Vec<u8>>,
    /// Notes about parts of the input that are ignored.
    pub notes: Vec<String>,
}

impl PixelSource for Spooled {
    fn width(&self) -> u32 {
        self.width
    }

    fn height(&self) -> u32 {
        self.height
    }

    fn channels(&self) -> Channels {
        self.channels
    }

    fn depth(&self) -> Depth {
        self.depth
    }

    fn part(&self, area: Rect) -> Result<Pixels, Error> {
        check_area(area, self.size())?;
        let [x, y, width, height] = <[u32; 4]>::from(area).map(u64::from);
        let pixel = (self.channels.count() * self.depth.bytes()) as u64;
        let mut bytes = vec![0; (width * height * pixel) as usize];
        let mut file = self.file.lock().unwrap_or_else(|e| e.into_inner());
        for (row, y) in bytes.chunks_exact_mut((width * pixel) as usize).zip(y..) {
            file.seek(SeekFrom::Start(self.start + (y * u64::from(self.width) + x) * pixel)).map_err(Error::Io)?;
            file.read_exact(row).map_err(Error::Io)?;
        }
        let samples = match self.depth {
            Depth::Eight => Samples::U8(bytes),
            Depth::Sixteen => Samples::U16(bytes.chunks_exact(2).map(|b| u16::from_be_bytes([b[0], b[1]])).collect()),
        };
        Pixels::new(area.width, area.height, self.channels, samples)
    }
}

impl Spooled {
    /// Downscales the picture to `size`, in memory.
    pub fn resized(self, path: &Path, size: [u32; 2], hidden: HiddenColors) -> Result<Source, Failure> {
        let pixels = resize::resize(&self, size, self.icc.as_deref(), hidden);
        let pixels = pixels.map_err(|e| Failure::library(path, &e))?;
        let orientation = source::orientation_in(self.exif.as_deref());
        let Spooled { cicp, icc, exif, notes, .. } = self;
        Ok(Source { pixels, cicp, icc, exif, orientation, is_cut_off: false, notes })
    }
}

/// An input that is read part by part, or must be read as a whole.
pub enum Opened {
    InParts(Box<Spooled>),
    AsWhole(Input),
}

/// Opens `input`, which came from `path`, without reading it into memory, and before `end` if that is set. A panic of a
/// decoder is reported as a broken file.
pub fn open(path: &Path, input: Input, end: Option<Instant>, profiles: Profiles) -> Result<Opened, Failure> {
    let Input::File(mut reader) = input else { return Ok(Opened::AsWhole(input)) };
    let spooled = guard::quietly(|| spooled(path, &mut reader, end, profiles));
    match spooled.unwrap_or_else(|panic| Err(source::panicked(path, &panic)))? {
        Some(spooled) => Ok(Opened::InParts(Box::new(spooled))),
        None => {
            reader.rewind().map_err(|e| Failure::io(path, &e))?;
            Ok(Opened::AsWhole(Input::File(reader)))
        }
    }
}

fn spooled(
    path: &Path,
    reader: &mut BufReader<File>,
    end: Option<Instant>,
    profiles: Profiles,
) -> Result<Option<Spooled>, Failure> {
    match reader.fill_buf().map_err(|e| Failure::io(path, &e))? {
        [b'P', b'5' | b'6', ..] => pnm(path, reader),
        [0x89, b'P', b'N', b'G', ..] => png(path, reader, end, profiles),
        _ => Ok(None),
    }
}

fn pnm(path: &Path, reader: &mut BufReader<File>) -> Result<Option<Spooled>, Failure> {
    let io = |e| Failure::io(path, &e);
    let broken = |what: String| Failure { kind: Kind::Format, message: format!("{}: {what}", path.display()) };
    let mut magic = [0; 2];
    reader.read_exact(&mut magic).map_err(io)?;
    let mut numbers = [0u32; 3];
    for number in &mut numbers {
        let found = number_of(reader).or_else(|e| match e.kind() {
            std::io::ErrorKind::UnexpectedEof => Ok(None),
            _ => Err(io(e)),
        });
        *number = found?.ok_or_else(|| broken("its header is incomplete".into()))?;
    }
    let [width, height, white] = numbers;
    let depth = match white {
        255 => Depth::Eight,
        65535 => Depth::Sixteen,
        // The decoder of `image` scales other maxima.
        _ => return Ok(None),
    };
    let channels = if magic[1] == b'5' { Channels::Grey } else { Channels::Rgb };
    let start = reader.stream_position().map_err(io)?;
    let file = reader.get_ref().try_clone().map_err(io)?;
    let bytes = u64::from(width) * u64::from(height) * (channels.count() * depth.bytes()) as u64;
    let length = file.metadata().map_err(io)?.len();
    if start.checked_add(bytes).is_none_or(|end| end > length) {
        return Err(broken(format!("needs {bytes} bytes of samples but has {}", length.saturating_sub(start))));
    }
    let file = Mutex::new(file);
    Ok(Some(Spooled {
        file,
        start,
        width,
        height,
        channels,
        depth,
        cicp: None,
        icc: None,
        exif: None,
        notes: Vec::new(),
    }))
}

/// Refuses a PNG whose `samples` bytes of samples are out of proportion to its `packed` bytes, because it would fill
/// the disk.
fn check_spooled(path: &Path, samples: u64, packed: u64) -> Result<(), Failure> {
    let most = packed.saturating_mul(MOST_UNPACKED).max(FREE_SPOOL);
    if samples <= most {
        return Ok(());
    }
    let message = format!(
        "{}: would take {samples} bytes on disk; a file of {packed} bytes may take at most {most}",
        path.display()
    );
    Err(Failure { kind: Kind::Limit, message })
}

/// Reads a number of a PNM header and the white space after it; `None` if there is none.
fn number_of(reader: &mut impl BufRead) -> std::io::Result<Option<u32>> {
    let mut number: Option<u32> = None;
    loop {
        let mut byte = [0];
        reader.read_exact(&mut byte)?;
        match byte[0] {
            digit @ b'0'..=b'9' => {
                let digit = u32::from(digit - b'0');
                number = number.unwrap_or(0).checked_mul(10).and_then(|n| n.checked_add(digit));
                if number.is_none() {
                    return Ok(None);
                }
            }
            b'#' if number.is_none() => {
                reader.skip_until(b'\n')?;
            }
            space if space.is_ascii_whitespace() => {
                if number.is_some() {
                    return Ok(number);
                }
            }
            _ => return Ok(None),
        }
    }
}

/// Reads a PNG up to its samples. A profile may take [`MAX_PROFILE_BYTES`], and its compressed form twice as much.
fn open_png<R: BufRead + Seek>(reader: R) -> Result<png::Reader<R>, png::DecodingError> {
    let mut decoder = png::Decoder::new(reader);
    let row = 8 * decoder.read_header_info()?.width as usize;
    decoder.set_limits(png::Limits { bytes: 3 * MAX_PROFILE_BYTES as usize + row });
    decoder.set_transformations(Transformations::EXPAND);
    decoder.read_info()
}

fn png(
    path: &Path,
    reader: &mut BufReader<File>,
    end: Option<Instant>,
    profiles: Profiles,
) -> Result<Option<Spooled>, Failure> {
    let io = |e| Failure::io(path, &e);
    let broken = |e: png::DecodingError| match e {
        png::DecodingError::IoError(e) if e.kind() != std::io::ErrorKind::UnexpectedEof => Failure::io(path, &e),
        e => Failure { kind: Kind::Format, message: format!("{}: {e}", path.display()) },
    };
    let packed = reader.get_ref().metadata().map_err(io)?.len();
    let found = completeness::look(reader, ImageFormat::Png).map_err(io)?;
    reader.rewind().map_err(io)?;
    let stated = source::stated(path, reader, profiles)?;
    let mut notes: Vec<String> = stated.note.map(String::from).into_iter().collect();
    let text = exif_text::read(path, reader, &stated, &mut notes)?;
    let overlay = Overlay::new(&mut *reader, stated.hidden.clone()).map_err(io)?;
    let mut decoder = open_png(overlay).map_err(broken)?;
    let info = decoder.info();
    if info.interlaced {
        return Ok(None);
    }
    let (width, height) = (info.width, info.height);
    let exif = text.or_else(|| stated.own_exif());
    let (mut icc, note) = stated.with_profile(info.icc_profile.as_ref().map(|v| v.to_vec()));
    notes.extend(note);
    if found.has_more {
        notes.push("only the first of its frames or pages is used".into());
    }
    if stated.has_xmp {
        notes.push("its XMP block is left out".into());
    }
    let (color, bits) = decoder.output_color_type();
    let channels = match color {
        ColorType::Grayscale => Channels::Grey,
        ColorType::GrayscaleAlpha => Channels::GreyAlpha,
        ColorType::Rgb => Channels::Rgb,
        ColorType::Rgba => Channels::Rgba,
        ColorType::Indexed => return Ok(None),
    };
    let depth = if bits == BitDepth::Sixteen { Depth::Sixteen } else { Depth::Eight };
    check_spooled(path, u64::from(width) * u64::from(height) * (channels.count() * depth.bytes()) as u64, packed)?;
    source::keep_fitting(&mut icc, channels, &mut notes);
    let mut file = tempfile::tempfile().map_err(io)?;
    let mut rows = BufWriter::new(&mut file);
    for y in 0..height {
        if end.is_some_and(|end| Instant::now() >= end) {
            let message = format!("{}: --time ran out after {y} of {height} rows", path.display());
            return Err(Failure { kind: Kind::Limit, message });
        }
        let row = decoder.next_row().map_err(broken)?;
        let row = row
            .ok_or_else(|| Failure { kind: Kind::Format, message: format!("{}: has too few rows", path.display()) })?;
        rows.write_all(row.data()).map_err(io)?;
    }
    rows.flush().map_err(io)?;
    drop(rows);
    let cicp = stated.cicp;
    Ok(Some(Spooled { file: Mutex::new(file), start: 0, width, height, channels, depth, cicp, icc, exif, notes }))
}
