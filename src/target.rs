//! Aim of an encode.

/// Aim of an encode: a size, a number of primitives, or a quality of the file.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[non_exhaustive]
pub enum Target {
    /// A ratio of 50, but at least 80 bytes for the primitives, so that no picture is too small for it. An ICC profile
    /// and an EXIF block are added on top.
    #[default]
    Auto,
    /// Compression ratio, finite and above 0: width × height × channels bytes (one byte a sample, whatever the source's
    /// depth) divided by the bytes of the file. The file is never larger than that.
    /// [`Error::TooSmall`](crate::Error::TooSmall) if the picture does not fit.
    Ratio(f64),
    /// File size in bytes, never exceeded. [`Error::TooSmall`](crate::Error::TooSmall) if the picture does not fit.
    Bytes(u64),
    /// Number of primitives.
    Primitives(u32),
    /// PSNR against the source in dB, above 0. The result is the smallest file found that reaches it. If the largest file that is
    /// tried, of twice the raw bytes, does not, the encode ends with [`Error::Parameter`](crate::Error::Parameter); under a budget of
    /// time it returns the best file found instead, and [`EncodeReport::psnr`](crate::EncodeReport::psnr) has its PSNR.
    Psnr(f64),
    /// Perceived quality: the SSIMULACRA2 score of the file, `0..=100`, met within half a point. About 30, 50, 70 and
    /// 90 stand for low, medium, high and very high quality. It takes up to six tries, most of which keep the Gaussians of
    /// the one before. If none meets the score, the
    /// result is the best file found; [`EncodeReport::quality`](crate::EncodeReport::quality) has its score.
    #[cfg(feature = "quality")]
    Quality(f64),
}
