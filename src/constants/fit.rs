//! The fit of Gaussians (`fit/`).

// Step sizes and moments of Adam (`schedule.rs`, `plan.rs`, `model/adam.rs`). `cargo run --release -p ssplat-lab
// --example rate_distortion -- PICTURES` measures the effect of other values.

/// Initial step size of the mean, in each Gaussian's own frame and units.
pub(crate) const MEAN_RATE: f32 = 0.3;
/// Initial step size of the logarithms of the scales.
pub(crate) const LOG_SCALE_RATE: f32 = 0.3;
/// Initial step size of the rotation, radians.
pub(crate) const ROTATION_RATE: f32 = 0.15;
/// Initial step size of the colour, 1 is white.
pub(crate) const COLOR_RATE: f32 = 0.02;
/// Step sizes at the end of a fit, relative to those at the start.
pub(crate) const LAST_RATE: f32 = 0.02;
/// Numbers of steps below which fits are short and of medium length.
pub(crate) const DECAY_STEPS: [f32; 2] = [150.0, 500.0];
/// Decay rates of the first and second moments in short fits, in those of medium length, and in long ones. In short
/// fits each step goes further, so earlier gradients become outdated sooner.
pub(crate) const DECAYS: [[f32; 2]; 3] = [[0.7, 0.9], [0.8, 0.9], [0.9, 0.95]];
/// Decay rates of the optimizer's moments under a detail layer with perceptual tuning. Compared with 0.9 and 0.95, they
/// gain 0.1 to 0.2 points of SSIMULACRA2 in these short fits.
pub(crate) const BASE_DECAY: [f32; 2] = [0.7, 0.9];
/// Regularizer on area: penalizes total support by 0.1 % of the mean squared error per covered pixel. Without it
/// Gaussians pile up where the picture is smooth.
pub(crate) const AREA_PRICE: f64 = 1e-3;
/// Pixels per primitive from which on the full price applies. Where primitives are denser, their number already limits
/// their size, and a higher price would harm texture.
pub(crate) const FULL_PRICE_PIXELS: f64 = 128.0;

// Number of iterations (`plan.rs`).

/// Fraction of a time budget that the float fit may use.
pub(crate) const FIT_TIME_SHARE: f64 = 0.8;
/// Number of primitives for which the settings of an effort state the iterations.
pub(crate) const REFERENCE_COUNT: f32 = 5500.0;
/// Exponent with which the iterations change with the number of primitives below [`REFERENCE_COUNT`]. Fewer primitives
/// cost less per step and need more steps to find their places.
pub(crate) const SPARSE_EXPONENT: f32 = -0.95;
/// Minimum and maximum of the factor on the iterations by the number of primitives.
pub(crate) const DENSITY_FACTORS: [f32; 2] = [0.25, 9.0];
/// Additional part of the iterations on pictures that are not large, with the numbers of primitives in
/// [`EXTRA_COUNTS`]. It gains 0.1 dB and takes only seconds.
pub(crate) const EXTRA_ITERATIONS: f32 = 0.5;
/// Numbers of primitives from which on it starts to apply, between which it applies in full, and from which on it does
/// not apply.
pub(crate) const EXTRA_COUNTS: [f32; 4] = [8000.0, 12_000.0, 25_000.0, 40_000.0];
/// Factor on the iterations for squared error at a ratio of 20, up to effort 6. It gains 0.09 dB and nearly doubles the
/// encoding time. At a ratio of 50 it would gain about as much for the same time; that is left to higher efforts.
pub(crate) const MAX_EXACT_FIT_FACTOR: f32 = 2.5;
/// Ratio at which that factor applies in full, and ratio at which it is 1. Between them it depends on the logarithm of
/// the ratio.
pub(crate) const EXACT_FIT_RATIOS: [f64; 2] = [20.0, 50.0];
/// Number of primitives from which on a fit has a brisk pace.
pub(crate) const BRISK_COUNT: usize = 4000;
/// Numbers of primitives from which on the next of the [numbers of sweeps](crate::effort::FitSettings::sweeps) applies.
pub(crate) const SWEEP_COUNTS: [usize; 3] = [2000, 40_000, 300_000];
/// Number of pixels from which on a picture counts as large. Smaller pictures are fast enough to process completely.
pub(crate) const LARGE_PIXELS: u64 = 1 << 21;
/// Minimum number of steps of a fit that is reweighted. For a fit of about 60 steps at 14 megapixels, the measurements
/// add half of the work again. They gain 0.05 dB and one point of SSIMULACRA2. Large pictures are therefore not
/// reweighted.
pub(crate) const MIN_REWEIGHED_STEPS: u32 = 150;
/// Fraction of the steps, and of a time budget, for the short fit. With 0.15 it shows less; with 0.5 too little remains
/// for the rest.
pub(crate) const PROBE_SHARE: f32 = 0.3;

// Relocation of primitives (`plan.rs`, `schedule.rs`).

/// Maximum number of relocations under a detail layer with perceptual tuning. Each costs as much as three to five
/// steps. 16 or 26 gain nothing.
pub(crate) const MAX_BASE_RELOCATIONS: u32 = 10;
/// Minimum number of steps between them.
pub(crate) const MIN_BASE_RELOCATION_INTERVAL: u32 = 10;
/// Maximum share of the primitives in each relocation at a steady pace.
pub(crate) const RELOCATED_SHARE: f32 = 0.1;
/// Maximum number of steps between relocations.
pub(crate) const MAX_RELOCATION_INTERVAL: u32 = 25;
/// End of relocations at a brisk pace, as a fraction of the iterations.
pub(crate) const BRISK_RELOCATION_END: f32 = 0.6;
/// End of relocations at a steady pace, as a fraction of the iterations.
pub(crate) const STEADY_RELOCATION_END: f32 = 0.7;
/// Initial share of the primitives in each relocation at a brisk pace. It falls to 0.
pub(crate) const BRISK_RELOCATED_SHARE: f32 = 0.2;
/// When the number of primitives is corrected, as fractions of the iterations.
pub(crate) const RECOUNT_AT: [f32; 3] = [0.3, 0.6, 0.85];

// Sampled rows and sizes of the picture (`schedule.rs`, `plan.rs`, `model/problem.rs`).

/// End of the iterations that sample the fewest rows, as a fraction of all iterations.
pub(crate) const SAMPLED_UNTIL: f32 = 0.8;
/// Start of the iterations that sample the most rows, as a fraction of all iterations.
pub(crate) const DENSE_FROM: f32 = 0.95;
/// Maximum distance of sampled rows, relative to the typical scale of a Gaussian.
pub(crate) const ROW_STEP_PER_SCALE: f32 = 0.9;
/// Factor on a power of that scale, in pixels, that bounds the distance as well. Larger distances between the rows of
/// large Gaussians would save more time, but each of a few primitives matters.
pub(crate) const ROW_STEP_FACTOR: f32 = 1.6;
/// Exponent of that power.
pub(crate) const ROW_STEP_EXPONENT: f32 = 0.6;
/// Iterations between checks of the error over all rows in the last part of a fit.
pub(crate) const CHECK_INTERVAL: u32 = 20;
/// Maximum size of a picture that is checked in each of those iterations, in pixels. A few primitives can lose tenths
/// of a decibel in a single step.
pub(crate) const MAX_ALWAYS_CHECKED_PIXELS: u64 = 1 << 14;
/// Fraction of the iterations that use a large picture at half size.
pub(crate) const HALF_SIZE_SHARE: f32 = 0.7;
/// Minimum number of primitives of a large picture that is fitted at half size. Fewer cost little, and each matters to
/// the end.
pub(crate) const MIN_HALF_SIZE_COUNT: usize = 1000;
/// Minimum distance of sampled rows at which a large picture is fitted at half size. Gaussians then span several
/// pixels, and half size loses nothing at first.
pub(crate) const MIN_HALF_SIZE_ROW_STEP: u32 = 5;
/// Numbers of pixels of small and of large pictures. Between them, the minimum number of pixels per primitive depends
/// on the logarithm of the number.
pub(crate) const REDUCTION_PIXELS: [f64; 2] = [393_216.0, 2_800_000.0];
/// Restore the best state if the final error exceeds its error by this factor.
pub(crate) const CLEARLY_WORSE: f64 = 1.01;

// A start for few primitives (`multi_start.rs`).

/// Number of primitives from which on the small ones need all pixels: 260 primitives lose 0.1 dB with a copy of half
/// the size.
pub(crate) const MAX_MULTI_START_COUNT: usize = 120;
/// Minimum scale of a typical Gaussian in the copy, pixels.
pub(crate) const MIN_START_SCALE: f32 = 6.0;
/// Minimum length of the copy's shorter side, pixels.
pub(crate) const MIN_START_SIDE: u32 = 16;
/// Fraction of the iterations that use the copy.
pub(crate) const START_SHARE: f32 = 0.7;
/// Number of fits with different seeds from which the best is chosen.
pub(crate) const STARTS: u16 = 4;
/// Fraction of the iterations that are skipped if a fit continues one of fewer primitives. On Kodak at a ratio of 50,
/// where half of the pictures are fitted again, it is 0.03 dB better than fitting from the start. With 0.5, these
/// pictures lose 0.1 dB, because new primitives are added too late.
pub(crate) const SKIPPED_SHARE: f32 = 0.3;

// Initial and new primitives (`model/placing/`).

/// Share of the primitives that follow detail. The rest is distributed evenly.
pub(crate) const DETAIL_SHARE: f64 = 0.8;
/// Initial scales in units of `1/√(π·density)`.
pub(crate) const INITIAL_SCALE: f32 = 0.7;
/// Increase of the aspect ratio of primitives on a straight edge over 1.
pub(crate) const EDGE_STRETCH: f32 = 2.0;
/// Range of the angles of primitives around the angle of an edge, radians.
pub(crate) const ANGLE_JITTER: f32 = 0.05;
/// Largest aspect ratio of a new primitive. The fit may stretch it further.
pub(crate) const MAX_RIDGE_ASPECT: f32 = 4.0;
/// Standard deviation of the residual's blur, in cells of its level: between 1.2 and 1.4.
pub(crate) const RESIDUAL_BLUR: f32 = 1.25;

// Weights for masking (`model/objective/masking.rs`).

/// Constant added to twice the variance of samples in `0..=1`. It is larger than SSIM's `C₂` of 0.0009, so that smooth
/// areas do not get nearly all of the weight.
pub(crate) const VARIANCE_FLOOR: f32 = 0.005;
/// Largest weight, and the inverse of the smallest.
pub(crate) const MAX_WEIGHT: f32 = 20.0;

/// Exponent of the inverse where primitives are dense. On kodim05, 13 and 23 at a ratio of 50, exponents of 0.5, 0.7
/// and 0.9 gained about 7, 8 and 10 points of SSIMULACRA2 for 0.1, 0.2 and 0.5 dB. With 0.9, Butteraugli was worse than
/// without weights.
pub(crate) const MASKING_EXPONENT: f32 = 0.7;
/// Pixels per primitive above which the exponent falls with their square root, so that files of few primitives lose at
/// most 0.3 dB as well.
pub(crate) const MASKING_DENSE_PIXELS: f32 = 400.0;
/// Luma weights of red, green and blue: about the share of each in perceived lightness.
pub(crate) const LUMA_WEIGHTS: [f32; 3] = [0.25, 0.6, 0.15];
/// Weights of squared errors in red, green and blue, with a mean of 1. An error in green changes SSIMULACRA2 ten times
/// as much as the same error in blue, and three times as much as in red. Weights that far apart would lose 0.15 dB and
/// gain less than these, because lightness is coded for all three channels at once.
pub(crate) const CHANNEL_WEIGHTS: [f32; 3] = [0.8, 1.6, 0.6];

// Weights after the probe fit (`model/objective/reweigh.rs`).

/// Exponent of the worth where primitives are dense. It is as large as possible without losing the decibels that the
/// probe fit gains at a ratio of 50.
pub(crate) const WORTH_EXPONENT: f32 = 0.8;
/// Pixels per primitive above which the exponent falls with their square root. With few primitives, Butteraugli, which
/// is dominated by the worst place, would lose more and more.
pub(crate) const WORTH_DENSE_PIXELS: f32 = 65.0;
/// Minimum worth before the exponent. With a lower one, errors would grow in places where no other term counts them.
pub(crate) const MIN_WORTH: f32 = 1.0;
/// Maximum worth before the exponent.
pub(crate) const MAX_WORTH: f32 = 6.0;
/// Weights in the score of the mean and the fourth norm of the loss at each size of the picture, from full size on,
/// each half the previous one. They are SSIMULACRA2's own weights for luma.
pub(crate) const WORTH_SIZE_WEIGHTS: [[f32; 2]; 4] = [[0.0, 7.47], [0.0, 6.68], [225.2, 19.2], [176.4, 24.4]];
/// Keeps the loss finite where there is no structure. SSIM's `C₂` of 0.0009 belongs to luma in a somewhat smaller
/// range.
pub(crate) const WORTH_VARIANCE_FLOOR: f32 = 0.0015;
