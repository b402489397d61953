//! Pictures of other formats to files, with their ICC profile and orientation: [`transcode`] and [`encode_decoder`].

use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use image::metadata::Orientation;
use image::{DynamicImage, ImageDecoder, ImageError, ImageReader};

use super::decoder::register;
use super::encoder::{check_extension, write};
use crate::encode::{EncodeReport, Encoded, Encoder, encode};
use crate::error::{Error, Result};
use crate::options::EncodeOptions;
use crate::pixels::Pixels;

/// Encodes the picture in the file at `input` and writes it to `output`, with what [`EncodeOptions::carry`] says of its
/// metadata: by default the ICC profile and the orientation.
///
/// The formats are those that `image` is built with, by content or extension, and ssplat. [`DynamicImage`] holds
/// neither profile nor orientation, so [`image::open`] and [`save`](super::save) lose both; this does not. A profile that
/// `options` brings takes the place of the picture's own, and so does an EXIF block.
///
/// # Errors
/// [`Error::Io`] when a file cannot be read or written, [`Error::Source`] when `input` is no picture that `image` knows,
/// [`Error::Parameter`] when `output` has the extension of another format; otherwise as [`encode`].
pub fn transcode(input: impl AsRef<Path>, output: impl AsRef<Path>, options: &EncodeOptions) -> Result<EncodeReport> {
    register();
    let (input, output) = (input.as_ref(), output.as_ref());
    check_extension(output)?;
    let failed = |error: ImageError| match error {
        // `image` reports a picture that ends too soon as an IO error, but the picture is at fault.
        ImageError::IoError(e) if e.kind() != std::io::ErrorKind::UnexpectedEof => Error::at(input, &e),
        error => Error::Source { path: Some(input.into()), error },
    };
    let io = |e: std::io::Error| Error::at(input, &e);
    let mut reader =
        ImageReader::new(BufReader::new(File::open(input).map_err(io)?)).with_guessed_format().map_err(io)?;
    if reader.format().is_none()
        && let Ok(format) = image::ImageFormat::from_path(input)
    {
        reader.set_format(format);
    }
    let decoder = reader.into_decoder().map_err(failed)?;
    let encoded = encode_decoder(decoder, options).map_err(|e| match e {
        Error::Source { error, .. } => failed(error),
        e => e,
    })?;
    write(output, &encoded.bytes)?;
    Ok(encoded.report)
}

/// Encodes the picture of a `decoder` of the `image` crate, with what [`EncodeOptions::carry`] says of its metadata.
///
/// # Errors
/// [`Error::Source`] when the decoder fails; otherwise as [`encode`].
pub fn encode_decoder(mut decoder: impl ImageDecoder, options: &EncodeOptions) -> Result<Encoded> {
    let failed = |error| Error::Source { path: None, error };
    let icc = decoder.icc_profile().map_err(failed)?;
    let exif = decoder.exif_metadata().map_err(failed)?;
    let orientation = decoder.orientation().unwrap_or(Orientation::NoTransforms);
    let pixels = Pixels::try_from(DynamicImage::from_decoder(decoder).map_err(failed)?)?;
    let icc = icc.filter(|icc| is_for(icc, &pixels));
    let carried = options.carry.of(icc, exif, orientation);
    let mut options = options.clone();
    options.icc = options.icc.or(carried.icc);
    options.exif = options.exif.or(carried.exif);
    encode(&pixels, &options)
}

impl Encoder {
    /// Encodes the picture in the file at `input` and writes it to `output`, with what [`carry`](Encoder::carry) says of its
    /// metadata: by default the ICC profile and the orientation.
    ///
    /// The formats are those that `image` is built with, by content or extension, and ssplat. A
    /// [`DynamicImage`](image::DynamicImage) holds neither profile nor orientation, so [`image::open`] and
    /// [`save`](Encoder::save) lose both; this does not. A profile that was [set](Encoder::icc) takes the place of the
    /// picture's own, and so does an EXIF block.
    ///
    /// ```no_run
    /// use ssplat::Encoder;
    ///
    /// Encoder::new().ratio(100.0).transcode("phone.jpg", "phone.ssplat")?;
    /// # Ok::<(), ssplat::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Io`] when a file cannot be read or written, [`Error::Source`] when `input` is no picture that `image` knows,
    /// [`Error::Parameter`] when `output` has the extension of another format; otherwise as [`Encoder::encode`].
    pub fn transcode(&self, input: impl AsRef<Path>, output: impl AsRef<Path>) -> Result<EncodeReport> {
        transcode(input, output, self.options())
    }

    /// Encodes the picture of a `decoder` of the `image` crate, with what [`carry`](Encoder::carry) says of its metadata.
    ///
    /// ```
    /// # let mut png = Vec::new();
    /// # image::DynamicImage::new_rgb8(8, 8).write_to(&mut std::io::Cursor::new(&mut png), image::ImageFormat::Png)?;
    /// let reader = image::ImageReader::new(std::io::Cursor::new(png)).with_guessed_format()?;
    /// let encoded = ssplat::Encoder::new().effort(1).encode_decoder(reader.into_decoder()?)?;
    /// # assert!(encoded.bytes.len() < 100);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Source`] when the decoder fails; otherwise as [`Encoder::encode`].
    pub fn encode_decoder(&self, decoder: impl ImageDecoder) -> Result<Encoded> {
        encode_decoder(decoder, self.options())
    }
}

/// Tells whether a profile is for the colours of `pixels`: that of a CMYK picture is not for those that it becomes.
fn is_for(icc: &[u8], pixels: &Pixels) -> bool {
    // ICC.1, header: data colour space.
    let wanted = if pixels.channels().count() < 3 { b"GRAY" } else { b"RGB " };
    icc.get(16..20) == Some(wanted)
}
