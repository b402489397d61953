//! The search for the best division of the bytes (`encode/detail/division_search.rs`).

// How sharp a picture is, for squared error.

/// Minimum gain of a larger base, in decibels, that justifies trying the largest one.
pub(crate) const MIN_BASE_GAIN: f64 = 0.22;
/// Bytes of the layer for which sharpness is measured, relative to those of the base. Findings at a ratio of 50 hold at
/// other ratios.
pub(crate) const MEASURED_LAYER_BYTES: f64 = 1.9;
/// Factor between the two steps at which the value of the layer's bytes is measured.
pub(crate) const COARSER_STEP: f64 = 1.5;
/// Exponent with which the bytes decrease as the step grows, in the range of this measurement.
pub(crate) const COARSER_STEP_EXPONENT: f64 = 1.4;

// Tries of several divisions.

/// Factor on the bytes of the Gaussians from one try to the next, for pictures whose texture does not tell how many
/// they need.
pub(crate) const TRIED_BASE_FACTOR: f64 = 1.6;
/// Minimum factor between two tries.
pub(crate) const MIN_TRIED_FACTOR: f64 = 1.12;
/// Minimum share of the Gaussians that is tried, relative to the maximum.
pub(crate) const MIN_TRIED_SHARE: f64 = 0.2;
/// Maximum of 1 − MS-SSIM after a change of the division, relative to the value before, that justifies the change.
pub(crate) const MAX_LOSS_AFTER_CHANGE: f64 = 0.98;
/// Maximum of 1 − MS-SSIM of Gaussians alone, relative to that of a file with a layer, at which Gaussians alone have
/// the higher SSIMULACRA2. MS-SSIM prefers Gaussians alone: with a factor of 1, the choices for twelve photographs of
/// 192 pixels at four sizes lose 0.5 points more (docs/studies/division.md).
pub(crate) const MAX_LOSS_OF_GAUSSIANS: f64 = 0.9;
/// Maximum ratio at which several divisions are tried for mixed pictures. At 200, MS-SSIM prefers divisions that lose
/// SSIMULACRA2.
pub(crate) const MAX_TRIED_RATIO: f64 = 120.0;
