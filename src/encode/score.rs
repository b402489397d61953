//! SSIMULACRA2 scores of encoded pictures.

use super::channels::widen;
use super::drawn::drawn;
use crate::bitstream::splats::PackedSplats;
use crate::error::Result;
use crate::pixels::Pixels;
use crate::raster::View;
use crate::ssimulacra2::ssimulacra2;

/// Returns the score of the picture with these integers against `original`, whose channels it restores.
pub(super) fn score(original: &Pixels, splats: &PackedSplats) -> Result<f64> {
    let wide = (splats.channels != original.channels()).then(|| widen(splats, original.channels()));
    let splats = wide.as_ref().unwrap_or(splats);
    let drawn = drawn(splats, &View::of_size(splats.width, splats.height), splats.depth)?;
    ssimulacra2(original, &drawn)
}
