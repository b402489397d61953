//! The loss of several published methods and its gradient: absolute error and structural similarity.

use ssplat::Blend;
use ssplat::unstable::fit::model::drawing::field::Field;
use ssplat::unstable::fit::model::objective::planes::Planes;
use ssplat::unstable::fit::model::problem::Problem;
use ssplat::unstable::gaussian::EPSILON;
use ssplat::unstable::parallel;
use ssplat::unstable::simd::{self, LANES, Simd, Task};

/// Taps of the SSIM window.
const TAPS: usize = 11;
/// Standard deviation of the window, pixels.
const SIGMA: f32 = 1.5;
/// Keeps the luminance term finite: `K₁²`.
const C1: f32 = 0.0001;
/// Keeps the contrast term finite: `K₂²`.
const C2: f32 = 0.0009;

/// Weighted sum of absolute error and SSIM: `a · Σ|e| + (1 − a) · Σ(1 − SSIM)` over all samples.
#[derive(Debug)]
pub struct Loss {
    absolute: f32,
    window: [f32; TAPS],
    width: usize,
    /// Each channel of the target.
    truths: Vec<Vec<f32>>,
    /// Windowed means of the channels, which stay the same during the fit.
    means: Vec<Vec<f32>>,
    /// The gradient of SSIM in each channel.
    slopes: Vec<Vec<f32>>,
    buffers: Buffers,
}

/// Planes of one channel, reused in every step. The system would have to clear newly allocated ones each time.
#[derive(Debug)]
struct Buffers {
    picture: Vec<f32>,
    /// Horizontal sums, before they are summed vertically.
    across: Vec<f32>,
    /// Windowed means, mean squares and mean products; later the windowed derivatives of SSIM with respect to these.
    windowed: [Vec<f32>; 3],
    /// Derivatives of SSIM with respect to the means, mean squares and mean products, one after the other in each row.
    slopes: Vec<f32>,
}

impl Loss {
    /// Creates the loss. `absolute` is the weight of the absolute error, `0..=1`.
    pub fn new(target: &Planes, absolute: f32) -> Self {
        let raw: [f32; TAPS] = std::array::from_fn(|i| (-(i as f32 - 5.0).powi(2) / (2.0 * SIGMA * SIGMA)).exp());
        let sum: f32 = raw.iter().sum();
        let window = raw.map(|v| v / sum);
        let width = target.width as usize;
        let truths: Vec<Vec<f32>> = (0..target.channels.count()).map(|k| target.plane(k)).collect();
        let zeros = |times: usize| vec![0.0f32; times * width * target.height as usize];
        let mut across = zeros(1);
        let windowed_plane = |truth: &Vec<f32>| {
            let mut out = zeros(1);
            windowed(&window, width, |y, row| row.copy_from_slice(&truth[y * width..][..width]), &mut across, &mut out);
            out
        };
        let means = truths.iter().map(windowed_plane).collect();
        let slopes = truths.iter().map(|_| zeros(1)).collect();
        let buffers = Buffers { picture: zeros(1), across, windowed: [(); 3].map(|()| zeros(1)), slopes: zeros(3) };
        Loss { absolute, window, width, truths, means, slopes, buffers }
    }

    /// Replaces the picture of all rows in `field` ([`Output::Picture`]) by the gradient, in the layout of
    /// [`Output::Gradient`]. Where the picture is outside `0..=1`, the gradient is 0, as it is behind a clamp.
    ///
    /// [`Output::Picture`]: ssplat::unstable::fit::model::drawing::field::Output::Picture
    /// [`Output::Gradient`]: ssplat::unstable::fit::model::drawing::field::Output::Gradient
    pub fn gradient(&mut self, problem: &Problem<'_>, field: &mut Field) {
        let Problem { scene, target } = *problem;
        let (channels, stride, width) = (target.channels.count(), field.stride, self.width);
        let size = (channels + 1) * stride;
        for k in 0..channels {
            parallel::map_chunks(&mut self.buffers.picture, width, |y, out| {
                for (o, v) in out.iter_mut().zip(&field.planes[y * size + k * stride..]) {
                    *o = v.clamp(0.0, 1.0);
                }
            });
            self.similarity_slope(k);
        }
        let (absolute, slopes) = (self.absolute, &self.slopes);
        parallel::map_chunks(&mut field.planes, size, |y, row| {
            let (colors, weights) = row.split_at_mut(channels * stride);
            let (truth, row_weights) = (target.row(y as u32), target.untuned_weights(y as u32));
            for (x, weight) in weights.iter_mut().enumerate().take(width) {
                let inverse = match scene.blend {
                    Blend::Normalized => 1.0 / (*weight + EPSILON),
                    Blend::Sum => 1.0,
                };
                let mut h = 0.0;
                for k in 0..channels {
                    let (v, t) = (colors[k * stride + x], truth[k * stride + x]);
                    let opacity = row_weights.factor(k, x).powi(2);
                    let sign = if v == t { 0.0 } else { (v - t).signum() };
                    let slope = absolute * sign - (1.0 - absolute) * slopes[k][y * width + x];
                    let g = if (0.0..=1.0).contains(&v) { slope * opacity * inverse } else { 0.0 };
                    colors[k * stride + x] = g;
                    h += g * v;
                }
                *weight = if scene.blend == Blend::Normalized { h } else { 0.0 };
            }
            // Strips may overhang the end of the row. Values there must not count.
            for plane in row.chunks_exact_mut(stride) {
                plane[width..].fill(0.0);
            }
        });
    }

    /// Computes the gradient of the sum of SSIM over the pixels of channel `k` with respect to the picture in
    /// `buffers`. Both pictures are 0 outside, so that every pixel has a full window.
    fn similarity_slope(&mut self, k: usize) {
        let (window, width, truth, truth_means) = (&self.window, self.width, &self.truths[k], &self.means[k]);
        let Buffers { picture, across, windowed: [means, squares, products], slopes } = &mut self.buffers;
        let pairs = |y: usize| picture[y * width..][..width].iter().zip(&truth[y * width..][..width]);
        windowed(window, width, |y, row| row.copy_from_slice(&picture[y * width..][..width]), across, means);
        let square =
            |y: usize, row: &mut [f32]| row.iter_mut().zip(pairs(y)).for_each(|(o, (a, b))| *o = a * a + b * b);
        windowed(window, width, square, across, squares);
        let product = |y: usize, row: &mut [f32]| row.iter_mut().zip(pairs(y)).for_each(|(o, (a, b))| *o = a * b);
        windowed(window, width, product, across, products);
        parallel::map_chunks(slopes, 3 * width, |y, out| {
            let (by_mean, out) = out.split_at_mut(width);
            let (by_square, by_product) = out.split_at_mut(width);
            let at = y * width..(y + 1) * width;
            let (means, truths) = (&means[at.clone()], &truth_means[at.clone()]);
            let (squares, products) = (&squares[at.clone()], &products[at]);
            for x in 0..width {
                let (a, b) = (means[x], truths[x]);
                let (l2, s2) = (a * a + b * b + C1, squares[x] - a * a - b * b + C2);
                let (light, contrast) = ((2.0 * a * b + C1) / l2, (2.0 * (products[x] - a * b) + C2) / s2);
                let (square, product) = (-light * contrast / s2, 2.0 * light / s2);
                by_mean[x] = 2.0 * contrast * (b - light * a) / l2 - product * b - 2.0 * square * a;
                by_square[x] = square;
                by_product[x] = product;
            }
        });
        for (i, out) in [&mut *means, &mut *squares, &mut *products].into_iter().enumerate() {
            let row = |y: usize, row: &mut [f32]| row.copy_from_slice(&slopes[(3 * y + i) * width..][..width]);
            windowed(window, width, row, across, out);
        }
        parallel::map_chunks(&mut self.slopes[k], width, |y, out| {
            let at = y * width..(y + 1) * width;
            let (by_mean, by_square, by_product) = (&means[at.clone()], &squares[at.clone()], &products[at.clone()]);
            let (picture, truth) = (&picture[at.clone()], &truth[at]);
            for (x, o) in out.iter_mut().enumerate() {
                *o = by_mean[x] + (2.0 * picture[x] * by_square[x] + truth[x] * by_product[x]);
            }
        });
    }
}

/// Samples that are summed together. Each addition depends on the previous one, so several sums are interleaved.
const SAMPLES_TOGETHER: usize = 4 * LANES;

/// Applies the window to every pixel of a plane, whose rows `row` writes, and stores the result in `out`. Outside, the
/// plane is 0. `across` is scratch memory of the same size.
fn windowed(
    window: &[f32; TAPS],
    width: usize,
    row: impl Fn(usize, &mut [f32]) + Sync + Send,
    across: &mut [f32],
    out: &mut [f32],
) {
    const REACH: usize = TAPS / 2;
    let height = out.len() / width;
    parallel::map_chunks(across, width, |y, out| {
        let mut padded = vec![0.0f32; width + 2 * REACH];
        row(y, &mut padded[REACH..REACH + width]);
        let taps: [&[f32]; TAPS] = std::array::from_fn(|k| &padded[k..k + width]);
        simd::dispatch(Taps { window, taps: &taps, out });
    });
    let across = &*across;
    parallel::map_chunks(out, width, |y, out| {
        let first = REACH.saturating_sub(y);
        let last = TAPS.min(height + REACH - y);
        let mut taps: [&[f32]; TAPS] = [&[]; TAPS];
        for k in first..last {
            taps[k] = &across[(y + k - REACH) * width..][..width];
        }
        simd::dispatch(Taps { window: &window[first..last], taps: &taps[first..last], out });
    });
}

/// Computes the weighted sum of slices as long as `out`, in their order.
struct Taps<'a> {
    window: &'a [f32],
    taps: &'a [&'a [f32]],
    out: &'a mut [f32],
}

impl Task for Taps<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let (chunks, rest) = self.out.as_chunks_mut::<SAMPLES_TOGETHER>();
        let tail = chunks.len() * SAMPLES_TOGETHER;
        for (i, out) in chunks.iter_mut().enumerate() {
            let mut sums = [simd.splat(0.0); SAMPLES_TOGETHER / LANES];
            for (&w, tap) in self.window.iter().zip(self.taps) {
                let w = simd.splat(w);
                for (j, sum) in sums.iter_mut().enumerate() {
                    *sum = simd.add(*sum, simd.mul(w, simd.read(&tap[i * SAMPLES_TOGETHER + j * LANES..])));
                }
            }
            for (j, sum) in sums.into_iter().enumerate() {
                simd.write(&mut out[j * LANES..], sum);
            }
        }
        rest.fill(0.0);
        for (w, tap) in self.window.iter().zip(self.taps) {
            for (o, v) in rest.iter_mut().zip(&tap[tail..]) {
                *o += w * v;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use ssplat::{Channels, Pixels, Samples};

    use super::*;

    #[test]
    fn the_gradient_of_ssim_matches_finite_differences() {
        let (width, height) = (17, 14);
        let noise = |seed: usize| -> Vec<f32> {
            (0..width * height).map(|i| ((i * 7919 + seed * 104_729) % 251) as f32 / 251.0).collect()
        };
        let (mut picture, truth) = (noise(1), noise(2));
        let samples = truth.iter().map(|v| (v * 65535.0) as u16).collect();
        let target = Planes::new(&Pixels::new(17, 14, Channels::Grey, Samples::U16(samples)).unwrap());
        let truth = target.plane(0);
        let mut loss = Loss::new(&target, 0.5);
        loss.buffers.picture.copy_from_slice(&picture);
        loss.similarity_slope(0);
        let slope = loss.slopes[0].clone();
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
