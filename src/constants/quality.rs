//! Encodes to a perceptual quality (`encode/detail/quality_search.rs`, `encode/rate_control/quality.rs`). Points are those
//! of SSIMULACRA2.

// The requested score.

/// Points by which a file may miss the requested score.
pub(crate) const TOLERANCE: f64 = 0.5;
/// Points by which a layer may miss the score for its search to accept it.
pub(crate) const ACCEPTED_TOLERANCE: f64 = 0.4;
/// Margin above the requested score that tries aim at, points. Trimming can lower the score without another fit, but
/// cannot raise it.
pub(crate) const AIM_ABOVE: f64 = 0.25;

// Layers: the step for a score (`encode/detail/quality_search.rs`).

/// Steps that are assumed for a score until the picture's own are known: the natural logarithm of the step in 1/64 code
/// value, and points. Pictures differ mostly by a shift along the second axis.
pub(crate) const TYPICAL_STEPS: [[f64; 2]; 15] = [
    [2.8, 99.0],
    [4.25, 95.0],
    [4.68, 93.0],
    [4.87, 92.0],
    [5.19, 90.0],
    [5.45, 88.0],
    [5.72, 85.0],
    [6.11, 80.0],
    [6.38, 75.0],
    [6.6, 70.0],
    [6.92, 60.0],
    [7.14, 50.0],
    [7.35, 40.0],
    [8.05, 0.0],
    [9.2, -60.0],
];
/// Fineness of a picture with these steps. This and the next two values were fitted to 15 photographs of Kodak, CID22
/// and CLIC at 70 points, whose steps then scatter by a tenth, which is 2.5 points.
pub(crate) const TYPICAL_FINENESS: f64 = 0.717;
/// Exponent with which the steps of a photograph fall with the fineness.
pub(crate) const FINENESS_EXPONENT: f64 = 0.466;
/// Maximum change of the logarithm of the steps by the fineness.
pub(crate) const MAX_FINENESS_SHIFT: f64 = 0.5;
/// Bytes of a typical file, relative to those that the coefficients of the picture suggest.
pub(crate) const TYPICAL_SIZE: f64 = 0.8;
/// The same for drawings.
pub(crate) const TYPICAL_DRAWING_SIZE: f64 = 0.3;
/// Maximum error of one colour for which its score is measured, 1 is white.
pub(crate) const MAX_FAINT_ERROR: f64 = 2.0 / 255.0;
/// Maximum number of fits, which are more than one only if the size of the file was badly predicted.
pub(crate) const MAX_FITS: usize = 2;
/// Bytes of a layer in each tile below which the layer is practically empty.
pub(crate) const EMPTY_TILE_BYTES: usize = 6;
/// Points by which the layer before a round of descent may miss the score.
pub(crate) const ROUGH_TOLERANCE: f64 = 2.5;
/// Maximum number of layers before a round of descent.
pub(crate) const MAX_ROUGH_TRIES: usize = 4;
/// Maximum number of layers after the last round of descent.
pub(crate) const MAX_LAYER_TRIES: usize = 7;
/// Maximum change of the logarithm of the step in one try.
pub(crate) const MAX_STEP_CHANGE: f64 = 1.2;
/// Minimum difference of two scores that tells how the step changes with the score.
pub(crate) const MIN_MEASURED_DIFFERENCE: f64 = 0.8;
/// Range of that change, relative to the typical one.
pub(crate) const SLOPE_RANGE: [f64; 2] = [0.5, 3.0];
/// Parts of the logarithm of the step to which it is rounded, a tenth of a point.
pub(crate) const STEP_PARTS: f64 = 256.0;
/// Change of the logarithm of the step up to which the blocks of a layer are kept.
pub(crate) const MAX_STEP_CHANGE_WITH_SAME_BLOCKS: f64 = 0.25;

// Gaussians alone: the size for a score (`encode/rate_control/quality.rs`).

/// Scores that are assumed for a picture until its own are known: halvings of the raw bytes, and points. The values
/// were measured on Kodak; from a ratio of 20 on, they are means of twelve pictures. Pictures differ mostly by a shift
/// along the first axis. `cargo run --release -p ssplat-lab --example rate_distortion -- KODAK` measures the curve.
pub(crate) const TYPICAL_SCORES: [[f64; 2]; 10] = [
    [0.5, 100.0],
    [1.5, 97.0],
    [2.3, 94.5],
    [3.0, 90.5],
    [3.9, 82.0],
    [4.32, 76.1],
    [5.64, 56.1],
    [6.64, 36.7],
    [7.64, 12.7],
    [8.97, -23.9],
];
/// Maximum number of tries. Later tries mostly reuse the Gaussians of earlier ones.
pub(crate) const MAX_FILE_TRIES: usize = 6;
/// Number of parts of the time budget: one for each of three tries, and one for trimming.
pub(crate) const TIME_PARTS: u32 = 4;
/// Maximum margin above the requested score, in points, at which a file is trimmed instead of fitted again.
pub(crate) const MAX_TRIMMED_POINTS: f64 = 4.0;
/// Expected size of a file, relative to another file that reaches the score, up to which it is searched for.
pub(crate) const MAX_EXPECTED_SIZE: f64 = 0.7;
