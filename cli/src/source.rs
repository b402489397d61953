//! Reads pictures of any supported format, with their ICC profiles and EXIF blocks.

use std::io::Seek;
use std::path::Path;

use image::metadata::Orientation;
use image::{DynamicImage, ImageDecoder, ImageReader};
use ssplat::unstable::bitstream::header::MAGIC;
use ssplat::unstable::input::{MAX_ALLOC, limits, open as open_picture, picture as decoded_picture};
use ssplat::unstable::{DecodeOptions, colour};
use ssplat::{Channels, Error, HiddenColors, Limits, Pixels};

use crate::failure::{Failure, Kind};
use crate::input::{self, Input};
use crate::sniff::{Sniffed, sniff};
use crate::{completeness, guard, resize};

/// Whether pixels are rotated as the EXIF block says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Turn {
    Keep,
    Upright,
}

/// A picture with its metadata.
pub struct Source {
    pub pixels: Pixels,
    pub icc: Option<Vec<u8>>,
    pub exif: Option<Vec<u8>>,
    /// Orientation that is not applied to the pixels yet.
    pub orientation: Orientation,
    /// The file is truncated.
    pub is_cut_off: bool,
    /// Notes about parts of the file that are ignored.
    pub notes: Vec<String>,
}

impl Source {
    /// Downscales the picture to `size`.
    pub fn resized(self, path: &Path, size: [u32; 2], hidden: HiddenColors) -> Result<Source, Failure> {
        let pixels = resize::resize(&self.pixels, size, self.icc.as_deref(), hidden);
        Ok(Source { pixels: pixels.map_err(|e| Failure::library(path, &e))?, ..self })
    }

    /// Applies the orientation to the pixels.
    pub fn upright(self, path: &Path) -> Result<Source, Failure> {
        if self.orientation == Orientation::NoTransforms {
            return Ok(self);
        }
        let mut picture = DynamicImage::from(self.pixels);
        picture.apply_orientation(self.orientation);
        let pixels = Pixels::try_from(picture).map_err(|e| Failure::library(path, &e))?;
        let mut exif = self.exif;
        forget_orientation(&mut exif);
        Ok(Source { pixels, exif, orientation: Orientation::NoTransforms, ..self })
    }

    /// Returns an error if the file is truncated.
    pub fn whole(self, path: &Path) -> Result<Source, Failure> {
        if self.is_cut_off {
            let message =
                format!("{}: the file is cut off; --partial decodes the part that is present", path.display());
            return Err(Failure { kind: Kind::Format, message });
        }
        Ok(self)
    }
}

/// Decodes `path`, or standard input for `-`.
pub fn open(path: &Path, turn: Turn) -> Result<Source, Failure> {
    read(path, Input::open(path)?, turn)
}

/// Decodes `input`, which came from `path`. A panic of a decoder is reported as a broken file.
pub fn read(path: &Path, mut input: Input, turn: Turn) -> Result<Source, Failure> {
    let start = input.start().map_err(|e| Failure::io(path, &e))?;
    if start.is_empty() {
        return Err(Failure { kind: Kind::Format, message: format!("{}: is empty", Failure::input(path)) });
    }
    if start.starts_with(&MAGIC) {
        let decoded = decode(path, &input::all(path, input, Limits::default().alloc)?)?;
        return if turn == Turn::Upright { decoded.upright(path) } else { Ok(decoded) };
    }
    let sniffed = sniff(start);
    if let Some(other) = sniffed.filter(|other| !other.is_read()) {
        let message = format!("{}: {}", Failure::input(path), other.refusal());
        return Err(Failure { kind: Kind::Unsupported, message });
    }
    #[cfg(feature = "jxl")]
    if sniffed == Some(Sniffed::JpegXl) {
        let read = guard::quietly(|| crate::jxl::read(path, &mut input));
        return read.unwrap_or_else(|panic| Err(panicked(path, &panic)));
    }
    guard::quietly(|| read_foreign(path, input, turn)).unwrap_or_else(|panic| Err(panicked(path, &panic)))
}

/// Returns the message for a picture that exceeds the memory limit.
pub fn beyond_memory(path: &Path) -> String {
    let path = Failure::input(path);
    format!("{path}: needs more memory than is available, or than the {MAX_ALLOC} bytes that are allowed")
}

/// Returns the failure for a file on which its decoder panicked.
pub fn panicked(path: &Path, panic: &str) -> Failure {
    let message = format!("{}: its decoder failed unexpectedly: {panic}", Failure::input(path));
    Failure { kind: Kind::Format, message }
}

/// Decodes a picture of another format than ssplat.
fn read_foreign(path: &Path, mut input: Input, turn: Turn) -> Result<Source, Failure> {
    let io = |e| Failure::io(path, &e);
    let start = input.start().map_err(io)?;
    let failed = |e| {
        let mut failure = Failure::image(path, &e);
        if failure.kind == Kind::Limit {
            failure.message = beyond_memory(path);
        }
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
                "{}: its first picture is a reduced version, as in raw files of cameras (DNG, NEF): convert it to PNG or TIFF first",
                Failure::input(path)
            );
            return Err(Failure { kind: Kind::Unsupported, message });
        }
        if found.has_more {
            notes.push("only the first of its frames or pages is used".into());
        }
    }
    #[cfg(feature = "avif")]
    let avif = if sniff(input.start().map_err(io)?) == Some(Sniffed::Avif) {
        Some(crate::avif::look(path, &mut input)?)
    } else {
        None
    };
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
    #[cfg(feature = "avif")]
    if let Some(avif) = avif {
        orientation = avif.orientation;
        picture = avif.own_channels(picture);
    }
    if turn == Turn::Upright {
        picture.apply_orientation(orientation);
        forget_orientation(&mut exif);
        orientation = Orientation::NoTransforms;
    }
    let pixels = Pixels::try_from(picture).map_err(|e| match e {
        // NaN samples make the file invalid.
        Error::Parameter { problem, .. } => {
            Failure { kind: Kind::Format, message: format!("{}: {problem}", Failure::input(path)) }
        }
        e => Failure::library(path, &e),
    })?;
    let mut icc = icc;
    keep_fitting(&mut icc, pixels.channels(), &mut notes);
    Ok(Source { pixels, icc, exif, orientation, is_cut_off, notes })
}

/// Returns width and height of a picture in a format other than ssplat, or `None` if they are unknown. Rewinds the
/// input.
pub fn size(path: &Path, input: &mut Input) -> Option<[u32; 2]> {
    let mut size = || {
        let start = input.start().ok()?;
        #[cfg(feature = "jxl")]
        if sniff(start) == Some(Sniffed::JpegXl) {
            return crate::jxl::size(input);
        }
        // The AVIF decoder decodes the whole picture before it returns the size.
        if sniff(start) == Some(Sniffed::Avif) {
            return None;
        }
        let format = image::guess_format(start).or_else(|_| image::ImageFormat::from_path(path)).ok()?;
        // The JPEG decoder reads the whole file first.
        if format == image::ImageFormat::Jpeg && input.length().ok()? > MAX_ALLOC {
            return None;
        }
        let mut reader = ImageReader::with_format(&mut *input, format);
        reader.limits(limits());
        reader.into_dimensions().ok().map(<[u32; 2]>::from)
    };
    let found = guard::quietly(&mut size).ok().flatten();
    if input.rewind().is_ok() { found } else { None }
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

/// Removes the orientation from an EXIF block, because the pixels are upright.
pub fn forget_orientation(exif: &mut Option<Vec<u8>>) {
    if let Some(exif) = exif {
        let _ = Orientation::remove_from_exif_chunk(exif);
    }
}

/// Removes a profile that does not fit `channels`, and adds a note.
pub fn keep_fitting(icc: &mut Option<Vec<u8>>, channels: Channels, notes: &mut Vec<String>) {
    if let Some(space) = icc.as_ref().and_then(|icc| misfit(icc, channels)) {
        notes.push(format!("its ICC profile is for {space}, not for the stored channels, and is left out"));
        *icc = None;
    }
}

/// Returns the colour space of a profile if it does not fit `channels`.
fn misfit(icc: &[u8], channels: Channels) -> Option<String> {
    // ICC.1, header: data colour space.
    let space = icc.get(16..20).unwrap_or(b"none");
    let wanted = if channels.count() < 3 { b"GRAY" } else { b"RGB " };
    (space != wanted).then(|| String::from_utf8_lossy(space).trim().to_string())
}
