//! 3D Gaussian Splatting (Kerbl et al., "3D Gaussian Splatting for Real-Time Radiance Field Rendering", SIGGRAPH 2023,
//! arXiv 2308.04079) in the plane, as papers on image representation use it for comparison: 2D Gaussians with opacity,
//! blended from front to back in the order in which they are stored. After
//! github.com/graphdeco-inria/gaussian-splatting: `arguments`, `gaussian_model.py`, `train.py`, and the kernels of its
//! rasterizer.
//!
//! `α = o exp(−σ)`, with `o = sigmoid(p)`, initially 0.1; `Σ = R S Sᵀ Rᵀ + 0.3` pixel²; colours are `½ + 0.282 f` and
//! at least 0, as for spherical harmonics of degree 0; the background is black. Limits are in `blended.rs`. Scales are
//! initialized with the root mean square distance to the three nearest neighbours. The loss is 0.8 of the absolute
//! error plus 0.2 · (1 − SSIM). Adam has rates of 0.00016 falling to 0.0000016 for positions, 0.0025 for colours, 0.05
//! for opacities, 0.005 for logarithms of scales, and 0.001 for quaternions, which is 0.002 for an angle. The
//! published number of iterations is 30 000.
//!
//! Differences from the published program: all Gaussians lie at the same distance, and the scene's extent, the unit of
//! positions, is half the picture's longer side. Gaussians are initialized at random positions with the picture's
//! colours, because there is no reconstruction that provides points. Their initial number is half of the requested
//! one, which growth and pruning (`densify.rs`) do not exceed. [`Number::Stays`] starts with all of them instead and
//! keeps them. The loss is computed after a clamp.

use std::time::Instant;

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::blended::{self, Drawing, Rule, Splat};
use super::densify::{Due, Growth, Population, logit};
use super::estimate;
use super::optimizer::{Adam, NUMBERS};
use super::tiles::Reach;
use super::{Counted, Fit, Options, Point, drawn};
use crate::loss::Loss;
use ssplat::unstable::fit::model::objective::planes::Planes;
use ssplat::unstable::fit::model::problem::{Problem, Scene};
use ssplat::unstable::gaussian::{Blend, Gaussian};

const PLACE_RATES: [f32; 2] = [1.6e-4, 1.6e-6];
const SCALE_RATE: f32 = 5e-3;
const ANGLE_RATE: f32 = 2e-3;
const COLOR_RATE: f32 = 2.5e-3;
const OPACITY_RATE: f32 = 5e-2;
const ABSOLUTE: f32 = 0.8;
const OPACITY: f32 = 0.1;
/// Spherical harmonic of degree 0.
const HARMONIC: f32 = 0.282_094_8;
/// Variance added to the diagonal of the covariance as a low-pass filter, pixels².
const LOW_PASS: f32 = 0.3;
/// Relative steps for rounding the numbers for the estimate of the size: pixels, logarithms, radians, colours in units
/// of `1 / HARMONIC`, and the argument of the sigmoid.
const STEPS: [f32; NUMBERS] = [0.25, 0.25, 0.1, 0.1, 0.1, 0.07, 0.07, 0.07, 0.2];

/// Whether the number of Gaussians changes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Number {
    /// As published.
    Grows,
    Stays,
}

pub(super) fn fit(target: &Planes, number: Number, options: &Options) -> Fit {
    let (width, channels) = (target.width as usize, target.channels.count());
    let size = [target.width, target.height];
    let unit = 0.5 * target.width.max(target.height) as f32;
    let scene = Scene { width: target.width, height: target.height, blend: Blend::Sum, background: [0.0; 4] };
    let (truth, mut loss) = (blended::pixels_of(target), Loss::new(target, ABSOLUTE));
    let mut rng = Pcg64Mcg::seed_from_u64(options.seed);
    let first = if number == Number::Grows { options.count.div_ceil(2) } else { options.count };
    let numbers = start(target, first, &mut rng);
    let mut population = Population { adam: Adam::new(numbers.len()), numbers };
    let samples = (width * target.height as usize * channels) as f32;
    let mut growth = Growth::new(rng, size.map(|s| s as f32), samples, (unit, options.count));
    let (mut trace, mut watching) = (Vec::new(), 0.0);
    let clock = Instant::now();
    let psnr = |drawing: &Drawing| drawn::psnr(target, blended::squared_error(&truth, &drawing.pixels));
    for iteration in 0..options.iterations {
        let splats: Vec<Splat> = population.numbers.iter().map(splat).collect();
        let drawing = Drawing::new(&splats, size.map(|v| v as usize), Rule::FrontToBack);
        if options.trace > 0 && iteration.is_multiple_of(options.iterations.div_ceil(options.trace)) {
            let now = Instant::now();
            let seconds = clock.elapsed().as_secs_f64() - watching;
            trace.push(Point { iteration, seconds, psnr: psnr(&drawing) });
            watching += now.elapsed().as_secs_f64();
        }
        let mut field = blended::field(target, &drawing.pixels);
        // The gradient of a sum is that with respect to the picture itself. It is the gradient of a total and not of a
        // mean, which keeps Adam's epsilon far below the divisors, as in the published program.
        loss.gradient(&Problem { scene, target }, &mut field);
        let slopes = blended::from_field(target, &field);
        let found = drawing.gradients(&splats, width, Rule::FrontToBack, &slopes);
        let gradients: Vec<_> = population.numbers.iter().zip(&found).map(|(n, g)| gradient(n, g, channels)).collect();
        let done = iteration as f32 / options.iterations as f32;
        let place = unit * PLACE_RATES[0] * (PLACE_RATES[1] / PLACE_RATES[0]).powf(done);
        let [scale, color] = [SCALE_RATE, COLOR_RATE];
        let rates = [place, place, scale, scale, ANGLE_RATE, color, color, color, OPACITY_RATE];
        let seen = found.iter().zip(&splats).map(|(g, s)| (g.slope.mean, s.reach.meets(size)));
        let due = Due::after(iteration + 1, options.iterations);
        if number == Number::Stays || growth.passes(&mut population, seen, due) {
            population.adam.step(&mut population.numbers, &gradients, rates.map(|r| r * options.rate));
        }
    }
    let numbers = population.numbers;
    let draw = |numbers: &[[f32; NUMBERS]]| {
        let splats: Vec<Splat> = numbers.iter().map(splat).collect();
        Drawing::new(&splats, size.map(|v| v as usize), Rule::FrontToBack)
    };
    let drawing = draw(&numbers);
    let (seconds, psnr_of_floats) = (clock.elapsed().as_secs_f64() - watching, psnr(&drawing));
    let last = Point { iteration: options.iterations, seconds, psnr: psnr_of_floats };
    trace.extend((options.trace > 0).then_some(last));
    let estimate = options.bytes.and_then(|bytes| {
        // The fourth colour holds the opacity; a grey picture does not use the second and the third.
        let used: Vec<usize> = (0..5 + channels).chain([8]).collect();
        let (bytes, rounded) = estimate::rounded(&numbers, &STEPS, &used, bytes)?;
        Some(Counted { bytes, coded: None, psnr: psnr(&draw(&rounded)) })
    });
    let picture = drawn::picture(target, Blend::Normalized, numbers.iter().map(gaussian).collect());
    let field = blended::field(target, &drawing.pixels);
    let pixels = drawn::pixels(target, &field.planes);
    Fit {
        pixels,
        psnr: psnr_of_floats,
        picture,
        seconds,
        iterations: options.iterations,
        trace,
        counted: None,
        estimate,
    }
}

/// Returns Gaussians at random positions in pixels, with the colours of the picture and scales by the three nearest.
fn start(target: &Planes, count: usize, rng: &mut Pcg64Mcg) -> Vec<[f32; NUMBERS]> {
    let size = [target.width as f32, target.height as f32];
    let places: Vec<[f32; 2]> = (0..count).map(|_| size.map(|s| s * rng.random::<f32>())).collect();
    let opacity = logit(OPACITY);
    let distances = nearest(&places);
    (places.iter().zip(distances))
        .map(|(place, square)| {
            // A single Gaussian has no neighbour and gets the picture's size.
            let scale = if square.is_finite() { 0.5 * square.max(1e-7).ln() } else { size[0].max(size[1]).ln() };
            let color = target.at(*place).map(|c| (c - 0.5) / HARMONIC);
            [place[0], place[1], scale, scale, 0.0, color[0], color[1], color[2], opacity]
        })
        .collect()
}

/// Returns the mean squared distance of each position to the three nearest ones, or to all others if there are fewer.
fn nearest(places: &[[f32; 2]]) -> Vec<f32> {
    let mut order: Vec<usize> = (0..places.len()).collect();
    order.sort_by(|&a, &b| places[a][0].total_cmp(&places[b][0]));
    let mut out = vec![f32::INFINITY; places.len()];
    for (rank, &i) in order.iter().enumerate() {
        let mut best = [f32::INFINITY; 3];
        let mut see = |j: usize| {
            let [dx, dy] = [0, 1].map(|k| places[i][k] - places[j][k]);
            if dx * dx > best[2] {
                return false;
            }
            let square = dx * dx + dy * dy;
            if square < best[2] {
                best[2] = square;
                best.sort_by(f32::total_cmp);
            }
            true
        };
        // Search outwards along x, until the distance along x alone is too large.
        let _ = order[rank + 1..].iter().all(|&j| see(j));
        let _ = order[..rank].iter().rev().all(|&j| see(j));
        let known: Vec<f32> = best.into_iter().filter(|v| v.is_finite()).collect();
        if !known.is_empty() {
            out[i] = known.iter().sum::<f32>() / known.len() as f32;
        }
    }
    out
}

/// Variances along the axes, after the low-pass filter.
fn variances(n: &[f32; NUMBERS]) -> [f32; 2] {
    [n[2], n[3]].map(|l| (2.0 * l).exp() + LOW_PASS)
}

fn color(n: &[f32; NUMBERS]) -> [f32; 4] {
    let [a, b, c] = [n[5], n[6], n[7]].map(|f| (0.5 + HARMONIC * f).max(0.0));
    [a, b, c, 0.0]
}

fn splat(n: &[f32; NUMBERS]) -> Splat {
    let [a, b] = variances(n);
    let (sin, cos) = n[4].sin_cos();
    let conic = [cos * cos / a + sin * sin / b, cos * sin * (1.0 / a - 1.0 / b), sin * sin / a + cos * cos / b];
    let center = [n[0] - 0.5, n[1] - 0.5];
    let reach = Reach { center, half: [(3.0 * a.max(b).sqrt()).ceil(); 2] };
    Splat { center, conic, reach, opacity: 1.0 / (1.0 + (-n[8]).exp()), color: color(n) }
}

fn gaussian(n: &[f32; NUMBERS]) -> Gaussian {
    let [a, b] = variances(n).map(f32::sqrt);
    let turned = if a >= b { 0.0 } else { std::f32::consts::FRAC_PI_2 };
    let rotation = (n[4] + turned).rem_euclid(std::f32::consts::PI);
    Gaussian { mean: [n[0], n[1]], scale: [a.max(b), a.min(b)], rotation, color: color(n) }
}

/// Returns the gradient with respect to the numbers.
fn gradient(n: &[f32; NUMBERS], found: &blended::Gradient, channels: usize) -> [f32; NUMBERS] {
    let ([xx, xy, yy], [gx, gy]) = (found.slope.covariance, found.slope.mean);
    let (sin, cos) = n[4].sin_cos();
    let uu = cos * cos * xx + 2.0 * cos * sin * xy + sin * sin * yy;
    let vv = sin * sin * xx - 2.0 * cos * sin * xy + cos * cos * yy;
    let uv = cos * sin * (yy - xx) + (cos * cos - sin * sin) * xy;
    let [a, b] = [n[2], n[3]].map(|l| (2.0 * l).exp());
    let opacity = 1.0 / (1.0 + (-n[8]).exp());
    let mut all = [gx, gy, 2.0 * a * uu, 2.0 * b * vv, 2.0 * (a - b) * uv, 0.0, 0.0, 0.0, 0.0];
    for k in 0..channels {
        all[5 + k] = if 0.5 + HARMONIC * n[5 + k] > 0.0 { HARMONIC * found.slope.color[k] } else { 0.0 };
    }
    all[8] = found.log_opacity * (1.0 - opacity);
    // A Gaussian whose gradient overflows gets none.
    if all.iter().all(|v| v.is_finite()) { all } else { [0.0; NUMBERS] }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recipes::blended::differences;

    const SIZE: [usize; 2] = [24, 20];

    /// Returns a weighted sum of the samples in double precision, directly from the paper's equations: each pixel
    /// visits all Gaussians from the first to the last.
    fn mixture(numbers: &[[f64; NUMBERS]], by: impl Fn(usize, usize, usize) -> f64) -> f64 {
        let mut sum = 0.0;
        for (x, y) in (0..SIZE[1]).flat_map(|y| (0..SIZE[0]).map(move |x| (x, y))) {
            let (mut light, mut color) = (1.0, [0.0; 3]);
            for n in numbers {
                let [dx, dy] = [x as f64 + 0.5 - n[0], y as f64 + 0.5 - n[1]];
                let (sin, cos) = n[4].sin_cos();
                let [a, b] = [n[2], n[3]].map(|l| (2.0 * l).exp());
                let [xx, xy, yy] = [
                    cos * cos * a + sin * sin * b + f64::from(LOW_PASS),
                    cos * sin * (a - b),
                    sin * sin * a + cos * cos * b + f64::from(LOW_PASS),
                ];
                let sigma = 0.5 * (yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy) / (xx * yy - xy * xy);
                let alpha = ((-sigma).exp() / (1.0 + (-n[8]).exp())).min(0.99);
                if alpha < 1.0 / 255.0 {
                    continue;
                }
                if light * (1.0 - alpha) < 1e-4 {
                    break;
                }
                for k in 0..3 {
                    color[k] += light * alpha * (0.5 + f64::from(HARMONIC) * n[5 + k]).max(0.0);
                }
                light *= 1.0 - alpha;
            }
            sum += (0..3).map(|k| by(x, y, k) * color[k]).sum::<f64>();
        }
        sum
    }

    #[test]
    fn gradients_are_the_differences_of_the_published_equations_in_double_precision() {
        // Each reaches all tiles. The last is behind four that are nearly opaque in the middle, where no light is
        // left.
        let numbers: Vec<[f32; NUMBERS]> = vec![
            [9.3, 8.1, 2.1, 1.2, 0.7, 0.9, -0.3, 0.4, -0.5],
            [14.2, 11.9, 1.9, 2.4, 2.3, -0.7, 0.2, 1.4, 3.1],
            [12.6, 9.7, 2.3, 1.7, -0.4, 0.1, -2.9, 0.6, 3.4],
            [11.1, 10.4, 2.2, 2.0, 1.1, 0.6, 0.8, -0.9, 3.6],
            [12.3, 10.2, 2.6, 2.4, 0.2, 0.3, 0.5, 0.2, 3.9],
            [10.3, 9.2, 2.0, 2.2, 0.5, -0.2, 1.1, 0.7, 1.0],
        ];
        let by = |x: usize, y: usize, k: usize| ((x * 7 + y * 13 + k * 5) % 11) as f64 / 5.0 - 1.0;
        let splats: Vec<Splat> = numbers.iter().map(splat).collect();
        let drawing = Drawing::new(&splats, SIZE, Rule::FrontToBack);
        let slopes = differences::slopes(SIZE, by);
        let doubles: Vec<_> = numbers.iter().map(|n| n.map(f64::from)).collect();
        let drawn: f64 = (drawing.pixels.iter().zip(&slopes))
            .map(|(p, s)| (0..3).map(|k| f64::from(p[k]) * f64::from(s[k])).sum::<f64>())
            .sum();
        let want = mixture(&doubles, by);
        assert!((drawn - want).abs() < 1e-3 * want.abs().max(1.0), "{drawn} {want}");
        let found = drawing.gradients(&splats, SIZE[0], Rule::FrontToBack, &slopes);
        for (i, g) in found.iter().enumerate() {
            differences::assert_near(&gradient(&numbers[i], g, 3)[..NUMBERS], &doubles, i, |moved| mixture(moved, by));
        }
    }

    #[test]
    fn scales_start_by_the_three_nearest() {
        let places: Vec<[f32; 2]> = (0..60).map(|i| [(i * 37 % 61) as f32, (i * 23 % 59) as f32]).collect();
        for (i, found) in nearest(&places).into_iter().enumerate() {
            let square = |p: &[f32; 2]| (p[0] - places[i][0]).powi(2) + (p[1] - places[i][1]).powi(2);
            let mut all: Vec<f32> = places.iter().map(square).collect();
            all.sort_by(f32::total_cmp);
            assert!((found - (all[1] + all[2] + all[3]) / 3.0).abs() < 1e-3, "{i}: {found} {all:?}");
        }
    }
}
