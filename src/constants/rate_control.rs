//! Targets and their sizes (`encode/rate_control/`, `encode/primitive_count.rs`).

// The default target without a quality.

/// Compression ratio of `Target::Auto` where the default quality is not measured. It is that of a typical photograph
/// with this quality.
pub(crate) const AUTO_RATIO: f64 = 25.0;
/// Minimum number of bytes for the primitives of `Target::Auto`, enough for about twenty.
pub(crate) const MIN_AUTO_BYTES: u64 = 80;

// Number of primitives of a file.

/// Estimated bits per primitive in the coded layout, before any primitive is coded.
pub(crate) const CODED_BITS: f64 = 34.5;
/// The same in the planes layout.
pub(crate) const PLANES_BITS: f64 = 46.0;
/// Minimum assumed cost of a primitive, bytes. Without it, a few similar primitives would suggest that any number fits.
pub(crate) const MIN_PRIMITIVE_BYTES: f64 = 0.5;
/// Number of primitives below which a fit starts with [`EXCESS_OF_FEW`].
pub(crate) const FEW_PRIMITIVES: usize = 10_000;
/// Over-allocation factor of a fit of few primitives. On twelve Kodak pictures, 1.05 gains 0.02 to 0.07 dB over 1.008
/// at ratios from 50 to 1000. With 15 000 primitives at a ratio of 20, it gained nothing and lost 0.0003 of MS-SSIM.
/// `cargo run --release -p ssplat-lab --example rate_distortion -- PICTURES` measures it.
pub(crate) const EXCESS_OF_FEW: f64 = 1.05;
/// Over-allocation factor of a fit of many primitives.
pub(crate) const EXCESS_OF_MANY: f64 = 1.008;

// The bracket of a search (`search.rs`).

/// Minimum size that a search tries, bytes.
pub(crate) const MIN_TRIED_BYTES: f64 = 64.0;
/// Maximum size that a search tries, as a multiple of the raw bytes. Noise takes more than the raw bytes.
pub(crate) const MAX_TRIED_SIZE: f64 = 2.0;
/// Lower bound of that maximum, for pictures of a few pixels, bytes.
pub(crate) const MIN_LARGEST_TRIED_BYTES: f64 = 512.0;
/// Number of failed tries after which the largest size is tried.
pub(crate) const MAX_FAILED_TRIES: usize = 5;
/// Width of the bracket at which the search ends, as a binary logarithm: 1 % of the size.
pub(crate) const MIN_BRACKET: f64 = 0.014;
/// Minimum step out of an open bracket after the first try, as a binary logarithm of the size.
pub(crate) const MIN_OPEN_STEP: f64 = 0.05;
/// Growth of that minimum with each further try.
pub(crate) const OPEN_STEP_GROWTH: f64 = 3.0;
/// Maximum of that step.
pub(crate) const MAX_OPEN_STEP: f64 = 4.5;
/// Minimum distance of a try from the ends of the bracket, as a fraction of its width, because scores scatter.
pub(crate) const MIN_BRACKET_MARGIN: f64 = 0.1;

// A search for a PSNR (`psnr.rs`).

/// Maximum number of tries. Later tries mostly reuse the Gaussians of earlier ones.
pub(crate) const MAX_PSNR_TRIES: usize = 8;
/// Number of parts of the time budget: one for each of four tries, and one for pruning. Most searches take at most four
/// tries.
pub(crate) const PSNR_TIME_PARTS: u32 = 5;
/// The search ends when the PSNR of a file exceeds the requested PSNR by less than this, in decibels.
pub(crate) const PSNR_TOLERANCE: f64 = 0.1;
/// Margin above the requested PSNR that tries aim at, in decibels.
pub(crate) const PSNR_AIM_ABOVE: f64 = 0.05;
/// Compression ratio of the first try.
pub(crate) const FIRST_PSNR_RATIO: f64 = 50.0;
/// Decibels that doubling the bytes adds in small files. Kodak gains 2.8 dB from a ratio of 100 to 50, and another 4.7
/// dB to 20.
pub(crate) const DECIBELS_PER_DOUBLING: f64 = 2.5;
/// Maximum observed loss by quantization before descent recovers some of it, decibels. A fit for a PSNR goes on until
/// it exceeds it by that much.
pub(crate) const QUANTIZATION_LOSS: f64 = 3.0;
