//! The encoder as programs use it: what is asked for, by setters, and the pictures.

use std::ops::ControlFlow;
use std::time::Duration;

use super::report::Progress;
use super::workers::{Hands, Workers};
use super::{Encoded, encode_by};
use crate::bitstream::splats::Layout;
use crate::error::Result;
use crate::options::{Backend, Carry, Detail, EncodeOptions, Thumbnail, Tune};
use crate::pixel_source::PixelSource;
use crate::target::Target;

/// Encodes pictures. What is not set is as [`Encoder::new`] has it.
///
/// ```
/// use ssplat::{Channels, Encoder, Pixels, Samples};
///
/// // A grey ramp of 32 × 16 pixels, rows from the top, 8 bits a sample.
/// let ramp = (0..32 * 16).map(|i| (i % 32 * 8) as u8).collect();
/// let pixels = Pixels::new(32, 16, Channels::Grey, Samples::U8(ramp))?;
///
/// let encoded = Encoder::new().bytes(120).effort(1).encode(&pixels)?;
/// assert!(encoded.bytes.len() <= 120);
/// # Ok::<(), ssplat::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Encoder {
    options: EncodeOptions,
}

impl Encoder {
    /// An encoder for files at a ratio of 50, at effort 5, tuned for eyes.
    #[must_use]
    pub fn new() -> Self {
        Encoder::default()
    }

    /// What to aim at; the last of `target`, `ratio`, `bytes`, `psnr` and `quality` counts.
    #[must_use]
    pub fn target(mut self, target: Target) -> Self {
        self.options.target = target;
        self
    }

    /// Files of a ratio: width × height × channels over bytes ([`Target::Ratio`]).
    #[must_use]
    pub fn ratio(self, ratio: f64) -> Self {
        self.target(Target::Ratio(ratio))
    }

    /// Files of at most so many bytes ([`Target::Bytes`]).
    #[must_use]
    pub fn bytes(self, bytes: u64) -> Self {
        self.target(Target::Bytes(bytes))
    }

    /// The smallest files of a PSNR, dB ([`Target::Psnr`]).
    #[must_use]
    pub fn psnr(self, psnr: f64) -> Self {
        self.target(Target::Psnr(psnr))
    }

    /// Files of a quality as eyes see it, `0..=100` ([`Target::Quality`]).
    #[cfg(feature = "quality")]
    #[must_use]
    pub fn quality(self, quality: f64) -> Self {
        self.target(Target::Quality(quality))
    }

    /// `1..=9`: how much work to spend; 5 by default. Each step takes up to twice the time of the one below.
    #[must_use]
    pub fn effort(mut self, effort: u8) -> Self {
        self.options.effort = effort;
        self
    }

    /// Wall-clock budget of a whole encode, however many fits the target takes; the best state reached is written.
    #[must_use]
    pub fn time(mut self, time: Duration) -> Self {
        self.options.time = Some(time);
        self
    }

    /// Which measure to favour: by default [`Tune::Iq`], and [`Tune::Psnr`] where the target is a PSNR.
    #[must_use]
    pub fn tune(mut self, tune: Tune) -> Self {
        self.options.tune = Some(tune);
        self
    }

    /// Whether files have a detail layer; by default where it pays.
    #[must_use]
    pub fn detail(mut self, detail: Detail) -> Self {
        self.options.detail = detail;
        self
    }

    /// Which device fits; by default a GPU where one is found and the picture is worth it.
    #[must_use]
    pub fn backend(mut self, backend: Backend) -> Self {
        self.options.backend = backend;
        self
    }

    /// Whether files carry a thumbnail; by default those of 100 000 bytes and more.
    #[must_use]
    pub fn thumbnail(mut self, thumbnail: Thumbnail) -> Self {
        self.options.thumbnail = thumbnail;
        self
    }

    /// `1..=8` progressive levels: a file cut after a level is a whole, coarser picture. Each costs 1 to 2 % of the bytes.
    #[must_use]
    pub fn levels(mut self, levels: u8) -> Self {
        self.options.levels = levels;
        self
    }

    /// How integers become bytes; [`Layout::Coded`] by default, the smallest.
    #[must_use]
    pub fn layout(mut self, layout: Layout) -> Self {
        self.options.layout = layout;
        self
    }

    /// The side of tiles to fit the picture in, pixels: a multiple of 128 up to 16384. It bounds the memory of an encode. By
    /// default pictures of more than 2²⁸ pixels are fitted in tiles of 2048, others as a whole.
    #[must_use]
    pub fn tiles(mut self, side: u32) -> Self {
        self.options.tiles = Some(side);
        self
    }

    /// Seed of everything random; 0 by default. Equal seeds give equal bytes from one version of this crate, on any number
    /// of threads.
    #[must_use]
    pub fn seed(mut self, seed: u64) -> Self {
        self.options.seed = seed;
        self
    }

    /// What files carry of a source's metadata, where it has some; by default the ICC profile and the orientation.
    #[must_use]
    pub fn carry(mut self, carry: Carry) -> Self {
        self.options.carry = carry;
        self
    }

    /// ICC profile to carry, whatever [`carry`](Encoder::carry) says.
    #[must_use]
    pub fn icc(mut self, icc: Vec<u8>) -> Self {
        self.options.icc = Some(icc);
        self
    }

    /// EXIF block to carry, from its TIFF header on, whatever [`carry`](Encoder::carry) says.
    #[must_use]
    pub fn exif(mut self, exif: Vec<u8>) -> Self {
        self.options.exif = Some(exif);
        self
    }

    /// Encodes a picture: [`Pixels`](crate::Pixels), or one that is read a part at a time if it is fitted in tiles.
    ///
    /// # Errors
    /// [`Error::Parameter`](crate::Error::Parameter) when something that was set is out of range,
    /// [`Error::TooSmall`](crate::Error::TooSmall) when the asked size cannot hold the picture, and those of `source`.
    pub fn encode(&self, source: &dyn PixelSource) -> Result<Encoded> {
        self.encode_with_progress(source, &mut |_| ControlFlow::Continue(()))
    }

    /// Encodes a picture and calls `progress` a few hundred times on the way.
    ///
    /// # Errors
    /// As [`encode`](Encoder::encode), and [`Error::Cancelled`](crate::Error::Cancelled) when `progress` returns
    /// [`ControlFlow::Break`].
    pub fn encode_with_progress(
        &self,
        source: &dyn PixelSource,
        progress: &mut dyn FnMut(&Progress) -> ControlFlow<()>,
    ) -> Result<Encoded> {
        encode_by(source, &self.options, Hands::Own, progress)
    }

    /// Encodes a picture whose tiles `workers` work on, elsewhere: fits, joins and sweeps, all but the first look at the picture and
    /// the writing of the file. The bytes are the same. A picture that is not in tiles is encoded here.
    ///
    /// # Errors
    /// As [`encode_with_progress`](Encoder::encode_with_progress), those of `workers`, and
    /// [`Error::Parameter`](crate::Error::Parameter) naming the tile for an answer that is no answer to its task.
    pub fn encode_divided(
        &self,
        source: &dyn PixelSource,
        workers: &mut dyn Workers,
        progress: &mut dyn FnMut(&Progress) -> ControlFlow<()>,
    ) -> Result<Encoded> {
        encode_by(source, &self.options, Hands::Others(workers), progress)
    }

    /// What was set.
    pub(crate) fn options(&self) -> &EncodeOptions {
        &self.options
    }
}

#[cfg(any(test, feature = "unstable"))]
impl From<EncodeOptions> for Encoder {
    fn from(options: EncodeOptions) -> Self {
        Encoder { options }
    }
}
