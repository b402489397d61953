//! GaussianImage (Zhang et al., "GaussianImage: 1000 FPS Image Representation and Compression by 2D Gaussian
//! Splatting", ECCV 2024, arXiv 2403.08551), after github.com/Xinjie-Q/GaussianImage: `gaussianimage_cholesky.py`,
//! `gaussianimage_rs.py`, `train.py` and `optimizer.py`, and the kernels of its `gsplat`.
//!
//! The picture is the sum `I = Σ cₙ exp(−σₙ)`, without background, clamped; the colours include the opacity. Positions
//! are `½·size·(1 + tanh p)`, so that they stay inside; pixel centres are at integers. Covariances are `L Lᵀ` with ½
//! added to the factor's diagonal, or rotation and scales, where the scales are `|s + ½|` and the angle is
//! `2π·sigmoid(r)`. All numbers are initialized at random in 0..1, positions uniformly. The loss is the mean squared
//! error after the clamp. The optimizer is Adan with a rate of 0.001, halved after 40 % and 80 % of the iterations (20
//! 000 of 50 000). The result is the last state.
//!
//! Differences from the published program: a Gaussian falls to 0 at 3.5 scales, as everywhere in this crate, whereas
//! theirs is cut off below 1/255. The codec's second stage is in `quantized.rs`.

use std::time::Instant;

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::moments::{self, Slope};
use super::optimizer::{Adan, NUMBERS};
use super::{Fit, Options, Point, drawn, quantized};
use ssplat::unstable::fit::model::drawing::field::{Field, Output};
use ssplat::unstable::fit::model::drawing::project::{Primitive, Projected};
use ssplat::unstable::fit::model::objective::planes::Planes;
use ssplat::unstable::fit::model::objective::rows::RowSet;
use ssplat::unstable::fit::model::problem::{Problem, Scene};
use ssplat::unstable::gaussian::Blend;
use ssplat::unstable::parallel;

pub(super) const RATE: f32 = 1e-3;
/// Fraction of the iterations after which the rate is halved, repeatedly.
const HALVING_INTERVAL: f32 = 0.4;
/// Offset added to the factor's diagonal and to the scales.
const BOUND: f32 = 0.5;
/// Minimum scale that is drawn, pixels; covariances without an inverse are not drawn.
const MIN_SCALE: f32 = 0.02;

/// Parametrization of covariances.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Covariance {
    Cholesky,
    RotationScale,
}

/// Returns the factor of the rate after `iteration` of `iterations`.
pub(super) fn halved(iteration: u32, iterations: u32) -> f32 {
    0.5f32.powi((iteration as f32 / (HALVING_INTERVAL * iterations as f32)) as i32)
}

/// Renders the method's numbers and computes their gradients.
pub(super) struct Stage<'a> {
    pub target: &'a Planes,
    pub covariance: Covariance,
    field: Field,
}

impl Stage<'_> {
    pub(super) fn channels(&self) -> usize {
        self.target.channels.count()
    }

    fn problem(&self) -> Problem<'_> {
        let (width, height) = (self.target.width, self.target.height);
        let scene = Scene { width, height, blend: Blend::Sum, background: [0.0; 4] };
        Problem { scene, target: self.target }
    }

    fn size(&self) -> [f32; 2] {
        [self.target.width as f32, self.target.height as f32]
    }

    fn project(&self, numbers: &[[f32; NUMBERS]]) -> Vec<Projected> {
        let (size, covariance) = (self.size(), self.covariance);
        numbers.iter().map(|n| Projected::new(&primitive(n, size, covariance), self.target.height)).collect()
    }

    /// Renders, and returns the squared error.
    pub(super) fn draw(&mut self, numbers: &[[f32; NUMBERS]]) -> f64 {
        let projected = self.project(numbers);
        let mut field = std::mem::take(&mut self.field);
        let error = field.draw(&self.problem(), &projected, RowSet::ALL, Output::Picture);
        self.field = field;
        error
    }

    /// Returns the gradients with respect to the numbers that were rendered last.
    fn gradients_of_drawn(&mut self, numbers: &[[f32; NUMBERS]]) -> Vec<[f32; NUMBERS]> {
        loss_gradient(self.target, &mut self.field);
        let slopes = moments::slopes(&self.field, self.channels(), self.target.width, &self.project(numbers));
        let (size, covariance) = (self.size(), self.covariance);
        numbers.iter().zip(&slopes).map(|(n, slope)| gradient(n, slope, size, covariance)).collect()
    }

    /// Renders, and returns the gradients.
    pub(super) fn gradients(&mut self, numbers: &[[f32; NUMBERS]]) -> Vec<[f32; NUMBERS]> {
        self.draw(numbers);
        self.gradients_of_drawn(numbers)
    }
}

pub(super) fn fit(target: &Planes, covariance: Covariance, options: &Options) -> Fit {
    let mut stage = Stage { target, covariance, field: Field::default() };
    let mut rng = Pcg64Mcg::seed_from_u64(options.seed);
    let mut numbers: Vec<[f32; NUMBERS]> = (0..options.count)
        .map(|_| {
            let mut n: [f32; NUMBERS] = std::array::from_fn(|_| rng.random());
            // The inverse of the activation, so that positions are uniform in the picture.
            n[0] = (2.0 * n[0] - 1.0).atanh();
            n[1] = (2.0 * n[1] - 1.0).atanh();
            n
        })
        .collect();
    let mut adan = Adan::new(options.count);
    let (mut trace, mut watching) = (Vec::new(), 0.0);
    let start = Instant::now();
    for iteration in 0..options.iterations {
        let error = stage.draw(&numbers);
        if options.trace > 0 && iteration.is_multiple_of(options.iterations.div_ceil(options.trace)) {
            let now = Instant::now();
            let seconds = start.elapsed().as_secs_f64() - watching;
            trace.push(Point { iteration, seconds, psnr: drawn::psnr(target, error) });
            watching += now.elapsed().as_secs_f64();
        }
        let gradients = stage.gradients_of_drawn(&numbers);
        adan.step(&mut numbers, &gradients, options.rate * RATE * halved(iteration, options.iterations));
    }
    let error = stage.draw(&numbers);
    let seconds = start.elapsed().as_secs_f64() - watching;
    let psnr = drawn::psnr(target, error);
    trace.extend((options.trace > 0).then_some(Point { iteration: options.iterations, seconds, psnr }));
    let pixels = drawn::pixels(target, &stage.field.planes);
    let size = stage.size();
    let gaussians = numbers.iter().map(|n| primitive(n, size, covariance).to_gaussian()).collect();
    let picture = drawn::picture(target, Blend::Sum, gaussians);
    let counted = quantized::counted(&mut stage, numbers, options, &mut rng);
    Fit { pixels, psnr, picture, seconds, iterations: options.iterations, trace, counted, estimate: None }
}

/// Returns the Gaussian of its numbers.
fn primitive(n: &[f32; NUMBERS], size: [f32; 2], covariance: Covariance) -> Primitive {
    // Pixel centres are at +0.5 here, and at integers there.
    let mean = [0, 1].map(|k| 0.5 * size[k] * (1.0 + n[k].tanh()) + 0.5);
    let (scale, rotation) = match covariance {
        Covariance::Cholesky => {
            let [l11, l21, l22] = factor(n);
            let (xx, xy, yy) = (l11 * l11, l11 * l21, l21 * l21 + l22 * l22);
            let large = 0.5 * (xx + yy) + (0.5 * (xx - yy)).hypot(xy);
            // The product of the scales is that of the diagonal.
            let major = large.sqrt();
            ([major, (l11 * l22).abs() / major], 0.5 * (2.0 * xy).atan2(xx - yy))
        }
        Covariance::RotationScale => (scales(n).map(f32::abs), -angle(n)),
    };
    let mut color = [0.0; 4];
    color.copy_from_slice(&n[5..]);
    Primitive { mean, log_scale: scale.map(|s| s.max(MIN_SCALE).ln()), rotation, color }
}

fn factor(n: &[f32; NUMBERS]) -> [f32; 3] {
    [n[2] + BOUND, n[3], n[4] + BOUND]
}

fn scales(n: &[f32; NUMBERS]) -> [f32; 2] {
    [n[2] + BOUND, n[3] + BOUND]
}

fn angle(n: &[f32; NUMBERS]) -> f32 {
    std::f32::consts::TAU / (1.0 + (-n[4]).exp())
}

/// Returns the gradient with respect to the numbers.
fn gradient(n: &[f32; NUMBERS], slope: &Slope, size: [f32; 2], covariance: Covariance) -> [f32; NUMBERS] {
    let place = [0, 1].map(|k| {
        let t = n[k].tanh();
        slope.mean[k] * 0.5 * size[k] * (1.0 - t * t)
    });
    let [xx, xy, yy] = slope.covariance;
    let shape = match covariance {
        // d(L Lᵀ) against a symmetric G is 2 G L.
        Covariance::Cholesky => {
            let [l11, l21, l22] = factor(n);
            [2.0 * (xx * l11 + xy * l21), 2.0 * (xy * l11 + yy * l21), 2.0 * yy * l22]
        }
        Covariance::RotationScale => {
            let [s1, s2] = scales(n);
            let angle = angle(n);
            let (sin, cos) = (-angle).sin_cos();
            // The matrix in the Gaussian's own axes.
            let uu = cos * cos * xx + 2.0 * cos * sin * xy + sin * sin * yy;
            let vv = sin * sin * xx - 2.0 * cos * sin * xy + cos * cos * yy;
            let uv = cos * sin * (yy - xx) + (cos * cos - sin * sin) * xy;
            let turn = angle / std::f32::consts::TAU;
            let by_angle = -2.0 * uv * (s1 * s1 - s2 * s2);
            [2.0 * uu * s1, 2.0 * vv * s2, by_angle * std::f32::consts::TAU * turn * (1.0 - turn)]
        }
    };
    let c = slope.color;
    let all = [place[0], place[1], shape[0], shape[1], shape[2], c[0], c[1], c[2], c[3]];
    // Their kernel skips covariances without an inverse, which get no gradient.
    if all.iter().all(|v| v.is_finite()) { all } else { [0.0; NUMBERS] }
}

/// Replaces the picture in `field` by the gradient of the mean squared error after a clamp.
fn loss_gradient(target: &Planes, field: &mut Field) {
    let (channels, stride, width) = (target.channels.count(), field.stride, target.width as usize);
    let samples = width as f32 * target.height as f32 * channels as f32;
    parallel::map_chunks(&mut field.planes, (channels + 1) * stride, |y, row| {
        let truth = target.row(y as u32);
        for k in 0..channels {
            for x in 0..width {
                let v = &mut row[k * stride + x];
                *v = if (0.0..=1.0).contains(v) { 2.0 * (*v - truth[k * stride + x]) / samples } else { 0.0 };
            }
            row[k * stride + width..(k + 1) * stride].fill(0.0);
        }
        row[channels * stride..].fill(0.0);
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use ssplat::unstable::gaussian::Channels;
    use ssplat::{Pixels, Samples};

    const SIZE: [usize; 2] = [24, 20];

    /// Returns the mean squared error in double precision, directly from the paper's equations: `Σ = L Lᵀ` or `Rᵀ S Sᵀ
    /// R`, `σ = ½ dᵀ Σ⁻¹ d`, `I = Σ c exp(−σ)`, with pixel centres at integers and this crate's support.
    fn loss(truth: &[u8], numbers: &[[f64; NUMBERS]], covariance: Covariance) -> f64 {
        let edge = (-0.5 * f64::from(ssplat::unstable::gaussian::CUTOFF).powi(2)).exp();
        let mut sum = 0.0;
        for (i, &truth) in truth.iter().enumerate() {
            let (x, y, k) = (i / 3 % SIZE[0], i / 3 / SIZE[0], i % 3);
            let mut value = 0.0;
            for n in numbers {
                let [dx, dy] = [(x, 0), (y, 1)].map(|(v, k)| v as f64 - 0.5 * SIZE[k] as f64 * (1.0 + n[k].tanh()));
                let bound = f64::from(BOUND);
                let [xx, xy, yy] = match covariance {
                    Covariance::Cholesky => {
                        let [l11, l21, l22] = [n[2] + bound, n[3], n[4] + bound];
                        [l11 * l11, l11 * l21, l21 * l21 + l22 * l22]
                    }
                    Covariance::RotationScale => {
                        let (sin, cos) = (std::f64::consts::TAU / (1.0 + (-n[4]).exp())).sin_cos();
                        let [a, b] = [n[2], n[3]].map(|s| (s + bound).powi(2));
                        [cos * cos * a + sin * sin * b, cos * sin * (b - a), sin * sin * a + cos * cos * b]
                    }
                };
                let sigma = 0.5 * (yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy) / (xx * yy - xy * xy);
                value += n[5 + k] * ((-sigma).exp() - edge).max(0.0);
            }
            sum += (value.clamp(0.0, 1.0) - f64::from(truth) / 255.0).powi(2);
        }
        sum / truth.len() as f64
    }

    #[test]
    fn gradients_are_the_differences_of_the_published_equations_in_double_precision() {
        let truth: Vec<u8> = (0..SIZE[0] * SIZE[1] * 3).map(|i| (i * 7 % 90 + 80) as u8).collect();
        let [width, height] = SIZE.map(|v| v as u32);
        let pixels = Pixels::new(width, height, Channels::Rgb, Samples::U8(truth.clone())).unwrap();
        let target = Planes::new(&pixels);
        let scene = Scene { width, height, blend: Blend::Sum, background: [0.0; 4] };
        let size = SIZE.map(|v| v as f32);
        for covariance in [Covariance::Cholesky, Covariance::RotationScale] {
            // The second is rotated; the third is bright enough to be clamped.
            let numbers = [
                [0.1, -0.3, 2.5, 1.2, 1.9, 0.3, 0.2, 0.25, 0.0],
                [-0.4, 0.2, 1.0, 2.2, -1.8, 0.2, 0.3, 0.1, 0.0],
                [0.7, 0.5, 1.5, -0.7, 0.9, 1.4, 0.5, -0.2, 0.0],
            ];
            let projected: Vec<_> =
                numbers.iter().map(|n| Projected::new(&primitive(n, size, covariance), height)).collect();
            let mut field = Field::default();
            field.draw(&Problem { scene, target: &target }, &projected, RowSet::ALL, Output::Picture);
            loss_gradient(&target, &mut field);
            for (i, slope) in moments::slopes(&field, 3, width, &projected).iter().enumerate() {
                let found = gradient(&numbers[i], slope, size, covariance);
                let largest = found.iter().fold(0.0f32, |a, b| a.max(b.abs()));
                for k in 0..8 {
                    let at = |by: f64| {
                        let mut moved = numbers.map(|n| n.map(f64::from));
                        moved[i][k] += by;
                        loss(&truth, &moved, covariance)
                    };
                    let want = ((at(1e-6) - at(-1e-6)) / 2e-6) as f32;
                    // Single precision, and sums over 480 pixels.
                    let near = (found[k] - want).abs() < 2e-3 * want.abs() + 2e-3 * largest;
                    assert!(near, "{covariance:?} {i} {k}: {} {want}", found[k]);
                }
            }
        }
    }
}
