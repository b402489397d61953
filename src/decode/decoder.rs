//! The decoder as programs use it: what is asked for, by setters, and the files.

use super::{Decoded, decode, decode_into, thumbnail};
use crate::error::Result;
use crate::limits::Limits;
use crate::options::{Damage, DecodeOptions, Layers};
use crate::raster::SamplesMut;

/// Decodes files. [`Reader`](crate::Reader) is for a file that is drawn more than once.
///
/// ```no_run
/// use ssplat::Decoder;
///
/// let bytes = std::fs::read("photo.ssplat")?;
/// let whole = Decoder::new().decode(&bytes)?.pixels;
///
/// // The part of 640 × 480 pixels at (100, 50), at half the size.
/// let part = Decoder::new().region([100, 50, 640, 480]).size([320, 240]).decode(&bytes)?.pixels;
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Decoder {
    options: DecodeOptions,
}

impl Decoder {
    /// A decoder of whole pictures, at their own size, with the default [`Limits`].
    #[must_use]
    pub fn new() -> Self {
        Decoder::default()
    }

    /// What a file may ask for.
    #[must_use]
    pub fn limits(mut self, limits: Limits) -> Self {
        self.options.limits = limits;
        self
    }

    /// The part to draw: left, top, width and height, pixels of the picture. What lies outside is not drawn, and in large
    /// files mostly not even read.
    #[must_use]
    pub fn region(mut self, region: [u32; 4]) -> Self {
        self.options.region = Some(region);
        self
    }

    /// Width and height of the output, pixels. Larger ones than the region's sample the continuous picture, smaller ones are
    /// low-passed as [`View::resized`](crate::View::resized) says.
    #[must_use]
    pub fn size(mut self, size: [u32; 2]) -> Self {
        self.options.size = Some(size);
        self
    }

    /// What to do with a truncated or damaged file; to fail, by default.
    #[must_use]
    pub fn damage(mut self, damage: Damage) -> Self {
        self.options.damage = damage;
        self
    }

    /// Which layers to draw; both, by default.
    #[must_use]
    pub fn layers(mut self, layers: Layers) -> Self {
        self.options.layers = layers;
        self
    }

    /// Decodes the file `bytes`, or what is asked for of it.
    ///
    /// # Errors
    /// [`Error::Format`](crate::Error::Format) and [`Error::UnsupportedVersion`](crate::Error::UnsupportedVersion) for
    /// what cannot be read, [`Error::LimitExceeded`](crate::Error::LimitExceeded) for what is too large,
    /// [`Error::Parameter`](crate::Error::Parameter) for a region outside the picture or an empty one.
    pub fn decode(&self, bytes: &[u8]) -> Result<Decoded> {
        decode(bytes, &self.options)
    }

    /// Decodes the file `bytes` into `out`, row by row with interleaved channels, with the depth of `out`: for one picture
    /// after the other in the same memory. [`Reader`](crate::Reader) tells a picture's size beforehand.
    ///
    /// # Errors
    /// As [`decode`](Decoder::decode), and [`Error::Parameter`](crate::Error::Parameter) naming `out` if that has not exactly
    /// width × height × channels samples.
    pub fn decode_into(&self, bytes: &[u8], out: SamplesMut<'_>) -> Result<()> {
        decode_into(bytes, &self.options, out).map(|_| ())
    }

    /// Draws the picture of the file `bytes` as large as it fits into `within`, width and height in pixels, and never larger
    /// than it is.
    ///
    /// Where the file carries a thumbnail of at least this size, that is drawn and nothing else is read: in half a millisecond
    /// whatever the picture's size, and with its own error, which is larger than that of the picture. Else the picture is drawn.
    /// The picture's ICC profile and EXIF block go with both. Region, size, damage and layers do not matter here.
    ///
    /// # Errors
    /// As [`decode`](Decoder::decode); [`Error::Parameter`](crate::Error::Parameter) when a side of `within` is 0.
    pub fn thumbnail(&self, bytes: &[u8], within: [u32; 2]) -> Result<Decoded> {
        thumbnail(bytes, within, &self.options.limits)
    }
}
