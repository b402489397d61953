//! Reads pictures of any supported format, with their ICC profiles and EXIF blocks.

use std::io::{ErrorKind, Read, Seek};
use std::path::Path;

use image::metadata::Orientation;
use image::{DynamicImage, GenericImageView, ImageDecoder, ImageFormat, ImageReader};
use ssplat::unstable::DecodeOptions;
use ssplat::unstable::bitstream::header::MAGIC;
use ssplat::unstable::colour::{self, Overlay, Profiles, Stated};
use ssplat::unstable::input::{MAX_ALLOC, limits, open as open_picture, picture as decoded_picture};
use ssplat::{Channels, Cicp, HiddenColors, Limits, Metadata, Pixels};

use crate::failure::{Failure, Kind};
use crate::input::{self, Input};
use crate::limits::{MAX_SIDE, beyond_memory, too_long};
use crate::sniff::{Sniffed, refusal_of_others, sniff};
use crate::{completeness, exif_text, floats, guard, jpeg_end, resize, tiff};

/// Whether pixels are rotated as the EXIF block says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Turn {
    Keep,
    Upright,
}

/// How a picture is read.
#[derive(Debug, Clone, Copy)]
pub struct Reading {
    pub turn: Turn,
    pub profiles: Profiles,
    /// Longest side to which a picture is downscaled that exceeds [`MAX_SIDE`]; it is refused otherwise.
    pub max_side: Option<u32>,
    pub hidden: HiddenColors,
}

impl Reading {
    /// Reads everything but pictures that exceed [`MAX_SIDE`].
    pub fn turned(turn: Turn) -> Reading {
        Reading { turn, profiles: Profiles::Read, max_side: None, hidden: HiddenColors::default() }
    }
}

/// A picture with its metadata.
pub struct Source {
    pub pixels: Pixels,
    /// Code points that no profile can express.
    pub cicp: Option<Cicp>,
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
        let pixels = turned(path, self.pixels, self.orientation)?;
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
    read(path, Input::open(path)?, &Reading::turned(turn))
}

/// Decodes `input`, which came from `path`. A panic of a decoder is reported as a broken file.
pub fn read(path: &Path, mut input: Input, reading: &Reading) -> Result<Source, Failure> {
    let start = input.start().map_err(|e| Failure::io(path, &e))?;
    if start.is_empty() {
        return Err(Failure {
            kind: Kind::Format,
            message: format!("{}: empty (0 bytes), not a picture", Failure::input(path)),
        });
    }
    if start.starts_with(&MAGIC) {
        let decoded = decode(path, &input::all(path, input, Limits::default().alloc)?)?;
        return if reading.turn == Turn::Upright { decoded.upright(path) } else { Ok(decoded) };
    }
    let sniffed = sniff(start);
    if let Some(other) = sniffed.filter(|other| !other.is_read()) {
        let message = format!("{}: {}", Failure::input(path), other.refusal());
        return Err(Failure { kind: Kind::Unsupported, message });
    }
    if let Some((kind, refusal)) = refusal_of_others(start) {
        return Err(Failure { kind, message: format!("{}: {refusal}", Failure::input(path)) });
    }
    #[cfg(feature = "jxl")]
    if sniffed == Some(Sniffed::JpegXl) {
        let read = guard::quietly(|| crate::jxl::read(path, &mut input, reading));
        return read.unwrap_or_else(|panic| Err(panicked(path, &panic)));
    }
    guard::quietly(|| read_foreign(path, input, reading)).unwrap_or_else(|panic| Err(panicked(path, &panic)))
}

/// Returns the failure for a file on which its decoder panicked.
pub fn panicked(path: &Path, panic: &str) -> Failure {
    let message = format!("{}: its decoder failed unexpectedly: {panic}", Failure::input(path));
    Failure { kind: Kind::Format, message }
}

/// A picture in memory, from a decoder other than those of `image`.
pub struct Decoded {
    /// Has the channels of the file, and 16 bits for each sample where the file has more than 8.
    pub picture: DynamicImage,
    pub orientation: Orientation,
    /// Primaries, transfer characteristics, matrix coefficients (0, because the pixels are RGB) and full range (1), by
    /// ITU-T H.273.
    pub code_points: Option<[u8; 4]>,
    pub icc: Option<Vec<u8>>,
    pub exif: Option<Vec<u8>>,
    /// What is left out.
    pub notes: Vec<String>,
}

/// Decodes a picture of another format than ssplat.
fn read_foreign(path: &Path, mut input: Input, reading: &Reading) -> Result<Source, Failure> {
    let io = |e| Failure::io(path, &e);
    let start = input.start().map_err(io)?;
    let failed = |e| {
        let mut failure = Failure::image(path, &e);
        if failure.kind == Kind::Limit {
            failure.message = beyond_memory(path);
        }
        failure
    };
    let unsupported =
        |what: &str| Failure { kind: Kind::Unsupported, message: format!("{}: {what}", Failure::input(path)) };
    let format = image::guess_format(start).or_else(|_| image::ImageFormat::from_path(path));
    let mut is_cut_off = false;
    let mut notes = Vec::new();
    if let Ok(format) = format {
        let found = completeness::look(&mut input, format).map_err(io)?;
        input.rewind().map_err(io)?;
        if let Some(kind) = found.unsupported {
            return Err(unsupported(kind));
        }
        is_cut_off = !found.is_whole;
        if found.is_reduced {
            return Err(unsupported(
                "its first picture is a reduced version, as in raw files of cameras (DNG, NEF): convert it to PNG or TIFF first",
            ));
        }
        if found.has_gain_map {
            notes.push("its gain map is left out: the picture has standard dynamic range".into());
        } else if found.has_more {
            notes.push("only the first of its frames or pages is used".into());
        }
        if is_cut_off && format == ImageFormat::Jpeg && jpeg_end::has_all_samples(path, &mut input)? {
            is_cut_off = false;
            notes.push("its end marker is missing, but its picture is complete".into());
        }
    }
    let stated = stated(path, &mut input, reading.profiles)?;
    notes.extend(stated.note.map(String::from));
    let text = exif_text::read(path, &mut input, &stated, &mut notes)?;
    let (picture, mut exif, mut orientation, icc);
    let mut code_points = None;
    #[cfg(feature = "avif")]
    let avif = if sniff(input.start().map_err(io)?) == Some(Sniffed::Avif) {
        Some(crate::avif::read(path, &mut input)?)
    } else {
        None
    };
    #[cfg(not(feature = "avif"))]
    let avif = None::<Decoded>;
    if let Some(found) = avif {
        // A profile takes precedence (MIAF, 7.3.6.4).
        if reading.profiles == Profiles::Read && found.icc.is_none() {
            code_points = found.code_points.map(|points| colour::of_cicp(points, !found.picture.color().has_color()));
        }
        picture = found.picture;
        notes.extend(found.notes);
        (exif, orientation) = (found.exif, found.orientation);
        icc = stated.with_profile(found.icc.filter(|_| reading.profiles == Profiles::Read));
    } else if let Some(found) = tiff::read(path, &mut input)? {
        picture = found.picture;
        notes.extend(found.notes);
        (exif, orientation, icc) = (None, found.orientation, stated.own_profile());
    } else {
        let mut decoder = open_picture(&mut input, path, &stated, &limits()).map_err(failed)?;
        icc = stated.profile(&mut decoder).map_err(failed)?;
        (exif, orientation) = stated.exif(&mut decoder).map_err(failed)?;
        if stated.has_xmp || decoder.xmp_metadata().is_ok_and(|xmp| xmp.is_some()) {
            notes.push("its XMP block is left out".into());
        }
        picture = decoded_picture(decoder).map_err(failed)?;
    }
    let (mut icc, note) = icc;
    notes.extend(note);
    let mut cicp = stated.cicp;
    if let Some(found) = code_points {
        (cicp, icc) = (found.cicp, found.icc);
    }
    if let Some(text) = text {
        orientation = orientation_in(Some(&text));
        exif = Some(text);
    }
    let picture = stated.corrected(picture);
    notes.extend(floats::check(path, &picture)?);
    let [width, height] = <[u32; 2]>::from(picture.dimensions());
    let mut pixels = None;
    if width.max(height) > MAX_SIDE {
        let size = resize::fitted([width, height], reading.max_side);
        if size[0].max(size[1]) > MAX_SIDE {
            return Err(too_long(path, [width, height]));
        }
        let small = resize::resize(&picture, size, icc.as_deref(), reading.hidden);
        pixels = Some(small.map_err(|e| Failure::library(path, &e))?);
    }
    let mut pixels = match pixels {
        Some(pixels) => pixels,
        None => Pixels::try_from(picture).map_err(|e| Failure::library(path, &e))?,
    };
    if reading.turn == Turn::Upright {
        pixels = turned(path, pixels, orientation)?;
        forget_orientation(&mut exif);
        orientation = Orientation::NoTransforms;
    }
    keep_fitting(&mut icc, pixels.channels(), &mut notes);
    Ok(Source { pixels, cicp, icc, exif, orientation, is_cut_off, notes })
}

/// Applies an orientation to `pixels`.
fn turned(path: &Path, pixels: Pixels, orientation: Orientation) -> Result<Pixels, Failure> {
    if orientation == Orientation::NoTransforms {
        return Ok(pixels);
    }
    let mut picture = DynamicImage::from(pixels);
    picture.apply_orientation(orientation);
    Pixels::try_from(picture).map_err(|e| Failure::library(path, &e))
}

/// Returns what the file in `input` states, and which of its parts are hidden from its decoder.
pub fn stated(path: &Path, input: &mut (impl std::io::BufRead + Seek), profiles: Profiles) -> Result<Stated, Failure> {
    colour::look(input, profiles).map_err(|e| match e.kind() {
        ErrorKind::FileTooLarge => Failure { kind: Kind::Limit, message: format!("{}: {e}", Failure::input(path)) },
        _ => Failure::io(path, &e),
    })
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
        // The PNG decoder decompresses a profile first.
        if format == ImageFormat::Png {
            let mut header = [0; 24];
            input.read_exact(&mut header).ok()?;
            let (words, _) = header.as_chunks::<4>();
            return Some([words[4], words[5]].map(u32::from_be_bytes)).filter(|_| &header[12..16] == b"IHDR");
        }
        // The JPEG decoder reads the whole file first.
        if format == ImageFormat::Jpeg && input.length().ok()? > MAX_ALLOC {
            return None;
        }
        // The type that `open_picture` reads, so that the decoders are compiled once.
        let overlay = Overlay::new(&mut *input, Vec::new()).ok()?;
        let mut reader = ImageReader::with_format(overlay, format);
        reader.limits(limits());
        reader.into_dimensions().ok().map(<[u32; 2]>::from)
    };
    let found = guard::quietly(&mut size).ok().flatten();
    if input.rewind().is_ok() { found } else { None }
}

/// Decodes the ssplat file `bytes`, which came from `path`.
pub fn decode(path: &Path, bytes: &[u8]) -> Result<Source, Failure> {
    let decoded = ssplat::unstable::decode(bytes, &DecodeOptions::default()).map_err(|e| Failure::library(path, &e))?;
    let Metadata { cicp, icc, exif, .. } = decoded.metadata;
    let orientation = orientation_in(exif.as_deref());
    Ok(Source { pixels: decoded.pixels, cicp, icc, exif, orientation, is_cut_off: false, notes: Vec::new() })
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
    if let Some(why) = icc.as_ref().and_then(|icc| colour::misfit(icc, channels.count() < 3)) {
        notes.push(format!("its ICC profile {why}, and is left out"));
        *icc = None;
    }
}
