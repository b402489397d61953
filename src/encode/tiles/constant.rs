//! Single colours of pictures that are read in tiles.

use super::grid::Window;
use crate::encode::constant::is_constant;
use crate::error::Result;
use crate::fit::model::objective::planes::Planes;
use crate::pixel_source::PixelSource;
use crate::rect::Rect;

/// Returns the mean colour of the picture of `source`, which `tiles` cover. Calls `on_progress` for each of them.
pub(super) fn mean(
    source: &dyn PixelSource,
    tiles: &[Window],
    mut on_progress: impl FnMut() -> Result<()>,
) -> Result<[f32; 4]> {
    let (mut sum, mut area) = ([0.0f64; 4], 0.0);
    for tile in tiles {
        on_progress()?;
        let mean = Planes::new(&source.part(tile.core.bounds())?).mean;
        sum = std::array::from_fn(|k| sum[k] + f64::from(mean[k]) * tile.core.pixels());
        area += tile.core.pixels();
    }
    Ok(sum.map(|v| (v / area) as f32))
}

/// Returns the colour of a picture whose pixels are all equal. Reads `tiles`, which together cover the picture of
/// `source`, until two pixels differ. Calls `on_progress` with the fraction that is done.
pub(super) fn color(
    source: &dyn PixelSource,
    tiles: &[Window],
    mut on_progress: impl FnMut(f32) -> Result<()>,
) -> Result<Option<[f32; 4]>> {
    let mut color = None;
    for (i, tile) in tiles.iter().enumerate() {
        on_progress(i as f32 / tiles.len() as f32)?;
        let part = source.part(tile.core.bounds())?;
        if !is_constant(&part) {
            return Ok(None);
        }
        // Averaging many equal pixels loses precision, so the colour is taken from a single pixel.
        let own = Planes::new(&part.part(Rect::new(0, 0, 1, 1))?).mean;
        if *color.get_or_insert(own) != own {
            return Ok(None);
        }
    }
    Ok(color)
}
