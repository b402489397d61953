//! Computes the error of a picture that consists of Gaussians and a detail layer.

use std::ops::Range;

use super::residual::lines_at_once;
use crate::bitstream::detail::DetailLayer;
use crate::bitstream::detail::levels::{TILE, tile_area, tile_counts};
use crate::bitstream::splats::PackedSplats;
use crate::detail::tile::{Scratch, TilePlanes, UNIT, reconstruct};
use crate::encode::input::stored_scene;
use crate::fit::model::drawing::field::{self, Field};
use crate::fit::model::drawing::project::Projected;
use crate::fit::model::objective::planes::Planes;
use crate::fit::model::problem::{Problem, Scene};
use crate::gaussian::Channels;
use crate::parallel;
use crate::round::rounded::projected;
use crate::simd::{self, LANES, Simd, Task};

/// Values that a layer adds to the channels of a target, tile by tile. The target can have fewer channels than the
/// layer.
#[derive(Debug)]
pub(super) struct Added {
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
            for (x, out) in part.chunks_mut(LANES).enumerate() {
                let strip = planes.strip(self.of[k], [x * LANES, y % TILE], 1)[0];
                for (out, v) in out.iter_mut().zip(strip) {
                    *out = f32::from(v) * (UNIT / 255.0);
                }
            }
        }
    }
}

/// Weights of errors.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::encode) enum Counted {
    /// All errors have equal weight.
    Alike,
    /// Errors have the weights of the target.
    AsTheyWeigh,
}

/// Returns the squared error of the picture rendered from `projected` with `layer` over it. `channels` are the channels
/// of the layer.
pub(in crate::encode) fn squared_error(
    (scene, target): (Scene, &Planes),
    projected: &[Projected],
    (layer, channels): (&DetailLayer, Channels),
    counted: Counted,
) -> f64 {
    let problem = Problem { scene, target };
    let [across, _] = tile_counts([target.width, target.height]);
    let mut sum = 0.0;
    Field::default().draw_parts(&problem, projected, lines_at_once(across), |part| {
        let added = Added::of_lines(layer, channels, target, part.lines());
        let errors = parallel::map(part.lines().len(), |i| {
            let y = part.first + i;
            row_error(target, y, part.row(y), &added, counted)
        });
        sum = errors.iter().fold(sum, |sum, error| sum + error);
    });
    sum
}

/// Returns the squared error of line `y`, of which the Gaussians render `drawn`.
fn row_error(target: &Planes, y: usize, drawn: &[f32], added: &Added, counted: Counted) -> f64 {
    let (width, stride) = (target.width as usize, target.stride);
    let wanted = target.row(y as u32);
    let (mut more, mut weights) = (vec![0.0; width], vec![0.0; width]);
    let mut error = 0.0;
    let amplitude = target.amplitude(y as u32).filter(|_| counted == Counted::AsTheyWeigh);
    for k in 0..target.channels.count() {
        weights.fill(if counted == Counted::AsTheyWeigh { target.channel_amplitude[k] } else { 1.0 });
        let opacity = target.opacity.filter(|&a| a != k).map(|a| &wanted[a * stride..]);
        for factors in [opacity, amplitude].into_iter().flatten() {
            weights.iter_mut().zip(factors).for_each(|(weight, factor)| *weight *= factor);
        }
        added.row(y, k, &mut more);
        let [drawn, wanted] = [drawn, wanted].map(|row| &row[k * stride..][..width]);
        error += simd::dispatch(RowError { drawn, added: &more, wanted, weights: &weights });
    }
    error
}

/// Sums the weighted squared errors of a row of one channel.
struct RowError<'a> {
    drawn: &'a [f32],
    added: &'a [f32],
    wanted: &'a [f32],
    weights: &'a [f32],
}

impl Task for RowError<'_> {
    type Output = f64;

    #[inline(always)]
    fn run<S: Simd>(self, _: S) -> f64 {
        let RowError { drawn, added, wanted, weights } = self;
        // Eight partial sums, so that every instruction set adds in the same order.
        let mut sums = [0f64; LANES];
        let rows = drawn.chunks(LANES).zip(added.chunks(LANES)).zip(wanted.chunks(LANES).zip(weights.chunks(LANES)));
        for ((drawn, added), (wanted, weights)) in rows {
            let mut errors = [0f32; LANES];
            for k in 0..drawn.len().min(LANES) {
                let value = (drawn[k].clamp(0.0, 1.0) + added[k]).clamp(0.0, 1.0);
                errors[k] = (value - wanted[k]) * weights[k];
            }
            for k in 0..LANES {
                sums[k] += f64::from(errors[k]) * f64::from(errors[k]);
            }
        }
        sums.iter().sum()
    }
}

/// Returns the squared error of a stored picture over the samples of `planes`. `channels` are those of the file.
pub(in crate::encode) fn stored_error(splats: &PackedSplats, planes: &Planes, channels: Channels) -> f64 {
    let projected = projected(&splats.quantizer(), &splats.gaussians, splats.height);
    if let Some(layer) = &splats.detail {
        return squared_error((stored_scene(splats), planes), &projected, (layer, channels), Counted::Alike);
    }
    field::squared_error(&Problem { scene: stored_scene(splats), target: planes }, &projected)
}
