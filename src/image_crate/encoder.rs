//! Encodes pictures of the `image` crate: [`SsplatEncoder`] and [`Encoder::save`].
//!
//! `image` has no hook for saving, so `DynamicImage::save("x.ssplat")` cannot work. Use one of these instead:
//!
//! ```no_run
//! use ssplat::{Encoder, SsplatEncoder};
//!
//! let picture = image::open("photo.png")?;
//! let encoder = Encoder::new().ratio(100.0);
//! encoder.save(&picture, "photo.ssplat")?;
//!
//! let mut bytes = Vec::new();
//! picture.write_with_encoder(SsplatEncoder::new(&mut bytes, encoder))?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use std::io::Write;
use std::path::Path;

use image::error::{EncodingError, ImageFormatHint, ParameterError, ParameterErrorKind, UnsupportedError};
use image::error::{LimitError, LimitErrorKind, UnsupportedErrorKind};
use image::{DynamicImage, ExtendedColorType, ImageEncoder, ImageError, ImageFormat, ImageResult};

use super::convert::{Rejected, gather};
use super::decoder::EXTENSION;
use super::replace::replace;
use crate::encode::{EncodeReport, encode};
use crate::encoder::Encoder;
use crate::error::{Error, Result};
use crate::options::EncodeOptions;
use crate::parameter::Parameter;
use crate::pixels::Pixels;

/// Encodes `picture` and writes the file to `path`. The file is first written under another name, so that an existing
/// file is replaced only once the new one is complete.
///
/// A [`DynamicImage`] has neither the ICC profile nor the orientation of its file.
///
/// # Errors
/// [`Error::Io`] if the file cannot be written, [`Error::Parameter`] if `path` has the extension of another format;
/// otherwise as [`encode`].
pub fn save(picture: &DynamicImage, path: impl AsRef<Path>, options: &EncodeOptions) -> Result<EncodeReport> {
    check_extension(path.as_ref())?;
    let encoded = encode(&Pixels::try_from(picture)?, options)?;
    write(path.as_ref(), &encoded.bytes)?;
    Ok(encoded.report)
}

impl Encoder {
    /// Encodes `picture` and writes the file to `path`. An existing file is replaced only once the new one is complete.
    ///
    /// A [`DynamicImage`] has neither the ICC profile nor the orientation of its file. Use
    /// [`transcode`](Encoder::transcode) to keep them, or set them with [`icc`](Encoder::icc) and
    /// [`exif`](Encoder::exif).
    ///
    /// # Errors
    /// [`Error::Io`] if the file cannot be written, [`Error::Parameter`] if `path` has the extension of another
    /// format; otherwise as [`Encoder::encode`].
    pub fn save(&self, picture: &DynamicImage, path: impl AsRef<Path>) -> Result<EncodeReport> {
        save(picture, path, self.options())
    }
}

/// Rejects a path whose extension belongs to another picture format.
pub(super) fn check_extension(path: &Path) -> Result<()> {
    if ImageFormat::from_path(path).is_err() {
        return Ok(());
    }
    let problem = format!("{} has the extension of another format", path.display());
    Err(Error::Parameter { parameter: Parameter::Path, problem })
}

/// Writes a whole file.
pub(super) fn write(path: &Path, bytes: &[u8]) -> Result<()> {
    replace(path, bytes).map_err(|e| Error::at(path, e))
}

/// Writes pictures as ssplat files, for [`DynamicImage::write_with_encoder`].
///
/// It accepts the colour types of [`DynamicImage`], and `Bgr8` and `Bgra8`. Samples in `f32` are encoded values where
/// 1.0 is white; they are clamped to `0..=1` and stored with 16 bits. A sample that is not finite is an error.
#[derive(Debug)]
pub struct SsplatEncoder<W> {
    writer: W,
    encoder: Encoder,
}

impl<W: Write> SsplatEncoder<W> {
    /// Returns an encoder that writes one file to `writer`, in a single call.
    pub fn new(writer: W, encoder: impl Into<Encoder>) -> Self {
        SsplatEncoder { writer, encoder: encoder.into() }
    }
}

impl<W: Write> ImageEncoder for SsplatEncoder<W> {
    fn write_image(mut self, buf: &[u8], width: u32, height: u32, color_type: ExtendedColorType) -> ImageResult<()> {
        let pixels = gather(buf, width, height, color_type)?;
        let encoded = self.encoder.encode(&pixels).map_err(encoding_error)?;
        self.writer.write_all(&encoded.bytes)?;
        self.writer.flush()?;
        Ok(())
    }

    fn set_icc_profile(&mut self, icc_profile: Vec<u8>) -> Result<(), UnsupportedError> {
        self.encoder = std::mem::take(&mut self.encoder).icc(icc_profile);
        Ok(())
    }

    fn set_exif_metadata(&mut self, exif: Vec<u8>) -> Result<(), UnsupportedError> {
        self.encoder = std::mem::take(&mut self.encoder).exif(exif);
        Ok(())
    }
}

impl From<Rejected> for ImageError {
    fn from(rejected: Rejected) -> Self {
        match rejected {
            Rejected::Pixels(e) => encoding_error(e),
            Rejected::Color(c) => {
                ImageError::Unsupported(UnsupportedError::from_format_and_kind(hint(), UnsupportedErrorKind::Color(c)))
            }
        }
    }
}

/// Returns the name of the format for errors of `image`.
fn hint() -> ImageFormatHint {
    ImageFormatHint::Name(EXTENSION.into())
}

/// Converts an encoding error to an error of `image`.
fn encoding_error(e: Error) -> ImageError {
    match e {
        Error::Io(e) => ImageError::IoError(e),
        Error::LimitExceeded { .. } => ImageError::Limits(LimitError::from_kind(LimitErrorKind::InsufficientMemory)),
        Error::Parameter { .. } | Error::TooSmall { .. } => {
            ImageError::Parameter(ParameterError::from_kind(ParameterErrorKind::Generic(e.to_string())))
        }
        e => ImageError::Encoding(EncodingError::new(hint(), e)),
    }
}
