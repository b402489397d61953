//! Computes the difference between a picture and its Gaussians, tile by tile, as planes of luma and chroma
//! (spec §11.5).

use crate::bitstream::detail::levels::{SUPER, TILE, tile_area, tile_counts};
use crate::bitstream::detail::model::PLANES;
use crate::encode::stored_error::lines_at_once;
use crate::encode::texture::luma_and_chroma;
use crate::fit::model::drawing::field::Field;
use crate::fit::model::drawing::project::Projected;
use crate::fit::model::objective::planes::Planes;
use crate::fit::model::problem::{Problem, Scene};
use crate::parallel;

/// Factor that converts fractions of white to the unit of the layer's planes, 1/16 of an 8-bit code value.
const PARTS: f32 = 16.0 * 255.0;

/// The residual of one tile. The planes are padded to whole superblocks, and their rows are [`TILE`] values apart.
/// Empty planes represent zeros.
#[derive(Debug, Clone)]
pub(super) struct TileResidual {
    /// Width and height of the tile's part of the picture, pixels.
    pub size: [usize; 2],
    pub planes: [Vec<f32>; PLANES],
    /// Luma of the original, 8-bit code values. It determines how well errors are masked.
    pub luma: Vec<f32>,
}

/// Returns the difference between `target` and the picture rendered from `projected`, tile by tile.
pub(super) fn residuals(scene: Scene, target: &Planes, projected: &[Projected]) -> Vec<TileResidual> {
    let problem = Problem { scene, target };
    let size = [target.width, target.height];
    let [across, _] = tile_counts(size);
    let mut tiles = Vec::new();
    Field::default().draw_parts(&problem, projected, lines_at_once(across), |part| {
        let rows_of_tiles = part.lines().len().div_ceil(TILE);
        let first = part.first / TILE * across;
        let tile = |i: usize| residual(target, |row| part.row(row), tile_area(size, first + i));
        tiles.extend(parallel::map(rows_of_tiles * across, tile));
    });
    tiles
}

/// Returns the residual in a part of `target`, given by left, top, width and height. `drawn` returns the rendered rows.
pub(super) fn residual<'a>(
    target: &Planes,
    drawn: impl Fn(usize) -> &'a [f32],
    [left, top, width, height]: [usize; 4],
) -> TileResidual {
    let (count, alpha) = (target.channels.count(), target.channels.alpha());
    let colors = count - usize::from(alpha.is_some());
    let padded = [width, height].map(|side| side.next_multiple_of(SUPER));
    let mut planes: [Vec<f32>; PLANES] = std::array::from_fn(|_| Vec::new());
    let used: &[usize] = if colors == 3 { &[0, 1, 2] } else { &[0] };
    used.iter().chain(alpha.map(|_| &3)).for_each(|&k| planes[k] = vec![0.0; TILE * TILE]);
    let mut luma = vec![0.0; TILE * TILE];
    // The picture is reflected beyond its edge.
    let reflected = |i: usize, n: usize| if i < n { i } else { (2 * n - 1).saturating_sub(i) };
    for y in 0..padded[1] {
        let row = (top + reflected(y, height)) as u32;
        let (wanted, drawn) = (target.row(row), drawn(row as usize));
        for x in 0..padded[0] {
            let column = left + reflected(x, width);
            let value = |k: usize| wanted[k * target.stride + column];
            let rest = |k: usize| PARTS * (value(k) - drawn[k * target.stride + column].clamp(0.0, 1.0));
            let at = y * TILE + x;
            // The residual of invisible colours is 0, so they take no bytes.
            let is_seen = target.opacity.is_none_or(|a| value(a) > 0.0);
            if is_seen && colors == 3 {
                for (plane, value) in planes.iter_mut().zip(luma_and_chroma([rest(0), rest(1), rest(2)])) {
                    plane[at] = value;
                }
            } else if is_seen {
                planes[0][at] = rest(0);
            }
            if let Some(a) = alpha {
                planes[3][at] = rest(a);
            }
            luma[at] = 255.0 * if colors == 3 { luma_and_chroma([0, 1, 2].map(value))[0] } else { value(0) };
        }
    }
    TileResidual { size: [width, height], planes, luma }
}
