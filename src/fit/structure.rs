//! Structural similarity for the fit: weights that make the squared error favour it, and its own gradient.

use crate::fit::field::{Field, Scene};
use crate::fit::sample::blur;
use crate::fit::target::Target;
use crate::gaussian::{Blend, EPSILON};
use crate::parallel;

/// What is added to twice the variance: above SSIM's own `C₂` of 0.0009, so that smooth areas do not take everything.
const FLOOR: f32 = 0.005;
/// Power of the inverse where primitives are dense: 1 would be SSIM's own slope, and would cost more decibels than
/// [`Tune::Ssim`] may.
///
/// [`Tune::Ssim`]: crate::options::Tune::Ssim
const POWER: f32 = 0.5;
/// Pixels per primitive from which on the power falls with their square root: large primitives have little to do with
/// a variance over a few pixels, and the same power costs more decibels the fewer they are.
const DENSE: f32 = 160.0;
/// Largest weight, and the inverse of the smallest.
const MOST: f32 = 20.0;

/// Amplitudes for [`Target::amplitude`]: errors count more where the picture varies little, as they do in SSIM, whose
/// contrast term falls by about `e² / (2σ² + C₂)` for an error `e` over a local variance `σ²`; for `count` primitives.
pub(crate) fn amplitudes(target: &Target, count: usize) -> Vec<f32> {
    let colors = target.channels.count() - usize::from(target.channels.alpha().is_some());
    let (width, height) = (target.width as usize, target.height as usize);
    let sparse = (width * height) as f32 / count.max(1) as f32 / DENSE;
    let power = POWER * sparse.max(1.0).sqrt().recip();
    let mut weights = vec![0.0f32; width * height];
    for k in 0..colors {
        let mut plane = target.plane(k);
        let soften = |p: &[f32]| blur(&blur(p, width, height), width, height);
        let means = soften(&plane);
        for v in &mut plane {
            *v *= *v;
        }
        let squares = soften(&plane);
        for (w, (m, s)) in weights.iter_mut().zip(means.iter().zip(&squares)) {
            *w += (2.0 * (s - m * m).max(0.0) + FLOOR).powf(-power);
        }
    }
    let sums = parallel::map(height, |y| weights[y * width..][..width].iter().map(|&w| f64::from(w)).sum::<f64>());
    let mean = (sums.iter().sum::<f64>() / (width * height) as f64) as f32;
    let mut out = vec![0.0; target.stride * height];
    parallel::map_chunks(&mut out, target.stride, |y, out| {
        for (o, w) in out.iter_mut().zip(&weights[y * width..][..width]) {
            *o = (w / mean).clamp(MOST.recip(), MOST).sqrt();
        }
    });
    out
}

/// Taps of SSIM's window.
const TAPS: usize = 11;
/// Standard deviation of the window, pixels.
const SIGMA: f32 = 1.5;
/// Keeps the luminance term finite: `K₁²`.
const C1: f32 = 0.0001;
/// Keeps the contrast term finite: `K₂²`.
const C2: f32 = 0.0009;

/// Absolute error and SSIM together: `a · Σ|e| + (1 − a) · Σ(1 − SSIM)` over all samples.
#[derive(Debug)]
pub(crate) struct Loss {
    absolute: f32,
    window: [f32; TAPS],
    /// Windowed means of each channel of the target; they stay the same all along.
    means: Vec<Vec<f32>>,
}

impl Loss {
    /// `absolute`: the share of the absolute error, `0..=1`.
    pub(crate) fn new(target: &Target, absolute: f32) -> Self {
        let raw: [f32; TAPS] = std::array::from_fn(|i| (-(i as f32 - 5.0).powi(2) / (2.0 * SIGMA * SIGMA)).exp());
        let sum: f32 = raw.iter().sum();
        let window = raw.map(|v| v / sum);
        let means =
            (0..target.channels.count()).map(|k| windowed(&window, &target.plane(k), target.width as usize)).collect();
        Loss { absolute, window, means }
    }

    /// Turns the picture of all rows in `field` ([`Output::Picture`]) into the gradient, as [`Output::Gradient`] leaves
    /// it. Where the picture is outside `0..=1` the gradient is 0, as it is behind a clamp.
    ///
    /// [`Output::Picture`]: crate::fit::field::Output::Picture
    /// [`Output::Gradient`]: crate::fit::field::Output::Gradient
    pub(crate) fn gradient(&self, scene: &Scene, target: &Target, field: &mut Field) {
        let (channels, stride, width) = (target.channels.count(), field.stride, scene.width as usize);
        let size = (channels + 1) * stride;
        let slopes: Vec<Vec<f32>> = (0..channels)
            .map(|k| {
                let mut picture = vec![0.0f32; width * scene.height as usize];
                parallel::map_chunks(&mut picture, width, |y, out| {
                    for (o, v) in out.iter_mut().zip(&field.planes[y * size + k * stride..]) {
                        *o = v.clamp(0.0, 1.0);
                    }
                });
                self.similarity_slope(&picture, &target.plane(k), &self.means[k], width)
            })
            .collect();
        parallel::map_chunks(&mut field.planes, size, |y, row| {
            let (colors, weights) = row.split_at_mut(channels * stride);
            let truth = target.row(y as u32);
            for (x, weight) in weights.iter_mut().enumerate().take(width) {
                let inverse = match scene.blend {
                    Blend::Normalized => 1.0 / (*weight + EPSILON),
                    Blend::Sum => 1.0,
                };
                let mut h = 0.0;
                for k in 0..channels {
                    let (v, t) = (colors[k * stride + x], truth[k * stride + x]);
                    let opacity = target.channels.alpha().filter(|&a| a != k).map_or(1.0, |a| truth[a * stride + x]);
                    let sign = if v == t { 0.0 } else { (v - t).signum() };
                    let slope = self.absolute * sign - (1.0 - self.absolute) * slopes[k][y * width + x];
                    let g = if (0.0..=1.0).contains(&v) { slope * opacity * inverse } else { 0.0 };
                    colors[k * stride + x] = g;
                    h += g * v;
                }
                *weight = if scene.blend == Blend::Normalized { h } else { 0.0 };
            }
            // Runs may overhang the row's end: what lies there must not count.
            for plane in row.chunks_exact_mut(stride) {
                plane[width..].fill(0.0);
            }
        });
    }

    /// The gradient of the sum of SSIM over the pixels of one channel with respect to `picture`. Outside, both pictures
    /// are 0, so that every pixel has a window.
    fn similarity_slope(&self, picture: &[f32], truth: &[f32], truth_means: &[f32], width: usize) -> Vec<f32> {
        let blend = |f: fn(f32, f32) -> f32| {
            let mut out = vec![0.0; picture.len()];
            parallel::map_chunks(&mut out, width, |y, out| {
                let pairs = picture[y * width..].iter().zip(&truth[y * width..]);
                for (o, (a, b)) in out.iter_mut().zip(pairs) {
                    *o = f(*a, *b);
                }
            });
            windowed(&self.window, &out, width)
        };
        let means = windowed(&self.window, picture, width);
        let squares = blend(|a, b| a * a + b * b);
        let products = blend(|a, b| a * b);
        // Slopes with respect to the windowed mean, mean square and mean product.
        let [mut by_mean, mut by_square, mut by_product] = [(); 3].map(|()| vec![0.0f32; picture.len()]);
        let slopes = |y: usize, x: usize| {
            let i = y * width + x;
            let (a, b) = (means[i], truth_means[i]);
            let (l2, s2) = (a * a + b * b + C1, squares[i] - a * a - b * b + C2);
            let (light, contrast) = ((2.0 * a * b + C1) / l2, (2.0 * (products[i] - a * b) + C2) / s2);
            let (square, product) = (-light * contrast / s2, 2.0 * light / s2);
            [2.0 * contrast * (b - light * a) / l2 - product * b - 2.0 * square * a, square, product]
        };
        parallel::map_chunk_pairs((&mut by_mean, width), (&mut by_square, width), |y, by_mean, by_square| {
            for (x, (m, s)) in by_mean.iter_mut().zip(by_square).enumerate() {
                [*m, *s, _] = slopes(y, x);
            }
        });
        parallel::map_chunks(&mut by_product, width, |y, out| {
            for (x, o) in out.iter_mut().enumerate() {
                *o = slopes(y, x)[2];
            }
        });
        let [mut out, by_square, by_product] =
            [by_mean, by_square, by_product].map(|plane| windowed(&self.window, &plane, width));
        parallel::map_chunks(&mut out, width, |y, out| {
            for (x, o) in out.iter_mut().enumerate() {
                let i = y * width + x;
                *o += 2.0 * picture[i] * by_square[i] + truth[i] * by_product[i];
            }
        });
        out
    }
}

/// The window over every pixel of a plane; outside, the plane is 0.
fn windowed(window: &[f32; TAPS], plane: &[f32], width: usize) -> Vec<f32> {
    const REACH: usize = TAPS / 2;
    let height = plane.len() / width;
    let mut across = vec![0.0f32; plane.len()];
    parallel::map_chunks(&mut across, width, |y, out| {
        let mut padded = vec![0.0f32; width + 2 * REACH];
        padded[REACH..REACH + width].copy_from_slice(&plane[y * width..][..width]);
        for (k, &w) in window.iter().enumerate() {
            for (o, v) in out.iter_mut().zip(&padded[k..]) {
                *o += w * v;
            }
        }
    });
    let mut out = vec![0.0f32; plane.len()];
    parallel::map_chunks(&mut out, width, |y, out| {
        for (k, &w) in window.iter().enumerate() {
            let Some(source) = (y + k).checked_sub(REACH).filter(|&s| s < height) else { continue };
            for (o, v) in out.iter_mut().zip(&across[source * width..]) {
                *o += w * v;
            }
        }
    });
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Channels, Pixels, Samples};

    #[test]
    fn smooth_areas_weigh_more_and_the_mean_weight_is_one() {
        let samples = (0..64 * 40usize).map(|i| if i % 64 < 32 { 90 } else { (i * 7919 % 251) as u8 }).collect();
        let target = Target::new(&Pixels::new(64, 40, Channels::Grey, Samples::U8(samples)).unwrap());
        let amplitudes = amplitudes(&target, 50);
        assert_eq!(amplitudes.len(), target.stride * 40);
        let rows = amplitudes.chunks_exact(target.stride);
        let mean = rows.clone().flat_map(|r| &r[..64]).map(|a| a * a).sum::<f32>() / (64.0 * 40.0);
        assert!((mean - 1.0).abs() < 1e-4, "{mean}");
        for row in rows {
            assert!(row[10] > 2.0 * row[50], "{} {}", row[10], row[50]);
        }
    }

    #[test]
    fn the_slope_of_similarity_is_the_one_that_differences_find() {
        let (width, height) = (17, 14);
        let noise = |seed: usize| -> Vec<f32> {
            (0..width * height).map(|i| ((i * 7919 + seed * 104_729) % 251) as f32 / 251.0).collect()
        };
        let (mut picture, truth) = (noise(1), noise(2));
        let samples = truth.iter().map(|v| (v * 65535.0) as u16).collect();
        let target = Target::new(&Pixels::new(17, 14, Channels::Grey, Samples::U16(samples)).unwrap());
        let truth = target.plane(0);
        let loss = Loss::new(&target, 0.5);
        let slope = loss.similarity_slope(&picture, &truth, &loss.means[0], width);
        // SSIM by its definition, one window at a time, in f64.
        let similarity = |picture: &[f32]| -> f64 {
            let mut sum = 0.0;
            for i in 0..width * height {
                let [mut a, mut b, mut aa, mut bb, mut ab] = [0.0f64; 5];
                for j in 0..TAPS * TAPS {
                    let (x, y) = ((i % width + j % TAPS).wrapping_sub(5), (i / width + j / TAPS).wrapping_sub(5));
                    if x < width && y < height {
                        let w = f64::from(loss.window[j % TAPS] * loss.window[j / TAPS]);
                        let (p, t) = (f64::from(picture[y * width + x]), f64::from(truth[y * width + x]));
                        (a, b, aa, bb, ab) = (a + w * p, b + w * t, aa + w * p * p, bb + w * t * t, ab + w * p * t);
                    }
                }
                sum += (2.0 * a * b + 1e-4) * (2.0 * (ab - a * b) + 9e-4)
                    / ((a * a + b * b + 1e-4) * (aa + bb - a * a - b * b + 9e-4));
            }
            sum
        };
        for i in [0, 5, 20, 100, 136, 237] {
            let middle = picture[i];
            picture[i] = middle + 0.01;
            let above = similarity(&picture);
            picture[i] = middle - 0.01;
            let difference = (above - similarity(&picture)) / 0.02;
            picture[i] = middle;
            assert!(
                (f64::from(slope[i]) - difference).abs() < 0.01 * (1.0 + difference.abs()),
                "{i}: {} {difference}",
                slope[i]
            );
        }
    }
}
