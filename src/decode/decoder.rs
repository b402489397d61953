//! The decoder's public interface: options as setters, and methods that decode files.

use std::path::Path;

use super::reader::Reader;
use super::{Decoded, decode, decode_into, decode_opened};
use crate::error::Result;
use crate::limits::Limits;
use crate::options::{Damage, DecodeOptions, Layers};
use crate::raster::SamplesMut;
use crate::rect::Rect;

/// Decodes files. Use [`Reader`](crate::Reader) for a file that is rendered more than once.
///
/// ```no_run
/// use ssplat::{Decoder, Rect};
///
/// let whole = Decoder::new().decode_file("photo.ssplat")?.pixels;
///
/// // The part of 640 × 480 pixels at (100, 50), at half the size.
/// let bytes = std::fs::read("photo.ssplat")?;
/// let part = Decoder::new().region(Rect::new(100, 50, 640, 480)).size([320, 240]).decode(&bytes)?.pixels;
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Decoder {
    options: DecodeOptions,
}

impl Decoder {
    /// Returns a decoder that renders whole pictures at their own size, with the default [`Limits`].
    #[must_use]
    pub fn new() -> Self {
        Decoder::default()
    }

    /// Sets the limits on size, memory and work. A file that exceeds one is refused with
    /// [`Error::LimitExceeded`](crate::Error::LimitExceeded).
    #[must_use]
    pub fn limits(mut self, limits: Limits) -> Self {
        self.options.limits = limits;
        self
    }

    /// Sets the region to render, in pixels of the picture. Parts of the file that are
    /// not visible in the region are not rendered, and in large files mostly not even read. The default is the whole
    /// picture.
    #[must_use]
    #[doc(alias("crop", "roi", "part"))]
    pub fn region(mut self, region: Rect) -> Self {
        self.options.region = Some(region);
        self
    }

    /// Sets the width and height of the output, in pixels, each in `1..=2²⁰`. The default is the size of the region.
    /// An output larger than the region samples the continuous picture; a smaller one is low-pass filtered as
    /// described at [`View::resized`](crate::View::resized).
    #[must_use]
    #[doc(alias("resize", "scale", "width", "height"))]
    pub fn size(mut self, size: [u32; 2]) -> Self {
        self.options.size = Some(size);
        self
    }

    /// Sets the treatment of truncated or damaged files. The default is [`Damage::Refuse`].
    #[must_use]
    #[doc(alias("truncated", "partial"))]
    pub fn damage(mut self, damage: Damage) -> Self {
        self.options.damage = damage;
        self
    }

    /// Sets the layers to render, as [`View::layers`](crate::View::layers). The default is [`Layers::Both`].
    #[must_use]
    pub fn layers(mut self, layers: Layers) -> Self {
        self.options.layers = layers;
        self
    }

    /// Decodes the file `bytes`, with the region and the size that were set.
    ///
    /// # Errors
    /// [`Error::Format`](crate::Error::Format) and [`Error::UnsupportedVersion`](crate::Error::UnsupportedVersion) for
    /// files that cannot be read, [`Error::LimitExceeded`](crate::Error::LimitExceeded) for files that exceed the
    /// [`Limits`], [`Error::Parameter`](crate::Error::Parameter) for a region that is empty or not within the picture
    /// and for a size outside `1..=2²⁰`.
    pub fn decode(&self, bytes: &[u8]) -> Result<Decoded> {
        decode(bytes, &self.options)
    }

    /// Decodes the file at `path`, as [`decode`](Decoder::decode) does.
    ///
    /// # Errors
    /// As [`decode`](Decoder::decode), and [`Error::Io`](crate::Error::Io), whose message names the path.
    pub fn decode_file(&self, path: impl AsRef<Path>) -> Result<Decoded> {
        decode_opened(Reader::open(path, &self.options.limits)?, &self.options)
    }

    /// Decodes the file `bytes` into `out`, row by row with interleaved channels, at the bit depth of `out`. Use this
    /// method to decode several pictures into the same memory. [`Reader`](crate::Reader) returns the size of a picture
    /// beforehand.
    ///
    /// # Errors
    /// As [`decode`](Decoder::decode), and [`Error::Parameter`](crate::Error::Parameter) naming `out` if `out` does
    /// not have exactly width × height × channels samples.
    pub fn decode_into(&self, bytes: &[u8], out: SamplesMut<'_>) -> Result<()> {
        decode_into(bytes, &self.options, out).map(|_| ())
    }
}
