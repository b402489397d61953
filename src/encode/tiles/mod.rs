//! Encodes a picture in tiles. Each tile is fitted separately, in memory bounded by the size of a tile, and all tiles
//! are written to one file.
//!
//! Background, step sizes, weights and the price of a bit are those of the whole picture, so that the tiles match each
//! other. Passes alternate between two positions of the tiles, half a tile apart, so that the seams of one pass lie in
//! the interiors of the next. In the first pass, each tile is fitted alone, with a margin whose primitives are dropped.
//! Later passes continue the same schedule, while the primitives around each tile stay fixed. Sweeps over the integers
//! alternate between the two positions as well.

mod constant;
pub(super) mod fit;
mod floats;
mod global;
mod grid;
mod integers;
mod mosaic;
mod narrow;
pub(super) mod picture;
mod rounding;
mod shrunk;
mod task;
mod wire;

use grid::UNIT;
pub(super) use rounding::quantize;
pub use wire::work_on_tile;

/// Valid sides of a tile, pixels. Each is a multiple of the smallest.
pub(super) const TILE_SIDES: std::ops::RangeInclusive<u32> = 2 * UNIT..=1 << 14;
/// Default side of a tile, pixels.
pub(super) const DEFAULT_TILE_SIDE: u32 = 2048;
