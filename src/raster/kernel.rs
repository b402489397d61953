//! The hot loops: Gaussians into a strip of eight columns, and the strip into code values.
//!
//! Plain arrays in loops of fixed length, compiled for each instruction set by `pulp`. No fused multiply-add, so
//! every instruction set gives the same bits. A strip is wide enough for one AVX register and, with its planes
//! side by side, small enough for the first-level cache.

use super::project::{LANES, SUPPORT, Splat, Walk};
use super::samples::Sample;
use crate::gaussian::{Blend, CUTOFF_WEIGHT, EPSILON};

/// Columns of a tile.
pub(super) const TILE_WIDTH: usize = 128;

/// Rows of a tile. The recurrence starts afresh in each, which bounds its drift: 64 rows of f32 rounding in the
/// ratio add up to 64²/2 · 2⁻²⁴ ≈ 1.2·10⁻⁴ of the weight.
pub(super) const TILE_HEIGHT: usize = 64;

/// Strips of a tile.
const STRIPS: usize = TILE_WIDTH / LANES;

type Lanes = [f32; LANES];

/// `2^x` for `−126 ≤ x ≤ 126` within 2·10⁻⁷ of its value; below, `2^−126`.
#[inline(always)]
fn exp2(x: Lanes) -> Lanes {
    // Adding 1.5·2²³ leaves the nearest integer in the low bits.
    const MAGIC: f32 = 12_582_912.0;
    std::array::from_fn(|i| {
        let x = if x[i] > -126.0 { x[i] } else { -126.0 };
        let shifted = x + MAGIC;
        let f = x - (shifted - MAGIC);
        // Minimax over |f| ≤ ½ with 1 and ln 2 kept, so that arguments near 0 are exact.
        let mut p = 1.330_026_5e-3 * f + 9.669_709e-3;
        p = p * f + 5.550_56e-2;
        p = p * f + 2.402_228_1e-1;
        p = p * f + std::f32::consts::LN_2;
        p = p * f + 1.0;
        f32::from_bits((shifted.to_bits() << 23).wrapping_add(p.to_bits()))
    })
}

/// What tiles are drawn with: allocated once a thread.
#[derive(Debug, Default)]
pub(super) struct Scratch<T> {
    /// Members of the tile by strip, and where each strip's start.
    order: Vec<u32>,
    spans: Vec<(u8, u8)>,
    /// Code values of the tile, one plane a channel.
    planes: Vec<T>,
}

/// The part of a tile that a view shows.
#[derive(Debug, Clone)]
pub(super) struct Window {
    /// The tile's corner on the grid, output pixels.
    pub corner: [f64; 2],
    /// Columns of the tile that are shown.
    pub columns: std::ops::Range<usize>,
    /// Rows of the tile that are shown.
    pub rows: std::ops::Range<usize>,
}

/// Everything that is the same for all tiles.
#[derive(Debug, Clone, Copy)]
pub(super) struct Scene<'a> {
    pub splats: &'a [Splat],
    pub blend: Blend,
    pub background: [f32; 4],
    pub channels: usize,
}

/// Draws one tile; `out` has a slice for each shown row.
#[inline(always)]
pub(super) fn draw_tile<T: Sample>(
    scene: &Scene<'_>,
    members: &[u32],
    window: &Window,
    scratch: &mut Scratch<T>,
    out: &mut [&mut [T]],
) {
    match (scene.blend, scene.channels) {
        (Blend::Normalized, 1) => draw::<T, 1, 2>(scene, members, window, scratch, out),
        (Blend::Normalized, 2) => draw::<T, 2, 3>(scene, members, window, scratch, out),
        (Blend::Normalized, 3) => draw::<T, 3, 4>(scene, members, window, scratch, out),
        (Blend::Normalized, _) => draw::<T, 4, 5>(scene, members, window, scratch, out),
        (Blend::Sum, 1) => draw::<T, 1, 1>(scene, members, window, scratch, out),
        (Blend::Sum, 2) => draw::<T, 2, 2>(scene, members, window, scratch, out),
        (Blend::Sum, 3) => draw::<T, 3, 3>(scene, members, window, scratch, out),
        (Blend::Sum, _) => draw::<T, 4, 4>(scene, members, window, scratch, out),
    }
}

/// `C` channels; `P` planes are summed: the channels and, where the blend divides by it, the weight.
#[inline(always)]
fn draw<T: Sample, const C: usize, const P: usize>(
    scene: &Scene<'_>,
    members: &[u32],
    window: &Window,
    scratch: &mut Scratch<T>,
    out: &mut [&mut [T]],
) {
    let Scratch { order, spans, planes } = scratch;
    let starts = sort_by_strip(scene.splats, members, window.corner[0], spans, order);
    planes.resize(C * TILE_HEIGHT * TILE_WIDTH, T::default());
    let mut start = [[0.0; LANES]; P];
    for (k, plane) in start.iter_mut().enumerate() {
        let b = if k < C { scene.background[k] } else { 1.0 };
        *plane = [if P > C { EPSILON * b } else { b }; LANES];
    }
    let height = window.rows.end;
    let mut strip = [[[0.0; LANES]; P]; TILE_HEIGHT];
    for s in window.columns.start / LANES..window.columns.end.div_ceil(LANES) {
        let strip = &mut strip[..height];
        strip.fill(start);
        let corner = [window.corner[0] + (s * LANES) as f64, window.corner[1]];
        for &id in &order[starts[s] as usize..starts[s + 1] as usize] {
            add::<C, P>(strip, &scene.splats[id as usize], corner);
        }
        for (y, row) in strip.iter().enumerate().skip(window.rows.start) {
            let scale: Lanes = if P > C { std::array::from_fn(|i| 1.0 / row[P - 1][i]) } else { [1.0; LANES] };
            for (c, sums) in row.iter().enumerate().take(C) {
                let at = (c * TILE_HEIGHT + y) * TILE_WIDTH + s * LANES;
                let codes: &mut [T; LANES] = (&mut planes[at..at + LANES]).try_into().expect("a strip's width");
                for i in 0..LANES {
                    let v = sums[i] * scale[i];
                    let v = if v > 0.0 { v } else { 0.0 };
                    let v = if v < 1.0 { v } else { 1.0 };
                    codes[i] = T::from_code((v * T::WHITE + 0.5) as i32);
                }
            }
        }
    }
    for (y, row) in window.rows.clone().zip(out) {
        interleave::<T, C>(planes, y, window.columns.clone(), row);
    }
}

/// Sorts `members` by the strips that they touch; returns where each strip's list starts in `order`.
#[inline(always)]
fn sort_by_strip(
    splats: &[Splat],
    members: &[u32],
    corner: f64,
    spans: &mut Vec<(u8, u8)>,
    order: &mut Vec<u32>,
) -> [u32; STRIPS + 1] {
    let mut counts = [0u32; STRIPS + 1];
    spans.clear();
    for &id in members {
        let splat = &splats[id as usize];
        let x = splat.mean[0] - corner - 0.5;
        // Columns whose centres lie within the extent.
        let first = (x - splat.extent[0]).ceil().clamp(0.0, TILE_WIDTH as f64) as usize;
        let end = ((x + splat.extent[0]).floor() + 1.0).clamp(0.0, TILE_WIDTH as f64) as usize;
        let span = if first < end { (first / LANES, (end - 1) / LANES + 1) } else { (0, 0) };
        for count in &mut counts[span.0..span.1] {
            *count += 1;
        }
        spans.push((span.0 as u8, span.1 as u8));
    }
    let mut total = 0;
    for count in &mut counts {
        total += std::mem::replace(count, total);
    }
    let mut next = counts;
    order.clear();
    order.resize(total as usize, 0);
    for (&id, &(first, end)) in members.iter().zip(spans.iter()) {
        for slot in &mut next[usize::from(first)..usize::from(end)] {
            order[*slot as usize] = id;
            *slot += 1;
        }
    }
    counts
}

/// Adds one Gaussian to a strip whose top left corner on the grid is `corner`.
#[inline(always)]
fn add<const C: usize, const P: usize>(strip: &mut [[Lanes; P]], splat: &Splat, corner: [f64; 2]) {
    let dx = corner[0] + 0.5 - splat.mean[0];
    let dy = corner[1] + 0.5 - splat.mean[1];
    let u0 = (splat.rise * dy - splat.shear * dx) as f32;
    let v0 = (splat.run * dx) as f32;
    let (rise, shear, run) = (splat.rise as f32, splat.shear as f32, splat.run as f32);
    // Rows between the support's highest and lowest point over the strip.
    let edge = |lane: f32, sign: f32| {
        let v = v0 + run * lane;
        let rest = SUPPORT as f32 - v * v;
        let u = if rest > 0.0 { rest.sqrt() } else { 0.0 };
        (sign * u - u0 + shear * lane) / rise
    };
    let last_lane = (LANES - 1) as f64;
    let low = edge((-splat.tip - dx).clamp(0.0, last_lane) as f32, -1.0);
    let high = edge((splat.tip - dx).clamp(0.0, last_lane) as f32, 1.0);
    let first = low.ceil().max(0.0) as usize;
    let end = ((high.floor() + 1.0).max(0.0) as usize).min(strip.len());
    if first >= end {
        return;
    }
    let top = u0 + rise * first as f32;
    let mut u = [0.0; LANES];
    let mut v2 = [0.0; LANES];
    for i in 0..LANES {
        u[i] = top - shear * i as f32;
        let v = v0 + run * i as f32;
        v2[i] = v * v;
    }
    let color: [f32; C] = std::array::from_fn(|k| splat.color[k]);
    let exponent = |u: &Lanes| -> Lanes { std::array::from_fn(|i| -(u[i] * u[i] + v2[i])) };
    match splat.walk {
        Walk::Recurrence => {
            let mut g = exp2(exponent(&u));
            let mut ratio = exp2(std::array::from_fn(|i| -(rise * (2.0 * u[i] + rise))));
            let bend = splat.bend;
            for row in &mut strip[first..end] {
                deposit::<C, P>(row, &g, &color);
                for i in 0..LANES {
                    g[i] *= ratio[i];
                    ratio[i] *= bend;
                }
            }
        }
        Walk::Direct => {
            for (y, row) in strip[first..end].iter_mut().enumerate() {
                let down = rise * y as f32;
                let here: Lanes = std::array::from_fn(|i| u[i] + down);
                deposit::<C, P>(row, &exp2(exponent(&here)), &color);
            }
        }
    }
}

/// Adds the weights that belong to Gaussian values `g` to one row of a strip.
#[inline(always)]
fn deposit<const C: usize, const P: usize>(row: &mut [Lanes; P], g: &Lanes, color: &[f32; C]) {
    let mut w = [0.0; LANES];
    for i in 0..LANES {
        let shifted = g[i] - CUTOFF_WEIGHT;
        w[i] = if shifted > 0.0 { shifted } else { 0.0 };
    }
    for c in 0..C {
        for i in 0..LANES {
            row[c][i] += w[i] * color[c];
        }
    }
    if P > C {
        for i in 0..LANES {
            row[C][i] += w[i];
        }
    }
}

/// One row of the planes, channels interleaved.
#[inline(always)]
fn interleave<T: Sample, const C: usize>(planes: &[T], y: usize, columns: std::ops::Range<usize>, out: &mut [T]) {
    let row = |c: usize| &planes[(c * TILE_HEIGHT + y) * TILE_WIDTH..][columns.clone()];
    let rows: [&[T]; C] = std::array::from_fn(row);
    for (x, pixel) in out.chunks_exact_mut(C).enumerate() {
        for c in 0..C {
            pixel[c] = rows[c][x];
        }
    }
}
