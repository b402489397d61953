//! Decodes files for the `image` crate: [`register`], which makes `image::open("x.ssplat")` work, and
//! [`SsplatDecoder`].
//!
//! ```no_run
//! ssplat::register();
//! let picture = image::open("photo.ssplat")?;
//! # Ok::<(), image::ImageError>(())
//! ```

use std::io::Read;
use std::sync::OnceLock;

use image::error::{DecodingError, ImageFormatHint, LimitError, LimitErrorKind, ParameterError, ParameterErrorKind};
use image::error::{UnsupportedError, UnsupportedErrorKind};
use image::hooks::{register_decoding_hook, register_format_detection_hook};
use image::{ColorType, ImageDecoder, ImageError, ImageResult, LimitSupport};

use super::colour::profile_or_equivalent;
use crate::bitstream::cicp::Cicp;
use crate::bitstream::header::{Header, MAGIC};
use crate::bitstream::read_rest;
use crate::decode::{Reader, SsplatImage};
use crate::error::{Error, Result};
use crate::gaussian::Channels;
use crate::limits::Limits;
use crate::parameter::Limit;
use crate::pixels::Depth;
use crate::raster::{Renderer, SamplesMut};

/// File name extension of ssplat files, without the dot.
pub const EXTENSION: &str = "ssplat";

/// Registers this crate with the `image` crate for the whole process, so that `image` opens ssplat files by extension
/// and by content.
///
/// Returns whether `image` opens ssplat files with this crate. The result is false if another hook is registered for
/// the extension; that hook is kept and nothing is registered. Further calls change nothing and return the same value.
#[doc(alias("hook", "plugin"))]
pub fn register() -> bool {
    static ACCEPTED: OnceLock<bool> = OnceLock::new();
    *ACCEPTED.get_or_init(|| {
        let accepted =
            register_decoding_hook(EXTENSION.into(), Box::new(|reader| Ok(Box::new(SsplatDecoder::new(reader)?))));
        if accepted {
            register_format_detection_hook(EXTENSION.into(), &MAGIC, None);
        }
        accepted
    })
}

/// Decodes one ssplat file for the `image` crate, on the CPU.
///
/// The output has the channels and the depth of the file. `max_image_width` and `max_image_height` of
/// [`set_limits`](ImageDecoder::set_limits) are strict; `max_alloc` bounds all memory that the decoder allocates in
/// addition to the caller's buffer. The orientation in the EXIF block is returned by
/// [`orientation`](ImageDecoder::orientation), not applied.
#[derive(Debug)]
pub struct SsplatDecoder<R> {
    reader: R,
    header: Header,
    limits: Limits,
    /// The whole file, once anything after the header has been needed.
    opened: Option<SsplatImage>,
}

impl<R: Read> SsplatDecoder<R> {
    /// Reads the header only.
    ///
    /// # Errors
    /// [`ImageError::Decoding`] if the header is broken, [`ImageError::Unsupported`] for another version,
    /// [`ImageError::Limits`] if the file exceeds the default [`Limits`], [`ImageError::IoError`] from `reader`.
    pub fn new(mut reader: R) -> ImageResult<Self> {
        let limits = Limits::default();
        let header = Header::read(&mut reader, &limits).map_err(decoding_error)?;
        Ok(SsplatDecoder { reader, header, limits, opened: None })
    }

    /// Returns the code points of the picture's colours, which [`ImageDecoder`] has no method for. They take precedence
    /// over its profile, and convert to `image::metadata::Cicp` by `try_from`.
    ///
    /// # Errors
    /// As [`read_image`](ImageDecoder::read_image).
    pub fn cicp(&mut self) -> ImageResult<Option<Cicp>> {
        Ok(self.opened()?.metadata().cicp)
    }

    /// Returns the file, which is read on first use.
    fn opened(&mut self) -> ImageResult<&mut SsplatImage> {
        let opened = match self.opened.take() {
            Some(opened) => opened,
            None => self.read().map_err(decoding_error)?,
        };
        Ok(self.opened.insert(opened))
    }

    fn read(&mut self) -> Result<SsplatImage> {
        let rest = read_rest(&mut self.reader, &self.limits)?;
        Reader::with_header(self.header.clone(), rest.into(), &self.limits).read()
    }

    /// Returns a renderer of the picture and drops the integers.
    fn renderer(&mut self) -> ImageResult<Renderer> {
        let opened = self.opened()?;
        let renderer = opened.renderer(&opened.view()).map_err(decoding_error)?;
        self.opened = None;
        Ok(renderer)
    }
}

impl<R: Read> ImageDecoder for SsplatDecoder<R> {
    fn dimensions(&self) -> (u32, u32) {
        (self.header.width, self.header.height)
    }

    fn color_type(&self) -> ColorType {
        match (self.header.channels, self.header.depth) {
            (Channels::Grey, Depth::Eight) => ColorType::L8,
            (Channels::GreyAlpha, Depth::Eight) => ColorType::La8,
            (Channels::Rgb, Depth::Eight) => ColorType::Rgb8,
            (Channels::Rgba, Depth::Eight) => ColorType::Rgba8,
            (Channels::Grey, Depth::Sixteen) => ColorType::L16,
            (Channels::GreyAlpha, Depth::Sixteen) => ColorType::La16,
            (Channels::Rgb, Depth::Sixteen) => ColorType::Rgb16,
            (Channels::Rgba, Depth::Sixteen) => ColorType::Rgba16,
        }
    }

    /// Returns the profile of the file, or one with the meaning of its code points if a profile can express them.
    fn icc_profile(&mut self) -> ImageResult<Option<Vec<u8>>> {
        let is_grey = self.header.channels.count() < 3;
        Ok(profile_or_equivalent(self.opened()?.metadata(), is_grey))
    }

    fn exif_metadata(&mut self) -> ImageResult<Option<Vec<u8>>> {
        Ok(self.opened()?.metadata().exif.clone())
    }

    fn set_limits(&mut self, limits: image::Limits) -> ImageResult<()> {
        limits.check_support(&LimitSupport::default())?;
        limits.check_dimensions(self.header.width, self.header.height)?;
        let alloc = limits.max_alloc.unwrap_or(u64::MAX);
        if let Some(opened) = &mut self.opened {
            opened.limit_alloc(alloc).map_err(decoding_error)?;
        }
        self.limits.alloc = alloc;
        Ok(())
    }

    fn read_image(mut self, buf: &mut [u8]) -> ImageResult<()> {
        assert_eq!(buf.len() as u64, self.total_bytes(), "buffer length");
        let renderer = self.renderer()?;
        match self.header.depth {
            Depth::Eight => renderer.render_into(SamplesMut::U8(buf)),
            Depth::Sixteen => match bytemuck::try_cast_slice_mut(buf) {
                Ok(samples) => renderer.render_into(SamplesMut::U16(samples)),
                Err(_) => render_unaligned(&renderer, buf),
            },
        }
        Ok(())
    }

    fn read_image_boxed(self: Box<Self>, buf: &mut [u8]) -> ImageResult<()> {
        (*self).read_image(buf)
    }
}

/// Renders 16-bit samples through an aligned band into a buffer that starts at an odd address.
fn render_unaligned(renderer: &Renderer, mut buf: &mut [u8]) {
    let mut band = Vec::new();
    for i in 0..renderer.bands() {
        band.resize(renderer.band_rows(i).len() * renderer.row_len(), 0u16);
        renderer.render_bands(i..i + 1, SamplesMut::U16(&mut band));
        let (out, rest) = buf.split_at_mut(2 * band.len());
        out.copy_from_slice(bytemuck::cast_slice(&band));
        buf = rest;
    }
}

/// Converts a decoding error to an error of `image`, with the original as its source where `image` has one.
fn decoding_error(e: Error) -> ImageError {
    match e {
        Error::Io(e) => ImageError::IoError(e),
        Error::UnsupportedVersion { .. } => ImageError::Unsupported(UnsupportedError::from_format_and_kind(
            hint(),
            UnsupportedErrorKind::GenericFeature(e.to_string()),
        )),
        Error::LimitExceeded { limit: Limit::Width | Limit::Height, .. } => {
            ImageError::Limits(LimitError::from_kind(LimitErrorKind::DimensionError))
        }
        Error::LimitExceeded { .. } => ImageError::Limits(LimitError::from_kind(LimitErrorKind::InsufficientMemory)),
        Error::Parameter { .. } => {
            ImageError::Parameter(ParameterError::from_kind(ParameterErrorKind::Generic(e.to_string())))
        }
        e => ImageError::Decoding(DecodingError::new(hint(), e)),
    }
}

/// Returns the name of the format for errors of `image`.
fn hint() -> ImageFormatHint {
    ImageFormatHint::Name(EXTENSION.into())
}
