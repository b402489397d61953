//! Computes the error of a picture that consists of Gaussians and a detail layer.

use std::ops::Range;

use super::input::stored_scene;
use crate::bitstream::detail::DetailLayer;
use crate::bitstream::detail::levels::{TILE, tile_area, tile_counts};
use crate::bitstream::splats::PackedSplats;
use crate::detail::tile::{Scratch, TilePlanes, UNIT, reconstruct};
use crate::fit::model::drawing::field::{self, Field};
use crate::fit::model::drawing::project::Projected;
use crate::fit::model::objective::planes::Planes;
use crate::fit::model::problem::{Problem, Scene};
use crate::gaussian::Channels;
use crate::parallel;
use crate::rdo::rounded::projected;

/// Returns the number of lines that are drawn at a time in a picture of `across` tiles in a row: whole tiles, with
/// enough work for each thread.
pub(super) fn lines_at_once(across: usize) -> usize {
    const TILES_PER_THREAD: usize = 2;
    TILE * (TILES_PER_THREAD * parallel::threads()).div_ceil(across)
}

/// Values that a layer adds to the channels of a target, tile by tile. The target can have fewer channels than the
/// layer.
#[derive(Debug)]
pub(in crate::encode) struct Added {
    tiles: Vec<Option<TilePlanes>>,
    across: usize,
    /// Index of the first tile in the layer.
    first: usize,
    /// Index of the layer's channel that corresponds to each channel of the target.
    of: [usize; 4],
}

impl Added {
    pub(super) fn new(layer: &DetailLayer, channels: Channels, target: &Planes) -> Self {
        Added::of_lines(layer, channels, target, 0..target.height as usize)
    }

    /// Returns the additions to `lines` of the target, which begin with a row of tiles.
    pub(super) fn of_lines(layer: &DetailLayer, channels: Channels, target: &Planes, lines: Range<usize>) -> Self {
        let size = [target.width, target.height];
        let [across, _] = tile_counts(size);
        let [first, end] = [lines.start / TILE, lines.end.div_ceil(TILE)].map(|row| row * across);
        let tiles = parallel::map(end - first, |i| {
            let levels = layer.tiles[first + i].as_ref()?;
            let [_, _, width, height] = tile_area(size, first + i);
            let (mut scratch, mut planes) = (Scratch::default(), TilePlanes::default());
            reconstruct(levels, (&layer.head, channels, [width, height]), &mut scratch, &mut planes);
            Some(planes)
        });
        let of = std::array::from_fn(|k| match (target.channels.alpha(), channels.alpha()) {
            (Some(a), Some(alpha)) if a == k => alpha,
            _ => k,
        });
        Added { tiles, across, first, of }
    }

    /// Writes to `row` the values that the layer adds to row `y` of the target's channel `k`, as fractions of white.
    pub(super) fn row(&self, y: usize, k: usize, row: &mut [f32]) {
        row.fill(0.0);
        for (x, part) in row.chunks_mut(TILE).enumerate() {
            let tile = y / TILE * self.across + x - self.first;
            let Some(planes) = self.tiles.get(tile).and_then(Option::as_ref) else { continue };
            if self.of[k] >= planes.channels() {
                continue;
            }
            for (out, v) in part.iter_mut().zip(planes.row(self.of[k], [0, y % TILE])) {
                *out = f32::from(v) * (UNIT / 255.0);
            }
        }
    }
}

/// Returns the squared error of the picture rendered from `projected` with `layer` over it, with the weights of
/// `target`. `channels` are the channels of the layer.
pub(in crate::encode) fn squared_error(
    (scene, target): (Scene, &Planes),
    projected: &[Projected],
    (layer, channels): (&DetailLayer, Channels),
) -> f64 {
    let problem = Problem { scene, target };
    let [across, _] = tile_counts([target.width, target.height]);
    let mut sum = 0.0;
    Field::default().draw_parts(&problem, projected, lines_at_once(across), |part| {
        let added = Added::of_lines(layer, channels, target, part.lines());
        let errors = parallel::map(part.lines().len(), |i| {
            let y = part.first + i;
            row_error(target, y, part.row(y), &added)
        });
        sum = errors.iter().fold(sum, |sum, error| sum + error);
    });
    sum
}

/// Returns the squared error of line `y`, of which the Gaussians render `drawn`.
fn row_error(target: &Planes, y: usize, drawn: &[f32], added: &Added) -> f64 {
    let (count, weights) = (target.channels.count(), target.weights(y as u32));
    let wanted = target.row(y as u32);
    let mut more = vec![0.0; target.width as usize];
    let mut error = 0.0;
    for k in 0..count {
        added.row(y, k, &mut more);
        for (x, more) in more.iter().enumerate() {
            let at = k * target.stride + x;
            let value = (drawn[at].clamp(0.0, 1.0) + more).clamp(0.0, 1.0);
            error += f64::from((value - wanted[at]) * weights.factor(k, x)).powi(2);
        }
    }
    error
}

/// Returns the squared error of a stored picture over the samples of `planes`, with their weights except those of the
/// tuning. `channels` are those of the file.
pub(in crate::encode) fn stored_error(splats: &PackedSplats, planes: &Planes, channels: Channels) -> f64 {
    let projected = projected(&splats.quantizer(), &splats.gaussians, splats.height);
    if let Some(layer) = &splats.detail {
        return squared_error((stored_scene(splats), &planes.untuned()), &projected, (layer, channels));
    }
    field::squared_error(&Problem { scene: stored_scene(splats), target: planes }, &projected)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::weighting::cases;

    #[test]
    fn errors_of_rows_are_weighted_sums_over_all_samples() {
        let (width, height) = (37u32, 9u32);
        for case in cases::all(width, height) {
            let (target, count) = (&case.target, case.target.channels.count());
            // A layer without tiles adds nothing.
            let added = Added { tiles: vec![None], across: 1, first: 0, of: [0, 1, 2, 3] };
            let drawn = vec![0.25f32; (count + 1) * target.stride];
            let error: f64 = (0..height as usize).map(|y| row_error(target, y, &drawn, &added)).sum();
            let samples = case.values.iter().zip(&case.weights);
            let want: f64 = samples.map(|(value, weight)| weight * (value - 0.25).powi(2)).sum();
            assert!((error / want - 1.0).abs() < 1e-5, "{}: {error} {want}", case.name);
        }
    }
}
