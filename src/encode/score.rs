//! SSIMULACRA2 scores of pictures that the encoder made.

use super::drawn::drawn;
use crate::bitstream::splats::PackedSplats;
use crate::error::Result;
use crate::pixels::Pixels;
use crate::raster::View;
use crate::ssimulacra2::ssimulacra2;

/// Returns the score of the picture with these integers against `original`, whose sides have to be long enough for one.
pub(super) fn score(original: &Pixels, splats: &PackedSplats) -> Result<f64> {
    let drawn = drawn(splats, &View::of_size(splats.width, splats.height), splats.depth)?;
    Ok(ssimulacra2(original, &drawn)?.expect("the sides were checked"))
}
