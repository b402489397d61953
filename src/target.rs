//! Target of an encode.

/// Quality of [`Target::Auto`]. At this quality, the original and the picture are hard to tell apart side by side.
#[cfg(feature = "quality-hook")]
pub const DEFAULT_QUALITY: f64 = 70.0;

/// Target of an encode: the size, the number of Gaussians, or the quality of the file.
///
/// A picture is stored without loss if that fits into the requested size, or if it takes no more bytes than the requested
/// quality or PSNR. If it does not fit, the file of a screen, a page or a drawing has an exact layer with colours near
/// those of the picture if that is better by MS-SSIM than Gaussians and a detail layer. Photographs within a page are
/// left to these two. [`Encoder::detail`](crate::Encoder::detail) turns this off.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[non_exhaustive]
#[doc(alias("quality", "rate_control"))]
pub enum Target {
    /// The default quality of 70 points, as `Target::Quality(70.0)`. A build without the feature `quality` measures no
    /// quality: its default is a ratio of 25, with at least 80 bytes for the Gaussians, so that no picture is too small
    /// for it. The bytes of an ICC profile and an EXIF block are not counted.
    #[default]
    Auto,
    /// Compression ratio, finite and above 0: width × height × channels (the raw size at one byte per sample, whatever
    /// the depth of the source) divided by the size of the file in bytes. The file is never larger than the ratio
    /// allows. Encoding fails with [`Error::TooSmall`](crate::Error::TooSmall) if the picture does not fit.
    #[doc(alias("compression", "bpp"))]
    Ratio(f64),
    /// Maximum file size in bytes. Encoding fails with [`Error::TooSmall`](crate::Error::TooSmall) if the picture does
    /// not fit.
    #[doc(alias("size", "filesize"))]
    Bytes(u64),
    /// Number of Gaussians.
    #[doc(alias("gaussians", "splats"))]
    Gaussians(u32),
    /// PSNR of the decoded picture against the source in dB, above 0, where errors of colours are weighted by the alpha
    /// of the source. The result is the smallest file found that reaches it. The picture is stored without loss if that
    /// takes no more bytes. With a layout, levels or layers that exclude this, encoding fails with
    /// [`Error::Parameter`](crate::Error::Parameter) if even a file of twice the raw size does not reach it. With a time
    /// limit, the result is the best file found instead, and [`EncodeReport::psnr`](crate::EncodeReport::psnr) has its
    /// PSNR.
    Psnr(f64),
    /// The picture itself, without loss: the file has an exact layer that covers the whole picture, and nothing else.
    /// It requires [`Layout::Coded`](crate::Layout::Coded).
    Lossless,
    /// Perceptual quality: the SSIMULACRA2 score of the file, `0..=100`, met within half a point. About 30, 50, 70 and
    /// 90 mean low, medium, high and very high quality. The encoder predicts the size of the file, fits the Gaussians once and
    /// searches for the layer. Files of Gaussians alone, and those of pictures in tiles, take up to six tries. The
    /// picture itself, without loss, is stored if that takes no more bytes or if no other file meets the score. With a
    /// layout, levels or layers that exclude this, the result is the best file found, and
    /// [`EncodeReport::quality`](crate::EncodeReport::quality) has its score.
    ///
    /// SSIMULACRA2 needs pictures of some size and visible contrasts. A picture with a side below 64 pixels is
    /// therefore extended by reflections before it is measured, and so is the decoded one. If a picture of 16 bits uses
    /// less than an eighth of the range of its samples, that part is stretched to the whole range in both.
    #[cfg(feature = "quality-hook")]
    #[doc(alias("ssimulacra2", "perceptual"))]
    Quality(f64),
}
