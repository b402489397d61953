//! How the detail layer is coded (`encode/detail/`).

/// The slopes and the steps of chroma at one quantizer step of the layer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Knot {
    /// The layer's step, in 1/64 code value.
    pub step: u16,
    /// Slopes for luma, grey and alpha, and for chroma.
    pub slopes: [u8; 2],
    /// Steps of orange and green chroma relative to that of luma, in sixteenths.
    pub chroma: [u8; 2],
}

// Parameters of each tuning (`settings.rs`).

/// Squared error that a bit must save (λ) for the lowest squared error, in squared steps.
pub(crate) const PSNR_LAMBDA: f32 = 0.10;
/// Biases of the reconstruction for the lowest squared error, as in the head of the layer. Those of `DetailHead::PLAIN`
/// lose 0.02 dB at a ratio of 20 and nothing at 50.
pub(crate) const PSNR_BIASES: [u8; 2] = [1, 3];
/// λ for perceptual tuning, in squared steps.
pub(crate) const IQ_LAMBDA: f32 = 0.1;
/// Biases of the reconstruction for perceptual tuning. [0, 2] loses 0.1 to 0.2 points at efforts 1 and 2, 0.07 at 2.8
/// megapixels, and nothing where the Gaussians are optimized under the layer (docs/studies/perceptual-tuning.md).
pub(crate) const IQ_BIASES: [u8; 2] = [0, 0];
/// Steps between which the [factor on luma](LUMA_GAINS) grows with the logarithm of the step, 1/64 code value.
pub(crate) const LUMA_GAIN_STEPS: [f32; 2] = [64.0, 640.0];
/// Factors on the coefficients of luma at these steps, for perceptual tuning and Gaussians that are not optimized under
/// the layer. Quantization removes energy, which looks like blur. With these factors and the [biases](IQ_BIASES), effort
/// 2 gains 0.5, 0.7 and 0.6 points on Kodak and 0.2 on CID22 at ratios of 20, 50 and 100, and Butteraugli grows by 0.5 %
/// (docs/studies/perceptual-tuning.md). Where the Gaussians are optimized under the layer, they gain nothing.
pub(crate) const LUMA_GAINS: [f32; 2] = [1.01, 1.04];
/// Exponents of the luma variance with which the steps grow for perceptual tuning, in fine and in coarse layers. That
/// of coarse layers gains 0.02, 0.1 and 0.2 points on Kodak and CID22 at ratios of 20, 50 and 100 over that of fine
/// layers, and loses 0.00, 0.01 and 0.03 of Butteraugli. With 0.22, Butteraugli loses three times as much.
pub(crate) const IQ_VARIANCE_EXPONENTS: [f32; 2] = [0.11, 0.165];
/// Growth of the steps with frequency for perceptual tuning. Compared with slopes of 40 at every step, at a ratio of
/// 100 and effort 2, these gain 4.3 SSIMULACRA2 points on three Kodak pictures and 0.5 on two of CLIC. They lose 0.39
/// and 0.11 dB. The first knot is for small steps. On 18 pictures of Kodak and CID22 at a ratio of 10, it gains 0.1
/// points and 0.03 of Butteraugli; drawings would lose 0.7 points by its chroma. Chroma slopes of 40 and 60 instead of
/// 100 and 150 lose 0.05 to 0.16 points on Kodak, CID22 and CLIC at ratios of 20 to 100.
pub(crate) const IQ_SLOPES: &[Knot] = &[
    Knot { step: 100, slopes: [10, 40], chroma: [80, 40] },
    Knot { step: 600, slopes: [40, 100], chroma: [64, 32] },
    Knot { step: 3000, slopes: [130, 150], chroma: [64, 32] },
];
/// Number of sample values of a picture with 16 bits below which its layer is coded for the lowest squared error. The
/// smallest step is 4 values, and the tuned ones are several times larger at high frequencies.
pub(crate) const MIN_TUNED_SAMPLE_VALUES: u32 = 2048;

// Parameters of drawings (`settings.rs`).

/// Minimum bits of the layer per pixel for which a drawing is coded with the parameters for drawings. A screenshot and
/// a page gain 5.4 and 0.5 SSIMULACRA2 points with 0.3 bits (a ratio of 50), and 5.6 and 2.6 points with 0.11 bits (a
/// ratio of 100). Three diagrams gain 0.0 to 0.3 points with 0.25 bits (a ratio of 50). They lose up to 0.9 points with
/// 0.06 bits. With 0.03 bits (a ratio of 200), all but one lose up to 5 points, because the layer has few levels there
/// and larger blocks are cheaper.
pub(crate) const MIN_DRAWING_BITS: f64 = 0.09;
/// Number of pixels above which these bits grow. On parts of 2048 × 2048 pixels of a map and of a page, the parameters
/// for drawings lose 3.3 and 2.4 points with 0.1 bits (a ratio of 200); with 0.2 bits (100), they lose 1.2 and gain
/// 0.5.
pub(crate) const DRAWING_BITS_PIXELS: f64 = 262_144.0;
/// Exponent with which these bits grow with the number of pixels.
pub(crate) const DRAWING_BITS_EXPONENT: f64 = 0.2;
/// Growth of the steps with frequency in drawings, whose lines are sharp in coarse layers too.
pub(crate) const DRAWING_SLOPES: &[Knot] =
    &[Knot { step: 600, slopes: [20, 40], chroma: [64, 32] }, Knot { step: 3000, slopes: [40, 60], chroma: [64, 32] }];
/// Exponent of the luma variance with which the steps grow in drawings.
pub(crate) const DRAWING_VARIANCE_EXPONENT: f32 = 0.06;

// Blocks with flat ground, where ringing is visible (`flat_cells.rs`, `ringing.rs`). docs/studies/ringing.md compares
// the values for photographs with others, and `lab/ringing.py` measures the errors on flat ground.

/// Range of luma below which a cell of a photograph is flat, code values. It allows for noise.
pub(crate) const FLAT_RANGE: f32 = 4.0;
/// Factor on the estimated cost, and on that by the prices of the entropy coder, of blocks of a photograph that contain
/// both flat and other cells.
pub(crate) const MIXED_COST: f32 = 1.15;
/// The same factor for drawings, on the estimated cost. It contributes 3.7 and 2.2 SSIMULACRA2 points to the gain of a
/// screenshot and a page at a ratio of 100 from the parameters for drawings. With 1.6 and 2, diagrams lose 0.1 to 0.3
/// points.
pub(crate) const DRAWING_MIXED_COST: f32 = 1.3;
/// Root of the mean squared error, without the mean around a cell, from which a flat cell rings, code values.
pub(crate) const MIN_RINGING: f32 = 3.0;
/// Factor on the cost of mixed blocks that contain or touch a cell that rings.
pub(crate) const RINGING_COST: f32 = 2.5;
/// Maximum number of times that the blocks of a tile are chosen again because it rings.
pub(crate) const RINGING_ROUNDS: u32 = 2;
/// Part of the error that the Gaussians alone may have in a cell that rings. If they have more, smaller blocks do not
/// help.
pub(crate) const MAX_BASE_ERROR_SHARE: f32 = 0.8;
/// Width of the border around a cell over which its mean error is taken, pixels.
pub(crate) const RINGING_BORDER: usize = 2;

// Estimated cost of blocks (`scaled.rs`).

/// Estimated cost of a level, squared steps.
pub(crate) const ESTIMATED_LEVEL_COST: f32 = 0.5;
/// Additional cost per step of its magnitude, squared steps.
pub(crate) const ESTIMATED_MAGNITUDE_COST: f32 = 0.06;

// Choice of levels and of priced blocks (`trellis.rs`).

/// Maximum number of candidates for which a block of each size is compared with smaller blocks by its price.
pub(crate) const MAX_PRICED_CANDIDATES: [usize; 4] = [usize::MAX, usize::MAX, 40, 48];
/// Magnitude in steps that the largest coefficient of a block must reach for smaller blocks to be tried. Below it,
/// smaller blocks have no levels either.
pub(crate) const MIN_SPLIT_MAGNITUDE: f32 = 0.45;
/// Magnitude in steps below which a coefficient starts without a level (dead zone).
pub(crate) const DEAD_ZONE: f32 = 0.58;
/// Magnitude in steps above which a level of 1 is kept without a trial in a quick search.
pub(crate) const QUICK_SURE_ONE: f32 = 1.1;
/// The same in other searches.
pub(crate) const SURE_ONE: f32 = 1.5;
/// Minimum of the magnitude minus the level, in steps, at which a level above 1 is kept without a trial in a quick
/// search.
pub(crate) const QUICK_SURE_EXCESS: f32 = -0.2;
/// The same in other searches.
pub(crate) const SURE_EXCESS: f32 = 0.1;
/// Maximum number of candidates in a block for which each level is tried individually.
pub(crate) const MAX_EXACT_CANDIDATES: usize = 6;
/// Margin in bits beyond which an estimate is conclusive.
pub(crate) const CONCLUSIVE_BITS: f32 = 1.0;
/// Bits that lowering a level saves in the levels after it. The estimate does not include them.
pub(crate) const SAVED_CONTEXT_BITS: f32 = 0.6;

// Step classes by local activity (`adaptive_quantization.rs`).

/// Variance of luma that is negligible, code values². It is added to the variance before the logarithm.
pub(crate) const ACTIVITY_VARIANCE_FLOOR: f32 = 30.0;
/// Weights of neighbouring squares along one axis.
pub(crate) const ACTIVITY_KERNEL: [f32; 5] = [1.0, 3.0, 4.0, 3.0, 1.0];
/// Steps up to which a layer is fine and from which on it is coarse, 1/64 code value.
pub(crate) const COARSE_LAYER_STEPS: [f64; 2] = [250.0, 600.0];

// Coupling of luma and green chroma (`chroma_coupling.rs`).

/// Fraction of the green chroma error that is added to luma.
pub(crate) const GREEN_ERROR_IN_LUMA: f32 = 1.0 / 6.0;
/// Fraction of the luma error that is added to green chroma. It is less than half of the optimum for errors that remain
/// completely.
pub(crate) const LUMA_ERROR_IN_GREEN: f32 = 0.4 * 2.0 / 3.0;

// Search for the step with which the layer fills its bytes (`search.rs`, `parts.rs`).

/// Maximum number of coder runs in a search.
pub(crate) const MAX_RUNS: u32 = 7;
/// Maximum shortfall of an accepted layer where the effort does not state it, as a fraction of the available bytes.
pub(crate) const MAX_SHORTFALL: f64 = 0.004;
/// Fraction of the available bytes by which such a search aims below them.
pub(crate) const AIMS_BELOW: f64 = 0.0015;
/// Exponent with which the bytes decrease as the step grows, until two runs have measured it.
pub(crate) const STEP_EXPONENT: f64 = 1.05;
/// Minimum distance between the logarithms of two steps for measuring that exponent.
pub(crate) const MIN_STEP_DISTANCE: f64 = 0.004;
/// Factor on the maximum number of runs while no layer fits.
pub(crate) const EXTRA_RUNS_FACTOR: u32 = 3;
/// Bits per level that the first guess assumes.
pub(crate) const GUESSED_LEVEL_BITS: f64 = 5.0;
/// Magnitude in steps above which a coefficient is likely to have a level.
pub(crate) const GUESSED_LEVEL_MAGNITUDE: f32 = 0.8;
/// Number of tiles for each sampled tile. The sample contains at least 8 tiles, or all if there are fewer, and at most
/// 64. Each takes a megabyte of memory.
pub(crate) const SAMPLED_TILE_INTERVAL: usize = 16;
/// Maximum number of times that the whole picture is coded.
pub(crate) const MAX_PICTURE_RUNS: u32 = 5;

// Descent over the Gaussians' integers under the layer (`refine_base.rs`).

/// Number of sweeps per round. The first one finds most improvements.
pub(crate) const REFINEMENT_SWEEPS: usize = 2;
