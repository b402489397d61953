//! How the bytes of a file are allocated to Gaussians and detail layer (`encode/allocation.rs`).

use std::ops::RangeInclusive;

// Classes of texture (`encode/texture.rs`).

/// Variance of luma that is negligible, code values². It is added to the variance before the logarithm.
pub(crate) const TEXTURE_VARIANCE_FLOOR: f64 = 4.0;
/// Variance of luma below which a square has one colour, code values². It allows for rounding errors.
pub(crate) const MAX_FLAT_VARIANCE: f64 = 0.001;
/// Share of one-colour squares above which a picture is a drawing. Of 50 pictures, 8 diagrams, pages and screenshots
/// have 0.34 to 0.86, one cut-out on white has 0.67, and all other photographs have at most 0.12. A page with
/// photographs has 0.27. Coded as a drawing, it loses 1.9 SSIMULACRA2 points at a ratio of 50.
pub(crate) const DRAWING_FLAT_SHARE: f64 = 0.3;
/// Share of one-colour squares above which a picture is partly a drawing, such as a page with photographs.
pub(crate) const MIXED_FLAT_SHARE: f64 = 0.1;
/// Activity above which a picture is busy: more than a simple diagram.
pub(crate) const BUSY_ACTIVITY: f64 = 2.9;
/// Fineness from which on a picture is a regular texture, such as a weave, a halftone or a checkerboard. Such textures
/// have 15 or more, white noise has 4, and photographs of Kodak and CID22 have at most 1.2, as thumbnails too.
pub(crate) const REGULAR_FINENESS: f64 = 8.0;

// Bytes of the Gaussians under a layer.

/// Number of pixels of the pictures from which the values of this section were determined. They scale with powers of
/// the number of pixels relative to this.
pub(crate) const REFERENCE_PIXELS: f64 = 393_216.0;
/// Bytes of Gaussians that suit most photographs of [`REFERENCE_PIXELS`] at a ratio of 50. `--detail SHARE` sets other
/// sizes.
pub(crate) const REFERENCE_BASE_BYTES: f64 = 8_200.0;
/// Exponent with which these bytes grow with the number of pixels.
pub(crate) const BASE_SIZE_EXPONENT: f64 = 0.35;
/// Exponent with which these bytes decrease as the ratio, relative to 50, grows from 20 to 100.
pub(crate) const BASE_RATIO_EXPONENT: f64 = 0.37;
/// Maximum share of the bytes of a file for them.
pub(crate) const MAX_BASE_SHARE: f64 = 0.7;
/// Maximum share of the bytes for the Gaussians of photographs of more than [`SMALL_PIXELS`] at the smaller of these ratios
/// and below it; at the larger, it is [`MAX_BASE_SHARE`]. `python lab/division.py target/release/ssplat PICTURES/cid22/*.png
/// --ratios 100` measures it (docs/studies/division.md).
pub(crate) const PHOTOGRAPH_BASE_SHARE: f64 = 0.6;
/// See [`PHOTOGRAPH_BASE_SHARE`].
pub(crate) const PHOTOGRAPH_BASE_SHARE_RATIOS: [f64; 2] = [100.0, 200.0];
/// Fineness from which on a photograph has fewer bytes of Gaussians. This and the next three values were fitted to 48
/// pictures at ratios of 50, 100 and 200, each encoded with factors from 0.35 to 1.4 and without a layer
/// (docs/studies/all-pictures.md). `python lab/fit_division.py PICTURES target/release/ssplat` fits the first three.
pub(crate) const FINE_BASE_FINENESS: f64 = 0.6;
/// Decrease of the factor on these bytes per unit of fineness above [`FINE_BASE_FINENESS`].
pub(crate) const FINE_BASE_SLOPE: f64 = 1.3;
/// Minimum of that factor.
pub(crate) const MIN_FINE_BASE_FACTOR: f64 = 0.5;
/// Ratios from which on that factor starts to apply, and at which it applies in full.
pub(crate) const FINE_BASE_RATIOS: [f64; 2] = [25.0, 100.0];
/// Activities at which a drawing starts to have more bytes of Gaussians and at which it has most.
pub(crate) const DRAWING_BASE_ACTIVITIES: [f64; 2] = [BUSY_ACTIVITY, 3.9];
/// Maximum factor on these bytes for drawings. A page of text with photographs gains 4 SSIMULACRA2 points at a ratio of
/// 50; simple diagrams would lose up to 1.
pub(crate) const MAX_DRAWING_BASE_FACTOR: f64 = 1.4;
/// Minimum share of the bytes for the Gaussians of a large, busy picture at a ratio of 100, where the layer is coarse.
pub(crate) const BUSY_BASE_SHARE: f64 = 0.5;
/// Activities at which that minimum share starts to apply and at which it applies in full.
pub(crate) const BUSY_SHARE_ACTIVITIES: [f64; 2] = [BUSY_ACTIVITY, 4.1];
/// Logarithm of the number of pixels, relative to [`REFERENCE_PIXELS`], at which that share applies in full.
pub(crate) const BUSY_SHARE_LOG_SIZE: f64 = 1.9;
/// Share of the bytes for the Gaussians of a regular texture. At 600 and 1200 bytes, a weave, stripes and a
/// checkerboard of 128 × 128 pixels gain 29 to 174 SSIMULACRA2 points over Gaussians alone. `python lab/division.py
/// target/release/ssplat PICTURES... --sizes 600,1200` measures it.
pub(crate) const REGULAR_BASE_SHARE: f64 = 0.05;
/// Exponent with which the maximum sharpness grows with the ratio relative to 20.
pub(crate) const SHARPNESS_RATIO_EXPONENT: f64 = 0.1;
/// Share of the bytes for the Gaussians of a sharp picture at a ratio of 20.
pub(crate) const SHARP_BASE_SHARE: f64 = 0.6;
/// Increase of that share with each doubling of the ratio.
pub(crate) const SHARP_BASE_SHARE_PER_OCTAVE: f64 = 0.15;
/// Maximum of that share.
pub(crate) const MAX_SHARP_BASE_SHARE: f64 = 0.9;
/// Maximum factor by which the Gaussians of a sharp picture may exceed their byte budget.
pub(crate) const MAX_SHARP_OVERSHOOT: f64 = 1.1;
/// Maximum share of the bytes for Gaussians that are tried.
pub(crate) const MAX_TRIED_BASE_SHARE: f64 = 0.82;
/// Minimum factor by which the bytes of the Gaussians must grow to justify another fit.
pub(crate) const MIN_BASE_GROWTH: f64 = 1.5;

// Whether a file has a layer.

/// Ratio above which files of [`REFERENCE_PIXELS`] have no layer, unless the tuning is perceptual and the texture is
/// known.
pub(crate) const MAX_LAYER_RATIO: f64 = 120.0;
/// Exponent with which that ratio grows with the number of pixels.
pub(crate) const LAYER_RATIO_EXPONENT: f64 = 0.85;
/// Ratio for which the settings of the effort state the [fineness](crate::effort::AllocationSettings::fineness) of
/// pictures with a layer. The largest ratio with a layer grows with the square of the fineness.
pub(crate) const FINENESS_RATIO: f64 = 100.0;
/// Number of pixels for which they state it.
pub(crate) const FINENESS_PIXELS: f64 = 262_144.0;
/// Exponent with which the largest ratio with a layer grows with the number of pixels.
pub(crate) const FINENESS_RATIO_EXPONENT: f64 = 2.0 / 3.0;
/// Maximum ratio at which drawings of [`FINENESS_PIXELS`] have a layer. At a ratio of 200, three diagrams gain 4 to 6
/// points with a layer.
pub(crate) const MAX_DRAWING_LAYER_RATIO: f64 = 250.0;
/// Ratio up to which texture does not rule out a layer.
pub(crate) const CERTAIN_LAYER_RATIO: f64 = 80.0;
/// Minimum size of a file with a layer, bytes.
pub(crate) const MIN_LAYER_FILE_BYTES: u64 = 2_500;
/// Numbers of pixels of small pictures. If their texture is known, their files may be smaller. The values for them are
/// from crops and thumbnails of 192 to 320 pixels at 600 to 4000 bytes (docs/studies/division.md). Still smaller ones,
/// which have no MS-SSIM, keep the usual minimum: at 1200 bytes, photographs of CID22 reduced to 96 pixels lose 1.5
/// points with a layer.
pub(crate) const SMALL_PIXELS: RangeInclusive<u64> = 161 * 161..=1 << 17;
/// Minimum size of a file with a layer for small pictures, bytes.
pub(crate) const MIN_SMALL_LAYER_FILE_BYTES: u64 = 700;
/// Minimum size of a file for which a layer is tried, for small pictures, bytes. A file without a layer takes five
/// times as long as one with a layer, so a try takes a fifth more time.
pub(crate) const MIN_TRIED_LAYER_FILE_BYTES: u64 = 400;
/// Multiple of the largest ratio with a layer up to which one is tried, for small pictures.
pub(crate) const MAX_TRIED_LAYER_RATIO_FACTOR: f64 = 2.0;
/// Maximum ratio of small pictures with a layer. Those that were measured have up to 205.
pub(crate) const MAX_SMALL_LAYER_RATIO: f64 = 250.0;
/// Minimum size of a file with a layer for regular textures, bytes; see [`REGULAR_BASE_SHARE`].
pub(crate) const MIN_REGULAR_LAYER_FILE_BYTES: u64 = 200;

// Length of the fit under a layer.

/// Shares of flat squares at which the fit of a picture under a layer starts to be longer and at which it is longest.
pub(crate) const LONG_FIT_FLAT_SHARES: [f64; 2] = [MIXED_FLAT_SHARE, DRAWING_FLAT_SHARE];
/// Largest factor on the iterations of such a fit. With twice the iterations, seven diagrams and pages gain 0.5 and 0.8
/// points at ratios of 50 and 100, and take 1.4 to 1.6 times as long.
pub(crate) const MAX_LONG_FIT_FACTOR: f32 = 2.0;
/// Ratios to which [`FIT_FACTORS`] belong. Between them, the factor depends on the logarithm of the ratio.
pub(crate) const FIT_FACTOR_RATIOS: [f64; 4] = [10.0, 20.0, 50.0, 100.0];
/// Factors on the iterations of the fits of other small pictures under a layer, at efforts 4 to 6. At a ratio of 20,
/// 1.6 gains 0.15 points on Kodak and on CID22 and takes a quarter more time; 2 gains nothing more. At 10, 2 would gain
/// 0.06 points on Kodak and take 1.4 times as long. At 100, 0.8 loses 0.2 and 0.0 points and saves a seventh of the
/// time. At 2.8 megapixels, 1.6 at 20 would gain 0.05 points and 0.8 at 100 lose 0.1.
pub(crate) const FIT_FACTORS: [f64; 4] = [1.0, 1.6, 1.0, 0.8];
/// Maximum ratio of large files, which have more rounds of descent.
pub(crate) const MAX_RATIO_OF_LARGE_FILES: f64 = 30.0;
