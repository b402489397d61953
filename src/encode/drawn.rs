//! Draws what an encode made, as a decoder would.

use crate::bitstream::splats::PackedSplats;
use crate::error::Result;
use crate::limits::Limits;
use crate::pixels::{Depth, Pixels};
use crate::raster::View;

/// Limits for the encoder's own integers, which need none on work.
pub(super) fn own_limits() -> Limits {
    Limits { tile_pairs: u64::MAX, work: u64::MAX, overlap: u64::MAX, primitives: u64::MAX, ..Limits::default() }
}

/// Draws the picture within `view`.
pub(super) fn drawn(splats: &PackedSplats, view: &View, depth: Depth) -> Result<Pixels> {
    splats.renderer(view, &own_limits())?.render(depth)
}

/// Draws a part of the picture: left, top, width and height in pixels.
pub(super) fn drawn_part(splats: &PackedSplats, [x, y, width, height]: [u32; 4], depth: Depth) -> Result<Pixels> {
    drawn(splats, &View::of_size(splats.width, splats.height).crop(x, y, width, height)?, depth)
}
