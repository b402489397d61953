//! Files with an exact layer (`encode/exact/`).

// Pictures for which the layer is tried (`mod.rs`, `survey.rs`).

/// Number of pairs of rows that are looked at to see whether a picture repeats itself.
pub(crate) const SAMPLED_PAIRS: u32 = 24;
/// Minimum share of pixels that equal their left or upper neighbour in a picture for which the layer is tried. Screens,
/// pages and drawings have .8 to .98, and photographs less than .3 or, if they are dark or out of focus, up to .6.
pub(crate) const MIN_EQUAL: f64 = 0.35;
/// Minimum share of these that equal both. Screens, pages and drawings have .69 to .98, and photographs .18 to .58.
pub(crate) const MIN_BOTH_EQUAL: f64 = 0.65;
/// Minimum share of pixels with sharp edges in any other picture for which the layer is tried: a page or
/// screen whose gradients are dithered, or with many photographs. They have 0.002 to 0.005, and photographs less than
/// 0.0007.
pub(crate) const MIN_EDGES: f64 = 0.0018;
/// Minimum number of equal pixels before a sharp edge.
pub(crate) const MIN_EDGE_RUN: usize = 4;
/// Minimum difference of luma within two pixels at a sharp edge, of the range of sample values.
pub(crate) const MIN_EDGE_DIFFERENCE: f32 = 0.16;
/// Logarithms of the tiles' sides: for pictures in which neighbouring pixels are often equal, which gain from
/// repetitions far away, and for all others, which gain from parallel decoding.
pub(crate) const TILE_SIDES: [u8; 2] = [11, 9];
/// Number of pairs of rows from which the bytes of a picture are estimated.
pub(crate) const ESTIMATED_PAIRS: u32 = 32;

// Paper with noise (`paper.rs`).

/// Number of pairs of rows that are looked at to see whether a picture is a page.
pub(crate) const PAPER_SAMPLED_PAIRS: u32 = 32;
/// Largest difference of paper from its most frequent level, 8-bit code values.
pub(crate) const MAX_PAPER_NOISE: u32 = 16;
/// Differences that are certainly noise, from which its standard deviation is measured.
pub(crate) const CERTAIN_PAPER_NOISE: u32 = 8;
/// Noise is removed up to this many standard deviations from the level of the paper.
pub(crate) const PAPER_NOISE_DEVIATIONS: f64 = 3.5;
/// Smallest difference of ink from the paper, 8-bit code values.
pub(crate) const MIN_INK_CONTRAST: u32 = 80;
/// Smallest step of an edge of ink, 8-bit code values.
pub(crate) const MIN_INK_EDGE: u32 = 48;
/// Minimum share of the pixels of a page that are paper. At most 0.3 of the pixels of photographs are as close to their
/// most frequent level as paper is.
pub(crate) const MIN_PAPER_SHARE: f64 = 0.5;
/// Minimum share of the pixels of a page that are ink.
pub(crate) const MIN_INK_SHARE: f64 = 0.005;
/// Minimum share of the pixels of a page that are edges.
pub(crate) const MIN_INK_EDGE_SHARE: f64 = 0.005;
/// Maximum share of the pixels that equal their left neighbour on paper with noise.
pub(crate) const MAX_EQUAL_ON_PAPER: f64 = 0.3;

// Near colours (`search.rs`).

/// Largest tolerance, in 8-bit code values. With larger ones, letters lose their shape.
pub(crate) const MAX_TOLERANCE: u32 = 48;
/// Tolerance of the first try.
pub(crate) const FIRST_TOLERANCE: u32 = 8;
/// Power of the tolerance with which the bytes fall, before two tries show it.
pub(crate) const TOLERANCE_EXPONENT: f64 = 0.5;
/// Size of a file without loss, relative to the requested one, up to which photographs in a page may have near colours
/// as well, within [`MAX_SURE_TOLERANCE`].
pub(crate) const MAX_NEAR_PHOTOGRAPH_SIZE: f64 = 1.4;
/// Minimum share of the room that a layer fills with which the search ends. A smaller tolerance would gain little.
pub(crate) const MIN_FILLED: f64 = 0.97;
/// Number of tries for a layer that is partly without loss.
pub(crate) const PARTLY_EXACT_TRIES: u32 = 4;
/// Share of the room that its tries after the first aim at.
pub(crate) const PARTLY_EXACT_AIM: f64 = 0.98;
/// The search for a quality ends when the tolerances that reach it and miss it differ by less than one in this many.
pub(crate) const TOLERANCE_RESOLUTION: u32 = 8;

// Comparison with Gaussians and a detail layer (`mod.rs`).

/// Largest tolerance of colours with which a file is taken without comparing it with one of Gaussians and a detail
/// layer. In the worst case that was found, the latter has .2 SSIMULACRA2 points more.
pub(crate) const MAX_SURE_TOLERANCE: u32 = 2;
/// Effort of the first file of Gaussians and a detail layer that is compared with near colours.
pub(crate) const QUICK_EFFORT: u8 = 2;
/// What a higher effort can gain at most, in decibels: of MS-SSIM or PSNR.
pub(crate) const MAX_EFFORT_GAIN: f64 = 2.0;
/// The same in SSIMULACRA2 points, for pages with photographs.
#[cfg(feature = "quality-hook")]
pub(crate) const MAX_EFFORT_GAIN_POINTS: f64 = 10.0;
/// Smallest size of a file of Gaussians and a detail layer relative to its prediction.
pub(crate) const MIN_PREDICTED_SIZE: f64 = 0.75;
/// Size of a file with near colours, relative to that prediction, up to which one fit of Gaussians is enough to compare
/// it with. A search of several fits would take up to six times as long, for files of a few kilobytes.
pub(crate) const MAX_SINGLE_FIT_SIZE: f64 = 1.5;
/// Minimum share of the time limit that remains for Gaussians and the detail layer where there is no other file.
pub(crate) const MIN_TIME_SHARE: f64 = 0.05;

// Photographs without loss (`mod.rs`).

/// Quality from which on a picture is stored without loss and no other file is tried.
#[cfg(feature = "quality-hook")]
pub(crate) const LOSSLESS_QUALITY: f64 = 99.5;
/// Quality from which on the picture without loss is tried whatever its estimated size.
#[cfg(feature = "quality-hook")]
pub(crate) const LOSSLESS_TRIED_QUALITY: f64 = 97.0;
/// Smallest size of a picture without loss relative to its estimate.
pub(crate) const MIN_LOSSLESS_SIZE: f64 = 0.7;
/// Seconds for each pixel of a photograph without loss. On one busy core of an Intel Xeon, three photographs took 6 to 9
/// µs of CPU time.
pub(crate) const LOSSLESS_SECONDS: f64 = 6e-6;
/// PSNR from which on the picture without loss is tried, in decibels above that of an error of one code value: 48 dB for
/// pictures of 8 bits.
pub(crate) const LOSSLESS_TRIED_LEVEL: f64 = 0.0;
/// PSNR from which on it is stored and no other file is tried, on the same scale: 60 dB for pictures of 8 bits. At effort
/// 5, seven photographs of Kodak and CID22 were smaller with loss at 50 dB, six at 52, five at 54 and three at 56 (by up
/// to 22 %).
pub(crate) const LOSSLESS_LEVEL: f64 = 11.8;
/// Points by which a file with near colours may miss a quality.
#[cfg(feature = "quality-hook")]
pub(crate) const NEAR_COLOR_TOLERANCE: f64 = 0.4;

// Photographs in a picture with an exact layer (`mask.rs`, `mixed.rs`).

/// Quantizer step of a transform that looks about as good as a tolerance, relative to the tolerance.
pub(crate) const STEP_OF_TOLERANCE: f32 = 2.0;
/// Quantizer step of the colour differences, relative to that of luma.
pub(crate) const MASK_CHROMA_STEP: f32 = 2.5;
/// Bits of a coefficient for each doubling of its square.
pub(crate) const BITS_PER_OCTAVE: f32 = 0.75;
/// Minimum number of cells of photographs in a picture with a mask.
pub(crate) const MIN_PHOTOGRAPH_CELLS: usize = 64;
/// Maximum share of all cells that they have.
pub(crate) const MAX_PHOTOGRAPH_SHARE: f64 = 0.9;
/// Minimum share of the visible pixels of a picture with alpha that a mask covers.
pub(crate) const MIN_VISIBLE_SHARE: f64 = 0.15;
/// Minimum share of the pixels around a cell that differ from all their neighbours in photographs. Screens and pages
/// have less than 0.6 of them in 99 of 100 cells, and photographs more than 0.68 in half of their cells and more than
/// 0.39 in 90 of 100.
pub(crate) const MIN_UNLIKE_SHARE: f32 = 0.7;
/// The same in the smooth parts of photographs.
pub(crate) const MIN_SMOOTH_UNLIKE_SHARE: f32 = 0.3;
/// Maximum range of luma around a cell in smooth parts of photographs, 8-bit code values.
pub(crate) const MAX_SMOOTH_RANGE: f32 = 48.0;
/// Minimum share of photographs around a cell that is kept as one.
pub(crate) const MIN_KEPT_SHARE: f32 = 0.3;
/// Minimum share of photographs around a cell that becomes one.
pub(crate) const MIN_JOINED_SHARE: f32 = 0.5;
/// Bytes of a sample of a photograph without loss that are always needed.
pub(crate) const MIN_SAMPLE_BYTES: f64 = 0.1;
/// Number of times that cells join photographs or leave them.
pub(crate) const MASK_ROUNDS: usize = 3;
/// Share of the bytes for the Gaussians of photographs.
pub(crate) const PHOTOGRAPH_BASE_SHARE: f64 = 0.35;
/// Minimum number of bytes of photographs with a detail layer.
pub(crate) const MIN_PHOTOGRAPH_LAYER_BYTES: u64 = 1500;
/// Factor on the iterations of the fit. The continued ground looks like that of a drawing, for which fits are twice as
/// long. With 0.5, pages lose 0.3 to 1.2 points at equal bytes; with 1, a fit takes 1.4 times as long.
pub(crate) const PHOTOGRAPH_ITERATIONS: f32 = 0.7;
/// Share of the points between a quality and 100 that the photographs, in a picture that is otherwise without loss,
/// have more. The rest may then have loss as well.
#[cfg(feature = "quality-hook")]
pub(crate) const PHOTOGRAPH_AIM_ABOVE: f64 = 0.1;
