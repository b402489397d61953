//! What luma and green chroma are to take of each other's error, where squared error of red, green and blue is to be
//! small.
//!
//! Errors `y` of luma and `g` of green chroma make `12y² + 3g² − 4yg` of it, and those of orange chroma have no part in
//! either: beside an error `g` that stays, the best one of luma is `g / 6`. Most of `g` stays, since most coefficients
//! of chroma are too small for a level. Beside an error `y` the best one of chroma is `2y / 3`; but most of `y` does
//! not stay when the layer is coded anew.

use super::residual::{TileResidual, luma_and_chroma};
use crate::bitstream::detail::DetailLayer;
use crate::bitstream::detail::levels::TILE;
use crate::detail::tile::{Scratch, TilePlanes, reconstruct};
use crate::gaussian::Channels;
use crate::parallel;

/// Part of the error of green chroma that luma takes.
const OF_GREEN: f32 = 1.0 / 6.0;
/// Part of the error of luma that green chroma takes: less than half of the best one where all of it stays.
const OF_LUMA: f32 = 0.4 * 2.0 / 3.0;

/// Adds to luma and green chroma of `tiles` what is best beside the errors of `layer`. Twelve pictures of Kodak gain
/// .03 dB at a ratio of 20, .02 at 50, and nothing at 100; the part of green chroma is .003.
pub(super) fn couple(tiles: &mut [TileResidual], layer: &DetailLayer, channels: Channels) {
    // The file's channels may be more than those that are fitted: a grey picture that is stored as RGB has no chroma.
    if tiles.iter().any(|tile| tile.planes[0].len() != tile.planes[2].len()) {
        return;
    }
    let errors = parallel::map(tiles.len(), |i| errors(&tiles[i], layer, i, channels));
    for (tile, errors) in tiles.iter_mut().zip(errors) {
        for (at, [luma, green]) in errors.into_iter().enumerate() {
            tile.planes[0][at] += OF_GREEN * green;
            tile.planes[2][at] += OF_LUMA * luma;
        }
    }
}

/// The errors of luma and green chroma in tile `index` of `layer`; 0 beyond the picture's edge.
fn errors(tile: &TileResidual, layer: &DetailLayer, index: usize, channels: Channels) -> Vec<[f32; 2]> {
    let (mut scratch, mut made) = (Scratch::default(), TilePlanes::default());
    if let Some(levels) = &layer.tiles[index] {
        reconstruct(levels, (&layer.head, channels, tile.size), &mut scratch, &mut made);
    }
    let mut errors = vec![[0.0; 2]; TILE * TILE];
    for y in 0..tile.size[1] {
        for x in 0..tile.size[0] {
            let at = y * TILE + x;
            let added = match &made.channels[..] {
                // Additions are counted in half of the planes' unit (spec §11.5).
                [r, g, b, ..] if made.has(x, y) => [r, g, b].map(|channel| 0.5 * f32::from(channel[at])),
                _ => [0.0; 3],
            };
            let [luma, _, green] = luma_and_chroma(added);
            errors[at] = [luma - tile.planes[0][at], green - tile.planes[2][at]];
        }
    }
    errors
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bitstream::detail::DetailHead;

    #[test]
    fn luma_beside_lost_green_chroma_has_less_error_in_red_green_and_blue() {
        let (luma, green) = (30.0, -12.0);
        let plane = |value: f32| vec![value; TILE * TILE];
        let mut tile = TileResidual {
            size: [TILE, TILE],
            planes: [plane(luma), plane(0.0), plane(green), Vec::new()],
            luma: plane(128.0),
        };
        // The layer has nothing: all of green chroma stays, and luma would, too.
        let layer = DetailLayer { head: DetailHead::PLAIN, tiles: vec![None] };
        couple(std::slice::from_mut(&mut tile), &layer, Channels::Rgb);
        // Additions of the specification, of what is coded less what is wanted.
        let error = |coded: f32| {
            let (y, g) = (coded - luma, -green);
            (2.0 * y - g).powi(2) + (2.0 * y + g).powi(2) + (2.0 * y - g).powi(2)
        };
        let coupled = tile.planes[0][0];
        assert!(error(coupled) < error(luma), "{} for {}", error(coupled), error(luma));
        let beside = |step: f32| error(coupled + step) - error(coupled);
        assert!(beside(0.1) > 0.0 && beside(-0.1) > 0.0, "{coupled} is not the best luma");
    }
}
