//! Pictures in: any format that is known by its content, with its ICC profile and EXIF block.

use std::fs::File;
use std::io::{self, BufRead, BufReader, Cursor, Read, Seek};
use std::path::Path;

use image::metadata::Orientation;
use image::{DynamicImage, ImageDecoder, ImageReader};
use ssplat::unstable::DecodeOptions;
use ssplat::unstable::bitstream::header::MAGIC;
use ssplat::{Channels, Limits, Pixels};

use crate::completeness;
use crate::failure::{Failure, Kind};

/// Most bytes that a decoder of `image` may allocate: a 177-megapixel picture takes 531 MB with 8 bits, twice that
/// with 16.
const MAX_ALLOC: u64 = 8 << 30;

/// Whether pixels are turned as their EXIF block says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Turn {
    Keep,
    Upright,
}

/// A picture and what came with it.
pub struct Source {
    pub pixels: Pixels,
    pub icc: Option<Vec<u8>>,
    pub exif: Option<Vec<u8>>,
    /// How the picture is still to be turned.
    pub orientation: Orientation,
    /// The file ends before its picture does.
    pub is_cut_off: bool,
    /// Notes about parts of the file that were not read.
    pub notes: Vec<String>,
}

impl Source {
    /// Refuses a picture of which a part is missing.
    pub fn whole(self, path: &Path) -> Result<Source, Failure> {
        if self.is_cut_off {
            let message = format!("{}: the file is cut off; --partial takes what is there", path.display());
            return Err(Failure { kind: Kind::Format, message });
        }
        Ok(self)
    }
}

trait ReadSeek: BufRead + Seek {}
impl<T: BufRead + Seek> ReadSeek for T {}

/// Reads a .ssplat file, or standard input for `-`; of anything else only the start, so that it is refused whatever its length.
pub fn read_splats(path: &Path) -> Result<Vec<u8>, Failure> {
    read(path, &MAGIC, Limits::default().alloc)
}

/// Reads the whole of `path`, or of standard input for `-`; refuses more than `most` bytes.
pub fn read_at_most(path: &Path, most: u64) -> Result<Vec<u8>, Failure> {
    read(path, &[], most)
}

/// Reads on behind `start` where the file begins with it.
fn read(path: &Path, start: &[u8], most: u64) -> Result<Vec<u8>, Failure> {
    if path.is_dir() {
        return Err(is_folder(path));
    }
    let mut bytes = Vec::new();
    let mut read = |reader: &mut dyn Read| {
        reader.take(start.len() as u64).read_to_end(&mut bytes)?;
        if bytes == start {
            reader.take(most.saturating_sub(start.len() as u64).saturating_add(1)).read_to_end(&mut bytes)?;
        }
        Ok(())
    };
    let done = if path == Path::new("-") {
        read(&mut io::stdin().lock())
    } else {
        File::open(path).and_then(|mut f| read(&mut f))
    };
    done.map_err(|e| Failure::io(path, &e))?;
    if bytes.len() as u64 > most {
        let message = format!("{}: is longer than {most} bytes", Failure::input(path));
        return Err(Failure { kind: Kind::Limit, message });
    }
    Ok(bytes)
}

/// The failure where a folder is named for a file.
fn is_folder(path: &Path) -> Failure {
    let message = format!("{}: is a folder; --out-dir DIR takes the files in it", path.display());
    Failure { kind: Kind::Io, message }
}

/// Decodes `path`, or standard input for `-`.
pub fn open(path: &Path, turn: Turn) -> Result<Source, Failure> {
    let io = |e| Failure::io(path, &e);
    let mut reader: Box<dyn ReadSeek> = if path == Path::new("-") {
        Box::new(Cursor::new(read_at_most(path, Limits::default().alloc)?))
    } else if path.is_dir() {
        return Err(is_folder(path));
    } else {
        Box::new(BufReader::new(File::open(path).map_err(io)?))
    };
    let start = reader.fill_buf().map_err(io)?;
    if start.is_empty() {
        return Err(Failure { kind: Kind::Format, message: format!("{}: is empty", Failure::input(path)) });
    }
    if start.starts_with(&MAGIC) {
        let mut bytes = Vec::new();
        reader.read_to_end(&mut bytes).map_err(io)?;
        return decode(path, &bytes);
    }
    let advice = advice(start);
    let failed = |e| {
        let mut failure = Failure::image(path, &e);
        failure.message += advice.unwrap_or("");
        failure
    };
    let mut image = ImageReader::new(reader).with_guessed_format().map_err(io)?;
    if image.format().is_none() {
        // A few formats (TGA) cannot be told by their content.
        if let Ok(format) = image::ImageFormat::from_path(path) {
            image.set_format(format);
        }
    }
    let mut is_cut_off = false;
    let mut notes = Vec::new();
    if let Some(format) = image.format() {
        let mut reader = image.into_inner();
        let found = completeness::look(&mut reader, format).map_err(io)?;
        reader.rewind().map_err(io)?;
        is_cut_off = !found.is_whole;
        if found.has_more {
            notes.push("only the first of its frames or pages is taken".into());
        }
        image = ImageReader::with_format(reader, format);
    }
    let mut limits = image::Limits::default();
    limits.max_alloc = Some(MAX_ALLOC);
    image.limits(limits);
    let mut decoder = image.into_decoder().map_err(failed)?;
    let icc = decoder.icc_profile().map_err(failed)?;
    let mut exif = decoder.exif_metadata().map_err(failed)?;
    if decoder.xmp_metadata().is_ok_and(|xmp| xmp.is_some()) {
        notes.push("its XMP block is left out".into());
    }
    let mut orientation = decoder.orientation().unwrap_or(Orientation::NoTransforms);
    let mut picture = DynamicImage::from_decoder(decoder).map_err(failed)?;
    if turn == Turn::Upright {
        picture.apply_orientation(orientation);
        if let Some(exif) = &mut exif {
            let _ = Orientation::remove_from_exif_chunk(exif);
        }
        orientation = Orientation::NoTransforms;
    }
    let pixels = Pixels::try_from(picture).map_err(|e| Failure::library(path, &e))?;
    let mut icc = icc;
    keep_fitting(&mut icc, pixels.channels(), &mut notes);
    Ok(Source { pixels, icc, exif, orientation, is_cut_off, notes })
}

/// Decodes the ssplat file `bytes`, which came from `path`.
pub fn decode(path: &Path, bytes: &[u8]) -> Result<Source, Failure> {
    let decoded = ssplat::unstable::decode(bytes, &DecodeOptions::default()).map_err(|e| Failure::library(path, &e))?;
    let (icc, exif) = (decoded.metadata.icc, decoded.metadata.exif);
    let orientation = orientation_in(exif.as_deref());
    Ok(Source { pixels: decoded.pixels, icc, exif, orientation, is_cut_off: false, notes: Vec::new() })
}

/// Returns the orientation stated in an EXIF block.
pub fn orientation_in(exif: Option<&[u8]>) -> Orientation {
    exif.and_then(Orientation::from_exif_chunk).unwrap_or(Orientation::NoTransforms)
}

/// Leaves a profile out that is not for `channels`, and notes it.
pub fn keep_fitting(icc: &mut Option<Vec<u8>>, channels: Channels, notes: &mut Vec<String>) {
    if let Some(space) = icc.as_ref().and_then(|icc| misfit(icc, channels)) {
        notes.push(format!("its ICC profile is for {space}, not for the stored channels, and is left out"));
        *icc = None;
    }
}

/// The colour space of a profile where it is another than that of `channels`.
fn misfit(icc: &[u8], channels: Channels) -> Option<String> {
    // ICC.1, header: data colour space.
    let space = icc.get(16..20).unwrap_or(b"none");
    let wanted = if channels.count() < 3 { b"GRAY" } else { b"RGB " };
    (space != wanted).then(|| String::from_utf8_lossy(space).trim().to_string())
}

/// Returns advice for formats that are not read, by the first bytes of a file.
fn advice(start: &[u8]) -> Option<&'static str> {
    match start.get(4..12) {
        Some(b"ftypavif" | b"ftypavis") => Some(" (an AVIF file: convert it first, with `avifdec IN.avif OUT.png`)"),
        Some(b"ftypheic" | b"ftypheix" | b"ftypmif1" | b"ftypmsf1" | b"ftyphevc") => {
            Some(" (a HEIC file: convert it first, with `heif-convert IN.heic OUT.png`)")
        }
        Some(b"JXL \r\n\x87\n") => Some(" (a JPEG XL file: convert it first, with `djxl IN.jxl OUT.png`)"),
        _ if start.starts_with(&[0xFF, 0x0A]) => {
            Some(" (a JPEG XL file: convert it first, with `djxl IN.jxl OUT.png`)")
        }
        _ => None,
    }
}
