//! Encodes pictures of other formats, with their ICC profile and orientation: [`transcode`] and [`encode_decoder`].

use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use image::{ImageDecoder, ImageError};

use super::colour::misfit;
use super::decoder::register;
use super::encoder::{check_extension, write};
use super::input;
use super::stated::{self, Profiles, Stated};
use crate::encode::{EncodeReport, Encoded, encode};
use crate::encoder::Encoder;
use crate::error::{Error, Result};
use crate::options::{EncodeOptions, MetadataPolicy};
use crate::pixels::Pixels;

/// Encodes the picture in the file at `input` and writes it to `output`. [`EncodeOptions::metadata`] selects the
/// metadata to keep: by default the ICC profile and the orientation.
///
/// It reads ssplat and all formats that `image` is built with, recognized by content or extension.
/// [`DynamicImage`](image::DynamicImage) has neither profile nor orientation, so [`image::open`] and
/// [`save`](super::save) lose both; this function keeps them. Code points, an ICC profile or an EXIF block in `options`
/// replace those of the picture.
///
/// # Errors
/// [`Error::Io`] if a file cannot be read or written, [`Error::Source`] if `image` cannot decode `input`,
/// [`Error::Parameter`] if `output` has the extension of another format; otherwise as [`encode`].
pub fn transcode(input: impl AsRef<Path>, output: impl AsRef<Path>, options: &EncodeOptions) -> Result<EncodeReport> {
    register();
    let (path, output) = (input.as_ref(), output.as_ref());
    check_extension(output)?;
    let failed = |error: ImageError| match error {
        // `image` reports a truncated picture as an I/O error, but the picture is at fault.
        ImageError::IoError(e) if e.kind() != std::io::ErrorKind::UnexpectedEof => Error::at(path, e),
        error => Error::Source { path: Some(path.into()), error },
    };
    let io = |e: std::io::Error| Error::at(path, e);
    let mut reader = BufReader::new(File::open(path).map_err(io)?);
    let is_used = options.metadata != MetadataPolicy::None && options.icc.is_none() && options.cicp.is_none();
    let profiles = if is_used { Profiles::Read } else { Profiles::Ignore };
    let stated = stated::look(&mut reader, profiles).map_err(io)?;
    let decoder = input::open(reader, path, &stated, &input::limits()).map_err(failed)?;
    let encoded = encode_stated(decoder, stated, options).map_err(|e| match e {
        Error::Source { error, .. } => failed(error),
        e => e,
    })?;
    write(output, &encoded.bytes)?;
    Ok(encoded.report)
}

/// Encodes the picture of a `decoder` of the `image` crate. [`EncodeOptions::metadata`] selects the metadata to keep.
///
/// # Errors
/// [`Error::Source`] if the decoder fails or the picture has more than 8 GiB of samples; otherwise as [`encode`].
pub fn encode_decoder(decoder: impl ImageDecoder, options: &EncodeOptions) -> Result<Encoded> {
    encode_stated(decoder, Stated::default(), options)
}

/// As [`encode_decoder`], for a file whose statements about colours are known.
fn encode_stated(mut decoder: impl ImageDecoder, stated: Stated, options: &EncodeOptions) -> Result<Encoded> {
    let failed = |error| Error::Source { path: None, error };
    // The decoder keeps the limits that its owner set. Only the memory that is allocated here is checked against those
    // of this crate.
    input::limits().reserve(decoder.total_bytes()).map_err(failed)?;
    let (icc, _) = stated.profile(&mut decoder).map_err(failed)?;
    let (exif, orientation) = stated.exif(&mut decoder).map_err(failed)?;
    let pixels = Pixels::try_from(stated.corrected(input::picture(decoder).map_err(failed)?))?;
    // The profile of a CMYK picture does not match the RGB pixels to which it is converted.
    let icc = icc.filter(|icc| misfit(icc, pixels.channels().count() < 3).is_none());
    // Colours in the options replace all that the picture states.
    let has_colors = options.cicp.is_some() || options.icc.is_some();
    let colors = if has_colors { (None, None) } else { (stated.cicp, icc) };
    let carried = options.metadata.select(colors, exif, orientation);
    let mut options = options.clone();
    options.cicp = options.cicp.or(carried.cicp);
    options.icc = options.icc.or(carried.icc);
    options.exif = options.exif.or(carried.exif);
    encode(&pixels, &options)
}

impl Encoder {
    /// Encodes the picture in the file at `input` and writes it to `output`. [`metadata`](Encoder::metadata) selects
    /// the metadata to keep: by default the ICC profile and the orientation.
    ///
    /// It reads ssplat and all formats that `image` is built with, recognized by content or extension. A
    /// [`DynamicImage`](image::DynamicImage) has neither profile nor orientation, so [`image::open`] and
    /// [`save`](Encoder::save) lose both; this method keeps them. Colours or an EXIF block that are set on the encoder
    /// with [`cicp`](Encoder::cicp), [`icc`](Encoder::icc) or [`exif`](Encoder::exif) replace those of the picture. What
    /// a PNG states about its colours without a profile (cICP, gAMA, cHRM) becomes a profile; PQ and HLG, which no
    /// profile can express, are stored as code points ([`Cicp`](crate::Cicp)). [`MetadataPolicy::Needed`](crate::MetadataPolicy::Needed) omits a profile that is
    /// equivalent to sRGB. A profile of more than 4 MiB, decompressed, is omitted, and so is one that does not match
    /// the channels of the picture. A TIFF with premultiplied alpha is converted to straight alpha.
    ///
    /// ```no_run
    /// use ssplat::Encoder;
    ///
    /// Encoder::new().ratio(100.0).transcode("phone.jpg", "phone.ssplat")?;
    /// # Ok::<(), ssplat::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Io`] if a file cannot be read or written, [`Error::Source`] if `image` cannot decode `input` or needs
    /// more than 8 GiB for it (1 GiB on 32-bit systems), [`Error::Parameter`] if `output` has the extension of another
    /// format; otherwise as [`Encoder::encode`].
    pub fn transcode(&self, input: impl AsRef<Path>, output: impl AsRef<Path>) -> Result<EncodeReport> {
        transcode(input, output, self.options())
    }

    /// Encodes the picture of a `decoder` of the `image` crate. [`metadata`](Encoder::metadata) selects the metadata to
    /// keep.
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
    /// [`Error::Source`] if the decoder fails or its picture has more than 8 GiB of samples (1 GiB on 32-bit systems);
    /// otherwise as [`Encoder::encode`].
    pub fn encode_decoder(&self, decoder: impl ImageDecoder) -> Result<Encoded> {
        encode_decoder(decoder, self.options())
    }
}
