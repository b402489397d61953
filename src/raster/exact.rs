//! Draws the pixels of the exact layer over a view (spec §12.7).
//!
//! At full size a covered pixel has its stored samples. In other sizes an output pixel is the mean of the part of the
//! picture that it covers: of the stored samples where the layer covers it, and of the view below elsewhere. Pixels of
//! the picture therefore keep sharp edges when a view is enlarged by a whole factor.

use std::ops::Range;
use std::sync::Arc;

use super::samples::Sample;
#[cfg(feature = "gpu")]
use super::samples::SamplesMut;
use super::view::View;
use crate::bitstream::ExactLayer;
use crate::bitstream::exact::{ExactTile, tile_area, tile_counts};
use crate::budget::Budget;
use crate::error::Result;
use crate::gaussian::Channels;
use crate::limits::Limits;
use crate::parallel;
use crate::parameter::Limit;
use crate::pixels::Samples;

/// Weight of a colour under alpha 0, as in the mean of samples (spec §5.5).
const HIDDEN_WEIGHT: f32 = 1.0 / 4096.0;
/// Values of a column: the weighted sums of four channels, the covered part, and the weights of the colours.
const SUMS: usize = 6;
const COVERED: usize = 4;
const WEIGHT: usize = 5;

/// An exact layer, ready to be drawn over a view.
#[derive(Debug, Clone)]
pub(crate) struct ExactOverlay {
    layer: Arc<ExactLayer>,
    channels: Channels,
    /// Width and height of the picture, pixels.
    size: [u32; 2],
}

/// The pixels of the picture under an output pixel along one axis, with the parts of the output pixel that they cover.
#[derive(Debug, Clone, Copy)]
struct Span {
    first: usize,
    count: usize,
    start: f64,
    end: f64,
}

impl Span {
    fn new(view: &View, k: usize, index: u32, side: usize) -> Self {
        let [start, end] = [0.0, 1.0].map(|edge| {
            let at = view.origin[k] + (f64::from(view.offset[k]) + f64::from(index) + edge) * view.step[k];
            at.clamp(0.0, side as f64)
        });
        let first = (start as usize).min(side - 1);
        let after = (end.ceil() as usize).clamp(first + 1, side);
        Span { first, count: after - first, start, end }
    }

    fn pixels(self) -> impl Iterator<Item = (usize, f32)> {
        let length = self.end - self.start;
        (self.first..self.first + self.count).map(move |i| {
            let covered = self.end.min((i + 1) as f64) - self.start.max(i as f64);
            (i, if self.count == 1 { 1.0 } else { (covered / length) as f32 })
        })
    }
}

impl ExactOverlay {
    pub(crate) fn new(layer: Arc<ExactLayer>, channels: Channels, size: [u32; 2]) -> Self {
        ExactOverlay { layer, channels, size }
    }

    /// Tells whether the pixels of `view` are the pixels of the picture.
    fn is_direct(&self, view: &View) -> bool {
        let sides = [view.width, view.height];
        let is_inside = (0..2).all(|k| u64::from(view.offset[k]) + u64::from(sides[k]) <= self.size[k].into());
        view.step == [1.0; 2] && view.origin == [0.0; 2] && is_inside
    }

    /// Returns the pixels of the picture along both axes under the rows `rows` of a view.
    fn area(&self, view: &View, rows: &Range<u32>) -> [Range<usize>; 2] {
        let range = |k: usize, from: u32, to: u32| {
            let side = self.size[k] as usize;
            let last = Span::new(view, k, to - 1, side);
            Span::new(view, k, from, side).first..last.first + last.count
        };
        [range(0, 0, view.width), range(1, rows.start, rows.end)]
    }

    /// Returns the work of drawing the layer over a view, in the units of [`Limits::work`].
    pub(crate) fn work(&self, view: &View) -> u64 {
        /// Work of a sample that is copied or summed.
        const SAMPLE_WORK: u64 = 6;
        let [columns, rows] = self.area(view, &(0..view.height)).map(|range| range.len() as u64);
        let width = columns.max(2 * u64::from(view.width));
        let height = rows.max(2 * u64::from(view.height));
        width.saturating_mul(height).saturating_mul(SAMPLE_WORK * self.channels.count() as u64)
    }

    /// Checks the work and the memory of drawing the layer over a view.
    ///
    /// # Errors
    /// [`Error::LimitExceeded`](crate::Error::LimitExceeded) if they exceed the limits.
    pub(crate) fn check(&self, view: &View, limits: &Limits, budget: &Budget) -> Result<()> {
        Limits::check(Limit::Work, self.work(view), limits.work)?;
        if self.is_direct(view) {
            return Ok(());
        }
        let [columns, _] = self.area(view, &(0..view.height));
        let row = columns.len() * size_of::<[f32; SUMS]>() + view.width as usize * size_of::<Span>();
        budget.check(row as u64 * parallel::threads() as u64)
    }

    /// Returns whether the layer covers all pixels of some rows of a view.
    pub(crate) fn hides(&self, view: &View, rows: &Range<u32>) -> bool {
        let [columns, rows] = self.area(view, rows);
        let side = 1 << self.layer.side;
        let [across, _] = tile_counts(self.size, self.layer.side);
        let is_whole = |tile: &Option<ExactTile>| tile.as_ref().is_some_and(|tile| tile.cells.is_none());
        (rows.start / side..rows.end.div_ceil(side)).all(|y| {
            let row = &self.layer.tiles[y * across..];
            row[columns.start / side..columns.end.div_ceil(side)].iter().all(is_whole)
        })
    }

    /// Draws the layer over the rows `rows` of a view, which `out` contains.
    pub(super) fn draw<T: Sample>(&self, view: &View, rows: Range<u32>, out: &mut [T]) {
        let length = view.width as usize * self.channels.count();
        if self.is_direct(view) {
            parallel::map_chunks(out, length, |i, row| {
                let at = [view.offset[0] as usize, (view.offset[1] + rows.start) as usize + i];
                self.copy(at, row);
            });
            return;
        }
        let spans: Vec<Span> = (0..view.width).map(|i| Span::new(view, 0, i, self.size[0] as usize)).collect();
        parallel::map_chunks(out, length, |j, row| {
            self.mix(&spans, Span::new(view, 1, rows.start + j as u32, self.size[1] as usize), row);
        });
    }

    /// Draws the layer over the rows `rows` of a view, which `out` contains.
    #[cfg(feature = "gpu")]
    pub(crate) fn draw_over(&self, view: &View, rows: Range<u32>, out: SamplesMut<'_>) {
        match out {
            SamplesMut::U8(out) => self.draw(view, rows, out),
            SamplesMut::U16(out) => self.draw(view, rows, out),
        }
    }

    /// Calls `visit` with each stretch of covered pixels in a row of the picture: its first column and its tile, with
    /// the position of its first sample there and the number of its samples.
    fn stretches(&self, y: usize, columns: Range<usize>, mut visit: impl FnMut(usize, &ExactTile, usize, usize)) {
        let side = self.layer.side;
        let [across, _] = tile_counts(self.size, side);
        let count = self.channels.count();
        let mut x = columns.start;
        while x < columns.end {
            let tile = (y >> side) * across + (x >> side);
            let [left, top, width, _] = tile_area(self.size, side, tile);
            let end = (left + width).min(columns.end);
            let Some(tile) = &self.layer.tiles[tile] else {
                x = end;
                continue;
            };
            while x < end {
                let (is_covered, to) = tile.run([x - left, y - top], end - left, width);
                if is_covered {
                    visit(x, tile, ((y - top) * width + x - left) * count, (to + left - x) * count);
                }
                x = to + left;
            }
        }
    }

    /// Copies the covered pixels of a row of the picture, from `x` on.
    fn copy<T: Sample>(&self, [x, y]: [usize; 2], out: &mut [T]) {
        let count = self.channels.count();
        self.stretches(y, x..x + out.len() / count, |from, tile, at, length| {
            T::copy_exact(&tile.samples, at, &mut out[(from - x) * count..][..length]);
        });
    }

    /// Mixes the covered pixels under an output row into it.
    fn mix<T: Sample>(&self, spans: &[Span], down: Span, out: &mut [T]) {
        let (Some(first), Some(last)) = (spans.first(), spans.last()) else { return };
        let (start, end) = (first.first, last.first + last.count);
        let (count, alpha) = (self.channels.count(), self.channels.alpha());
        let mut columns = vec![[0.0f32; SUMS]; end - start];
        for (y, weight) in down.pixels() {
            self.stretches(y, start..end, |x, tile, at, length| {
                for (i, sums) in columns[x - start..][..length / count].iter_mut().enumerate() {
                    let pixel: [f32; 4] =
                        std::array::from_fn(|k| if k < count { value(&tile.samples, at + i * count + k) } else { 0.0 });
                    let share = weight * alpha.map_or(1.0, |alpha| pixel[alpha] + HIDDEN_WEIGHT);
                    for k in 0..count {
                        sums[k] += pixel[k] * if Some(k) == alpha { weight } else { share };
                    }
                    sums[COVERED] += weight;
                    sums[WEIGHT] += share;
                }
            });
        }
        for (span, pixel) in spans.iter().zip(out.chunks_exact_mut(count)) {
            let mut sums = [0.0f32; SUMS];
            for (x, weight) in span.pixels() {
                sums.iter_mut().zip(&columns[x - start]).for_each(|(sum, v)| *sum += v * weight);
            }
            if sums[COVERED] == 0.0 {
                continue;
            }
            let below = (1.0 - sums[COVERED]).max(0.0);
            let opacity = alpha.map_or(1.0, |alpha| pixel[alpha].into() / T::WHITE + HIDDEN_WEIGHT);
            for k in 0..count {
                let other = pixel[k].into() / T::WHITE;
                let v = if Some(k) == alpha {
                    sums[k] + below * other
                } else {
                    (sums[k] + below * opacity * other) / (sums[WEIGHT] + below * opacity)
                };
                pixel[k] = T::floor(v.clamp(0.0, 1.0) * T::WHITE + 0.5);
            }
        }
    }
}

/// Returns a stored sample; 1 is white.
fn value(samples: &Samples, at: usize) -> f32 {
    match samples {
        Samples::U8(v) => f32::from(v[at]) / 255.0,
        Samples::U16(v) => f32::from(v[at]) / 65_535.0,
    }
}
