//! How errors count: the weight of the squared error of each sample. The fit, the descent over the integers, the detail
//! layer, the report and [`metrics`](crate::metrics) all take their weights from this file.
//!
//! The weight of a sample is a product of
//!
//! - its opacity, `0..=1`: the alpha of its pixel in the original, for colours. Errors in transparent pixels are
//!   invisible. Alpha itself has an opacity of 1, and so has every sample while an encode keeps hidden colours.
//! - the square of its pixel's amplitude, and of its channel's: how much the tuning of the encode counts them. Metrics
//!   and reports do not use them.
//!
//! An error is multiplied by the square root of the weight before it is squared, so squares are weighted once.

use crate::gaussian::Channels;
use crate::options::HiddenColors;
use crate::simd::Simd;

/// Returns the opacity of sample `k` of a pixel, in units of `white`. `alpha` is the index of the pixel's alpha, if it
/// counts.
#[inline(always)]
pub(crate) fn opacity<T: Copy>(pixel: &[T], k: usize, alpha: Option<usize>, white: T) -> T {
    alpha.filter(|&a| a != k).map_or(white, |a| pixel[a])
}

/// Returns the channel whose values are the opacity of the others while a picture is fitted.
pub(crate) fn opacity_channel(channels: Channels, hidden: HiddenColors) -> Option<usize> {
    match hidden {
        HiddenColors::Continue => channels.alpha(),
        HiddenColors::Keep => None,
    }
}

/// The weights of a row of samples. Factors of errors are square roots of weights.
#[derive(Debug, Clone, Copy)]
pub struct RowWeights<'a> {
    /// The channel of the opacities, and the opacities of the row.
    pub opacity: Option<(usize, &'a [f32])>,
    /// Factors of the errors of each pixel; `None` means 1.
    pub amplitude: Option<&'a [f32]>,
    /// Factors of the errors in each channel.
    pub channels: [f32; 4],
}

impl<'a> RowWeights<'a> {
    /// Returns the opacities of channel `k`; `None` means 1.
    #[inline(always)]
    fn opacity_of(&self, k: usize) -> Option<&'a [f32]> {
        self.opacity.filter(|&(a, _)| a != k).map(|(_, row)| row)
    }

    /// Returns the factor of the error of sample `x` in channel `k`.
    #[inline(always)]
    pub fn factor(&self, k: usize, x: usize) -> f32 {
        let opacity = self.opacity_of(k).map_or(1.0, |o| o[x].sqrt());
        opacity * self.channels[k] * self.amplitude.map_or(1.0, |a| a[x])
    }

    /// Returns the part of [`factor`](Self::factor) that depends on the pixel, for the pixels from `x` on. `None` means
    /// 1.
    #[inline(always)]
    pub(crate) fn pixels<S: Simd>(&self, simd: S, k: usize, x: usize) -> Option<S::Vector> {
        let opacity = self.opacity_of(k).map(|o| simd.sqrt(simd.read(&o[x..])));
        let amplitude = self.amplitude.map(|a| simd.read(&a[x..]));
        match (opacity, amplitude) {
            (Some(opacity), Some(amplitude)) => Some(simd.mul(opacity, amplitude)),
            (opacity, amplitude) => opacity.or(amplitude),
        }
    }
}

/// Targets with every kind of weighting, for tests that compare kernels with sums over all samples.
#[cfg(test)]
pub(crate) mod cases {
    use super::*;
    use crate::fit::model::objective::planes::Planes;
    use crate::gaussian::Blend;
    use crate::pixels::{Pixels, Samples};

    /// A target, how Gaussians blend, and the weights of its samples.
    pub(crate) struct Case {
        pub name: String,
        pub target: Planes,
        pub blend: Blend,
        /// Weight of each sample, by pixel and channel, computed from the picture and the options.
        pub weights: Vec<f64>,
        /// The same without the tuning.
        pub untuned: Vec<f64>,
        pub values: Vec<f64>,
    }

    const CHANNEL_AMPLITUDE: [f32; 4] = [0.9, 1.3, 0.6, 1.1];

    /// Returns pictures of `width` × `height` pixels with all channels, with hidden colours kept or not, with and
    /// without a tuning, and with both blends. Alpha takes all values from 0 to 1.
    pub(crate) fn all(width: u32, height: u32) -> Vec<Case> {
        let mut cases = Vec::new();
        for channels in [Channels::Grey, Channels::GreyAlpha, Channels::Rgb, Channels::Rgba] {
            for hidden in [HiddenColors::Continue, HiddenColors::Keep] {
                for (is_tuned, blend) in [(false, Blend::Normalized), (true, Blend::Normalized), (true, Blend::Sum)] {
                    let count = channels.count();
                    let samples: Vec<u8> =
                        (0..width as usize * height as usize * count).map(|i| (i * 7919 % 256) as u8).collect();
                    let values: Vec<f64> = samples.iter().map(|&v| f64::from(v) / 255.0).collect();
                    let pixels = Pixels::new(width, height, channels, Samples::U8(samples)).unwrap();
                    let mut target = Planes::with_hidden(&pixels, hidden);
                    if is_tuned {
                        let amplitudes = target.stride * height as usize;
                        target.amplitude = (0..amplitudes).map(|i| 0.5 + (i % 7) as f32 / 7.0).collect();
                        target.channel_amplitude = CHANNEL_AMPLITUDE;
                    }
                    let weight = |i: usize, is_tuned: bool| {
                        let (pixel, k) = (i / count, i % count);
                        let (x, y) = (pixel % width as usize, pixel / width as usize);
                        let opacity = match (channels.alpha(), hidden) {
                            (Some(a), HiddenColors::Continue) if a != k => values[pixel * count + a],
                            _ => 1.0,
                        };
                        let amplitude = 0.5 + ((y * target.stride + x) % 7) as f64 / 7.0;
                        let tuned = (amplitude * f64::from(CHANNEL_AMPLITUDE[k])).powi(2);
                        opacity * if is_tuned { tuned } else { 1.0 }
                    };
                    let [weights, untuned] =
                        [is_tuned, false].map(|tuned| (0..values.len()).map(|i| weight(i, tuned)).collect());
                    let name = format!("{channels:?}, {hidden:?}, tuned {is_tuned}, {blend:?}");
                    cases.push(Case { name, target, blend, weights, untuned, values });
                }
            }
        }
        cases
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simd::{self, LANES, Task};

    /// The factors of one channel by [`RowWeights::pixels`].
    struct Factors<'a> {
        weights: RowWeights<'a>,
        k: usize,
    }

    impl Task for Factors<'_> {
        type Output = [f32; LANES];

        fn run<S: Simd>(self, simd: S) -> Self::Output {
            simd.to_array(self.weights.pixels(simd, self.k, 0).unwrap_or(simd.splat(1.0)))
        }
    }

    #[test]
    fn squares_are_weighted_by_opacity_once_and_alpha_by_none() {
        let pixels: Vec<[f32; 2]> = (0..LANES).map(|x| [0.5, x as f32 / 7.0]).collect();
        let alpha: Vec<f32> = pixels.iter().map(|p| p[1]).collect();
        let amplitude: Vec<f32> = (0..LANES).map(|x| 0.5 + x as f32).collect();
        for amplitude in [None, Some(&amplitude[..])] {
            let weights = RowWeights { opacity: Some((1, &alpha)), amplitude, channels: [0.5, 2.0, 0.0, 0.0] };
            for k in 0..2 {
                let vector = simd::dispatch(Factors { weights, k });
                for (x, pixel) in pixels.iter().enumerate() {
                    let tuned = weights.channels[k] * amplitude.map_or(1.0, |a| a[x]);
                    let want = opacity(pixel, k, Some(1), 1.0) * tuned * tuned;
                    // Three roundings and a square.
                    assert!((weights.factor(k, x).powi(2) - want).abs() <= 4.0 * f32::EPSILON * want, "{k}, {x}");
                    let got = vector[x] * weights.channels[k];
                    assert!((got - weights.factor(k, x)).abs() <= 2.0 * f32::EPSILON * got, "{k}, {x}");
                }
            }
        }
    }
}
