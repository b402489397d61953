//! Renders encoded pictures as a decoder would.

use super::channels::widen;
use crate::bitstream::splats::{Metadata, PackedSplats};
use crate::error::Result;
use crate::limits::Limits;
use crate::metrics;
use crate::parameter::Limit;
use crate::pixels::{Depth, Pixels};
use crate::raster::View;
use crate::rect::Rect;

/// Returns limits for the encoder's own integers, whose work need not be limited.
pub(super) fn own_limits() -> Limits {
    Limits { tile_pairs: u64::MAX, work: u64::MAX, overlap: u64::MAX, gaussians: u64::MAX, ..Limits::default() }
}

/// Checks that decoders with default limits open the file of `splats` and render the whole picture, without rendering
/// it.
///
/// # Errors
/// [`Error::LimitExceeded`](crate::Error::LimitExceeded) if they would refuse it.
pub(crate) fn check_opens(splats: &PackedSplats) -> Result<()> {
    check_metadata(&splats.metadata)?;
    check_renders(splats)
}

/// The part of [`check_opens`] that concerns the metadata.
pub(super) fn check_metadata(metadata: &Metadata) -> Result<()> {
    let bytes = metadata.sections().map(|(_, contents)| contents.len() as u64).sum();
    Limits::check(Limit::Metadata, bytes, Limits::default().metadata)
}

/// The part of [`check_opens`] that concerns the picture.
pub(super) fn check_renders(splats: &PackedSplats) -> Result<()> {
    splats.renderer(&View::new(splats.width, splats.height), &Limits::default()).map(drop)
}

/// Renders the picture within `view`.
pub(super) fn drawn(splats: &PackedSplats, view: &View, depth: Depth) -> Result<Pixels> {
    splats.renderer(view, &own_limits())?.render(depth)
}

/// Renders the whole picture with the channels of `like`.
pub(super) fn drawn_like(splats: &PackedSplats, like: &Pixels) -> Result<Pixels> {
    let wide = (splats.channels != like.channels()).then(|| widen(splats, like.channels()));
    let splats = wide.as_ref().unwrap_or(splats);
    drawn(splats, &View::new(splats.width, splats.height), splats.depth)
}

/// Returns the squared error of a decoded picture over the samples of `original`, where 1.0 is white, weighted as
/// [`metrics::psnr`] does.
pub(super) fn decoded_error(original: &Pixels, decoded: &Pixels) -> f64 {
    let white = f64::from(original.depth().max());
    metrics::squared_error(original, decoded) / (white * white)
}

/// Renders a part of the picture, given as left, top, width and height in pixels.
pub(super) fn drawn_part(splats: &PackedSplats, area: Rect, depth: Depth) -> Result<Pixels> {
    drawn(splats, &View::new(splats.width, splats.height).crop(area)?, depth)
}
