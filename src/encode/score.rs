//! SSIMULACRA2 scores of encoded pictures.

use super::drawn::drawn_like;
use crate::bitstream::splats::PackedSplats;
use crate::error::Result;
use crate::pixels::Pixels;
use crate::ssimulacra2::ssimulacra2;

/// Returns the score of the picture with these integers against `original`, whose channels it restores.
pub(super) fn score(original: &Pixels, splats: &PackedSplats) -> Result<f64> {
    ssimulacra2(original, &drawn_like(splats, original)?)
}
