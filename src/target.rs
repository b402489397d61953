//! What an encode aims at.

/// What the encoder aims at.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[non_exhaustive]
pub enum Target {
    /// A ratio of 50, and at least 80 bytes for the primitives: no picture is too small for it. An ICC profile and an
    /// EXIF block come on top.
    #[default]
    Auto,
    /// Width × height × channels bytes (8 bits a sample whatever the source's depth) over file bytes; an error where that
    /// is too little for the picture.
    Ratio(f64),
    /// File size, bytes; never exceeded.
    Bytes(u64),
    /// Number of primitives.
    Primitives(u32),
    /// PSNR against the source, dB: the smallest file found that reaches it.
    Psnr(f64),
    /// A quality as eyes see it: the SSIMULACRA2 score that the file shall have, `0..=100`, within half a point; about 30, 50,
    /// 70 and 90 for low, medium, high and very high quality. It takes up to three fits. Where the score is not met the best
    /// file that was found is the result; [`EncodeReport::quality`](crate::EncodeReport::quality) says what it has.
    #[cfg(feature = "quality")]
    Quality(f64),
}
