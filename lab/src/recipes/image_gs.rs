//! Image-GS (Zhang et al., "Image-GS: Content-Adaptive Image Representation via 2D Gaussians", SIGGRAPH 2025, arXiv
//! 2407.01866), after github.com/NYU-ICL/image-gs: `model.py`, `cfgs/default.yaml` and the kernels of its `gsplat`.
//!
//! Half of the Gaussians are initialized at pixels drawn without replacement, 30 % of them uniformly and the others by
//! the squared magnitude of the gradient (Sobel), with a scale of 5 pixels and the pixel's colour. Four times, every
//! 500 of 10 000 iterations, an eighth of the total is added at pixels drawn by the square of the mean absolute error,
//! with the error there as colour, and the optimizer is reset. It is Adam on positions in units of the picture's sides
//! (rate 0.0005), inverse scales (0.002), angles (0.002) and colours (0.005). The loss is the mean absolute error plus
//! 0.1 · (1 − SSIM). Once all Gaussians are present, the rates fall to a tenth after 1000 iterations without an
//! improvement of 0.1 dB and 0.001 of SSIM, measured every 100 iterations; the second time, the fit ends. The blend is
//! in `top_k.rs`. Positions are at pixel centres, but pixels are sampled at integers: as in the published program, a
//! Gaussian starts half a pixel to the lower right of its pixel.
//!
//! Differences from the published program: the loss is computed after a clamp to 0..1, and the SSIM of the schedule
//! excludes the border. As by default there, numbers are not quantized during the fit; its size counts 16 bits for
//! each.

use std::time::Instant;

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::moments::Slope;
use super::optimizer::{Adam, NUMBERS};
use super::top_k::{Circle, Drawing};
use super::{Counted, Fit, Options, Point, drawn};
use crate::loss::Loss;
use ssplat::Pixels;
use ssplat::unstable::fit::model::drawing::field::Field;
use ssplat::unstable::fit::model::drawing::project::{Primitive, Projected};
use ssplat::unstable::fit::model::objective::planes::Planes;
use ssplat::unstable::fit::model::problem::{Problem, Scene};
use ssplat::unstable::gaussian::Blend;
use ssplat::unstable::metrics;

/// Iterations of the published program; all iteration counts here are relative to these.
const ITERATIONS: u32 = 10_000;
const INITIAL_SHARE: f32 = 0.5;
const RANDOM_SHARE: f32 = 0.3;
const INITIAL_SCALE: f32 = 5.0;
const ADD_TIMES: usize = 4;
const ADD_STEPS: u32 = 500;
const EVALUATED: u32 = 100;
const PATIENCE: u32 = 1000;
const DECAYS: u32 = 1;
const DECAY: f32 = 0.1;
const LEAST_GAIN: f64 = 1e-3;
const RATES: [f32; NUMBERS] = [5e-4, 5e-4, 2e-3, 2e-3, 2e-3, 5e-3, 5e-3, 5e-3, 5e-3];
/// Weight of the absolute error relative to SSIM's 0.1; the steps do not depend on the sum of both.
const ABSOLUTE: f32 = 1.0 / 1.1;

pub(super) fn fit(target: &Planes, options: &Options) -> Fit {
    let mut run = Run::new(target, options);
    let steps =
        |published: u32| (published as f32 * options.iterations as f32 / ITERATIONS as f32).ceil().max(1.0) as u32;
    let (mut trace, mut watching) = (Vec::new(), 0.0);
    let mut schedule = Schedule { patience: steps(PATIENCE), ..Schedule::default() };
    let truth = run.truth();
    let start = Instant::now();
    let mut iteration = 0;
    while iteration < options.iterations {
        run.draw();
        if options.trace > 0 && iteration.is_multiple_of(options.iterations.div_ceil(options.trace)) {
            let now = Instant::now();
            trace.push(Point { iteration, seconds: start.elapsed().as_secs_f64() - watching, psnr: run.psnr() });
            watching += now.elapsed().as_secs_f64();
        }
        run.step(options.rate * schedule.rate());
        iteration += 1;
        let is_whole = run.numbers.len() == options.count;
        if is_whole && iteration.is_multiple_of(steps(EVALUATED)) {
            run.draw();
            let ssim = metrics::compare(&truth, &drawn::pixels(target, &run.drawn)).ok().and_then(|c| c.ssim);
            if schedule.is_over(run.psnr(), ssim.unwrap_or(0.0), steps(EVALUATED)) {
                break;
            }
        }
        if !is_whole && iteration.is_multiple_of(steps(ADD_STEPS)) {
            run.draw();
            run.grow(options.count);
        }
    }
    run.draw();
    let (seconds, psnr) = (start.elapsed().as_secs_f64() - watching, run.psnr());
    trace.extend((options.trace > 0).then_some(Point { iteration, seconds, psnr }));
    let gaussians = run.numbers.iter().map(|n| primitive(n, run.size()).to_gaussian()).collect();
    let picture = drawn::picture(target, Blend::Normalized, gaussians);
    let pixels = drawn::pixels(target, &run.drawn);
    run.round();
    run.draw();
    let bytes = (run.numbers.len() * 2 * (5 + target.channels.count())) as u64;
    let counted = Some(Counted { bytes, coded: None, psnr: run.psnr() });
    Fit { pixels, psnr, picture, seconds, iterations: iteration, trace, counted, estimate: None }
}

/// Decides when rates fall and when the fit ends.
#[derive(Debug, Default)]
struct Schedule {
    psnr: f64,
    ssim: f64,
    waited: u32,
    patience: u32,
    decays: u32,
}

impl Schedule {
    fn rate(&self) -> f32 {
        DECAY.powi(self.decays as i32)
    }

    /// Tells whether the fit ends, `since` iterations after the last measurement.
    fn is_over(&mut self, psnr: f64, ssim: f64, since: u32) -> bool {
        let is_better = psnr > self.psnr + 100.0 * LEAST_GAIN && ssim > self.ssim + LEAST_GAIN;
        if is_better {
            (self.psnr, self.ssim, self.waited) = (psnr, ssim, 0);
            return false;
        }
        self.waited += since;
        if self.waited < self.patience {
            return false;
        }
        self.waited = 0;
        self.decays += 1;
        self.decays > DECAYS
    }
}

/// The current Gaussians.
struct Run<'a> {
    target: &'a Planes,
    rng: Pcg64Mcg,
    /// Position in units of the sides, inverse scales, angle, colour.
    numbers: Vec<[f32; NUMBERS]>,
    adam: Adam,
    loss: Loss,
    circles: Vec<Circle>,
    drawing: Drawing,
    /// The picture, in the layout of [`Field::planes`].
    drawn: Vec<f32>,
    /// Number of Gaussians that are added at a time.
    most: usize,
}

impl<'a> Run<'a> {
    fn new(target: &'a Planes, options: &Options) -> Self {
        let mut rng = Pcg64Mcg::seed_from_u64(options.seed);
        let count = (INITIAL_SHARE * options.count as f32).ceil() as usize;
        let most = (options.count - count).div_ceil(ADD_TIMES);
        let random = (RANDOM_SHARE * count as f32).round() as usize;
        let area = target.width as usize * target.height as usize;
        let mut places = draw_without_replacement(&vec![1.0; area], random, &mut rng);
        places.extend(draw_without_replacement(&gradients(target), count - random, &mut rng));
        let color = |place: usize| {
            let (x, y) = (place % target.width as usize, place / target.width as usize);
            std::array::from_fn(|k| {
                if k < target.channels.count() { target.row(y as u32)[k * target.stride + x] } else { 0.0 }
            })
        };
        let numbers: Vec<_> = places.iter().map(|&p| new_numbers(target, p, color(p))).collect();
        let adam = Adam::new(numbers.len());
        let (circles, drawing, drawn) = (Vec::new(), Drawing::default(), Vec::new());
        Run { target, rng, numbers, adam, loss: Loss::new(target, ABSOLUTE), circles, drawing, drawn, most }
    }

    fn size(&self) -> [f32; 2] {
        [self.target.width as f32, self.target.height as f32]
    }

    fn sides(&self) -> [usize; 2] {
        [self.target.width as usize, self.target.height as usize]
    }

    /// Returns the target with 8 bits per sample.
    fn truth(&self) -> Pixels {
        let (channels, stride) = (self.target.channels.count(), self.target.stride);
        let mut planes = vec![0.0; self.target.height as usize * (channels + 1) * stride];
        for (y, row) in planes.chunks_exact_mut((channels + 1) * stride).enumerate() {
            row[..channels * stride].copy_from_slice(&self.target.row(y as u32)[..channels * stride]);
        }
        drawn::pixels(self.target, &planes)
    }

    fn draw(&mut self) {
        let size = self.size();
        self.circles = self
            .numbers
            .iter()
            .map(|n| {
                let p = primitive(n, size);
                let large = p.log_scale[0].max(p.log_scale[1]).exp();
                Circle { projected: Projected::new(&p, self.target.height), radius: (3.0 * large).ceil() }
            })
            .collect();
        let (sides, channels) = (self.sides(), self.target.channels.count());
        self.drawing.draw(&self.circles, sides, channels, (&mut self.drawn, self.target.stride));
    }

    /// Returns the PSNR of the clamped picture that was rendered last.
    fn psnr(&self) -> f64 {
        let (channels, stride) = (self.target.channels.count(), self.target.stride);
        let mut error = 0.0;
        for (y, row) in self.drawn.chunks_exact((channels + 1) * stride).enumerate() {
            let truth = self.target.row(y as u32);
            for k in 0..channels {
                for x in 0..self.target.width as usize {
                    error += f64::from(row[k * stride + x].clamp(0.0, 1.0) - truth[k * stride + x]).powi(2);
                }
            }
        }
        drawn::psnr(self.target, error)
    }

    /// Rounds all numbers to 65 536 uniform steps between the minimum and maximum of their kind, as `ste_quantize`
    /// does.
    fn round(&mut self) {
        for kind in [0..2, 2..4, 4..5, 5..5 + self.target.channels.count()] {
            let values = || self.numbers.iter().flat_map(|n| &n[kind.clone()]);
            let [least, largest] =
                values().fold([f32::INFINITY, f32::NEG_INFINITY], |r, &v| [r[0].min(v), r[1].max(v)]);
            let step = ((largest - least) / 65535.0).max(1e-8);
            for v in self.numbers.iter_mut().flat_map(|n| &mut n[kind.clone()]) {
                *v = ((*v - least) / step).round_ties_even().clamp(0.0, 65535.0) * step + least;
            }
        }
    }

    /// Takes one step from the picture that was rendered last.
    fn step(&mut self, rate: f32) {
        let stride = self.target.stride;
        // The loss takes the picture as a sum; its gradient is then that with respect to the picture itself.
        let [width, height] = [self.target.width, self.target.height];
        let scene = Scene { width, height, blend: Blend::Sum, background: [0.0; 4] };
        let mut field = Field { planes: self.drawn.clone(), stride, ..Field::default() };
        self.loss.gradient(&Problem { scene, target: self.target }, &mut field);
        // The mean, so that Adam's epsilon has the same relative size as in the published program.
        let samples = (width * height) as f32 * self.target.channels.count() as f32;
        let mut gradients = self.gradients(&field.planes);
        gradients.iter_mut().flatten().for_each(|v| *v /= samples);
        self.adam.step(&mut self.numbers, &gradients, RATES.map(|r| r * rate));
    }

    /// Converts a gradient with respect to the picture rendered last to the gradient with respect to the numbers.
    fn gradients(&self, slopes: &[f32]) -> Vec<[f32; NUMBERS]> {
        let planes = (slopes, &self.drawn[..], self.target.stride);
        let sums = self.drawing.sums(&self.circles, self.sides(), self.target.channels.count(), planes);
        let size = self.size();
        (self.numbers.iter().zip(&sums).zip(&self.circles))
            .map(|((n, sums), circle)| {
                let mut geometry = [0.0; 5];
                geometry.copy_from_slice(&sums[..5]);
                let slope = Slope::from_moments(geometry, circle.projected.conic, [0.0; 4]);
                let shape = shape_gradient(n, slope.covariance);
                let place = [slope.mean[0] * size[0], slope.mean[1] * size[1]];
                [place[0], place[1], shape[0], shape[1], shape[2], sums[5], sums[6], sums[7], sums[8]]
            })
            .collect()
    }

    /// Adds Gaussians where the error of the picture rendered last is large.
    fn grow(&mut self, count: usize) {
        let (channels, stride) = (self.target.channels.count(), self.target.stride);
        let [width, height] = self.sides();
        let soft = (0..channels).map(|k| softened(&self.target.plane(k), width, height)).collect::<Vec<_>>();
        let difference = |place: usize, k: usize| {
            let (x, y) = (place % width, place / width);
            soft[k][place] - self.drawn[y * (channels + 1) * stride + k * stride + x].clamp(0.0, 1.0)
        };
        let weights: Vec<f32> = (0..width * height)
            .map(|place| {
                let mean = (0..channels).map(|k| difference(place, k).abs()).sum::<f32>() / channels as f32;
                mean * mean
            })
            .collect();
        let added = self.most.min(count - self.numbers.len());
        let places = draw_without_replacement(&weights, added, &mut self.rng);
        let color = |place: usize| std::array::from_fn(|k| if k < channels { difference(place, k) } else { 0.0 });
        let new: Vec<_> = places.iter().map(|&place| new_numbers(self.target, place, color(place))).collect();
        self.numbers.extend(new);
        self.adam = Adam::new(self.numbers.len());
    }
}

/// Returns a new Gaussian at a pixel.
fn new_numbers(target: &Planes, place: usize, color: [f32; 4]) -> [f32; NUMBERS] {
    let (x, y) = (place % target.width as usize, place / target.width as usize);
    let inverse = 1.0 / INITIAL_SCALE;
    let [x, y] = [(x as f32 + 0.5) / target.width as f32, (y as f32 + 0.5) / target.height as f32];
    [x, y, inverse, inverse, 0.0, color[0], color[1], color[2], color[3]]
}

fn primitive(n: &[f32; NUMBERS], size: [f32; 2]) -> Primitive {
    // Pixel centres are at +0.5 here, and at integers there.
    let mean = [n[0] * size[0] + 0.5, n[1] * size[1] + 0.5];
    let log_scale = [n[2], n[3]].map(|inverse| -inverse.abs().max(1e-6).ln());
    Primitive { mean, log_scale, rotation: -n[4], color: [n[5], n[6], n[7], n[8]] }
}

/// Returns the gradient with respect to inverse scales and angle.
fn shape_gradient(n: &[f32; NUMBERS], [xx, xy, yy]: [f32; 3]) -> [f32; 3] {
    let (sin, cos) = (-n[4]).sin_cos();
    let uu = cos * cos * xx + 2.0 * cos * sin * xy + sin * sin * yy;
    let vv = sin * sin * xx - 2.0 * cos * sin * xy + cos * cos * yy;
    let uv = cos * sin * (yy - xx) + (cos * cos - sin * sin) * xy;
    // The variance along an axis is n⁻².
    let [a, b] = [n[2], n[3]];
    [-2.0 * uu / (a * a * a), -2.0 * vv / (b * b * b), -2.0 * uv * (1.0 / (a * a) - 1.0 / (b * b))]
}

/// Returns the squared magnitude of the Sobel gradient over all channels; the border is reflected.
fn gradients(target: &Planes) -> Vec<f32> {
    let [width, height] = [target.width as usize, target.height as usize];
    let mut squares = vec![0.0f32; width * height];
    for k in 0..target.channels.count() {
        let plane = target.plane(k);
        for (place, square) in squares.iter_mut().enumerate() {
            let (x, y) = ((place % width) as isize, (place / width) as isize);
            let at = |dx: isize, dy: isize| {
                // The sample at the border is its own neighbour.
                let [x, y] = [(x + dx).clamp(0, width as isize - 1), (y + dy).clamp(0, height as isize - 1)];
                plane[y as usize * width + x as usize]
            };
            let across = |dy: isize| at(1, dy) - at(-1, dy);
            let down = |dx: isize| at(dx, 1) - at(dx, -1);
            let [gx, gy] = [across(-1) + 2.0 * across(0) + across(1), down(-1) + 2.0 * down(0) + down(1)];
            *square += gx * gx + gy * gy;
        }
    }
    squares
}

/// Returns the target for computing errors, blurred if the picture's mean side is 400 pixels or more.
fn softened(plane: &[f32], width: usize, height: usize) -> Vec<f32> {
    let reach = ((width as f32 * height as f32).sqrt() / 400.0).floor() as usize;
    if reach == 0 {
        return plane.to_vec();
    }
    let taps = if reach.max(3).is_multiple_of(2) { reach.max(3) + 1 } else { reach.max(3) };
    // The default of torchvision for a kernel of this many taps.
    let sigma = 0.3 * ((taps as f32 - 1.0) * 0.5 - 1.0) + 0.8;
    let half = (taps / 2) as isize;
    let kernel: Vec<f32> = (-half..=half).map(|d| (-0.5 * (d as f32 / sigma).powi(2)).exp()).collect();
    let sum: f32 = kernel.iter().sum();
    let pass = |from: &[f32], along_x: bool| {
        let mut out = vec![0.0f32; from.len()];
        for (place, o) in out.iter_mut().enumerate() {
            let (x, y) = ((place % width) as isize, (place / width) as isize);
            for (i, weight) in kernel.iter().enumerate() {
                let d = i as isize - half;
                let [x, y] =
                    if along_x { [mirrored(x + d, width), y as usize] } else { [x as usize, mirrored(y + d, height)] };
                *o += weight / sum * from[y * width + x];
            }
        }
        out
    };
    pass(&pass(plane, true), false)
}

/// Mirrors a coordinate at the border samples.
fn mirrored(v: isize, side: usize) -> usize {
    let last = side as isize - 1;
    let v = v.abs();
    (if v > last { (2 * last - v).max(0) } else { v }) as usize
}

/// Draws positions without replacement by their weights (Efraimidis and Spirakis, 2006). If fewer have a weight, the
/// others are drawn uniformly.
fn draw_without_replacement(weights: &[f32], count: usize, rng: &mut Pcg64Mcg) -> Vec<usize> {
    let mut keys: Vec<(f32, usize)> = weights
        .iter()
        .enumerate()
        .map(|(i, w)| (-(1.0 - rng.random::<f32>()).max(f32::MIN_POSITIVE).ln() / w.max(1e-12), i))
        .collect();
    let count = count.min(keys.len());
    if count < keys.len() {
        keys.select_nth_unstable_by(count, |a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        keys.truncate(count);
    }
    let mut places: Vec<usize> = keys.iter().map(|k| k.1).collect();
    places.sort_unstable();
    places
}

#[cfg(test)]
mod tests {
    use super::*;
    use ssplat::Samples;
    use ssplat::unstable::gaussian::Channels;

    /// Returns a picture whose left half is flat and whose right half is noise.
    fn half_busy() -> Planes {
        let noise = |i: u32| (i.wrapping_mul(2_654_435_761) >> 24) as u8;
        let at = |i: u32| if i % 64 < 32 { 100 } else { noise(i) };
        let pixels = Pixels::new(64, 48, Channels::Grey, Samples::U8((0..64 * 48).map(at).collect())).unwrap();
        Planes::new(&pixels)
    }

    #[test]
    fn seven_tenths_start_where_the_gradient_is() {
        let target = half_busy();
        let run = Run::new(&target, &Options::new(400));
        assert_eq!(run.numbers.len(), 200);
        let right = run.numbers.iter().filter(|n| n[0] > 30.0 / 64.0).count();
        // 140 by the gradient, and about half of the 60 uniform ones.
        assert!((155..=190).contains(&right), "{right}");
        assert!(
            run.numbers.iter().all(|n| n[2] == 0.2 && (n[5] * 255.0).fract().min(1.0 - (n[5] * 255.0).fract()) < 1e-3)
        );
    }

    #[test]
    fn growth_adds_an_eighth_four_times_where_the_error_is() {
        let target = half_busy();
        let mut run = Run::new(&target, &Options::new(400));
        let mut counts = Vec::new();
        while run.numbers.len() < 400 {
            run.draw();
            let before = run.numbers.len();
            run.grow(400);
            counts.push(run.numbers.len());
            let right = run.numbers[before..].iter().filter(|n| n[0] > 30.0 / 64.0).count();
            assert!(right > 40, "{right} of 50 where the noise is");
        }
        assert_eq!(counts, [250, 300, 350, 400]);
    }

    #[test]
    fn rates_fall_once_and_then_the_fit_ends() {
        let mut schedule = Schedule { patience: 300, ..Schedule::default() };
        assert!(!schedule.is_over(30.0, 0.9, 100));
        let looks: Vec<(bool, u32)> = (0..6).map(|_| (schedule.is_over(30.05, 0.95, 100), schedule.decays)).collect();
        assert_eq!(looks, [(false, 0), (false, 0), (false, 1), (false, 1), (false, 1), (true, 2)]);
    }

    /// Returns a weighted sum of the samples in double precision, directly from the paper's equations: `Σ = Rᵀ
    /// diag(1/s²) R`, `a = exp(−½ dᵀ Σ⁻¹ d)`, and at each pixel the ten largest `a`, normalized by their sum plus
    /// 1e-4.
    fn mixture(size: [usize; 2], numbers: &[[f64; NUMBERS]], by: impl Fn(usize, usize, usize) -> f64) -> f64 {
        let mut sum = 0.0;
        for (x, y) in (0..size[1]).flat_map(|y| (0..size[0]).map(move |x| (x, y))) {
            let mut values: Vec<(f64, &[f64; NUMBERS])> = numbers
                .iter()
                .map(|n| {
                    let [dx, dy] = [x as f64 - n[0] * size[0] as f64, y as f64 - n[1] * size[1] as f64];
                    // R d with their matrix, in units of the scales.
                    let (sin, cos) = n[4].sin_cos();
                    let (u, v) = ((cos * dx - sin * dy) * n[2], (sin * dx + cos * dy) * n[3]);
                    ((-0.5 * (u * u + v * v)).exp(), n)
                })
                .collect();
            values.sort_by(|a, b| b.0.total_cmp(&a.0));
            values.truncate(10);
            let all = values.iter().map(|v| v.0).sum::<f64>() + 1e-4;
            for k in 0..3 {
                sum += by(x, y, k) * values.iter().map(|(a, n)| a * n[5 + k]).sum::<f64>() / all;
            }
        }
        sum
    }

    #[test]
    fn gradients_are_the_differences_of_the_published_equations_in_double_precision() {
        // One tile, so that all Gaussians are considered everywhere, and more than ten of them.
        let size = [16usize, 12];
        let pixels = Pixels::new(16, 12, Channels::Rgb, Samples::U8(vec![90; 16 * 12 * 3])).unwrap();
        let target = Planes::new(&pixels);
        let mut run = Run::new(&target, &Options::new(28));
        run.numbers = (0..14u32)
            .map(|i| {
                let f = |k: u32| (f64::from(i + 1) * f64::from(k).sqrt()).fract() as f32;
                let [x, y] = [0.1 + 0.8 * f(2), 0.1 + 0.8 * f(3)];
                [x, y, 0.15 + 0.2 * f(5), 0.12 + 0.2 * f(7), 3.0 * f(11), f(13), f(17), f(19), 0.0]
            })
            .collect();
        run.draw();
        let by = |x: usize, y: usize, k: usize| ((x * 7 + y * 13 + k * 5) % 11) as f64 / 5.0 - 1.0;
        let stride = target.stride;
        let mut slopes = vec![0.0; run.drawn.len()];
        for (x, y, k) in (0..12).flat_map(|y| (0..16).flat_map(move |x| (0..3).map(move |k| (x, y, k)))) {
            slopes[y * 4 * stride + k * stride + x] = by(x, y, k) as f32;
        }
        for (i, found) in run.gradients(&slopes).iter().enumerate() {
            let largest = found.iter().fold(0.0f32, |a, b| a.max(b.abs()));
            for k in 0..8 {
                let at = |step: f64| {
                    let mut moved: Vec<_> = run.numbers.iter().map(|n| n.map(f64::from)).collect();
                    moved[i][k] += step;
                    mixture(size, &moved, by)
                };
                let want = ((at(1e-7) - at(-1e-7)) / 2e-7) as f32;
                let near = (found[k] - want).abs() < 2e-3 * want.abs() + 2e-3 * largest;
                assert!(near, "{i} {k}: {} {want}", found[k]);
            }
        }
    }
}
