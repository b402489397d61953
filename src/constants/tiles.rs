//! Fits in tiles (`encode/tiles/`).

// Tiles.

/// Width of the margin around a tile, in multiples of the scale of a typical primitive.
pub(crate) const MARGIN_SCALES: f64 = 12.0;
/// Fraction of the time for Gaussians that their float fit may use.
pub(crate) const FIT_TIME_SHARE: f64 = 0.7;
/// Maximum fraction of the primitives that are replaced by candidates, possibly in other tiles, at once.
pub(crate) const MAX_SWAPPED_SHARE: f64 = 0.2;
/// Maximum number of primitives from which the step sizes are derived. More primitives would not change them.
pub(crate) const MAX_SAMPLED_PRIMITIVES: usize = 1 << 20;

// Passes of the fit (`floats.rs`).

/// Fraction of the iterations in which each tile is fitted alone. At that point, fits of many primitives relocate
/// hardly any, and the steps are still large enough to close the seams.
pub(crate) const ALONE_SHARE: f32 = 0.5;
/// Fractions of the iterations at which the later passes end. The tiles of the first and the last of them are shifted
/// by half a tile.
pub(crate) const JOINED_UNTIL: [f32; 3] = [0.7, 0.85, 1.0];
/// Number of candidate primitives that are searched for in a tile, as a fraction of the primitives in the tile.
pub(crate) const CANDIDATE_SHARE: f32 = 0.25;

// Candidates in the integers of a tile (`integers.rs`).

/// Number of candidate primitives that are searched for in a tile, as a fraction of the primitives in the tile.
pub(crate) const INTEGER_CANDIDATE_SHARE: f32 = 0.06;
/// Number of candidates that are searched for in addition.
pub(crate) const MIN_INTEGER_CANDIDATES: usize = 8;
