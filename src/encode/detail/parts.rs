//! Codes the layer of a picture that is read one part at a time. The encoder finds the step on a sample of the tiles,
//! then codes all tiles with it.
//!
//! Memory holds the residual of one part, and the levels and block sizes of all tiles. Levels and block sizes take a
//! few bytes for each byte of the file.

use super::adaptive_quantization::{Masking, activities};
use super::residual::{TileResidual, residual};
use super::search::{Coded, code, search, smallest_step};
use super::settings::{SearchSettings, over_fixed_base, search_settings};
use crate::bitstream::detail::DetailLayer;
use crate::bitstream::detail::levels::{TILE, tile_area, tile_counts};
use crate::bitstream::splats::PackedSplats;
use crate::constants::detail;
use crate::encode::render::drawn_part;
use crate::error::Result;
use crate::fit::model::objective::planes::Planes;
use crate::gaussian::Channels;
use crate::options::{HiddenColors, Tune};
use crate::parallel;
use crate::pixel_source::PixelSource;
use crate::pixels::Depth;
use crate::rect::Rect;

/// Typical number of times, from which the progress is estimated.
const EXPECTED: f32 = 2.0;

/// A picture that is read one part at a time, and its Gaussians.
#[derive(Clone, Copy)]
pub(in crate::encode) struct Parts<'a> {
    /// The picture, without redundant channels.
    pub source: &'a dyn PixelSource,
    /// Gaussians with the same channels. To measure the error, they include the layer.
    pub splats: &'a PackedSplats,
    /// The channels of the file.
    pub channels: Channels,
    pub tune: Tune,
    pub hidden: HiddenColors,
}

impl Parts<'_> {
    /// Returns a layer whose index and streams take at most `max_bytes` bytes, or `None` if there is nothing to add or
    /// no room for a layer. `on_progress` receives the fraction of the work that is done.
    pub(crate) fn layer(
        &self,
        max_bytes: u64,
        on_progress: &mut dyn FnMut(f32) -> Result<()>,
    ) -> Result<Option<DetailLayer>> {
        on_progress(0.0)?;
        let count = self.count();
        let usual = search_settings(self.tune, self.channels, self.source.channels().alpha().is_some());
        let max_runs = detail::MAX_PICTURE_RUNS;
        let settings = SearchSettings { max_bytes, max_runs, ..over_fixed_base(usual, self.tune) };
        let sample_size = (count / detail::SAMPLED_TILE_INTERVAL).clamp(8, 64);
        // The positions are independent of rows and columns.
        let place = |k: usize| ((k as u64 * 0x9e37_79b9 & 0xffff_ffff) * count as u64 >> 32) as usize;
        let mut sampled: Vec<usize> =
            if count > sample_size { (0..sample_size).map(place).collect() } else { (0..count).collect() };
        sampled.sort_unstable();
        sampled.dedup();
        let (mut sample, mut area) = (Vec::new(), 0);
        for index in sampled {
            let [_, _, width, height] = tile_area(self.source.size(), index);
            area += width * height;
            sample.extend(self.residuals(index, 1)?);
        }
        let share = area as f64 / (f64::from(self.source.width()) * f64::from(self.source.height()));
        let of_sample = SearchSettings { max_bytes: (max_bytes as f64 * share) as u64, ..settings };
        let Some(first) = search(&sample, &of_sample, None) else { return Ok(None) };
        let step = f64::from(first.layer.head.step);
        let masking = Masking::new(&activities(&sample, &settings), &settings, step);
        drop(sample);
        let (mut sizes, mut runs) = (None, 0.0);
        let found = smallest_step(&settings, step, |step| {
            let mut on_progress = |done: f32| on_progress(((runs + done) / EXPECTED).min(1.0));
            let coded = self.coded(&settings, (masking, step), sizes.as_deref(), &mut on_progress)?;
            sizes.get_or_insert_with(|| coded.sizes.clone());
            runs += 1.0;
            Ok::<_, crate::Error>(coded)
        })?;
        Ok(found.map(|coded| coded.layer).filter(|layer| layer.tiles() > 0))
    }

    fn count(&self) -> usize {
        let [across, down] = tile_counts(self.source.size());
        across * down
    }

    /// Returns the first tile and the number of tiles of each part.
    fn parts(&self) -> impl Iterator<Item = (usize, usize)> + use<> {
        let [across, down] = tile_counts(self.source.size());
        // Each thread processes one tile.
        let at_once = parallel::threads();
        (0..down).flat_map(move |row| {
            (0..across).step_by(at_once).map(move |left| (row * across + left, at_once.min(across - left)))
        })
    }

    /// Codes all tiles with one step.
    fn coded(
        &self,
        settings: &SearchSettings,
        (masking, step): (Masking, u16),
        sizes: Option<&[[Vec<u8>; 3]]>,
        on_progress: &mut dyn FnMut(f32) -> Result<()>,
    ) -> Result<Coded> {
        let layer = DetailLayer { head: settings.setting_at(step).head, tiles: Vec::new() };
        let mut all = Coded { layer, bytes: 0, sizes: Vec::new() };
        for (index, count) in self.parts() {
            on_progress(index as f32 / self.count() as f32)?;
            let tiles = self.residuals(index, count)?;
            let classes = masking.classes(&activities(&tiles, settings));
            let part = code(&tiles, &classes, settings, step, (sizes.map(|sizes| &sizes[index..index + count]), &[]));
            all.layer.tiles.extend(part.layer.tiles);
            all.sizes.extend(part.sizes);
            all.bytes += part.bytes;
        }
        Ok(all)
    }

    /// Returns the residuals of `count` tiles of a row, starting at tile `index`.
    fn residuals(&self, index: usize, count: usize) -> Result<Vec<TileResidual>> {
        let (area, wanted, drawn) = self.part(index, count)?;
        let tile = |i: usize| {
            let left = i * TILE;
            let width = TILE.min(area.width as usize - left);
            residual(&wanted, |row| drawn.row(row as u32), [left, 0, width, area.height as usize])
        };
        Ok(parallel::map(count, tile))
    }

    /// Returns the area of `count` tiles of a row, the original in that area, and the picture that the Gaussians render
    /// there.
    fn part(&self, index: usize, count: usize) -> Result<(Rect, Planes, Planes)> {
        let [left, top, _, height] = tile_area(self.source.size(), index);
        let [last, _, width, _] = tile_area(self.source.size(), index + count - 1);
        let area = Rect::from([left, top, last + width - left, height].map(|side| side as u32));
        let wanted = Planes::with_hidden(&self.source.part(area)?, self.hidden);
        // 16 bits are finer than any quantizer step.
        let drawn = drawn_part(self.splats, area, Depth::Sixteen)?;
        Ok((area, wanted, Planes::new(&drawn)))
    }
}
