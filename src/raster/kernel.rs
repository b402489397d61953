//! The inner loops: they accumulate Gaussians in a strip of eight columns, and convert the strip to code values.
//!
//! A strip is as wide as one AVX register. With its planes next to each other, it is small enough for the first-level
//! cache.
//!
//! Large Gaussians are evaluated at every pixel, too. Interpolating sums of fewer samples would miss the kink at the
//! edge of a support. The kink amounts to several code values where a Gaussian lies alone and its weight is divided by
//! little more than ε.

use super::bins::{TILE_HEIGHT, TILE_WIDTH};
use super::overlay::{Additions, SCALE};
use super::project::{SUPPORT, Splat, Splats};
use super::samples::{Codes, Sample};
use crate::bitstream::detail::levels::SUPER;
use crate::detail::tile::{StripRow, TilePlanes};
use crate::gaussian::{Blend, EPSILON, HIDDEN};
use crate::simd::{LANES, Lanes, Simd, Task};

/// Strips of a tile.
const STRIPS: usize = TILE_WIDTH / LANES;

/// Working memory for rendering one tile at a time.
#[derive(Debug, Default)]
pub(super) struct Scratch {
    /// The splats of a batch.
    batch: Vec<Splat>,
    /// The segments of a batch in each strip that they touch.
    lists: [Vec<Segment>; STRIPS],
    /// Sums of the strips, row by row and plane by plane.
    sums: Vec<Lanes>,
    /// Code values of the tile.
    codes: Codes,
}

/// The part of a tile that a view shows, in pixels of the grid of the tiles, which has [`Drawing::parts`] pixels per
/// output pixel.
#[derive(Debug, Clone)]
pub(super) struct Window {
    /// The tile's corner on the grid.
    pub corner: [f64; 2],
    /// Columns of the tile that are shown.
    pub columns: std::ops::Range<usize>,
    /// Rows of the tile that are shown.
    pub rows: std::ops::Range<usize>,
}

/// Parameters that are the same for all tiles.
#[derive(Debug, Clone, Copy)]
pub(super) struct Drawing<'a> {
    pub splats: &'a Splats,
    pub blend: Blend,
    pub background: [f32; 4],
    pub channels: usize,
    /// Columns and rows that are averaged to a pixel of the output; divisors of [`LANES`].
    pub parts: [usize; 2],
}

/// Storage of the additions to pixels.
#[derive(Debug, Clone, Copy)]
pub(super) enum Source<'a> {
    /// Rows of the view.
    Rows(&'a Additions),
    /// The tile of the detail layer that contains the pixels.
    Tile(&'a TilePlanes),
}

/// Additions of a detail layer to the pixels of a tile.
#[derive(Debug, Clone, Copy)]
pub(super) struct Added<'a> {
    pub source: Source<'a>,
    /// The first row that is shown and the first column of the tile, in the coordinates of the source.
    pub row: usize,
    pub column: usize,
}

/// One tile to render.
pub(super) struct Job<'a, 'b, T> {
    pub scene: Drawing<'a>,
    /// The splats that touch the tile.
    pub members: &'a [u32],
    pub window: Window,
    pub scratch: &'a mut Scratch,
    /// A slice for each row of the output that is shown.
    pub out: &'a mut [&'b mut [T]],
    pub added: Option<Added<'a>>,
}

impl<T: Sample> Task for Job<'_, '_, T> {
    type Output = ();

    /// Renders the tile.
    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        match self.scene.channels {
            1 => draw::<S, T, 1, 2>(simd, self),
            2 => draw::<S, T, 2, 3>(simd, self),
            3 => draw::<S, T, 3, 4>(simd, self),
            _ => draw::<S, T, 4, 5>(simd, self),
        }
    }
}

/// Renders a tile with `C` channels. `P` planes are accumulated: those of the channels, and that of the weights.
/// [`Blend::Sum`] does not divide by the weights; a separate function without their plane would double the code, for a
/// blend that the encoder does not choose.
#[inline(always)]
fn draw<S: Simd, T: Sample, const C: usize, const P: usize>(simd: S, job: Job<'_, '_, T>) {
    let Job { scene, members, window, scratch, out, added } = job;
    let Scratch { batch: near, lists, sums, codes } = scratch;
    let codes = T::codes(codes);
    codes.resize(TILE_HEIGHT * TILE_WIDTH * C, T::default());
    let strips = window.columns.start / LANES..window.columns.end.div_ceil(LANES);
    let rows = window.rows.end;
    let [across, down] = scene.parts;
    let first_row = window.rows.start / down;
    let batches = members.len().div_ceil(MAX_BATCH).max(1);
    // With a single batch, all strips use the sums of one strip in turn, which stay in the first-level cache.
    let kept = if batches == 1 { 1 } else { STRIPS };
    sums.resize(kept * TILE_HEIGHT * P, Lanes([0.0; LANES]));
    // Finishing a strip visits all of its sums and resets them for the next strip.
    let renewed = kept == 1 && window.rows.start == 0;
    let is_divided = scene.blend == Blend::Normalized;
    let mut start = [0.0; P];
    for (k, value) in start.iter_mut().enumerate() {
        let b = if k < C { scene.background[k] } else { 1.0 };
        *value = if is_divided { EPSILON * b } else { b };
    }
    for batch in 0..batches {
        let members = &members[batch * MAX_BATCH..members.len().min((batch + 1) * MAX_BATCH)];
        // The splats are far apart in memory. They are copied together, because the kernel would wait for each of
        // them.
        near.clear();
        near.extend(members.iter().map(|&id| *scene.splats.get(id)));
        prepare(simd, near, window.corner, rows, lists);
        for s in strips.clone() {
            let strip = (s % kept) * TILE_HEIGHT * P;
            let (sums, _) = sums[strip..strip + rows * P].as_chunks_mut::<P>();
            if batch == 0 && !(renewed && s > strips.start) {
                for row in sums.iter_mut() {
                    fill(simd, row, start);
                }
            }
            add::<S, C, P>(simd, &lists[s], sums);
            if batch + 1 == batches {
                let codes = &mut codes[first_row * TILE_WIDTH * C..];
                let shown = &mut sums[window.rows.start..];
                let added = added.map(|a| Added { column: a.column + s * LANES / across, ..a });
                if scene.parts == [1, 1] {
                    finish::<S, T, C, P>(simd, shown, (is_divided, start, added), (codes, s * LANES * C));
                } else {
                    let codes = &mut codes[s * LANES / across * C..];
                    reduce::<S, T, C, P>(simd, shown, (scene.parts, is_divided, start, added), codes);
                }
            }
        }
    }
    let rows = codes.chunks_exact(TILE_WIDTH * C).skip(first_row);
    for (row, out) in rows.zip(out) {
        out.copy_from_slice(&row[window.columns.start / across * C..window.columns.end / across * C]);
    }
}

/// Sets the sums of one row of a strip to `values`.
#[inline(always)]
fn fill<S: Simd, const P: usize>(simd: S, row: &mut [Lanes; P], values: [f32; P]) {
    for (lanes, value) in row.iter_mut().zip(values) {
        simd.store(lanes, simd.splat(value));
    }
}

/// Returns the sums of one row of a strip as colours from 0 to white.
#[inline(always)]
fn shade<S: Simd, T: Sample, const C: usize, const P: usize>(
    simd: S,
    row: &[Lanes; P],
    is_divided: bool,
) -> [S::Vector; C] {
    let white = simd.splat(T::WHITE);
    let scale = if is_divided { simd.div(white, simd.load(&row[C])) } else { white };
    let mut values = [scale; C];
    for (value, sum) in values.iter_mut().zip(row) {
        let v = simd.mul(simd.load(sum), scale);
        *value = simd.min(simd.max(v, simd.splat(0.0)), white);
    }
    values
}

/// Converts the sums of a strip to code values. `codes` are whole rows of the tile, in which the strip's values start
/// at `at`. Resets the sums to `start`.
#[cfg_attr(target_family = "wasm", inline(never))]
#[cfg_attr(not(target_family = "wasm"), inline(always))]
fn finish<S: Simd, T: Sample, const C: usize, const P: usize>(
    simd: S,
    strip: &mut [[Lanes; P]],
    (is_divided, start, added): (bool, [f32; P], Option<Added<'_>>),
    (codes, at): (&mut [T], usize),
) {
    let mut codes = codes.chunks_exact_mut(TILE_WIDTH * C);
    // Rows of a superblock at a time: either all of them have additions, or none.
    let mut rest = strip;
    let mut row = added.map_or(0, |added| added.row);
    while !rest.is_empty() {
        let count = (SUPER - row % SUPER).min(rest.len());
        let (rows, below) = rest.split_at_mut(count);
        let more = added.map_or(More::Nothing, |added| added.rows::<C>(row, count));
        for (i, (sums, codes)) in rows.iter_mut().zip(&mut codes).enumerate() {
            let mut values = shade::<S, T, C, P>(simd, sums, is_divided);
            enrich::<S, T, C>(simd, &mut values, &more, i);
            for value in &mut values {
                *value = simd.add(*value, simd.splat(0.5));
            }
            T::store::<S, C>(simd, &mut codes[at..at + LANES * C], values);
            fill(simd, sums, start);
        }
        (rest, row) = (below, row + count);
    }
}

/// Rows of additions to a strip, eight columns wide.
enum More<'a, const C: usize> {
    Nothing,
    /// Additions to rows of the view, from the strip's column on.
    Rows {
        rows: &'a Additions,
        first: usize,
        column: usize,
    },
    /// Additions of a tile of the detail layer, by channel.
    Tile([&'a [StripRow]; C]),
}

impl<'a> Added<'a> {
    /// Returns the additions to `count` rows of a superblock from `row` on.
    #[inline(always)]
    fn rows<const C: usize>(&self, row: usize, count: usize) -> More<'a, C> {
        let column = self.column;
        match self.source {
            Source::Rows(rows) => More::Rows { rows, first: row, column },
            Source::Tile(planes) if planes.has(column, row) => {
                let mut channels = [&[] as &[StripRow]; C];
                for (c, rows) in channels.iter_mut().enumerate() {
                    *rows = planes.strip(c, [column, row], count);
                }
                More::Tile(channels)
            }
            Source::Tile(_) => More::Nothing,
        }
    }
}

/// Adds row `i` of `more` to a row of a strip.
#[cfg_attr(target_family = "wasm", inline(never))]
#[cfg_attr(not(target_family = "wasm"), inline(always))]
fn enrich<S: Simd, T: Sample, const C: usize>(simd: S, values: &mut [S::Vector; C], more: &More<'_, C>, i: usize) {
    let white = simd.splat(T::WHITE);
    for (c, value) in values.iter_mut().enumerate() {
        let more = match more {
            More::Nothing => return,
            More::Rows { rows, first, column } => simd.read(&rows.row(first + i)[c * rows.stride + column..]),
            More::Tile(channels) => simd.mul(simd.widen(&channels[c][i]), simd.splat(SCALE)),
        };
        let v = simd.add(*value, simd.mul(more, white));
        *value = simd.min(simd.max(v, simd.splat(0.0)), white);
    }
}

/// Averages each `across` columns and `down` rows of a strip to code values, which start at the strip's position in
/// the first row of `codes`. Resets the sums to `start`.
#[cfg_attr(target_family = "wasm", inline(never))]
#[cfg_attr(not(target_family = "wasm"), inline(always))]
fn reduce<S: Simd, T: Sample, const C: usize, const P: usize>(
    simd: S,
    strip: &mut [[Lanes; P]],
    ([across, down], is_divided, start, added): ([usize; 2], bool, [f32; P], Option<Added<'_>>),
    codes: &mut [T],
) {
    for (i, (rows, codes)) in strip.chunks_exact_mut(down).zip(codes.chunks_mut(TILE_WIDTH * C)).enumerate() {
        let added = added.map(|a| Added { row: a.row + i, ..a });
        average::<S, T, C, P>(simd, rows, (across, is_divided, start, added), &mut codes[..LANES / across * C]);
    }
}

/// Averages each `across` columns of all `rows` of a strip to code values, and resets the rows to `start`. Colours are
/// weighted by their alpha, so that colours under alpha 0 do not become visible.
#[inline(always)]
fn average<S: Simd, T: Sample, const C: usize, const P: usize>(
    simd: S,
    rows: &mut [[Lanes; P]],
    (across, is_divided, start, added): (usize, bool, [f32; P], Option<Added<'_>>),
    codes: &mut [T],
) {
    let down = rows.len();
    // Grey and alpha, or three colours and alpha.
    let has_alpha = C == 2 || C == 4;
    let hidden = simd.splat(HIDDEN * T::WHITE);
    let (mut sums, mut weights) = ([simd.splat(0.0); C], simd.splat(0.0));
    for row in rows {
        let mut values = shade::<S, T, C, P>(simd, row, is_divided);
        if has_alpha {
            let weight = simd.add(values[C - 1], hidden);
            weights = simd.add(weights, weight);
            for value in &mut values[..C - 1] {
                *value = simd.mul(*value, weight);
            }
        }
        for (sum, value) in sums.iter_mut().zip(values) {
            *sum = simd.add(*sum, value);
        }
        fill(simd, row, start);
    }
    let mut columns = [Lanes([0.0; LANES]); C];
    for (columns, sum) in columns.iter_mut().zip(sums) {
        simd.store(columns, sum);
    }
    let mut weight_columns = Lanes([0.0; LANES]);
    simd.store(&mut weight_columns, weights);
    // A power of two, so that the mean is as exact as the sum.
    let share = 1.0 / (across * down) as f32;
    means(&columns, has_alpha.then_some(&weight_columns), (across, share, added), codes);
}

/// Converts the sums of each `across` columns, times `share`, to code values. Sums of colours are divided by the sums
/// of `weights`, if there are any.
///
/// In WebAssembly, all numbers of channels share one function, which keeps the module small.
#[cfg_attr(target_family = "wasm", inline(never))]
#[cfg_attr(not(target_family = "wasm"), inline(always))]
fn means<T: Sample>(
    columns: &[Lanes],
    weights: Option<&Lanes>,
    (across, share, added): (usize, f32, Option<Added<'_>>),
    codes: &mut [T],
) {
    for (i, pixel) in codes.chunks_exact_mut(columns.len()).enumerate() {
        // Independent sums in parallel: each addition waits for the previous one of the same sum.
        let (mut sums, mut weight) = ([0.0; 4], 0.0);
        for column in i * across..(i + 1) * across {
            for (sum, lanes) in sums.iter_mut().zip(columns) {
                *sum += lanes.0[column];
            }
            weight += weights.map_or(0.0, |lanes| lanes.0[column]);
        }
        let color_share = weights.map_or(share, |_| 1.0 / weight);
        for (k, (code, sum)) in pixel.iter_mut().zip(sums).enumerate() {
            let share = if weights.is_some() && k == columns.len() - 1 { share } else { color_share };
            let more = match added {
                Some(Added { source: Source::Rows(additions), row, column }) => {
                    additions.row(row)[k * additions.stride + column + i] * T::WHITE
                }
                // Tiles are used only for views at the picture's own size.
                _ => 0.0,
            };
            *code = T::floor((sum * share + more).clamp(0.0, T::WHITE) + 0.5);
        }
    }
}

/// Cuts each member into the segments of the strips that it touches, for the first `rows` rows of the tile at
/// `corner`.
///
/// All segments of a batch are prepared before any is drawn. Preparations overlap in the processor, but not with a
/// loop over rows, whose end the processor must wait for.
///
/// WebAssembly is compiled for one instruction set, and all kernels share one function, which keeps the module small.
#[cfg_attr(target_family = "wasm", inline(never))]
#[cfg_attr(not(target_family = "wasm"), inline(always))]
fn prepare<S: Simd>(simd: S, members: &[Splat], corner: [f64; 2], rows: usize, lists: &mut [Vec<Segment>; STRIPS]) {
    for list in lists.iter_mut() {
        list.clear();
    }
    for splat in members {
        let (x, extent) = (splat.mean[0] - corner[0], splat.extent()[0]);
        // Strips that contain a column whose centre may lie within the extent.
        let first = ((x - extent - 0.5).max(0.0) * (1.0 / LANES as f64)) as i32 as usize;
        let end = ((x + extent + 0.5).clamp(0.0, TILE_WIDTH as f64) * (1.0 / LANES as f64)).ceil() as i32 as usize;
        if first < end {
            cut(simd, splat, corner, rows, first..end, lists);
        }
    }
}

/// Appends the segments of one splat to the lists of the `strips` that it touches. This is one long function, because
/// the search for the rows and the making of a segment in functions of their own took 0.8 % more instructions per
/// decode.
#[inline(always)]
fn cut<S: Simd>(
    simd: S,
    splat: &Splat,
    corner: [f64; 2],
    rows: usize,
    strips: std::ops::Range<usize>,
    lists: &mut [Vec<Segment>; STRIPS],
) {
    let zero = simd.splat(0.0);
    let (pitch, limit) = (simd.splat(splat.pitch()), splat.reach());
    let dx = corner[0] + 0.5 - splat.mean[0];
    let dy = corner[1] + 0.5 - splat.mean[1];
    let u_corner = splat.rise * dy - splat.shear * dx;
    let (rise, shear, run) =
        (simd.splat(splat.rise as f32), simd.splat(splat.shear as f32), simd.splat(splat.run as f32));
    // Change of the ratio of two rows from lane to lane, relative to the middle lane to stay within the range of f32.
    let turn = (2.0 * splat.rise * splat.shear) as f32;
    let middle = simd.splat(0.5 * (LANES - 1) as f32);
    let tilt = simd.exp2(simd.mul(simd.splat(turn), simd.sub(simd.index(), middle)));
    let mut at = strips.start;
    while at < strips.end {
        // Find the rows of the support in eight strips at a time.
        let strip_dx = dx + (at * LANES) as f64;
        let offset = simd.mul(simd.index(), simd.splat(LANES as f32));
        let u0 = simd.sub(simd.splat((u_corner - splat.shear * (at * LANES) as f64) as f32), simd.mul(shear, offset));
        let v0 = simd.add(simd.splat((splat.run * strip_dx) as f32), simd.mul(run, offset));
        let mut edges = [zero; 2];
        for (edge, sign) in edges.iter_mut().zip([-1.0f32, 1.0]) {
            let tip = simd.sub(simd.splat((f64::from(sign) * splat.tip - strip_dx) as f32), offset);
            let lane = simd.min(simd.max(tip, zero), simd.splat((LANES - 1) as f32));
            let v = simd.add(v0, simd.mul(run, lane));
            let half = simd.sqrt(simd.max(simd.sub(simd.splat(SUPPORT as f32), simd.mul(v, v)), zero));
            let u = simd.sub(simd.add(simd.mul(half, simd.splat(sign)), simd.mul(shear, lane)), u0);
            *edge = simd.mul(u, pitch);
        }
        // Rows are clamped to the whole tile, not to the part that is shown, because the bits must not depend on that
        // part.
        let height = simd.splat(TILE_HEIGHT as f32);
        let [low, high] = edges;
        // Computed from the bottom, so that rounding down rounds the first row up.
        let above = simd.floor(simd.sub(height, simd.min(simd.max(low, zero), height)));
        let end = simd.floor(simd.min(simd.max(simd.add(high, simd.splat(1.0)), zero), height));
        let mut u_first = Lanes([0.0; LANES]);
        for k in 0..LANES {
            let first = TILE_HEIGHT as u32 - above[k];
            let column = f64::from(((at + k) * LANES) as u32);
            u_first.0[k] = (u_corner - splat.shear * column + splat.rise * f64::from(first)) as f32;
        }
        let mut ratios = Lanes([0.0; LANES]);
        let central = simd.sub(simd.load(&u_first), simd.mul(shear, middle));
        let slope = simd.add(simd.add(central, central), rise);
        let mut length = Lanes([0.0; LANES]);
        for k in 0..LANES {
            length.0[k] = (end[k] + above[k]) as f32 - TILE_HEIGHT as f32;
        }
        let drift = simd.mul(simd.splat(splat.drift), simd.load(&length));
        simd.store(&mut ratios, simd.exp2(simd.sub(drift, simd.mul(rise, slope))));
        let mut v_first = Lanes([0.0; LANES]);
        simd.store(&mut v_first, v0);
        // Along a row, `u² + v²` is largest at an end of the strip.
        let last = simd.splat((LANES - 1) as f32);
        let (u_last, v_last) =
            (simd.sub(simd.load(&u_first), simd.mul(shear, last)), simd.add(v0, simd.mul(run, last)));
        let left = simd.add(simd.mul(simd.load(&u_first), simd.load(&u_first)), simd.mul(v0, v0));
        let right = simd.add(simd.mul(u_last, u_last), simd.mul(v_last, v_last));
        let mut reach = Lanes([0.0; LANES]);
        simd.store(&mut reach, simd.max(left, right));
        for k in 0..LANES.min(strips.end - at) {
            let (first, end) = ((TILE_HEIGHT as u32 - above[k]) as u8, end[k].min(rows as u32) as u8);
            if first >= end {
                continue;
            }
            let v = simd.add(simd.splat(v_first.0[k]), simd.mul(run, simd.index()));
            let rest = simd.sub(simd.splat(splat.level), simd.mul(v, v));
            let u = simd.sub(simd.splat(u_first.0[k]), simd.mul(shear, simd.index()));
            let walk = if reach.0[k] <= limit { Walk::Recurrence } else { Walk::Direct };
            let Splat { color, edge, .. } = *splat;
            let mut segment = Segment { first, end, walk, color, edge, ..Segment::NONE };
            match walk {
                Walk::Recurrence => {
                    simd.store(&mut segment.value, simd.exp2(simd.sub(rest, simd.mul(u, u))));
                    simd.store(&mut segment.ratio, simd.mul(tilt, simd.splat(ratios.0[k])));
                    segment.bend = splat.bend;
                }
                Walk::Direct => {
                    simd.store(&mut segment.value, u);
                    simd.store(&mut segment.ratio, rest);
                    segment.bend = splat.rise as f32;
                }
            }
            lists[at + k].push(segment);
        }
        at += LANES;
    }
}

/// Maximum number of Gaussians of a tile that are prepared before they are drawn. Tiles seldom have more, and the sums
/// of several batches would not stay in the first-level cache.
const MAX_BATCH: usize = 512;

/// How the kernel evaluates a Gaussian from row to row of a strip.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Walk {
    /// Two multiplications per row.
    Recurrence,
    /// An exponential per row, for Gaussians for which the recurrence would leave the range of f32.
    Direct,
}

/// One Gaussian on the rows of a strip that its support covers.
#[derive(Debug, Clone, Copy)]
struct Segment {
    /// Recurrence: the Gaussian on the first row. Direct: `u` on the first row.
    value: Lanes,
    /// Recurrence: the ratio of the second row to the first. Direct: `level − v²`.
    ratio: Lanes,
    color: [f32; 4],
    /// Recurrence: the ratio of successive ratios. Direct: `rise`.
    bend: f32,
    /// Offset subtracted from the Gaussian to give the weight.
    edge: f32,
    walk: Walk,
    first: u8,
    end: u8,
}

impl Segment {
    const NONE: Segment = Segment {
        value: Lanes([0.0; LANES]),
        ratio: Lanes([0.0; LANES]),
        color: [0.0; 4],
        bend: 0.0,
        edge: 0.0,
        walk: Walk::Direct,
        first: 0,
        end: 0,
    };

    /// Adds the segment to its strip.
    #[inline(always)]
    fn draw<S: Simd, const C: usize, const P: usize>(&self, simd: S, strip: &mut [[Lanes; P]]) {
        let rows = &mut strip[usize::from(self.first)..usize::from(self.end)];
        let mut color = [simd.splat(0.0); C];
        for (color, &value) in color.iter_mut().zip(&self.color) {
            *color = simd.splat(value);
        }
        let (value, mut ratio) = (simd.load(&self.value), simd.load(&self.ratio));
        let edge = simd.splat(self.edge);
        match self.walk {
            Walk::Recurrence => {
                let (mut g, bend) = (value, simd.splat(self.bend));
                for row in rows {
                    deposit::<S, C, P>(simd, row, simd.sub(g, edge), &color);
                    g = simd.mul(g, ratio);
                    ratio = simd.mul(ratio, bend);
                }
            }
            Walk::Direct => {
                for (y, row) in rows.iter_mut().enumerate() {
                    let u = simd.add(value, simd.splat(self.bend * y as f32));
                    let g = simd.exp2(simd.sub(ratio, simd.mul(u, u)));
                    deposit::<S, C, P>(simd, row, simd.sub(g, edge), &color);
                }
            }
        }
    }
}

/// Adds segments to their strip.
///
/// In WebAssembly, this loop is a function of its own, because browsers keep its values in registers only in a small
/// function.
#[cfg_attr(target_family = "wasm", inline(never))]
#[cfg_attr(not(target_family = "wasm"), inline(always))]
fn add<S: Simd, const C: usize, const P: usize>(simd: S, segments: &[Segment], strip: &mut [[Lanes; P]]) {
    for segment in segments {
        segment.draw::<S, C, P>(simd, strip);
    }
}

/// Adds the weights `above` to one row of a strip; negative ones count as 0.
#[inline(always)]
fn deposit<S: Simd, const C: usize, const P: usize>(
    simd: S,
    row: &mut [Lanes; P],
    above: S::Vector,
    color: &[S::Vector; C],
) {
    let w = simd.max(above, simd.splat(0.0));
    for c in 0..C {
        let sum = simd.add(simd.load(&row[c]), simd.mul(w, color[c]));
        simd.store(&mut row[c], sum);
    }
    let weight = simd.add(simd.load(&row[C]), w);
    simd.store(&mut row[C], weight);
}
