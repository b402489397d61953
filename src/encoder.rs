//! The encoder's public interface: setters for the options, and methods that encode pictures.

use std::io::Write;
use std::ops::ControlFlow;
use std::time::Duration;

use crate::bitstream::cicp::Cicp;
use crate::bitstream::splats::Layout;
use crate::encode::{EncodeReport, Encoded, Executor, Progress, Workers, encode_by};
use crate::error::Result;
use crate::gaussian::Gaussians;
use crate::options::{Backend, Detail, EncodeOptions, HiddenColors, MetadataPolicy, Thumbnail, Tune};
use crate::pack;
use crate::pixel_source::PixelSource;
use crate::target::Target;

/// Encodes pictures. Options that are not set have the defaults stated at their setters.
///
/// ```
/// use ssplat::{Channels, Encoder, Pixels};
///
/// // A grey ramp of 32 × 16 pixels, rows from the top, 8 bits a sample.
/// let ramp: Vec<u8> = (0..32 * 16).map(|i| (i % 32 * 8) as u8).collect();
/// let pixels = Pixels::new(32, 16, Channels::Grey, ramp)?;
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
    /// Returns an encoder with the default options: target [`Target::Auto`] (a quality of 70), effort 5, [`Tune::Iq`],
    /// one level and seed 0.
    #[must_use]
    pub fn new() -> Self {
        Encoder::default()
    }

    /// Sets the target. [`ratio`](Encoder::ratio), [`bytes`](Encoder::bytes) and the other target setters replace it;
    /// the last call counts. The default is [`Target::Auto`].
    #[must_use]
    pub fn target(mut self, target: Target) -> Self {
        self.options.target = target;
        self
    }

    /// Sets the target [`Target::Ratio`]: width × height × channels divided by the file size in bytes. The ratio must
    /// be finite and above 0.
    #[must_use]
    pub fn ratio(self, ratio: f64) -> Self {
        self.target(Target::Ratio(ratio))
    }

    /// Sets the target [`Target::Bytes`]: the maximum file size in bytes.
    #[must_use]
    pub fn bytes(self, bytes: u64) -> Self {
        self.target(Target::Bytes(bytes))
    }

    /// Sets the target [`Target::Gaussians`]: the number of Gaussians, with steps fine enough for them. Such a file
    /// has no detail layer.
    #[must_use]
    #[doc(alias("primitives", "splats"))]
    pub fn gaussians(self, count: u32) -> Self {
        self.target(Target::Gaussians(count))
    }

    /// Sets the target [`Target::Psnr`]: the PSNR in dB that the file reaches with as few bytes as possible. It must be
    /// finite and above 0.
    #[must_use]
    pub fn psnr(self, psnr: f64) -> Self {
        self.target(Target::Psnr(psnr))
    }

    /// Sets the target [`Target::Lossless`]: decoding the file gives the samples of the picture, with 8 or 16 bits.
    /// Colours under alpha 0 become black unless [`hidden_colors`](Encoder::hidden_colors) keeps them. Effort, time and
    /// tuning have no effect.
    ///
    /// ```
    /// use ssplat::{Channels, Decoder, Encoder, Pixels};
    ///
    /// let samples: Vec<u8> = (0..20 * 10 * 3).map(|i| (i * i % 251) as u8).collect();
    /// let pixels = Pixels::new(20, 10, Channels::Rgb, samples)?;
    /// let file = Encoder::new().lossless().encode(&pixels)?.bytes;
    /// assert_eq!(Decoder::new().decode(&file)?.pixels, pixels);
    /// # Ok::<(), ssplat::Error>(())
    /// ```
    #[must_use]
    #[doc(alias("exact"))]
    pub fn lossless(self) -> Self {
        self.target(Target::Lossless)
    }

    /// Sets the target [`Target::Quality`]: an SSIMULACRA2 score, `0..=100`.
    #[cfg(feature = "quality-hook")]
    #[must_use]
    pub fn quality(self, quality: f64) -> Self {
        self.target(Target::Quality(quality))
    }

    /// Sets the amount of work, `1..=9`. Each step takes up to twice as long as the previous one. The default is 5.
    #[must_use]
    pub fn effort(mut self, effort: u8) -> Self {
        self.options.effort = effort;
        self
    }

    /// Sets the time limit of a whole encode, wall clock, however many fits the target takes. If it is too short for
    /// [`effort`](Self::effort), the encoder uses a lower effort, which
    /// [`EncodeReport::effort`](crate::EncodeReport::effort) reports, and writes the best state reached. A large
    /// picture takes longer than a very short limit, because its layer is always coded to the end. By default there is
    /// no limit.
    ///
    /// In tiles, every stage visits each tile at least once, so an encode in small tiles can take several times as
    /// long.
    #[must_use]
    pub fn time(mut self, time: Duration) -> Self {
        self.options.time = Some(time);
        self
    }

    /// Sets the quality measure to optimize. The default is [`Tune::Iq`], or [`Tune::Psnr`] if the target is a PSNR.
    #[must_use]
    pub fn tune(mut self, tune: Tune) -> Self {
        self.options.tune = Some(tune);
        self
    }

    /// Sets whether files have a detail layer, and its share of the bytes. The default is [`Detail::Auto`], with which
    /// screens, pages and drawings may have an exact layer instead.
    #[must_use]
    pub fn detail(mut self, detail: Detail) -> Self {
        self.options.detail = detail;
        self
    }

    /// Sets the device that fits pictures. The default is [`Backend::Auto`].
    #[must_use]
    pub fn backend(mut self, backend: Backend) -> Self {
        self.options.backend = backend;
        self
    }

    /// Sets whether files carry a thumbnail. The default is [`Thumbnail::Auto`].
    #[must_use]
    pub fn thumbnail(mut self, thumbnail: Thumbnail) -> Self {
        self.options.thumbnail = thumbnail;
        self
    }

    /// Sets the number of progressive levels, `1..=8`. A file that is truncated after a level still decodes to a whole,
    /// coarser picture. Each level costs 1 to 2 % of the bytes. More than one level requires [`Layout::Coded`]. The
    /// default is 1.
    #[must_use]
    pub fn levels(mut self, levels: u8) -> Self {
        self.options.levels = levels;
        self
    }

    /// Sets the layout of the file. The default is [`Layout::Coded`], which gives the smallest files.
    #[must_use]
    pub fn layout(mut self, layout: Layout) -> Self {
        self.options.layout = layout;
        self
    }

    /// Sets the side of the tiles in which a picture is fitted, in pixels: a multiple of 128 up to 16384. Tiles bound
    /// the memory of an encode. By default, pictures of more than 2²⁵ pixels are fitted in tiles of 2048 unless a GPU
    /// is used, pictures of more than 2²⁸ pixels always, and all others as a whole. With tiles, a [`Target::Quality`]
    /// applies to the mean of the tiles' scores.
    #[cfg(any(test, feature = "unstable"))]
    #[must_use]
    pub fn tiles(mut self, side: u32) -> Self {
        self.options.tiles = Some(side);
        self
    }

    /// Sets the treatment of colours under alpha 0. The default is [`HiddenColors::Continue`].
    #[must_use]
    pub fn hidden_colors(mut self, hidden: HiddenColors) -> Self {
        self.options.hidden = hidden;
        self
    }

    /// Sets the seed of all random numbers. Equal seeds give equal bytes with one version of this crate, on any number
    /// of threads. The default is 0.
    #[cfg(any(test, feature = "unstable"))]
    #[must_use]
    pub fn seed(mut self, seed: u64) -> Self {
        self.options.seed = seed;
        self
    }

    /// Sets which metadata of the source the files carry. The default is [`MetadataPolicy::Needed`]: the colours and
    /// the orientation.
    #[must_use]
    pub fn metadata(mut self, metadata: MetadataPolicy) -> Self {
        self.options.metadata = metadata;
        self
    }

    /// Sets the code points of the colours of the files, for example [`Cicp::BT2100_PQ`]. They override
    /// [`metadata`](Encoder::metadata), and take precedence over an ICC profile. The samples are stored as they are.
    #[must_use]
    pub fn cicp(mut self, cicp: Cicp) -> Self {
        self.options.cicp = Some(cicp);
        self
    }

    /// Sets the ICC profile of the files. It overrides [`metadata`](Encoder::metadata).
    #[must_use]
    pub fn icc(mut self, icc: Vec<u8>) -> Self {
        self.options.icc = Some(icc);
        self
    }

    /// Sets the EXIF block of the files, starting at its TIFF header. It overrides [`metadata`](Encoder::metadata).
    #[must_use]
    pub fn exif(mut self, exif: Vec<u8>) -> Self {
        self.options.exif = Some(exif);
        self
    }

    /// Encodes a picture, as [`encode`](Encoder::encode) does, and writes the file to `writer`. Nothing is written if the
    /// encode fails.
    ///
    /// # Errors
    /// As [`encode`](Encoder::encode), and [`Error::Io`](crate::Error::Io) from `writer`.
    pub fn encode_to(&self, source: &dyn PixelSource, mut writer: impl Write) -> Result<EncodeReport> {
        let Encoded { bytes, report } = self.encode(source)?;
        writer.write_all(&bytes)?;
        Ok(report)
    }

    /// Encodes a picture: [`Pixels`](crate::Pixels), an `image::DynamicImage` or another source. If the picture is
    /// fitted in tiles, the source is read part by part.
    ///
    /// # Errors
    /// [`Error::Parameter`](crate::Error::Parameter) if an option is out of range,
    /// [`Error::TooSmall`](crate::Error::TooSmall) if a file of the requested size cannot hold the picture,
    /// [`Error::Gpu`](crate::Error::Gpu) if [`Backend::Gpu`] is set and the GPU is missing or fails, and the errors of
    /// `source`.
    pub fn encode(&self, source: &dyn PixelSource) -> Result<Encoded> {
        self.encode_with_progress(source, &mut |_| ControlFlow::Continue(()))
    }

    /// Encodes a picture and calls `progress` a few hundred times during the encode.
    ///
    /// # Errors
    /// As [`encode`](Encoder::encode), and [`Error::Cancelled`](crate::Error::Cancelled) if `progress` returns
    /// [`ControlFlow::Break`].
    pub fn encode_with_progress(
        &self,
        source: &dyn PixelSource,
        progress: &mut dyn FnMut(&Progress) -> ControlFlow<()>,
    ) -> Result<Encoded> {
        encode_by(source, &self.options, Executor::Own, progress)
    }

    /// Encodes a picture in tiles with `workers`, which may run outside this process. The workers fit, join and sweep
    /// the tiles on the CPU. The initial survey of the picture and the writing of the file run in this process. The
    /// file has the same bytes as without workers on the CPU. A picture that is not divided into tiles is encoded in
    /// this process.
    ///
    /// # Errors
    /// As [`encode_with_progress`](Encoder::encode_with_progress), the errors of `workers`, and
    /// [`Error::Parameter`](crate::Error::Parameter), which names the tile, if an answer does not match its task, or if
    /// [`Backend::Gpu`] is set for a picture in tiles.
    pub fn encode_divided(
        &self,
        source: &dyn PixelSource,
        workers: &mut dyn Workers,
        progress: &mut dyn FnMut(&Progress) -> ControlFlow<()>,
    ) -> Result<Encoded> {
        encode_by(source, &self.options, Executor::External(workers), progress)
    }

    /// Writes given Gaussians to a file, without fitting them to a picture: each value is rounded to the nearest that
    /// the file can store. No Gaussian is left out, and scales below 0.25 pixels are raised to that. The order of the
    /// Gaussians may change.
    ///
    /// The precision of the rounding depends on the target: with [`Target::Auto`] it is that of the finest files of
    /// this encoder, whatever their size; with [`bytes`](Encoder::bytes) or [`ratio`](Encoder::ratio) it is the finest
    /// of ten with which the file has at most that size. The Gaussians of such a file, if they are written again with
    /// the same options, keep their values exactly. [`layout`](Encoder::layout), [`levels`](Encoder::levels),
    /// [`icc`](Encoder::icc) and [`exif`](Encoder::exif) apply as well. [`EncodeReport::psnr`](crate::EncodeReport) is
    /// NaN, because there is no source to compare with.
    ///
    /// ```
    /// use ssplat::{Blend, Channels, Depth, Encoder, Gaussian, Gaussians, Limits, Reader};
    ///
    /// let gaussians = Gaussians {
    ///     width: 16,
    ///     height: 8,
    ///     channels: Channels::Rgb,
    ///     depth: Depth::Eight,
    ///     blend: Blend::Sum,
    ///     background: [0.0; 4],
    ///     list: vec![Gaussian { mean: [8.0, 4.0], scale: [3.0, 1.5], rotation: 0.3, color: [0.9, 0.2, 0.1, 0.0] }],
    /// };
    /// let file = Encoder::new().encode_gaussians(&gaussians)?.bytes;
    /// assert!(file.len() < 60);
    ///
    /// let stored = Reader::new(&file, &Limits::default())?.read()?.gaussians()?;
    /// assert!((stored.list[0].mean[0] - 8.0).abs() < 0.5);
    /// # Ok::<(), ssplat::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Parameter`](crate::Error::Parameter) if a value is not finite, a scale is not positive, a mean lies
    /// outside the picture, a colour exceeds the range of the format (8 times white in luma, chroma or alpha), a side
    /// of the picture is out of range, the file cannot be as small as requested, or an option is set that does not
    /// apply, such as an effort or a PSNR; [`Error::LimitExceeded`](crate::Error::LimitExceeded) if there are more
    /// Gaussians than the default [`Limits`](crate::Limits) allow decoders to read.
    #[doc(alias("pack", "quantize", "import"))]
    pub fn encode_gaussians(&self, gaussians: &Gaussians) -> Result<Encoded> {
        pack::encode_gaussians(gaussians, &self.options)
    }

    /// Returns the options.
    #[cfg(feature = "image")]
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
