//! Pictures in: any format that is known by its content, with its ICC profile and EXIF block.

use std::io::Seek;
use std::path::Path;

use image::metadata::Orientation;
use image::{ImageDecoder, ImageReader};
use ssplat::unstable::bitstream::header::MAGIC;
use ssplat::unstable::input::{MAX_ALLOC, limits, open as open_picture, picture as decoded_picture};
use ssplat::unstable::{DecodeOptions, colour};
use ssplat::{Channels, Error, Limits, Pixels};

use crate::failure::{Failure, Kind};
use crate::input::{self, Input};
use crate::{completeness, guard};

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

/// Decodes `path`, or standard input for `-`.
pub fn open(path: &Path, turn: Turn) -> Result<Source, Failure> {
    read(path, Input::open(path)?, turn)
}

/// Decodes what `input` holds, which came from `path`. A panic of a decoder is a broken file.
pub fn read(path: &Path, mut input: Input, turn: Turn) -> Result<Source, Failure> {
    let start = input.start().map_err(|e| Failure::io(path, &e))?;
    if start.is_empty() {
        return Err(Failure { kind: Kind::Format, message: format!("{}: is empty", Failure::input(path)) });
    }
    if start.starts_with(&MAGIC) {
        return decode(path, &input::all(path, input, Limits::default().alloc)?);
    }
    guard::quietly(|| read_foreign(path, input, turn)).unwrap_or_else(|panic| Err(panicked(path, &panic)))
}

/// The failure of a file at which a decoder panicked.
pub fn panicked(path: &Path, panic: &str) -> Failure {
    let message = format!("{}: its decoder cannot cope with it: {panic}", Failure::input(path));
    Failure { kind: Kind::Format, message }
}

/// Decodes a picture of another format than ssplat.
fn read_foreign(path: &Path, mut input: Input, turn: Turn) -> Result<Source, Failure> {
    let io = |e| Failure::io(path, &e);
    let start = input.start().map_err(io)?;
    let advice = advice(start);
    let failed = |e| {
        let mut failure = Failure::image(path, &e);
        if failure.kind == Kind::Limit {
            let path = Failure::input(path);
            failure.message = format!("{path}: takes more memory than there is, or than the {MAX_ALLOC} bytes allowed");
        }
        failure.message += advice.unwrap_or("");
        failure
    };
    let format = image::guess_format(start).or_else(|_| image::ImageFormat::from_path(path));
    let mut is_cut_off = false;
    let mut notes = Vec::new();
    if let Ok(format) = format {
        let found = completeness::look(&mut input, format).map_err(io)?;
        input.rewind().map_err(io)?;
        is_cut_off = !found.is_whole;
        if found.is_reduced {
            let message = format!(
                "{}: holds a small version first, as raw files of cameras do (DNG, NEF): develop the picture to PNG or TIFF",
                Failure::input(path)
            );
            return Err(Failure { kind: Kind::Unsupported, message });
        }
        if found.has_more {
            notes.push("only the first of its frames or pages is taken".into());
        }
    }
    let stated = colour::look(&mut input).map_err(io)?;
    notes.extend(stated.note.map(String::from));
    let mut decoder = open_picture(input, path, &limits()).map_err(failed)?;
    let icc = stated.or(decoder.icc_profile().map_err(failed)?);
    let mut exif = decoder.exif_metadata().map_err(failed)?;
    if decoder.xmp_metadata().is_ok_and(|xmp| xmp.is_some()) {
        notes.push("its XMP block is left out".into());
    }
    let mut orientation = decoder.orientation().unwrap_or(Orientation::NoTransforms);
    let mut picture = stated.without_idle_alpha(decoded_picture(decoder).map_err(failed)?);
    if turn == Turn::Upright {
        picture.apply_orientation(orientation);
        if let Some(exif) = &mut exif {
            let _ = Orientation::remove_from_exif_chunk(exif);
        }
        orientation = Orientation::NoTransforms;
    }
    let pixels = Pixels::try_from(picture).map_err(|e| match e {
        // A sample that is no number is the file's fault.
        Error::Parameter { problem, .. } => {
            Failure { kind: Kind::Format, message: format!("{}: {problem}", Failure::input(path)) }
        }
        e => Failure::library(path, &e),
    })?;
    let mut icc = icc;
    keep_fitting(&mut icc, pixels.channels(), &mut notes);
    Ok(Source { pixels, icc, exif, orientation, is_cut_off, notes })
}

/// Width times height of a picture of another format than ssplat; 0 where it cannot be told. The input is rewound.
pub fn pixels(path: &Path, input: &mut Input) -> u64 {
    let mut size = || {
        let format = image::guess_format(input.start().ok()?).or_else(|_| image::ImageFormat::from_path(path)).ok()?;
        // Its decoder begins with reading all of the file.
        if format == image::ImageFormat::Jpeg && input.length().ok()? > MAX_ALLOC {
            return None;
        }
        let mut reader = ImageReader::with_format(&mut *input, format);
        reader.limits(limits());
        let (width, height) = reader.into_dimensions().ok()?;
        Some(u64::from(width) * u64::from(height))
    };
    let found = guard::quietly(&mut size).ok().flatten();
    if input.rewind().is_ok() { found.unwrap_or(0) } else { 0 }
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
