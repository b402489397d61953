//! Other decisions of an encode (`encode/`).

// The device (`device.rs`).

/// Minimum number of pixels that `Backend::Auto` fits on a GPU. For smaller pictures, starting a GPU would take too
/// much of the time.
pub(crate) const MIN_GPU_PIXELS: u64 = 1 << 18;

// Removal of primitives that a PSNR does not need (`prune.rs`).

/// Maximum number of pictures that are rendered, times the primitives that cover a pixel of them in the mean. For
/// photographs it is never reached. A gradient has many wide primitives, each of which takes long to render.
pub(crate) const MAX_PRUNING_RENDERS: f32 = 3000.0;
/// Number of pictures that may always be rendered.
pub(crate) const MIN_PRUNING_RENDERS: usize = 24;
/// Up to this number, each primitive is also tried individually, because the predicted costs of removal are not exact.
pub(crate) const MAX_SINGLY_PRUNED: usize = 64;
/// Maximum number of rounds. Each removes primitives that are not needed, and a sweep over the rest makes room for the
/// next round.
pub(crate) const MAX_PRUNING_ROUNDS: usize = 6;
/// A round that removes less than one primitive in this many is the last.
pub(crate) const MIN_PRUNED_PART: usize = 50;

// Thumbnails (`thumbnail.rs`).

/// Longest side of a thumbnail, pixels.
pub(crate) const MAX_THUMBNAIL_SIDE: u32 = 256;
/// Minimum size of a file that carries a thumbnail by default, bytes.
pub(crate) const MIN_FILE_BYTES_WITH_THUMBNAIL: u64 = 100_000;
/// Size of the file relative to that of a default thumbnail.
pub(crate) const FILE_PER_THUMBNAIL: u64 = 100;
/// Maximum size of a default thumbnail, bytes. More bytes hardly improve it.
pub(crate) const MAX_THUMBNAIL_BYTES: u64 = 4000;
/// Maximum effort of a thumbnail. It takes little work compared with a large picture.
pub(crate) const MAX_THUMBNAIL_EFFORT: u8 = 3;
/// Factor on the iterations of the fit of a thumbnail. With twice the iterations, the thumbnails of three photographs
/// of 2.8 megapixels would gain 0.08 dB, and the encodes would take a sixteenth more time.
pub(crate) const THUMBNAIL_ITERATIONS: f32 = 0.3;
/// Time budget of the encode relative to that of the thumbnail.
pub(crate) const TIME_PER_THUMBNAIL: u32 = 20;

// The effort within a time limit (`timed_effort.rs`, `machine_speed.rs`).

/// Ratio at which the [durations](crate::effort::Duration) of the efforts were measured.
pub(crate) const MEASURED_RATIO: f64 = 50.0;
/// Power of the bytes with which the seconds grow at lower ratios. At a ratio of 20, efforts 2, 3 and 5 take 1.2, 1.2
/// and 1.1 times as long.
pub(crate) const TIME_BYTES_EXPONENT: f64 = 0.2;
/// Megapixels above which the seconds grow in proportion to the pixels.
pub(crate) const LINEAR_TIME_MEGAPIXELS: f64 = 2.8;
/// Part of the work that one thread does alone.
pub(crate) const SERIAL_SHARE: f64 = 0.3;
/// Duration of a search for a PSNR, relative to that of an encode to a size.
pub(crate) const PSNR_SEARCH_TIME: f64 = 3.0;
/// Duration of an encode to a quality, relative to that of an encode to a size.
pub(crate) const QUALITY_SEARCH_TIME: f64 = 1.3;
/// Seconds of a measurement on the machine on which the times in `timed_effort` were measured: 0.4 to 0.5 ms on an AMD
/// EPYC (model 1 of family 25) on which encodes take 1.4 to 1.8 times as long.
pub(crate) const REFERENCE_SPEED_SECONDS: f64 = 0.000_3;
