//! What the detail layer adds to the pixels of a view (spec §11.6).
//!
//! At full size an output pixel takes what its own pixel has. An enlarged view interpolates between pixels, a reduced one takes
//! the mean over what a pixel of it covers; either axis by itself. Rows are added up from the top whatever the view shows, so
//! that parts of a view have the bits of the whole.

use std::ops::Range;
use std::sync::{Arc, Mutex, MutexGuard};

use super::view::View;
use crate::bitstream::DetailLayer;
use crate::bitstream::detail::levels::{TILE, tile_area, tile_counts};
use crate::budget::Budget;
use crate::detail::tile::{Scratch, TilePlanes, UNIT, reconstruct};
use crate::error::Result;
use crate::gaussian::Channels;
use crate::parallel;

/// A detail layer, ready to be added to a view.
#[derive(Debug)]
pub(crate) struct Overlay {
    layer: Arc<DetailLayer>,
    channels: Channels,
    /// Width and height of the picture, pixels.
    size: [u32; 2],
    /// Memory that was used before: asking the system for it anew takes longer than the transforms.
    pool: Mutex<Pool>,
}

/// Memory to work in.
#[derive(Debug, Default)]
struct Pool {
    scratch: Vec<Scratch>,
    planes: Vec<TilePlanes>,
    values: Vec<Vec<f32>>,
}

/// What some rows of a view get added, in parts of white.
#[derive(Debug)]
pub(super) struct Additions {
    /// The first row, counted in the view.
    pub top: u32,
    /// Samples of a row of one channel.
    pub stride: usize,
    channels: usize,
    values: Vec<f32>,
}

/// Bytes of additions that are held at a time, if a row of tiles does not need more.
const HELD: u64 = 4 << 20;

impl Additions {
    /// The row `row` of the view, channel after channel.
    pub fn row(&self, row: u32) -> &[f32] {
        let length = self.stride * self.channels;
        &self.values[(row - self.top) as usize * length..][..length]
    }
}

/// What an output pixel takes along one axis: the first pixel, and what it and those behind it count.
#[derive(Debug, Clone, Default)]
struct Taps {
    first: usize,
    weights: Vec<f32>,
}

/// The taps of output pixel `index` of a grid that begins at `origin` with steps of `step`, on `side` pixels.
fn taps(origin: f64, step: f64, index: f64, side: usize) -> Taps {
    let last = side - 1;
    if step <= 1.0 {
        // Between the centres of two pixels.
        let at = (origin + (index + 0.5) * step - 0.5).clamp(0.0, last as f64);
        let first = (at as usize).min(last);
        let share = (at - first as f64) as f32;
        let weights = if share == 0.0 || first == last { vec![1.0] } else { vec![1.0 - share, share] };
        return Taps { first, weights };
    }
    let start = (origin + index * step).clamp(0.0, side as f64);
    let end = (origin + (index + 1.0) * step).clamp(start, side as f64);
    let first = (start as usize).min(last);
    let end_pixel = (end.ceil() as usize).clamp(first + 1, side);
    let covered = |i: usize| ((end.min((i + 1) as f64) - start.max(i as f64)) / step) as f32;
    Taps { first, weights: (first..end_pixel).map(covered).collect() }
}

impl Overlay {
    pub fn new(layer: Arc<DetailLayer>, channels: Channels, size: [u32; 2]) -> Self {
        Overlay { layer, channels, size, pool: Mutex::default() }
    }

    /// Rows of a view, in bands of at most so many, for which additions are made at once.
    pub fn rows_at_once(&self, view: &View) -> u32 {
        let row = u64::from(view.width) * self.channels.count() as u64 * size_of::<f32>() as u64;
        u32::try_from(HELD / row.max(1)).unwrap_or(u32::MAX).max(TILE as u32)
    }

    /// What it costs to make the tiles that `view` shows, in the units of [`Limits::work`](crate::Limits::work).
    pub fn work(&self, view: &View) -> u64 {
        /// For each sample of a tile: its share of the densest transform.
        const SAMPLE_WORK: u64 = 64;
        let [_, _, width, height] = view.area().map(|side| (u64::from(side) / TILE as u64 + 2) * TILE as u64);
        width.saturating_mul(height).saturating_mul(self.channels.count() as u64 * SAMPLE_WORK)
    }

    /// Checks that additions for `rows` rows of `view`, and what they are made from, can be held.
    pub fn check(&self, view: &View, rows: u32, budget: &Budget) -> Result<()> {
        let channels = self.channels.count() as u64;
        let additions = u64::from(view.width) * u64::from(rows) * channels * size_of::<f32>() as u64;
        let [across, _] = tile_counts(self.size);
        let tiles = across as u64 * (TILE * TILE) as u64 * (channels * 2 + 4);
        budget.check(additions.saturating_add(tiles))
    }

    /// What `rows` of the view get added, for columns from `left` of the view on (which may lie before its first one).
    pub(super) fn additions(&self, view: &View, left: i64, stride: usize, rows: Range<u32>) -> Additions {
        let channels = self.channels.count();
        let length = stride * channels;
        let mut values = self.pool().values.pop().unwrap_or_default();
        values.clear();
        values.resize(rows.len() * length, 0.0f32);
        let side = self.size.map(|side| side as usize);
        let grid = |k: usize, i: i64| f64::from(view.offset[k]) + i as f64;
        let is_exact = view.step == [1.0; 2] && view.origin.iter().all(|origin| origin.fract() == 0.0);
        let columns: Vec<Taps> = if is_exact {
            Vec::new()
        } else {
            let tap = |x: usize| taps(view.origin[0], view.step[0], grid(0, left + x as i64), side[0]);
            (0..stride).map(tap).collect()
        };
        let downs: Vec<Taps> =
            rows.clone().map(|y| taps(view.origin[1], view.step[1], grid(1, i64::from(y)), side[1])).collect();
        let Some(first) = downs.iter().map(|t| t.first).min() else {
            return Additions { top: rows.start, stride, channels, values };
        };
        let end = downs.iter().map(|t| t.first + t.weights.len()).max().expect("a row");
        // Pixels of the picture that are needed.
        let across = match is_exact {
            true => {
                let start = view.origin[0] as i64 + i64::from(view.offset[0]) + left;
                start.clamp(0, side[0] as i64 - 1) as usize..(start + stride as i64).clamp(1, side[0] as i64) as usize
            }
            false => {
                let start = columns.iter().map(|t| t.first).min().unwrap_or(0);
                start..columns.iter().map(|t| t.first + t.weights.len()).max().unwrap_or(1)
            }
        };
        let counts = tile_counts(self.size);
        let tiles = across.start / TILE..across.end.div_ceil(TILE).min(counts[0]);
        for row in first / TILE..end.div_ceil(TILE).min(counts[1]) {
            let planes = self.tile_row(row, tiles.clone());
            if planes.iter().all(Option::is_none) {
                self.keep(planes);
                continue;
            }
            let scale = UNIT / 255.0;
            let within = row * TILE..(row + 1) * TILE;
            parallel::map_chunks(&mut values, length, |k, out| {
                let down = &downs[k];
                for (y, &weight) in (down.first..).zip(&down.weights).filter(|(y, _)| within.contains(y)) {
                    let inside = y - within.start;
                    for c in 0..channels {
                        let out = &mut out[c * stride..(c + 1) * stride];
                        let line = |tile: usize| {
                            planes[tile - tiles.start].as_ref().map(|p| &p.channels[c][inside * TILE..][..TILE])
                        };
                        if is_exact {
                            let origin = view.origin[0] as i64 + i64::from(view.offset[0]) + left;
                            for tile in tiles.clone() {
                                let Some(line) = line(tile) else { continue };
                                let from = (tile * TILE).max(across.start);
                                let to = ((tile + 1) * TILE).min(across.end);
                                let out = &mut out[(from as i64 - origin) as usize..][..to - from];
                                for (out, &v) in out.iter_mut().zip(&line[from - tile * TILE..]) {
                                    *out = f32::from(v) * scale;
                                }
                            }
                            continue;
                        }
                        for (out, taps) in out.iter_mut().zip(&columns) {
                            let mut sum = 0.0;
                            for (x, &share) in (taps.first..).zip(&taps.weights) {
                                if let Some(line) = line(x / TILE) {
                                    sum += f32::from(line[x % TILE]) * share;
                                }
                            }
                            *out += sum * (weight * scale);
                        }
                    }
                }
            });
            self.keep(planes);
        }
        Additions { top: rows.start, stride, channels, values }
    }

    fn pool(&self) -> MutexGuard<'_, Pool> {
        self.pool.lock().expect("no holder panics")
    }

    /// Takes back the planes of tiles.
    fn keep(&self, planes: Vec<Option<TilePlanes>>) {
        self.pool().planes.extend(planes.into_iter().flatten());
    }

    /// Takes back additions that were made.
    pub(super) fn used(&self, additions: Additions) {
        self.pool().values.push(additions.values);
    }

    /// The planes of some tiles of a row of tiles.
    fn tile_row(&self, row: usize, tiles: Range<usize>) -> Vec<Option<TilePlanes>> {
        let [across, _] = tile_counts(self.size);
        parallel::map(tiles.len(), |i| {
            let index = row * across + tiles.start + i;
            let levels = self.layer.tiles[index].as_ref()?;
            let [_, _, width, height] = tile_area(self.size, index);
            let (scratch, planes) = {
                let mut pool = self.pool();
                (pool.scratch.pop(), pool.planes.pop())
            };
            let (mut scratch, mut planes) = (scratch.unwrap_or_default(), planes.unwrap_or_default());
            reconstruct(levels, (&self.layer.head, self.channels, [width, height]), &mut scratch, &mut planes);
            self.pool().scratch.push(scratch);
            Some(planes)
        })
    }
}
