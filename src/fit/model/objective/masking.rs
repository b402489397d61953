//! Perceptual weights of errors: per pixel, lower where the picture is busy at full, half and quarter size; and per
//! channel.
//!
//! People look at a picture from some distance. SSIMULACRA2 takes most of its score from the luma of the picture at a
//! quarter and an eighth of its size. There, an error `e` in surroundings of variance `σ²` costs about `e² / (2σ² +
//! C₂)`.

use crate::constants::fit;
use crate::fit::model::objective::blur::Cells;
use crate::fit::model::objective::planes::Planes;
use crate::fit::model::placing::sample::halve;
use crate::gaussian::Channels;
use crate::parallel;
use crate::strict_math::quick_powf;

/// Number of sizes that are analysed: full size, half and quarter. They have equal weight.
pub(crate) const SIZES: usize = 3;

/// Mean weight at each size, before normalization to a mean of 1.
pub(crate) type Means = [f64; SIZES];

/// Returns the number of pixels per primitive.
pub(crate) fn pixels_each(target: &Planes, count: usize) -> f32 {
    (target.width as usize * target.height as usize) as f32 / count.max(1) as f32
}

/// Returns [`Planes::amplitude`] for a fit of `count` primitives.
pub(crate) fn amplitudes(target: &Planes, count: usize) -> Vec<f32> {
    normalized(target, &weights(target, pixels_each(target, count), None).0, None)
}

/// Returns [`Planes::channel_amplitude`] for colour channels. Other channels are not weighted.
pub(crate) fn channel_amplitude(channels: Channels) -> [f32; 4] {
    let mut amplitude = [1.0; 4];
    if channels.count() >= 3 {
        amplitude[..3].copy_from_slice(&fit::CHANNEL_WEIGHTS.map(f32::sqrt));
    }
    amplitude
}

/// Returns the amplitudes of a part of a picture, given the pixels per primitive and the mean weights of the whole
/// picture.
pub(crate) fn amplitudes_of_part(target: &Planes, pixels_each: f32, means: &Means) -> Vec<f32> {
    normalized(target, &weights(target, pixels_each, Some(means)).0, Some(SIZES as f32))
}

/// Returns the mean weights of a part of a picture, given the pixels per primitive.
pub(crate) fn means_of_part(target: &Planes, pixels_each: f32) -> Means {
    weights(target, pixels_each, None).1
}

/// Returns weights with a mean of [`SIZES`], and their means before normalization. For a part of a picture, `whole` are
/// the means of the whole picture.
fn weights(target: &Planes, pixels_each: f32, whole: Option<&Means>) -> (Vec<f32>, Means) {
    let (width, height) = (target.width as usize, target.height as usize);
    let power = fit::MASKING_EXPONENT * (pixels_each / fit::MASKING_DENSE_PIXELS).max(1.0).sqrt().recip();
    let mut means = [0.0; SIZES];
    let mut weights = vec![0.0f32; width * height];
    let mut sizes = vec![[width, height]];
    let mut plane = luma(target);
    let mut scratch = Scratch::default();
    for (size, found) in means.iter_mut().enumerate() {
        let [w, h] = sizes[sizes.len() - 1];
        let (mut at_size, mean) = weights_at(&plane, [w, h], power, &mut scratch);
        *found = mean;
        let mean = whole.map_or(mean, |means| means[size]) as f32;
        at_size.iter_mut().for_each(|w| *w /= mean);
        for pair in sizes.windows(2).rev() {
            at_size = upsampled(&at_size, pair[1], pair[0]);
        }
        for (w, v) in weights.iter_mut().zip(at_size) {
            *w += v;
        }
        plane = halve(&plane, w, h);
        sizes.push([w.div_ceil(2), h.div_ceil(2)]);
    }
    (weights, means)
}

/// Returns the luma or grey values, without the padding.
fn luma(target: &Planes) -> Vec<f32> {
    if target.channels.count() < 3 {
        return target.plane(0);
    }
    let width = target.width as usize;
    let mut plane = vec![0.0f32; width * target.height as usize];
    parallel::map_chunks(&mut plane, width, |y, out| {
        let row = target.row(y as u32);
        for (x, o) in out.iter_mut().enumerate() {
            *o = (0..3).map(|k| fit::LUMA_WEIGHTS[k] * row[k * target.stride + x]).sum();
        }
    });
    plane
}

/// Scratch memory of blurs, reused at each size.
#[derive(Default)]
struct Scratch {
    means: Vec<f32>,
    spare: Vec<f32>,
}

/// Returns weights from the variance in a window of a few pixels, and their mean.
fn weights_at(plane: &[f32], [width, height]: [usize; 2], power: f32, scratch: &mut Scratch) -> (Vec<f32>, f64) {
    let soften = |values: Vec<f32>, spare: &mut Vec<f32>| {
        let mut cells = Cells { width, height, each: 1, values };
        cells.blur(spare);
        cells.blur(spare);
        cells.values
    };
    let mut means = std::mem::take(&mut scratch.means);
    means.clear();
    means.extend_from_slice(plane);
    let means = soften(means, &mut scratch.spare);
    let mut weights = soften(plane.iter().map(|v| v * v).collect(), &mut scratch.spare);
    let sums = parallel::map_chunks(&mut weights, width, |y, out| {
        for (w, m) in out.iter_mut().zip(&means[y * width..]) {
            *w = quick_powf(2.0 * (*w - m * m).max(0.0) + fit::VARIANCE_FLOOR, -power);
        }
        out.iter().map(|&w| f64::from(w)).sum::<f64>()
    });
    let mean = sums.iter().sum::<f64>() / weights.len() as f64;
    scratch.means = means;
    (weights, mean)
}

/// Enlarges a plane to twice its size, or one less in either direction, by linear interpolation between pixel centres.
pub(crate) fn upsampled(plane: &[f32], [w, h]: [usize; 2], [width, height]: [usize; 2]) -> Vec<f32> {
    /// Returns the nearer and the farther of two neighbours.
    fn near(i: usize, count: usize) -> [usize; 2] {
        let nearer = i / 2;
        [nearer, if i.is_multiple_of(2) { nearer.saturating_sub(1) } else { (nearer + 1).min(count - 1) }]
    }
    let mut out = vec![0.0f32; width * height];
    parallel::map_chunks(&mut out, width, |y, out| {
        let rows = near(y, h).map(|y| &plane[y * w..][..w]);
        for (x, o) in out.iter_mut().enumerate() {
            let [l, r] = near(x, w);
            let [a, b] = rows.map(|row| 0.75 * row[l] + 0.25 * row[r]);
            *o = 0.75 * a + 0.25 * b;
        }
    });
    out
}

/// Converts one weight per pixel to amplitudes: square roots with a mean square of 1. `mean` replaces the mean of
/// `weights`.
pub(crate) fn normalized(target: &Planes, weights: &[f32], mean: Option<f32>) -> Vec<f32> {
    let (width, height) = (target.width as usize, target.height as usize);
    let own = || {
        let sums = parallel::map(height, |y| weights[y * width..][..width].iter().map(|&w| f64::from(w)).sum::<f64>());
        (sums.iter().sum::<f64>() / (width * height) as f64) as f32
    };
    let mean = mean.unwrap_or_else(own);
    let mut out = vec![0.0; target.stride * height];
    parallel::map_chunks(&mut out, target.stride, |y, out| {
        for (o, w) in out.iter_mut().zip(&weights[y * width..][..width]) {
            *o = (w / mean).clamp(fit::MAX_WEIGHT.recip(), fit::MAX_WEIGHT).sqrt();
        }
    });
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Pixels, Samples};

    fn target(width: u32, height: u32, channels: Channels, value: impl Fn(usize, usize, usize) -> u8) -> Planes {
        let count = channels.count();
        let samples = (0..width as usize * height as usize * count)
            .map(|i| value(i / count % width as usize, i / count / width as usize, i % count))
            .collect();
        Planes::new(&Pixels::new(width, height, channels, Samples::U8(samples)).unwrap())
    }

    fn mean_square(target: &Planes, amplitudes: &[f32], columns: std::ops::Range<usize>) -> f32 {
        let rows = amplitudes.chunks_exact(target.stride);
        let (count, sum) = rows.flat_map(|r| &r[columns.clone()]).fold((0.0, 0.0), |(n, s), a| (n + 1.0, s + a * a));
        sum / count
    }

    #[test]
    fn smooth_areas_have_larger_weights_and_the_mean_is_one() {
        // These waves are too long for the window at full size, but count as busy at quarter size.
        let busy = |x: usize, y: usize| (128.0 + 100.0 * (x as f32 * 0.35).sin() * (y as f32 * 0.35).sin()) as u8;
        let target = target(128, 80, Channels::Rgb, |x, y, _| if x < 64 { 90 } else { busy(x, y) });
        let amplitudes = amplitudes(&target, 400);
        assert_eq!(amplitudes.len(), target.stride * 80);
        let of = |columns| mean_square(&target, &amplitudes, columns);
        assert!((of(0..128) - 1.0).abs() < 1e-3, "{}", of(0..128));
        assert!(of(0..48) > 3.0 * of(80..128), "{} {}", of(0..48), of(80..128));
    }

    #[test]
    fn a_flat_picture_of_any_size_has_equal_weights() {
        for (width, height) in [(1, 1), (2, 3), (7, 1), (13, 9), (33, 20)] {
            for channels in [Channels::Grey, Channels::GreyAlpha, Channels::Rgb, Channels::Rgba] {
                let target = target(width, height, channels, |_, _, k| 40 * k as u8 + 60);
                for row in amplitudes(&target, 1).chunks_exact(target.stride) {
                    assert!(row[..width as usize].iter().all(|a| (a - 1.0).abs() < 1e-4), "{width}x{height} {row:?}");
                }
            }
        }
    }
}
