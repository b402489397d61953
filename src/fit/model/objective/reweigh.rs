//! New pixel weights during the fit: errors weigh more where the picture has lost structure that costs little to keep.
//!
//! Weights that are based on the target alone ([`masking`]) cannot know where the primitives fail. SSIMULACRA2 takes
//! most of its score from the fourth norm of the lost structure at full size, and from its mean at a quarter and an
//! eighth of that size. Each pixel's share of that score, divided by its share of the weighted squared error, is the
//! worth of a lower error there. It varies by a factor of ten across a picture. Equal worth everywhere would be optimal
//! for the score, but would cost too many decibels, so [`fit::WORTH_EXPONENT`] applies only a part of it.
//!
//! [`masking`]: crate::fit::model::objective::masking

use crate::constants::fit;
use crate::fit::model::drawing::field::Field;
use crate::fit::model::objective::blur::blur;
use crate::fit::model::objective::masking::{normalized, pixels_each, upsampled};
use crate::fit::model::objective::planes::Planes;
use crate::fit::model::placing::sample::halve;
use crate::parallel;
use crate::strict_math::StrictMath;

/// How often the picture is halved before the worth is computed: one value per cell of 8 × 8 pixels.
const HALVINGS: usize = 3;

/// Returns the amplitudes that replace [`Planes::amplitude`] of `target`. `field` contains the current picture of
/// `count` primitives.
pub(crate) fn amplitudes(target: &Planes, field: &Field, count: usize) -> Vec<f32> {
    let size = [target.width as usize, target.height as usize];
    let power = fit::WORTH_EXPONENT * (fit::WORTH_DENSE_PIXELS / pixels_each(target, count)).min(1.0).sqrt();
    let [wanted, drawn] = lumas(target, field);
    let errors = cells(errors(target, [&wanted, &drawn]), size);
    let shares = cells(shares([wanted, drawn], size), size);
    let all = |v: &[f32]| v.iter().map(|&v| f64::from(v)).sum::<f64>();
    let (share, error) = (all(&shares), all(&errors));
    let scale = (error / share.max(f64::MIN_POSITIVE)) as f32;
    let least = (1e-6 * error / errors.len() as f64) as f32 + f32::MIN_POSITIVE;
    let worth = shares
        .iter()
        .zip(&errors)
        .map(|(s, e)| (scale * s / (e + least)).clamp(fit::MIN_WORTH, fit::MAX_WORTH).strict_powf(power));
    let mut worth: Vec<f32> = worth.collect();
    for pair in sizes(size, HALVINGS).windows(2).rev() {
        worth = upsampled(&worth, pair[1], pair[0]);
    }
    for (y, row) in worth.chunks_exact_mut(size[0]).enumerate() {
        if let Some(amplitude) = target.amplitude(y as u32) {
            row.iter_mut().zip(amplitude).for_each(|(w, a)| *w *= a * a);
        }
    }
    normalized(target, &worth, None)
}

/// Returns the picture's size and `halvings` further sizes, each half the previous one.
fn sizes(size: [usize; 2], halvings: usize) -> Vec<[usize; 2]> {
    std::iter::successors(Some(size), |s| Some(s.map(|v| v.div_ceil(2)))).take(halvings + 1).collect()
}

/// Returns the means over blurred cells.
fn cells(mut plane: Vec<f32>, size: [usize; 2]) -> Vec<f32> {
    let sizes = sizes(size, HALVINGS);
    for [w, h] in &sizes[..HALVINGS] {
        plane = halve(&plane, *w, *h);
    }
    let [w, h] = sizes[HALVINGS];
    blur(&blur(&plane, w, h), w, h)
}

/// Returns the squared luma errors of the pixels, weighted as in the fit.
fn errors(target: &Planes, [wanted, drawn]: [&[f32]; 2]) -> Vec<f32> {
    let width = target.width as usize;
    let mut errors = vec![0.0f32; width * target.height as usize];
    parallel::map_chunks(&mut errors, width, |y, out| {
        let amplitude = target.amplitude(y as u32);
        for (x, o) in out.iter_mut().enumerate() {
            let e = drawn[y * width + x] - wanted[y * width + x];
            *o = (e * amplitude.map_or(1.0, |a| a[x])).powi(2);
        }
    });
    errors
}

/// Returns each pixel's share of the score.
fn shares([mut wanted, mut drawn]: [Vec<f32>; 2], size: [usize; 2]) -> Vec<f32> {
    let sizes = sizes(size, fit::WORTH_SIZE_WEIGHTS.len() - 1);
    let mut lost = Vec::new();
    for (&[w, h], [of_mean, of_norm]) in sizes.iter().zip(fit::WORTH_SIZE_WEIGHTS) {
        let (mut at_size, fourth) = lost_structure([&wanted, &drawn], [w, h]);
        // The derivative of the norm with respect to each loss, times the loss.
        let of_norm = of_norm / (fourth as f32).strict_powf(0.75).max(1e-20);
        at_size.iter_mut().for_each(|l| *l *= of_mean + of_norm * *l * *l * *l);
        lost.push(at_size);
        (wanted, drawn) = (halve(&wanted, w, h), halve(&drawn, w, h));
    }
    let mut shares = lost.pop().expect("several sizes");
    for (pair, of_size) in sizes.windows(2).zip(lost).rev() {
        shares = upsampled(&shares, pair[1], pair[0]);
        shares.iter_mut().zip(of_size).for_each(|(s, l)| *s += l);
    }
    shares
}

/// Returns the luma or grey values of the target and of the current picture, multiplied by the target's opacity.
fn lumas(target: &Planes, field: &Field) -> [Vec<f32>; 2] {
    let (width, count) = (target.width as usize, target.channels.count());
    let luma: &[f32] = if count < 3 { &[1.0] } else { &fit::LUMA_WEIGHTS };
    [false, true].map(|is_drawn| {
        let mut plane = vec![0.0f32; width * target.height as usize];
        parallel::map_chunks(&mut plane, width, |y, out| {
            let wanted = target.row(y as u32);
            let row = if is_drawn { field.row(y, count) } else { wanted };
            for (x, o) in out.iter_mut().enumerate() {
                let sum =
                    luma.iter().enumerate().map(|(k, l)| l * row[k * target.stride + x].clamp(0.0, 1.0)).sum::<f32>();
                // Colours are weighted by the target's opacity.
                *o = sum * target.opacity.map_or(1.0, |a| wanted[a * target.stride + x]);
            }
        });
        plane
    })
}

/// Returns 1 − SSIM of two planes, with SSIMULACRA2's change to the first factor, and the mean of its fourth powers.
fn lost_structure([a, b]: [&[f32]; 2], [width, height]: [usize; 2]) -> (Vec<f32>, f64) {
    let soft = |plane: &[f32]| blur(plane, width, height);
    let product = |a: &[f32], b: &[f32]| soft(&a.iter().zip(b).map(|(a, b)| a * b).collect::<Vec<_>>());
    let (means, squares, products) = ([soft(a), soft(b)], [product(a, a), product(b, b)], product(a, b));
    let mut lost = vec![0.0f32; width * height];
    let sums = parallel::map_chunks(&mut lost, width, |y, out| {
        let mut sum = 0.0f32;
        for (x, o) in out.iter_mut().enumerate() {
            let i = y * width + x;
            let ([ma, mb], [aa, bb]) = ([means[0][i], means[1][i]], [squares[0][i], squares[1][i]]);
            let variances = (aa - ma * ma).max(0.0) + (bb - mb * mb).max(0.0);
            let structure =
                (2.0 * (products[i] - ma * mb) + fit::WORTH_VARIANCE_FLOOR) / (variances + fit::WORTH_VARIANCE_FLOOR);
            *o = (1.0 - (1.0 - (ma - mb) * (ma - mb)) * structure).max(0.0);
            sum += (*o * *o) * (*o * *o);
        }
        f64::from(sum)
    });
    (lost, sums.iter().sum::<f64>() / (width * height) as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::model::drawing::field::Output;
    use crate::fit::model::drawing::project::{Primitive, Projected};
    use crate::fit::model::objective::rows::RowSet;
    use crate::fit::model::problem::{Problem, Scene};
    use crate::gaussian::{Blend, Channels};
    use crate::{Pixels, Samples};

    fn noise(i: usize) -> f32 {
        (i as f32 * 0.618_034).fract()
    }

    #[test]
    fn lost_structure_matches_its_formula_in_double_precision() {
        // Heights above one unit of parallel work, and sizes below the window.
        for (w, h) in [(1, 1), (3, 2), (17, 9), (9, 71)] {
            let a: Vec<f32> = (0..w * h).map(noise).collect();
            let b: Vec<f32> = (0..w * h).map(|i| 0.5 * noise(i) + 0.4 * noise(3 * i + 7)).collect();
            let (lost, fourth) = lost_structure([&a, &b], [w, h]);
            let taps = [1.0, 4.0, 6.0, 4.0, 1.0].map(|t| t / 16.0);
            let soft = |x: usize, y: usize, of: &dyn Fn(usize) -> f64| -> f64 {
                let near = |v: usize, d: usize, n: usize| (v + d).saturating_sub(2).min(n - 1);
                (0..25).map(|k| taps[k / 5] * taps[k % 5] * of(near(y, k / 5, h) * w + near(x, k % 5, w))).sum()
            };
            let (p, q) = (|i: usize| f64::from(a[i]), |i: usize| f64::from(b[i]));
            let mut sum = 0.0;
            for y in 0..h {
                for x in 0..w {
                    let (m, n) = (soft(x, y, &p), soft(x, y, &q));
                    let [aa, bb] = [soft(x, y, &|i| p(i) * p(i)) - m * m, soft(x, y, &|i| q(i) * q(i)) - n * n];
                    let ab = soft(x, y, &|i| p(i) * q(i)) - m * n;
                    let c2 = f64::from(fit::WORTH_VARIANCE_FLOOR);
                    let want = (1.0 - (1.0 - (m - n) * (m - n)) * (2.0 * ab + c2) / (aa + bb + c2)).max(0.0);
                    sum += want.powi(4);
                    // Variances are differences of f32 values near 1, divided by at least C₂.
                    let got = f64::from(lost[y * w + x]);
                    assert!((got - want).abs() < 1e-3, "{w} × {h}, {x}, {y}: {got}, expected {want}");
                }
            }
            let want = sum / (w * h) as f64;
            assert!((fourth - want).abs() <= 5e-3 * want + 1e-9, "{w} × {h}: {fourth}, expected {want}");
        }
    }

    #[test]
    fn errors_weigh_more_where_structure_is_lost_and_the_mean_is_one() {
        let (width, height) = (128u32, 64u32);
        for channels in [Channels::Grey, Channels::GreyAlpha, Channels::Rgb, Channels::Rgba] {
            let count = channels.count();
            // An opaque picture with a strong pattern on the left and a faint one on the right.
            let side = |x: usize, y: usize| if (x / 2 + y / 2).is_multiple_of(2) { -1.0 } else { 1.0 };
            let value = |x: usize, y: usize| (140.0 + side(x, y) * if x < 64 { 60.0 } else { 20.0 }) as u8;
            let samples = (0..(width * height) as usize * count).map(|i| {
                let (x, y) = (i / count % width as usize, i / count / width as usize);
                if channels.alpha() == Some(i % count) { 255 } else { value(x, y) }
            });
            let pixels = Pixels::new(width, height, channels, Samples::U8(samples.collect())).unwrap();
            let mut target = Planes::new(&pixels);
            // The drawn picture is flat on the right. On the left it keeps the pattern, with an error of the same size.
            let scene = Scene { width, height, blend: Blend::Normalized, background: [0.5; 4] };
            let flat = Primitive { mean: [64.0, 32.0], log_scale: [4.0; 2], rotation: 0.0, color: [140.0 / 255.0; 4] };
            let mut field = Field::default();
            let problem = Problem { scene, target: &target };
            field.draw(&problem, &[Projected::new(&flat, height)], RowSet::ALL, Output::Picture);
            let size = (count + 1) * field.stride;
            for (y, row) in field.planes.chunks_exact_mut(size).enumerate() {
                for k in 0..count {
                    for x in 0..width as usize / 2 {
                        row[k * target.stride + x] = (140.0 + side(x, y) * 40.0) / 255.0;
                    }
                }
            }
            let amplitudes = amplitudes(&target, &field, 500);
            target.amplitude = amplitudes;
            let mean = |columns: std::ops::Range<usize>| {
                let rows = (0..height).map(|y| &target.amplitude(y).unwrap()[columns.clone()]);
                let (n, sum) = rows.flatten().fold((0.0, 0.0), |(n, s), a| (n + 1.0, s + a * a));
                sum / n
            };
            assert!((mean(0..128) - 1.0).abs() < 1e-3, "{channels:?} {}", mean(0..128));
            assert!(mean(80..128) > 1.5 * mean(0..48), "{channels:?} {} {}", mean(0..48), mean(80..128));
        }
    }

    #[test]
    fn perfect_and_empty_pictures_have_finite_weights() {
        for (width, height) in [(1, 1), (2, 9), (33, 20)] {
            let samples = (0..width * height * 3).map(|i| (i * 7 % 251) as u8).collect();
            let target = Planes::new(&Pixels::new(width, height, Channels::Rgb, Samples::U8(samples)).unwrap());
            let scene = Scene { width, height, blend: Blend::Sum, background: [0.0; 4] };
            let mut field = Field::default();
            field.draw(&Problem { scene, target: &target }, &[], RowSet::ALL, Output::Picture);
            for is_perfect in [false, true] {
                if is_perfect {
                    for y in 0..height {
                        let at = y as usize * 4 * field.stride;
                        field.planes[at..at + 3 * target.stride].copy_from_slice(target.row(y));
                    }
                }
                for row in amplitudes(&target, &field, 5).chunks_exact(target.stride) {
                    let row = &row[..width as usize];
                    assert!(row.iter().all(|a| a.is_finite() && *a > 0.2), "{width} × {height} {is_perfect} {row:?}");
                }
            }
        }
    }
}
