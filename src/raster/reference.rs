//! The definition of the picture in plain f64 (spec §5.2, §5.3, §11.6): slow and short. All other renderers are tested
//! against it.

use super::view::{Filter, View};
use crate::bitstream::DetailLayer;
use crate::bitstream::detail::levels::tile_area;
use crate::bitstream::splats::PackedSplats;
use crate::detail::tile::{Scratch, TilePlanes, reconstruct};
use crate::gaussian::{Blend, CUTOFF, EPSILON, Gaussian, Gaussians, HIDDEN};
use crate::pixels::Depth;

/// Returns the weight `max(0, exp(−d²/2) − exp(−K²/2))` of `g` at `(x, y)`, pixels.
#[must_use]
pub fn weight(g: &Gaussian, x: f64, y: f64) -> f64 {
    let (sin, cos) = f64::from(g.rotation).sin_cos();
    let (dx, dy) = (x - f64::from(g.mean[0]), y - f64::from(g.mean[1]));
    let u = (dx * cos + dy * sin) / f64::from(g.scale[0]);
    let v = (dy * cos - dx * sin) / f64::from(g.scale[1]);
    let cutoff = f64::from(CUTOFF);
    ((-0.5 * (u * u + v * v)).exp() - (-0.5 * cutoff * cutoff).exp()).max(0.0)
}

/// Returns the weight at `(x, y)` of `g` with `variance` (pixels²) added along x and y, with its integral preserved.
fn widened(g: &Gaussian, variance: [f64; 2], x: f64, y: f64) -> f64 {
    if variance == [0.0; 2] {
        return weight(g, x, y);
    }
    let (sin, cos) = f64::from(g.rotation).sin_cos();
    let (dx, dy) = (x - f64::from(g.mean[0]), y - f64::from(g.mean[1]));
    let [v1, v2] = g.scale.map(|s| f64::from(s).powi(2));
    let (xx, yy) = (v1 * cos * cos + v2 * sin * sin, v1 * sin * sin + v2 * cos * cos);
    let (wide, xy) = (xx + variance[0], (v1 - v2) * sin * cos);
    // The determinant, expanded so that nothing cancels.
    let det = v1 * v2 + variance[0] * yy + variance[1] * xx + variance[0] * variance[1];
    let lean = dy - dx * xy / wide;
    let distance = dx * dx / wide + lean * lean * wide / det;
    let cutoff = f64::from(CUTOFF);
    (v1 * v2 / det).sqrt() * ((-0.5 * distance).exp() - (-0.5 * cutoff * cutoff).exp()).max(0.0)
}

/// Returns the colour of `picture` at `(x, y)` (pixels), not clamped; 1.0 is white. Unused channels have the value of
/// the background.
#[must_use]
pub fn color(picture: &Gaussians, x: f64, y: f64) -> [f64; 4] {
    blend(picture, [0.0; 2], x, y)
}

/// Returns the colour of `picture` at `(x, y)` with `variance` (pixels²) added to the Gaussians' variances along x and
/// y.
fn blend(picture: &Gaussians, variance: [f64; 2], x: f64, y: f64) -> [f64; 4] {
    let background = picture.background.map(f64::from);
    let (mut sum, mut total) = ([0.0; 4], 0.0);
    for g in &picture.list {
        let w = widened(g, variance, x, y);
        total += w;
        for (s, c) in sum.iter_mut().zip(g.color) {
            *s += w * f64::from(c);
        }
    }
    let epsilon = f64::from(EPSILON);
    std::array::from_fn(|k| match picture.blend {
        Blend::Normalized => (sum[k] + epsilon * background[k]) / (total + epsilon),
        Blend::Sum => background[k] + sum[k],
    })
}

/// Returns the code value of a colour value at `depth`: `floor(clamp(v, 0, 1) · max + ½)` (spec §5.4).
#[must_use]
pub fn code(value: f64, depth: Depth) -> u16 {
    (value.clamp(0.0, 1.0) * f64::from(depth.max()) + 0.5).floor() as u16
}

/// Returns the colour values of every pixel of `view`, row by row with interleaved channels, sampled at the pixel
/// centres without a filter. For reduced views, a [`Renderer`](super::Renderer) does not return this but [`filtered`].
#[must_use]
pub fn sample(picture: &Gaussians, view: &View) -> Vec<f64> {
    let mut out = Vec::new();
    for j in 0..view.height() {
        for i in 0..view.width() {
            let [x, y] = view.position(i, j);
            out.extend_from_slice(&color(picture, x, y)[..picture.channels.count()]);
        }
    }
    out
}

/// Returns the colour values of every pixel of `view` with the low-pass filter of [`View::resized`] (spec §5.5), row
/// by row with interleaved channels: means of samples clamped to 0..=1, where colours are weighted by their alpha.
#[must_use]
pub fn filtered(picture: &Gaussians, view: &View) -> Vec<f64> {
    let Filter { parts, variance } = view.filter();
    let fine = view.refined(parts);
    let count = f64::from(parts[0] * parts[1]);
    let (channels, alpha) = (picture.channels.count(), picture.channels.alpha());
    let mut out = Vec::new();
    for j in 0..view.height() {
        for i in 0..view.width() {
            let (mut mean, mut weights) = ([0.0; 4], 0.0);
            for part in 0..parts[0] * parts[1] {
                let [x, y] = fine.position(i * parts[0] + part % parts[0], j * parts[1] + part / parts[0]);
                let values = blend(picture, variance, x, y).map(|v| v.clamp(0.0, 1.0));
                let weight = alpha.map_or(1.0, |k| values[k] + f64::from(HIDDEN));
                weights += weight;
                for (k, (mean, value)) in mean.iter_mut().zip(values).enumerate() {
                    *mean += value * if alpha == Some(k) { 1.0 } else { weight };
                }
            }
            for (k, mean) in mean.iter().enumerate().take(channels) {
                out.push(mean / if alpha == Some(k) { count } else { weights });
            }
        }
    }
    out
}

/// Returns the colour values of every pixel of `view`, with all layers (spec §5.5, §11.6, §12.7).
#[must_use]
pub fn layered(splats: &PackedSplats, view: &View) -> Vec<f64> {
    let mut values = detailed(splats, view);
    let Some(layer) = &splats.exact else { return values };
    let (size, channels) = ([splats.width, splats.height], splats.channels);
    let (count, alpha) = (channels.count(), channels.alpha());
    let hidden = f64::from(HIDDEN);
    // The pixels under an output pixel along an axis, with the parts of it that they fill.
    let boxes = |k: usize, index: u32| -> Vec<(usize, f64)> {
        let side = f64::from(size[k]);
        let edge = |i: u32| (view.origin[k] + f64::from(view.offset[k] + i) * view.step[k]).clamp(0.0, side);
        let (start, end) = (edge(index), edge(index + 1));
        let first = (start as usize).min(size[k] as usize - 1);
        let after = (end.ceil() as usize).clamp(first + 1, size[k] as usize);
        (first..after).map(|i| (i, (end.min(i as f64 + 1.0) - start.max(i as f64)) / (end - start))).collect()
    };
    for (i, below) in values.chunks_exact_mut(count).enumerate() {
        let [columns, rows] = [boxes(0, i as u32 % view.width()), boxes(1, i as u32 / view.width())];
        let (mut sums, mut weights, mut covered) = ([0.0; 4], [0.0; 4], 0.0);
        for (&(y, down), &(x, across)) in rows.iter().flat_map(|row| columns.iter().map(move |column| (row, column))) {
            let Some(pixel) = layer.pixel(size, channels, [x, y]) else { continue };
            covered += down * across;
            for k in 0..count {
                let opacity = alpha.filter(|&alpha| alpha != k).map_or(1.0, |alpha| pixel[alpha] + hidden);
                sums[k] += down * across * opacity * pixel[k];
                weights[k] += down * across * opacity;
            }
        }
        if covered > 0.0 {
            let rest = (1.0 - covered).max(0.0);
            let view: Vec<f64> = below.iter().map(|v| v.clamp(0.0, 1.0)).collect();
            for k in 0..count {
                let opacity = alpha.filter(|&alpha| alpha != k).map_or(1.0, |alpha| view[alpha] + hidden);
                below[k] = (sums[k] + rest * opacity * view[k]) / (weights[k] + rest * opacity);
            }
        }
    }
    values
}

/// Returns the colour values of every pixel of `view` as [`filtered`] does, with the additions of a detail layer (spec
/// §11.6).
#[must_use]
pub fn detailed(splats: &PackedSplats, view: &View) -> Vec<f64> {
    let mut values = filtered(&splats.to_gaussians(), view);
    let Some(layer) = &splats.detail else { return values };
    let (size, channels) = ([splats.width, splats.height], splats.channels.count());
    let added = additions(layer, splats);
    let (columns, rows) = (taps(view, 0, size[0]), taps(view, 1, size[1]));
    let mut out = values.iter_mut();
    for (row, column) in rows.iter().flat_map(|row| columns.iter().map(move |column| (row, column))) {
        for k in 0..channels {
            let mut sum = 0.0;
            for &(y, down) in row {
                for &(x, across) in column {
                    sum += down * across * f64::from(added[(y * size[0] as usize + x) * channels + k]);
                }
            }
            let value = out.next().expect("as many values as samples");
            *value = (value.clamp(0.0, 1.0) + sum / (32.0 * 255.0)).clamp(0.0, 1.0);
        }
    }
    values
}

/// Returns the additions of the layer to the samples of the whole picture, row by row with interleaved channels, in
/// 1/32 of an 8-bit code value.
fn additions(layer: &DetailLayer, splats: &PackedSplats) -> Vec<i16> {
    let (size, channels) = ([splats.width, splats.height], splats.channels.count());
    let mut out = vec![0; size[0] as usize * size[1] as usize * channels];
    let (mut scratch, mut planes) = (Scratch::default(), TilePlanes::default());
    for (i, tile) in layer.tiles.iter().enumerate() {
        let Some(tile) = tile else { continue };
        let [left, top, width, height] = tile_area(size, i);
        reconstruct(tile, (&layer.head, splats.channels, [width, height]), &mut scratch, &mut planes);
        for (y, x) in (0..height).flat_map(|y| (0..width).map(move |x| (y, x))) {
            for k in 0..channels {
                out[((top + y) * size[0] as usize + left + x) * channels + k] = planes.value(k, [x, y]);
            }
        }
    }
    out
}

/// Returns the picture pixels along an axis that contribute to each output pixel, with their weights. The picture has
/// `side` pixels along the axis.
fn taps(view: &View, axis: usize, side: u32) -> Vec<Vec<(usize, f64)>> {
    let (step, last) = (view.step[axis], f64::from(side - 1));
    let length = [view.width, view.height][axis];
    let grid = (0..length).map(|i| f64::from(view.offset[axis]) + f64::from(i));
    let share = |i: f64| {
        let start = view.origin[axis] + i * step;
        if step <= 1.0 {
            let at = (start + 0.5 * step - 0.5).clamp(0.0, last);
            let more = at - at.floor();
            let next = (at as usize + 1).min(last as usize);
            return vec![(at as usize, 1.0 - more), (next, more)];
        }
        let end = start + step;
        let covered = |x: usize| (end.min(x as f64 + 1.0) - start.max(x as f64)).max(0.0);
        (0..side as usize).map(|x| (x, covered(x) / step)).filter(|part| part.1 > 0.0).collect()
    };
    grid.map(share).collect()
}
