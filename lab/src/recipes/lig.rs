//! LIG (Zhu et al., "Large Images are Gaussians: High-Quality Large Image Representation with Levels of 2D Gaussian
//! Splatting", AAAI 2025, arXiv 2502.09039), after github.com/HKU-MedAI/LIG: `gaussianlig.py`, `train.py` and the
//! kernels of its `gsplat2d`.
//!
//! Two levels, each a clamped sum `I = Σ c exp(−σ)`. Positions are in pixels, and the three entries of the covariance
//! `Σ` are fitted directly. The first level has an eighth of the Gaussians (½ · 4⁻¹) and is fitted to the picture at
//! half its size, reduced by area means. The result is enlarged by bilinear interpolation and subtracted from the
//! picture. The residual is normalized to 0..1 by its minimum and maximum, and the second level is fitted to it.
//! Positions and entries of `Σ` are initialized at random (the entries in 0..1), colours with 0. The loss is the mean
//! squared error, the optimizer Adam with a rate of 0.018 for all numbers. Each level takes all iterations, 30 000 as
//! published; the rate would fall only after 70 000.
//!
//! `Σ` need not be positive definite, and more than half of the random ones are not. As in the published program, such
//! a Gaussian is drawn where its `σ` is not negative (`blended.rs`). The format cannot store it; in a file, its second
//! axis has the minimum scale.
//!
//! Difference from the published program: at the limit of 0.999, gradients use 0.999 and not 0.99.

use std::time::Instant;

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::blended::{self, Drawing, MIN_ALPHA, Rule, Splat};
use super::optimizer::{Adam, NUMBERS};
use super::tiles::Reach;
use super::{Counted, Fit, Options, Point, drawn};
use ssplat::unstable::fit::model::objective::planes::Planes;
use ssplat::unstable::gaussian::{Blend, Gaussian};

const RATE: f32 = 0.018;
/// Number of Gaussians of the first level relative to the total, before scaling with its number of pixels.
const FIRST_LEVEL_SHARE: f32 = 0.5;
/// Minimum scale in a file, pixels.
const MIN_SCALE: f32 = 0.02;

/// A picture in floats.
#[derive(Debug, Clone)]
struct Image {
    size: [usize; 2],
    pixels: Vec<[f32; 4]>,
}

/// State of the trace: the target, the time, and the points so far.
struct Watch<'a> {
    target: &'a Planes,
    options: &'a Options,
    truth: &'a Image,
    clock: Instant,
    /// Seconds spent on the trace.
    watching: f64,
    /// Iterations before this level.
    before: u32,
    trace: Vec<Point>,
}

impl Watch<'_> {
    fn see(&mut self, iteration: u32, whole: impl Fn() -> Image) {
        // Both levels share the points of the trace.
        if self.options.trace == 0
            || !iteration.is_multiple_of((2 * self.options.iterations).div_ceil(self.options.trace))
        {
            return;
        }
        let now = Instant::now();
        let seconds = self.clock.elapsed().as_secs_f64() - self.watching;
        let error = blended::squared_error(&self.truth.pixels, &whole().pixels);
        self.trace.push(Point { iteration: self.before + iteration, seconds, psnr: drawn::psnr(self.target, error) });
        self.watching += now.elapsed().as_secs_f64();
    }
}

pub(super) fn fit(target: &Planes, options: &Options) -> Fit {
    let channels = target.channels.count();
    let mut rng = Pcg64Mcg::seed_from_u64(options.seed);
    let truth = Image { size: [target.width, target.height].map(|v| v as usize), pixels: blended::pixels_of(target) };
    let small = truth.by_areas(truth.size.map(|v| (v / 2).max(1)));
    let first = (options.count as f32 * 0.25 * FIRST_LEVEL_SHARE) as usize;
    let (clock, trace) = (Instant::now(), Vec::with_capacity(options.trace as usize + 3));
    let mut watch = Watch { target, options, truth: &truth, clock, watching: 0.0, before: 0, trace };
    let coarse = level(&small, first, options, &mut rng, |iteration, drawn| {
        watch.see(iteration, || drawn.enlarged(truth.size));
    });
    let base = draw(&coarse, small.size).enlarged(truth.size);
    let mut rest = truth.clone();
    rest.pixels.iter_mut().zip(&base.pixels).for_each(|(r, b)| (0..channels).for_each(|k| r[k] -= b[k]));
    let values = || rest.pixels.iter().flat_map(|p| &p[..channels]);
    let [least, largest] = values().fold([f32::INFINITY, f32::NEG_INFINITY], |r, &v| [r[0].min(v), r[1].max(v)]);
    // A constant residual cannot be normalized; the published program divides by zero.
    let range = if largest > least { largest - least } else { 1.0 };
    rest.pixels.iter_mut().for_each(|p| (0..channels).for_each(|k| p[k] = (p[k] - least) / range));
    let whole = |fine: &Image| {
        let add = |(b, f): (&[f32; 4], &[f32; 4])| {
            std::array::from_fn(|k| if k < channels { b[k] + f[k] * range + least } else { 0.0 })
        };
        Image { size: truth.size, pixels: base.pixels.iter().zip(&fine.pixels).map(add).collect() }
    };
    watch.before = options.iterations;
    let fine = level(&rest, options.count - first, options, &mut rng, |iteration, drawn| {
        watch.see(iteration, || whole(drawn));
    });
    let image = whole(&draw(&fine, truth.size));
    let seconds = watch.clock.elapsed().as_secs_f64() - watch.watching;
    let psnr = drawn::psnr(target, blended::squared_error(&truth.pixels, &image.pixels));
    let mut trace = watch.trace;
    trace.extend((options.trace > 0).then_some(Point { iteration: 2 * options.iterations, seconds, psnr }));
    let zoom = [0, 1].map(|k| truth.size[k] as f32 / small.size[k] as f32);
    let mut gaussians: Vec<Gaussian> = coarse.iter().map(|n| gaussian(n, zoom, 1.0)).collect();
    gaussians.extend(fine.iter().map(|n| gaussian(n, [1.0; 2], range)));
    let mut picture = drawn::picture(target, Blend::Sum, gaussians);
    picture.background[..channels].fill(least);
    let pixels = drawn::pixels(target, &blended::field(target, &image.pixels).planes);
    // Its numbers and the two of the normalization, as its program stores them.
    let counted = Some(Counted { bytes: 4 * (options.count * (5 + channels) + 2) as u64, coded: None, psnr });
    Fit { pixels, psnr, picture, seconds, iterations: options.iterations, trace, counted, estimate: None }
}

/// Fits one level. `see` is called with each picture before its step.
fn level(
    target: &Image,
    count: usize,
    options: &Options,
    rng: &mut Pcg64Mcg,
    mut see: impl FnMut(u32, &Image),
) -> Vec<[f32; NUMBERS]> {
    let size = target.size.map(|v| v as f32);
    let mut numbers: Vec<[f32; NUMBERS]> = (0..count)
        .map(|_| {
            let random: [f32; 5] = std::array::from_fn(|_| rng.random());
            [random[0] * size[0], random[1] * size[1], random[2], random[3], random[4], 0.0, 0.0, 0.0, 0.0]
        })
        .collect();
    let mut adam = Adam::new(count);
    for iteration in 0..options.iterations {
        let splats: Vec<Splat> = numbers.iter().map(splat).collect();
        let drawing = Drawing::new(&splats, target.size, Rule::Sum);
        // The mean over three channels, as there, because Adam's quotients depend on its magnitude.
        let samples = (3 * target.pixels.len()) as f32;
        let slope = |(v, t): (&[f32; 4], &[f32; 4])| {
            std::array::from_fn(|k| if (0.0..=1.0).contains(&v[k]) { 2.0 * (v[k] - t[k]) / samples } else { 0.0 })
        };
        let slopes: Vec<[f32; 4]> = drawing.pixels.iter().zip(&target.pixels).map(slope).collect();
        let found = drawing.gradients(&splats, target.size[0], Rule::Sum, &slopes);
        see(iteration, &clamped(drawing, target.size));
        let gradients: Vec<_> = found.iter().map(gradient).collect();
        adam.step(&mut numbers, &gradients, [options.rate * RATE; NUMBERS]);
    }
    numbers
}

fn clamped(drawing: Drawing, size: [usize; 2]) -> Image {
    let mut pixels = drawing.pixels;
    pixels.iter_mut().flatten().for_each(|v| *v = v.clamp(0.0, 1.0));
    Image { size, pixels }
}

fn draw(numbers: &[[f32; NUMBERS]], size: [usize; 2]) -> Image {
    let splats: Vec<Splat> = numbers.iter().map(splat).collect();
    clamped(Drawing::new(&splats, size, Rule::Sum), size)
}

fn splat(n: &[f32; NUMBERS]) -> Splat {
    let [xx, xy, yy] = [n[2], n[3], n[4]];
    let determinant = xx * yy - xy * xy;
    let conic = [yy / determinant, -xy / determinant, xx / determinant];
    // Distance at which the value falls to the minimum. The root of a negative number is NaN, which is drawn nowhere.
    let half = [xx, yy].map(|v| (-2.0 * MIN_ALPHA.ln() * v).sqrt().ceil());
    let half = if half.iter().all(|v| *v > 0.0) && determinant != 0.0 { half } else { [0.0; 2] };
    let reach = Reach { center: [n[0], n[1]], half };
    let color = [n[5], n[6], n[7], n[8]];
    Splat { center: [n[0] - 0.5, n[1] - 0.5], conic, reach, opacity: 1.0, color }
}

/// Returns the gradient with respect to the numbers.
fn gradient(found: &blended::Gradient) -> [f32; NUMBERS] {
    let ([gx, gy], [xx, xy, yy], c) = (found.slope.mean, found.slope.covariance, found.slope.color);
    // One number represents two entries.
    let all = [gx, gy, xx, 2.0 * xy, yy, c[0], c[1], c[2], c[3]];
    if all.iter().all(|v| v.is_finite()) { all } else { [0.0; NUMBERS] }
}

/// Returns the Gaussian in a picture `zoom` times as large, with colours times `gain`.
fn gaussian(n: &[f32; NUMBERS], zoom: [f32; 2], gain: f32) -> Gaussian {
    let [xx, xy, yy] = [n[2] * zoom[0] * zoom[0], n[3] * zoom[0] * zoom[1], n[4] * zoom[1] * zoom[1]];
    let (middle, spread) = (0.5 * (xx + yy), (0.5 * (xx - yy)).hypot(xy));
    let scale = [middle + spread, middle - spread].map(|v| v.max(MIN_SCALE * MIN_SCALE).sqrt());
    let rotation = (0.5 * (2.0 * xy).atan2(xx - yy)).rem_euclid(std::f32::consts::PI);
    // A Gaussian that is not drawn there gets no colour here.
    let shown = if xx > 0.0 && yy > 0.0 { gain } else { 0.0 };
    Gaussian { mean: [n[0] * zoom[0], n[1] * zoom[1]], scale, rotation, color: [5, 6, 7, 8].map(|k| shown * n[k]) }
}

impl Image {
    /// Reduces the picture by area means over whole pixels: from `floor(i s / n)` to `ceil((i + 1) s / n)`.
    fn by_areas(&self, size: [usize; 2]) -> Image {
        let range = |i: usize, k: usize| i * self.size[k] / size[k]..((i + 1) * self.size[k]).div_ceil(size[k]);
        let mut pixels = Vec::with_capacity(size[0] * size[1]);
        for (y, x) in (0..size[1]).flat_map(|y| (0..size[0]).map(move |x| (y, x))) {
            let (mut sum, mut count) = ([0.0f32; 4], 0.0);
            for (py, px) in range(y, 1).flat_map(|py| range(x, 0).map(move |px| (py, px))) {
                let pixel = &self.pixels[py * self.size[0] + px];
                (0..4).for_each(|k| sum[k] += pixel[k]);
                count += 1.0;
            }
            pixels.push(sum.map(|s| s / count));
        }
        Image { size, pixels }
    }

    /// Enlarges the picture by bilinear interpolation between pixel centres; the border is repeated.
    fn enlarged(&self, size: [usize; 2]) -> Image {
        let at = |i: usize, k: usize| {
            let place = ((i as f32 + 0.5) * self.size[k] as f32 / size[k] as f32 - 0.5).max(0.0);
            let first = (place as usize).min(self.size[k] - 1);
            (first, (first + 1).min(self.size[k] - 1), place - first as f32)
        };
        let mut pixels = Vec::with_capacity(size[0] * size[1]);
        for y in 0..size[1] {
            let (top, bottom, v) = at(y, 1);
            for x in 0..size[0] {
                let (left, right, u) = at(x, 0);
                let pixel = |x: usize, y: usize| &self.pixels[y * self.size[0] + x];
                pixels.push(std::array::from_fn(|k| {
                    let row = |y: usize| pixel(left, y)[k] * (1.0 - u) + pixel(right, y)[k] * u;
                    row(top) * (1.0 - v) + row(bottom) * v
                }));
            }
        }
        Image { size, pixels }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recipes::blended::differences;

    const SIZE: [usize; 2] = [24, 20];

    /// Returns `½ dᵀ Σ⁻¹ d` at a pixel.
    fn sigma(n: &[f64; NUMBERS], x: usize, y: usize) -> f64 {
        let [dx, dy] = [x as f64 + 0.5 - n[0], y as f64 + 0.5 - n[1]];
        let [xx, xy, yy] = [n[2], n[3], n[4]];
        0.5 * (yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy) / (xx * yy - xy * xy)
    }

    /// Returns a weighted sum of the samples in double precision: `I = Σ c exp(−σ)` where `σ` is not negative.
    fn mixture(numbers: &[[f64; NUMBERS]], by: impl Fn(usize, usize, usize) -> f64) -> f64 {
        let mut sum = 0.0;
        for (x, y) in (0..SIZE[1]).flat_map(|y| (0..SIZE[0]).map(move |x| (x, y))) {
            for n in numbers {
                let sigma = sigma(n, x, y);
                if sigma >= 0.0 && (-sigma).exp() >= 1.0 / 255.0 {
                    sum += (0..3).map(|k| by(x, y, k) * (-sigma).exp() * n[5 + k]).sum::<f64>();
                }
            }
        }
        sum
    }

    #[test]
    fn gradients_are_the_differences_of_the_published_equations_in_double_precision() {
        // The last two are not ellipses.
        let numbers: [[f32; NUMBERS]; 4] = [
            [9.3, 8.1, 31.0, 6.0, 17.0, 0.3, -0.2, 0.4, 0.0],
            [14.2, 11.9, 15.0, -9.0, 41.0, -0.7, 0.2, 0.1, 0.0],
            [12.6, 9.7, 18.0, 23.0, 20.0, 0.1, 0.9, -0.6, 0.0],
            [11.4, 10.3, 16.0, -31.0, 22.0, 0.5, 0.2, 0.6, 0.0],
        ];
        let doubles = numbers.map(|n| n.map(f64::from));
        let by = |x: usize, y: usize, k: usize| {
            // Gradients pass through the limit near 1, where the value is constant; such pixels are excluded.
            let is_free = doubles.iter().all(|n| !(-1e-6..2e-3).contains(&sigma(n, x, y)));
            if is_free { ((x * 7 + y * 13 + k * 5) % 11) as f64 / 5.0 - 1.0 } else { 0.0 }
        };
        let splats: Vec<Splat> = numbers.iter().map(splat).collect();
        let drawing = Drawing::new(&splats, SIZE, Rule::Sum);
        let slopes = differences::slopes(SIZE, by);
        let found = drawing.gradients(&splats, SIZE[0], Rule::Sum, &slopes);
        for (i, g) in found.iter().enumerate() {
            differences::assert_near(&gradient(g)[..8], &doubles, i, |moved| mixture(moved, by));
        }
    }

    #[test]
    fn halving_takes_means_and_enlarging_goes_between_centres() {
        let ramp = Image { size: [5, 2], pixels: (0..10).map(|i| [(i % 5) as f32; 4]).collect() };
        let small = ramp.by_areas([2, 1]);
        // From 0 to 3 and from 2 to 5.
        assert_eq!(small.pixels, [[1.0; 4], [3.0; 4]]);
        let large = Image { size: [2, 1], pixels: vec![[1.0; 4], [3.0; 4]] }.enlarged([4, 1]);
        assert_eq!(large.pixels, [[1.0; 4], [1.5; 4], [2.5; 4], [3.0; 4]]);
    }

    #[test]
    fn a_gaussian_of_the_first_level_is_twice_as_large_in_the_picture() {
        let g = gaussian(&[3.0, 4.0, 5.0, 0.0, 2.0, 0.3, 0.2, 0.1, 0.0], [2.0, 2.0], 0.5);
        assert_eq!((g.mean, g.color), ([6.0, 8.0], [0.15, 0.1, 0.05, 0.0]));
        assert!((g.scale[0] - 20.0f32.sqrt()).abs() < 1e-5 && (g.scale[1] - 8.0f32.sqrt()).abs() < 1e-5, "{g:?}");
    }
}
