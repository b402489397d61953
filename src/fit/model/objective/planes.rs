//! The target of a fit as padded planes of floats.

use std::sync::Arc;

use crate::gaussian::Channels;
use crate::options::HiddenColors;
use crate::parallel;
use crate::pixels::Pixels;
use crate::simd::LANES;
use crate::weighting::{self, RowWeights};

/// Rows of `channels` planes. Each plane's row has `stride` floats: `width` samples, then zeros.
#[derive(Debug, Clone)]
pub struct Planes {
    pub width: u32,
    pub height: u32,
    pub channels: Channels,
    pub stride: usize,
    planes: Arc<Vec<f32>>,
    /// Square root of the weight of each pixel's squared error, `stride` floats per row. Empty if all weights are 1.
    pub amplitude: Vec<f32>,
    /// Square root of the weight of squared errors in each channel.
    pub channel_amplitude: [f32; 4],
    /// Channel that weights the errors of colours: alpha, unless hidden colours are kept.
    pub opacity: Option<usize>,
    /// Mean colour. Colours are weighted by the channel [`opacity`](Planes::opacity).
    pub mean: [f32; 4],
}

/// Returns the length of a plane's row. A strip may start at the last pixel.
pub fn stride(width: u32) -> usize {
    (width as usize).next_multiple_of(LANES) + LANES
}

impl Planes {
    /// Returns the planes of `pixels`, with colours weighted by alpha.
    pub fn new(pixels: &Pixels) -> Self {
        Planes::weighted_by(pixels, pixels.channels().alpha())
    }

    /// Returns the planes of `pixels`. `hidden` determines whether colours under alpha 0 count.
    pub fn with_hidden(pixels: &Pixels, hidden: HiddenColors) -> Self {
        Planes::weighted_by(pixels, weighting::opacity_channel(pixels.channels(), hidden))
    }

    fn weighted_by(pixels: &Pixels, opacity: Option<usize>) -> Self {
        let (width, height, channels) = (pixels.width(), pixels.height(), pixels.channels());
        let (count, stride, w) = (channels.count(), stride(width), width as usize);
        let mut planes = vec![0.0f32; height as usize * count * stride];
        let sums = parallel::map_chunks(&mut planes, count * stride, |y, row| {
            let mut sum = [0.0f64; 5];
            for x in 0..w {
                let first = (y * w + x) * count;
                let weight = opacity.map_or(1.0, |a| f64::from(pixels.value(first + a)));
                for k in 0..count {
                    let v = pixels.value(first + k);
                    row[k * stride + x] = v;
                    sum[k] += f64::from(v) * if opacity == Some(k) { 1.0 } else { weight };
                }
                sum[4] += weight;
            }
            sum
        });
        let mut sum = [0.0f64; 5];
        for s in &sums {
            for k in 0..5 {
                sum[k] += s[k];
            }
        }
        let area = f64::from(width) * f64::from(height);
        let mean = std::array::from_fn(|k| {
            let weight = if opacity == Some(k) { area } else { sum[4] };
            if weight > 0.0 { (sum[k] / weight) as f32 } else { 0.0 }
        });
        let planes = Arc::new(planes);
        Planes {
            width,
            height,
            channels,
            stride,
            planes,
            amplitude: Vec::new(),
            channel_amplitude: [1.0; 4],
            opacity,
            mean,
        }
    }

    /// Returns the planes of row `y`.
    #[inline(always)]
    pub fn row(&self, y: u32) -> &[f32] {
        let size = self.channels.count() * self.stride;
        &self.planes[y as usize * size..][..size]
    }

    /// Returns channel `k` without the padding.
    pub fn plane(&self, k: usize) -> Vec<f32> {
        let width = self.width as usize;
        let mut plane = vec![0.0f32; width * self.height as usize];
        parallel::map_chunks(&mut plane, width, |y, out| {
            out.copy_from_slice(&self.row(y as u32)[k * self.stride..][..width]);
        });
        plane
    }

    /// Returns the picture at half its size: means of 2 × 2 pixels, with repeated borders. Colours are weighted by
    /// opacity.
    pub fn halved(&self) -> Planes {
        let (count, alpha) = (self.channels.count(), self.opacity);
        let (width, height) = (self.width.div_ceil(2), self.height.div_ceil(2));
        let (stride, last) = (stride(width), self.width as usize - 1);
        let below = |y: usize| [2 * y as u32, (2 * y as u32 + 1).min(self.height - 1)];
        let mut planes = vec![0.0f32; height as usize * count * stride];
        parallel::map_chunks(&mut planes, count * stride, |y, out| {
            let rows = below(y).map(|y| self.row(y));
            let four = |k: usize, x: usize| {
                let plane = rows.map(|r| &r[k * self.stride..]);
                [plane[0][2 * x], plane[0][(2 * x + 1).min(last)], plane[1][2 * x], plane[1][(2 * x + 1).min(last)]]
            };
            for k in 0..count {
                for x in 0..width as usize {
                    let v = four(k, x);
                    let opacity = alpha.filter(|&a| a != k).map_or([1.0; 4], |a| four(a, x));
                    let total: f32 = opacity.iter().sum();
                    out[k * stride + x] = if total > 0.0 {
                        v.iter().zip(opacity).map(|(v, o)| v * o).sum::<f32>() / total
                    } else {
                        0.25 * v.iter().sum::<f32>()
                    };
                }
            }
        });
        let mut amplitude = Vec::new();
        if !self.amplitude.is_empty() {
            amplitude.resize(height as usize * stride, 0.0);
            parallel::map_chunks(&mut amplitude, stride, |y, out| {
                let rows = below(y).map(|y| self.amplitude(y).expect("one amplitude row for each row"));
                for x in 0..width as usize {
                    let square = |x: usize| rows[0][x] * rows[0][x] + rows[1][x] * rows[1][x];
                    out[x] = (0.25 * (square(2 * x) + square((2 * x + 1).min(last)))).sqrt();
                }
            });
        }
        Planes { width, height, stride, planes: Arc::new(planes), amplitude, ..*self }
    }

    /// Returns the same picture with other amplitudes. Both share their samples in memory.
    pub fn weighed(&self, amplitude: Vec<f32>) -> Planes {
        Planes { planes: Arc::clone(&self.planes), amplitude, ..*self }
    }

    /// Returns a copy in which `change(y, planes)` has modified the planes of each row, [`Planes::stride`] floats each.
    pub fn changed(&self, change: impl Fn(usize, &mut [f32]) + Sync + Send) -> Planes {
        let mut planes = self.planes.as_ref().clone();
        parallel::map_chunks(&mut planes, self.channels.count() * self.stride, |y, row| change(y, row));
        Planes { planes: Arc::new(planes), amplitude: self.amplitude.clone(), ..*self }
    }

    /// Returns the factors of the errors in row `y` before they are squared. `None` means 1.
    #[inline(always)]
    pub fn amplitude(&self, y: u32) -> Option<&[f32]> {
        self.amplitude.get(y as usize * self.stride..)?.get(..self.stride)
    }

    /// Returns the weights of the errors in row `y`.
    #[inline(always)]
    pub(crate) fn weights(&self, y: u32) -> RowWeights<'_> {
        let (amplitude, channels) = (self.amplitude(y), self.channel_amplitude);
        RowWeights { amplitude, channels, ..self.untuned_weights(y) }
    }

    /// Returns the weights of the errors in row `y` without those of the tuning.
    #[inline(always)]
    pub fn untuned_weights(&self, y: u32) -> RowWeights<'_> {
        let opacity = self.opacity.map(|a| (a, &self.row(y)[a * self.stride..][..self.stride]));
        RowWeights { opacity, amplitude: None, channels: [1.0; 4] }
    }

    /// Returns the same picture without the weights of the tuning.
    pub(crate) fn untuned(&self) -> Planes {
        Planes { channel_amplitude: [1.0; 4], ..self.weighed(Vec::new()) }
    }

    /// Returns the same picture with the weights of [`metrics::psnr`](crate::metrics::psnr), whether hidden colours are
    /// kept or not.
    pub(crate) fn as_shown(&self) -> Planes {
        Planes { opacity: self.channels.alpha(), ..self.untuned() }
    }

    /// Returns whether the weights of all pixels are equal within 1 %, so that weighting has no effect.
    pub fn is_even(&self) -> bool {
        let rows = self.amplitude.chunks_exact(self.stride).map(|row| &row[..self.width as usize]);
        rows.flatten().all(|a| (a * a - 1.0).abs() < 0.01)
    }

    /// Returns the pixel that contains the point (in pixels), clamped to the picture.
    fn pixel(&self, point: [f32; 2]) -> (usize, u32) {
        let x = (point[0].max(0.0) as usize).min(self.width as usize - 1);
        (x, (point[1].max(0.0) as u32).min(self.height - 1))
    }

    /// Returns the amplitude at the pixel that contains the point (in pixels).
    pub fn amplitude_at(&self, point: [f32; 2]) -> f32 {
        let (x, y) = self.pixel(point);
        self.amplitude(y).map_or(1.0, |a| a[x])
    }

    /// Returns the colour at the pixel that contains the point (in pixels), clamped to the picture.
    pub fn at(&self, point: [f32; 2]) -> [f32; 4] {
        let (x, y) = self.pixel(point);
        let row = self.row(y);
        let mut color = [0.0; 4];
        for (k, c) in color.iter_mut().enumerate().take(self.channels.count()) {
            *c = row[k * self.stride + x];
        }
        color
    }
}
