//! Computes the additions of the detail layer to the pixels of a view (spec §11.6).
//!
//! At full size, an output pixel gets the additions of the same pixel of the picture, from the tile that is passed to
//! the kernel. An enlarged view interpolates between pixels, and a reduced view averages the pixels that an output
//! pixel covers; both axes are independent. Rows are always summed from the top, whatever the view shows, so that
//! parts of a view have the same bits as the whole.

use std::ops::Range;
use std::sync::{Arc, Mutex, MutexGuard};

use super::bins::TILE_WIDTH;
use super::view::View;
use crate::bitstream::DetailLayer;
use crate::bitstream::detail::levels::{TILE, TileLevels, tile_area, tile_counts};
use crate::budget::Budget;
use crate::detail::supers::Supers;
use crate::detail::tile::{CHANNEL_BYTES, Scratch, TilePlanes, UNIT, reconstruct_some};
use crate::error::Result;
use crate::gaussian::Channels;
use crate::limits::Limits;
use crate::parallel;
use crate::parameter::Limit;
use crate::simd::LANES;

/// A detail layer, ready to be added to a view.
#[derive(Debug)]
pub(crate) struct Overlay {
    layer: Arc<DetailLayer>,
    channels: Channels,
    /// Width and height of the picture, pixels.
    size: [u32; 2],
    /// Memory for reuse. Allocating it from the system each time takes longer than the transforms.
    pool: Mutex<Pool>,
}

/// Reusable working memory.
#[derive(Debug, Default)]
struct Pool {
    scratch: Vec<Scratch>,
    planes: Vec<TilePlanes>,
    values: Vec<Vec<f32>>,
}

/// Additions to some rows of a view; 1 is white.
#[derive(Debug)]
pub(crate) struct Additions {
    /// The first row, in rows of the view.
    pub top: u32,
    /// Samples of a row of one channel.
    pub stride: usize,
    channels: usize,
    values: Vec<f32>,
}

/// Bytes of additions or tiles that are held at a time, unless one row of tiles needs more.
const TARGET_BYTES: u64 = 4 << 20;

/// Bytes that an output row or column needs in addition to its samples: its taps, and its part of the slices.
const LINE_BYTES: u64 = 2 * size_of::<Taps>() as u64;

/// Work of reading and rendering a level of a detail layer, in the units of [`Limits::work`]. A large level takes 110
/// ns, and a unit half a nanosecond with plain instructions.
const LEVEL_WORK: u64 = 200;

/// Samples of rows of tiles that are held at once for resampling, unless one row needs more.
const HELD_SAMPLES: usize = 1 << 16;

/// Value of a tile's unit, where 1 is white.
pub(super) const SCALE: f32 = UNIT / 255.0;

impl Additions {
    /// Returns the row `row`, channel after channel.
    pub(crate) fn row(&self, row: usize) -> &[f32] {
        let length = self.stride * self.channels;
        &self.values[(row - self.top as usize) * length..][..length]
    }

    /// Returns the first `rows` rows, one after the other.
    #[cfg(feature = "gpu")]
    pub(crate) fn first_rows(&self, rows: u32) -> &[f32] {
        &self.values[..rows as usize * self.stride * self.channels]
    }
}

/// The picture pixels that contribute to an output pixel along one axis: `count` pixels from `first` on.
#[derive(Debug, Clone, Copy)]
struct Taps {
    first: usize,
    count: usize,
    /// Weights of the first pixel, of those between, and of the last. If there is only one, its weight is the first.
    weights: [f32; 3],
}

/// Returns the taps of output pixel `index` of a grid with origin `origin` and step `step`, on `side` pixels.
fn taps(origin: f64, step: f64, index: f64, side: usize) -> Taps {
    let last = side - 1;
    if step <= 1.0 {
        // Position between the centres of two pixels.
        let at = (origin + (index + 0.5) * step - 0.5).clamp(0.0, last as f64);
        let first = (at as usize).min(last);
        let share = (at - first as f64) as f32;
        if share == 0.0 || first == last {
            return Taps { first, count: 1, weights: [1.0; 3] };
        }
        return Taps { first, count: 2, weights: [1.0 - share, 0.0, share] };
    }
    let start = (origin + index * step).clamp(0.0, side as f64);
    let end = (origin + (index + 1.0) * step).clamp(start, side as f64);
    let first = (start as usize).min(last);
    let after = (end.ceil() as usize).clamp(first + 1, side);
    let covered = |i: usize| ((end.min((i + 1) as f64) - start.max(i as f64)) / step) as f32;
    Taps { first, count: after - first, weights: [covered(first), (1.0 / step) as f32, covered(after - 1)] }
}

impl Taps {
    fn end(&self) -> usize {
        self.first + self.count
    }

    /// Returns the pixels that lie in `within`, and their weights.
    #[inline(always)]
    fn pixels(&self, within: Range<usize>) -> impl Iterator<Item = (usize, f32)> {
        let [first, middle, last] = self.weights;
        (self.first.max(within.start)..self.end().min(within.end)).map(move |pixel| {
            let weight = match pixel {
                _ if pixel == self.first => first,
                _ if pixel + 1 < self.end() => middle,
                _ => last,
            };
            (pixel, weight)
        })
    }
}

impl Taps {
    /// Returns the weighted sums of the channels of some samples, the first of which is the first pixel.
    #[inline(always)]
    fn sums(&self, samples: &[[f32; 4]]) -> [f32; 4] {
        let mut sums = [0.0; 4];
        let mut add = |samples: &[[f32; 4]], weight: f32| {
            for sample in samples {
                for k in 0..4 {
                    sums[k] += sample[k] * weight;
                }
            }
        };
        let [first, middle, last] = self.weights;
        add(&samples[..1], first);
        if self.count > 1 {
            add(&samples[1..self.count - 1], middle);
            add(&samples[self.count - 1..self.count], last);
        }
        sums
    }
}

impl Overlay {
    pub(crate) fn new(layer: Arc<DetailLayer>, channels: Channels, size: [u32; 2]) -> Self {
        Overlay { layer, channels, size, pool: Mutex::default() }
    }

    /// Tells whether the pixels of `view` are the pixels of the picture, so that tiles are added without resampling.
    pub(crate) fn is_direct(&self, view: &View) -> bool {
        let sides = [view.width, view.height];
        let is_inside = (0..2).all(|k| u64::from(view.offset[k]) + u64::from(sides[k]) <= self.size[k].into());
        view.step == [1.0; 2] && view.origin == [0.0; 2] && is_inside
    }

    /// Returns the number of rows of tiles that are held at once.
    pub(crate) fn tile_rows_at_once(&self, view: &View) -> u32 {
        u32::try_from(TARGET_BYTES / self.tile_row_memory(view)).unwrap_or(u32::MAX).max(1)
    }

    /// Returns the bytes that a row of tiles takes in a direct view, with the slices of the rows to which it is added.
    fn tile_row_memory(&self, view: &View) -> u64 {
        let tiles = (view.offset[0] + view.width).div_ceil(TILE as u32) - view.offset[0] / TILE as u32;
        let slices = TILE / TILE_WIDTH * TILE * size_of::<&[u16]>();
        u64::from(tiles) * (self.channels.count() * CHANNEL_BYTES + slices) as u64
    }

    /// Returns the number of rows, of `stride` samples per channel, for which additions are computed at once.
    pub(crate) fn rows_at_once(&self, stride: usize) -> u32 {
        u32::try_from(TARGET_BYTES / self.row_memory(stride)).unwrap_or(u32::MAX).max(TILE as u32)
    }

    /// Returns the bytes that a row of additions takes, including its taps.
    pub(crate) fn row_memory(&self, stride: usize) -> u64 {
        stride as u64 * self.channels.count() as u64 * size_of::<f32>() as u64 + LINE_BYTES
    }

    /// Returns the best number of rows of a view, from row `first` on and at most `most`, for which additions are
    /// computed at once. If tiles are shown unscaled and more rows follow, the rows end at an edge of tiles, so that
    /// no tile is computed twice.
    #[cfg(feature = "gpu")]
    pub(crate) fn rows_from(&self, view: &View, first: u32, most: u32) -> u32 {
        if most >= view.height - first {
            return most;
        }
        let top = u64::from(view.offset[1]) + u64::from(first);
        let end = (top + u64::from(most)) / TILE as u64 * TILE as u64;
        if self.is_direct(view) && end > top { (end - top) as u32 } else { most }
    }

    /// Returns the work of computing and adding the part of the layer that `view` shows, in the units of
    /// [`Limits::work`].
    ///
    /// # Errors
    /// [`Error::LimitExceeded`](crate::Error::LimitExceeded) if that work alone could exceed the limits.
    pub(crate) fn work(&self, view: &View, limits: &Limits) -> Result<u64> {
        /// Work per sample of a tile: its part of the densest transform.
        const SAMPLE_WORK: u64 = 64;
        let [width, height] = view.area().size().map(|side| (u64::from(side) / TILE as u64 + 2) * TILE as u64);
        let samples = width.saturating_mul(height).saturating_mul(self.channels.count() as u64 * SAMPLE_WORK);
        // Samples and levels are checked separately before they are known to exist, at four and three times their cost.
        Limits::check(Limit::Work, samples, limits.work)?;
        Ok((samples / 4).saturating_add(LEVEL_WORK * self.layer.levels() as u64).saturating_add(self.tap_work(view)))
    }

    /// Returns the work of all resampling taps of `view`. A picture that is enlarged along one axis and reduced along
    /// the other has more taps than pixels or samples.
    fn tap_work(&self, view: &View) -> u64 {
        /// Work per tap, which takes 3 ns.
        const TAP_WORK: u64 = 6;
        if self.is_direct(view) {
            return 0;
        }
        let [width, height] = view.area().size().map(u64::from);
        let taps = width.max(2 * u64::from(view.width)).saturating_mul(height.max(2 * u64::from(view.height)));
        taps.saturating_mul(self.channels.count() as u64 * TAP_WORK)
    }

    /// Checks that the additions to `rows` rows of `view`, of `stride` samples per channel, and their inputs fit into
    /// `budget`.
    pub(crate) fn check(&self, view: &View, stride: usize, rows: u32, budget: &Budget) -> Result<()> {
        if self.is_direct(view) {
            // Rows of tiles that are shown completely or in part.
            let shown = (view.offset[1] + view.height).div_ceil(TILE as u32) - view.offset[1] / TILE as u32;
            let held = u64::from(self.tile_rows_at_once(view).min(shown)) * self.tile_row_memory(view);
            return budget.check(held + size_of::<[i32; TILE * TILE]>() as u64);
        }
        self.check_rows(stride, rows, budget)
    }

    /// Checks that the additions to `rows` rows fit into `budget` if they are computed for whole rows, even if tiles
    /// are shown unscaled.
    pub(crate) fn check_rows(&self, stride: usize, rows: u32, budget: &Budget) -> Result<()> {
        let additions = self.row_memory(stride).saturating_mul(rows.into());
        let [across, _] = tile_counts(self.size);
        // The additions, and what threads need to make them and to weigh their rows.
        let tiles = across as u64 * (self.channels.count() * CHANNEL_BYTES + TILE * TILE * size_of::<i32>()) as u64;
        budget.check(additions.saturating_add(tiles).saturating_add(stride as u64 * LINE_BYTES))
    }

    /// Returns the additions to the rows `rows` of the view, for columns from `left` on. `left` may be negative.
    pub(crate) fn additions(&self, view: &View, left: i64, stride: usize, rows: Range<u32>) -> Additions {
        let channels = self.channels.count();
        let length = stride * channels;
        let mut values = self.pool().values.pop().unwrap_or_default();
        values.clear();
        values.resize(rows.len() * length, 0.0f32);
        let side = self.size.map(|side| side as usize);
        let columns = axis(view, 0, left..left + stride as i64, side[0]);
        let downs = axis(view, 1, rows.start.into()..rows.end.into(), side[1]);
        // The CPU renders such views directly from tiles.
        let is_direct = cfg!(feature = "gpu") && left == 0 && stride == view.width as usize && self.is_direct(view);
        // Tiles that are needed.
        let (across, down) = (tiles_of(&columns), tiles_of(&downs));
        let most = (HELD_SAMPLES / (across.len() * TILE).max(1)).max(1);
        for row in down {
            let planes = self.tile_row(row, across.clone());
            let within = row * TILE..(row + 1) * TILE;
            // Rows to which these tiles contribute; there may be many thousands. Both ends of the taps are in
            // ascending order.
            let first = downs.partition_point(|taps| taps.end() <= within.start);
            let some = first..downs.partition_point(|taps| taps.first < within.end);
            parallel::map_chunks(&mut values[some.start * length..some.end * length], length, |k, out| {
                let down = &downs[some.start + k];
                let mut samples = Vec::new();
                let mut held = 0..0;
                for (y, weight) in down.pixels(within.clone()) {
                    let line = y % TILE;
                    if is_direct {
                        for (c, out) in out.chunks_exact_mut(stride).enumerate() {
                            scale(&planes, (c, line), columns[0].first, out);
                        }
                        continue;
                    }
                    if y >= held.end {
                        held = y..(y + most).min(down.end()).min(within.end);
                        interleave(&planes, line..line + held.len(), channels, &mut samples);
                    }
                    let samples = &samples[(y - held.start) * across.len() * TILE..];
                    for (i, taps) in columns.iter().enumerate() {
                        let sums = taps.sums(&samples[taps.first - across.start * TILE..]);
                        for (c, sum) in sums.iter().enumerate().take(channels) {
                            out[c * stride + i] += sum * (weight * SCALE);
                        }
                    }
                }
            });
            planes.into_iter().flatten().for_each(|planes| self.recycle_planes(planes));
        }
        Additions { top: rows.start, stride, channels, values }
    }

    fn pool(&self) -> MutexGuard<'_, Pool> {
        self.pool.lock().expect("no holder panics")
    }

    /// Returns the planes of a tile to the pool.
    pub(super) fn recycle_planes(&self, planes: TilePlanes) {
        self.pool().planes.push(planes);
    }

    /// Returns additions to the pool.
    pub(crate) fn recycle_additions(&self, additions: Additions) {
        self.pool().values.push(additions.values);
    }

    /// Returns the planes of some tiles of a row of tiles.
    fn tile_row(&self, row: usize, tiles: Range<usize>) -> Vec<Option<TilePlanes>> {
        parallel::map(tiles.len(), |i| self.tile([tiles.start + i, row], Supers::ALL))
    }

    /// Returns the additions of the tile at a column and row, in the superblocks `wanted`; `None` if it has no levels.
    pub(super) fn tile(&self, [column, row]: [usize; 2], wanted: Supers) -> Option<TilePlanes> {
        let index = row * tile_counts(self.size)[0] + column;
        let levels: &TileLevels = self.layer.tiles[index].as_ref()?;
        let [_, _, width, height] = tile_area(self.size, index);
        let (scratch, planes) = {
            let mut pool = self.pool();
            (pool.scratch.pop(), pool.planes.pop())
        };
        let (mut scratch, mut planes) = (scratch.unwrap_or_default(), planes.unwrap_or_default());
        let layer = (&self.layer.head, self.channels, [width, height]);
        reconstruct_some(levels, layer, wanted, &mut scratch, &mut planes);
        self.pool().scratch.push(scratch);
        Some(planes)
    }
}

/// Returns the taps of some output pixels of a view along axis `k`, of a picture with `side` pixels along it. Pixels
/// are counted from the start of the view.
#[inline(never)]
fn axis(view: &View, k: usize, pixels: Range<i64>, side: usize) -> Vec<Taps> {
    pixels.map(|i| taps(view.origin[k], view.step[k], f64::from(view.offset[k]) + i as f64, side)).collect()
}

/// Collects the additions to rows `lines` of a row of tiles, with the channels of a pixel next to each other. Channels
/// that do not exist are 0.
///
/// Strips lie in different pages, and adjacent rows of a strip in one cache line, so the strips are read one by one.
fn interleave(tiles: &[Option<TilePlanes>], lines: Range<usize>, channels: usize, samples: &mut Vec<[f32; 4]>) {
    let width = tiles.len() * TILE;
    samples.clear();
    samples.resize(lines.len() * width, [0.0; 4]);
    for x in (0..width).step_by(LANES) {
        let Some(planes) = &tiles[x / TILE] else { continue };
        for (i, line) in lines.clone().enumerate() {
            let pixels = &mut samples[i * width + x..][..LANES];
            for c in 0..channels.min(4) {
                let values = planes.strip(c, [x % TILE, line], 1)[0];
                for (pixel, value) in pixels.iter_mut().zip(values) {
                    pixel[c] = value.into();
                }
            }
        }
    }
}

/// Copies the additions of a row of tiles at their own size, scaled to parts of white: those of channel `c` in row
/// `line` of each tile, from column `first` of the row's first tile (or of its picture) on.
fn scale(tiles: &[Option<TilePlanes>], (c, line): (usize, usize), first: usize, mut out: &mut [f32]) {
    let mut start = first % TILE;
    for planes in tiles {
        let (part, rest) = out.split_at_mut(out.len().min(TILE - start));
        if let Some(planes) = planes {
            for (out, value) in part.iter_mut().zip(planes.row(c, [start, line])) {
                *out = f32::from(value) * SCALE;
            }
        }
        (start, out) = (0, rest);
    }
}

/// Returns the tiles along an axis to which some taps refer.
fn tiles_of(taps: &[Taps]) -> Range<usize> {
    let start = taps.iter().map(|t| t.first).min().unwrap_or(0);
    let end = taps.iter().map(Taps::end).max().unwrap_or(0);
    start / TILE..end.div_ceil(TILE)
}
