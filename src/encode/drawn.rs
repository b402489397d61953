//! Renders encoded pictures as a decoder would.

use crate::bitstream::splats::PackedSplats;
use crate::error::Result;
use crate::limits::Limits;
use crate::pixels::{Depth, Pixels};
use crate::raster::View;
use crate::rect::Rect;

/// Returns limits for the encoder's own integers, whose work need not be limited.
pub(super) fn own_limits() -> Limits {
    Limits { tile_pairs: u64::MAX, work: u64::MAX, overlap: u64::MAX, primitives: u64::MAX, ..Limits::default() }
}

/// Renders the picture within `view`.
pub(super) fn drawn(splats: &PackedSplats, view: &View, depth: Depth) -> Result<Pixels> {
    splats.renderer(view, &own_limits())?.render(depth)
}

/// Renders a part of the picture, given as left, top, width and height in pixels.
pub(super) fn drawn_part(splats: &PackedSplats, area: Rect, depth: Depth) -> Result<Pixels> {
    drawn(splats, &View::of_size(splats.width, splats.height).crop(area)?, depth)
}
