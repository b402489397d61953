//! Rate–distortion optimization of the integers (`rdo/`).

// Steps of integers during a fit (`rounded.rs`).

/// Minimum number of rows in which the error is measured that decides about the steps.
pub(crate) const ROWS_OF_STEPS: u32 = 128;
/// Maximum distance of these rows.
pub(crate) const MAX_ROW_DISTANCE_OF_STEPS: u32 = 8;

// Step sizes of the layouts (`rounded.rs`).

/// Quantile of the primitives' sizes for which the coarsest positions of the coded layout are chosen.
pub(crate) const COARSEST_QUANTILE: f32 = 0.97;
/// PSNR of the fit at which the steps of the coded layout change, decibels. The better the fit, the finer the steps
/// that use the bytes best.
pub(crate) const STEP_PSNRS: [f64; 4] = [24.0, 30.0, 36.0, 41.0];
/// Steps of scale, position and luma below and between these, as in the header. Found by trying all neighbours on
/// photographs at ratios from 20 to 1500; the optimum is flat. `cargo run --release -p ssplat-lab --example
/// rate_distortion -- PICTURES` measures the effect of other values.
pub(crate) const CODED_STEPS: [[u8; 3]; 5] = [[5, 5, 6], [4, 6, 6], [4, 7, 6], [3, 7, 5], [2, 8, 4]];
/// Quantile of the primitives' sizes for which the single position step of the other layouts is chosen.
pub(crate) const SINGLE_STEP_QUANTILE: f32 = 0.25;
/// Binary logarithm of the size of these primitives relative to that step: a sixth of their size.
pub(crate) const SINGLE_STEP_LOG_PART: f32 = 2.5;

// Size of the file (`size.rs`, `size_loop.rs`). `cargo run --release -p ssplat-lab --example rate_distortion --
// PICTURES` measures curves with other values, and the example `tiny_files` those of small files.

/// Squared error that a bit must save, relative to the mean squared error per bit: the slope of the rate–distortion
/// curve, where doubling the bytes gains two to three decibels.
pub(crate) const SLOPE: f64 = 0.7;
/// Minimum number of sweeps from which the rounds are counted. One lets the integers settle, and one shows that they
/// have.
pub(crate) const MIN_SWEEPS: u32 = 2;
/// Rounds after the last planned sweep in which the file may still be brought to its size. One or two are usually
/// enough.
pub(crate) const EXTRA_ROUNDS: u32 = 6;
/// Number of rounds before the last planned sweep from which on the size is corrected. The remaining sweeps settle what
/// was added. Earlier, each sweep shortens the file by more than a correction would.
pub(crate) const CORRECTION_ROUNDS: u32 = 3;
/// A sweep that lowers the objective by a smaller share of the error is quiet: it has found almost nothing.
pub(crate) const QUIET_GAIN: f64 = 2e-4;
/// Number of consecutive quiet sweeps that end the descent. A single one may be caused by a correction of the size.
pub(crate) const QUIET_SWEEPS: u32 = 2;
/// A file is settled if it is below its size by at most one part in this many, or by a few bytes.
pub(crate) const SETTLED_PART: u64 = 400;
/// Bytes by which a settled file may always be too short: less than one primitive.
pub(crate) const SETTLED_BYTES: u64 = 4;
/// Share of the free bytes that is filled with new primitives. The first estimate of their cost may be too low, and a
/// file that is too long costs another round.
pub(crate) const FILL_SHARE: f64 = 0.97;
/// After the last planned sweep, a file that is too long is cut to one part in this many below its size, because each
/// sweep may lengthen it slightly again.
pub(crate) const MARGIN_PART: u64 = 1000;
/// Share of a file's bytes that the first sweep is expected to save: 1 to 3.5 % on photographs of 0.4 to 14 megapixels.
pub(crate) const FIRST_SHRINK: f64 = 0.02;
/// Savings of a sweep relative to those of the previous one: 0.3 to 0.7 on the same photographs.
pub(crate) const SHRINK_DECAY: f64 = 0.45;
/// A file fills its size if it is below it by at most one part in this many, or by [`FILLED_BYTES`].
pub(crate) const FILLED_PART: u64 = 50;
/// Bytes by which a file that fills its size may always be too short: about ten primitives.
pub(crate) const FILLED_BYTES: u64 = 40;

// Moves of the descent (`descend.rs`, `local_quadratic.rs`, `patch.rs`).

/// Number of bits by which a move may look worse than no move and still be evaluated, because it is not known yet how
/// well its colour can be rounded.
pub(crate) const MAX_APPARENT_LOSS: f32 = 3.0;
/// Width of a patch relative to that of its primitive: room for larger shapes.
pub(crate) const PATCH_GROWTH: f32 = 1.25;
/// Margin of a patch on either side for shifted shapes, pixels.
pub(crate) const PATCH_MARGIN: f32 = 3.0;
/// Maximum number of moves that are evaluated. More of them would gain 0.01 dB.
pub(crate) const MAX_MOVES: usize = 6;
/// Maximum shift of the mean, in units of the scales. Farther away, the model does not hold.
pub(crate) const TRUST_RADIUS: f32 = 1.0;
/// Where rows may be skipped, their distance grows by 1 for this many rows of the primitive's support.
pub(crate) const SUPPORT_ROWS_PER_STEP: usize = 32;
/// Maximum distance of the rows of a patch on a large picture.
pub(crate) const MAX_ROW_STEP: usize = 4;
/// Mean number of primitives over a pixel, for each row step that is added on any picture. Photographs have 4 to 16. A
/// gradient can have hundreds of wide ones, and would take many times as long as a photograph.
pub(crate) const PRIMITIVES_PER_ROW_STEP: f32 = 24.0;
/// Maximum distance of these rows.
pub(crate) const MAX_CROWDED_ROW_STEP: f32 = 16.0;

// Cost of bits (`bit_cost.rs`).

/// Factor on the predicted bits of a colour. A colour close to its neighbours' also makes theirs cheaper. Of 1, 1.3 and
/// 1.6 this was best on Kodak 05, 13, 15 and 23 at ratios of 50 and 200. `cargo run --release -p ssplat-lab --example
/// rate_distortion -- PICTURES` measures the effect of other values.
pub(crate) const COLOR_BITS_FACTOR: f32 = 1.3;
/// Count that a scale has before any primitive is counted.
pub(crate) const SCALE_COUNT_FLOOR: f32 = 0.05;
/// Count that a colour has before any primitive is counted.
pub(crate) const COLOR_COUNT_FLOOR: f32 = 0.02;
/// Weights with which a colour counts for itself and for values at distances of 1 and 2, because colours are samples of
/// a smooth density.
pub(crate) const COLOR_COUNT_KERNEL: [f32; 3] = [0.4, 0.2, 0.1];
