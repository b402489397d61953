//! The second stage of GaussianImage's codec, which continues the fit with quantizers in the loop, after `quantize.py`
//! and `train_quantize.py` of github.com/Xinjie-Q/GaussianImage.
//!
//! Positions are stored in half precision before `tanh`. Each of the three numbers of the covariance (with rotation:
//! the angle in radians) has 64 uniform steps between its minimum and maximum; offset and step are learned (LSQ+,
//! Bhalgat et al. 2020). A colour is the sum of two vectors, the second for the remainder of the first, each from a
//! codebook of eight. Codebooks are initialized by k-means with five rounds and follow the means of their members with
//! a decay of 0.8 (van den Oord et al. 2017). Gradients pass through the rounding, and the mean squared remainder of
//! each codebook is added to the loss with a weight of 1. Optimizer, rate and schedule are those of the first stage.
//!
//! Differences from the published program: the result is the last state and not the best; the gradient passes to the
//! colours once and not through each codebook.
//!
//! Bytes are counted twice. The published measure has no entropy coder: `test_quantize.py`, which computes the paper's
//! figures, calls `compress_wo_ec` and `analysis_wo_ec`, where each index counts 3 bits. The program also has
//! `compress` and `analysis`, which entropy-code the covariances' codes and all indices by their frequencies.
//! [`coded_bytes`] does the same.

use rand::RngExt;
use rand_pcg::Pcg64Mcg;

use super::gaussian_image::{Covariance, RATE, Stage, halved};
use super::optimizer::{Adan, NUMBERS};
use super::{Counted, Options, categorical, drawn};

/// Maximum code of a number of the covariance.
const MAX_CODE: f32 = 63.0;
/// Vectors in a codebook.
const VECTORS: usize = 8;
const ROUNDS: usize = 5;
const DECAY: f32 = 0.8;
/// Keeps a vector without members finite.
const EPSILON: f32 = 1e-5;

type Color = [f32; 4];

/// Continues the fit for `options.second_stage` iterations, and returns the size and quality of the rounded numbers.
pub(super) fn counted(
    stage: &mut Stage<'_>,
    mut numbers: Vec<[f32; NUMBERS]>,
    options: &Options,
    rng: &mut Pcg64Mcg,
) -> Option<Counted> {
    if numbers.iter().flatten().any(|v| !v.is_finite()) {
        return None;
    }
    let channels = stage.channels();
    let mut even = Even::new(&numbers, stage.covariance);
    let mut books = Books::new(numbers.iter().map(colors).collect(), rng);
    let (mut adan, mut tables) = (Adan::new(numbers.len()), Adan::new(1));
    for iteration in 0..options.second_stage {
        let rounded: Vec<_> = numbers.iter().map(|n| rounded(n, &even, &books, stage.covariance)).collect();
        let slopes = stage.gradients(&rounded);
        let mut of_tables = [[0.0; NUMBERS]];
        let mut gradients = Vec::with_capacity(numbers.len());
        for ((n, r), mut g) in numbers.iter().zip(&rounded).zip(slopes) {
            for k in 0..3 {
                let by_value = g[2 + k] / slope_of_shape(r, k, stage.covariance);
                let [by_input, by_step, by_offset] = even.slopes(shape(n, stage.covariance)[k], k);
                g[2 + k] = by_value * by_input * slope_of_shape(n, k, stage.covariance);
                of_tables[0][k] += by_value * by_step;
                of_tables[0][3 + k] += by_value * by_offset;
            }
            let left = books.left(&colors(n));
            for k in 0..channels {
                // Gradient of the mean squared remainders of both codebooks.
                g[5 + k] += 2.0 * (left[0][k] + left[1][k]) / (numbers.len() * channels) as f32;
            }
            gradients.push(if g.iter().all(|v| v.is_finite()) { g } else { [0.0; NUMBERS] });
        }
        books.follow(numbers.iter().map(colors));
        let rate = options.rate * RATE * halved(iteration, options.second_stage);
        adan.step(&mut numbers, &gradients, rate);
        let mut moved = [even.numbers()];
        tables.step(&mut moved, &of_tables, rate);
        even.set(&moved[0]);
    }
    let rounded: Vec<_> = numbers.iter().map(|n| rounded(n, &even, &books, stage.covariance)).collect();
    let psnr = drawn::psnr(stage.target, stage.draw(&rounded));
    let coded = Some(coded_bytes(&numbers, &even, &books, stage));
    Some(Counted { bytes: bytes(numbers.len(), channels), coded, psnr })
}

/// Returns the size in bytes if the codes are entropy-coded, including the two tables.
fn coded_bytes(numbers: &[[f32; NUMBERS]], even: &Even, books: &Books, stage: &Stage<'_>) -> u64 {
    let shape = |n| shape(n, stage.covariance);
    let code = |(k, v)| even.code(v, k).round_ties_even() as u8;
    let shapes: Vec<u8> = numbers.iter().flat_map(|n| shape(n).into_iter().enumerate().map(code)).collect();
    let indices: Vec<u8> = numbers.iter().flat_map(|n| books.indices(&colors(n))).collect();
    let fixed = bytes(0, stage.channels()) + 4 * numbers.len() as u64;
    fixed + categorical::bytes(&shapes) + categorical::bytes(&indices)
}

/// Returns the size in bytes: 16 bits per coordinate, 6 for each number of the covariance, two indices of 3 bits; two
/// codebooks, and an offset and a step for each number of the covariance, in 32 bits.
pub(super) fn bytes(count: usize, channels: usize) -> u64 {
    let each = 2 * 16 + 3 * 6 + 2 * 3;
    let fixed = 32 * (2 * VECTORS * channels + 2 * 3);
    (count as u64 * each + fixed as u64).div_ceil(8)
}

fn colors(n: &[f32; NUMBERS]) -> Color {
    [n[5], n[6], n[7], n[8]]
}

/// Returns the numbers of the covariance that are rounded.
fn shape(n: &[f32; NUMBERS], covariance: Covariance) -> [f32; 3] {
    match covariance {
        Covariance::Cholesky => [n[2], n[3], n[4]],
        Covariance::RotationScale => [n[2], n[3], std::f32::consts::TAU / (1.0 + (-n[4]).exp())],
    }
}

/// Returns the derivative of a number of [`shape`] with respect to its parameter.
fn slope_of_shape(n: &[f32; NUMBERS], k: usize, covariance: Covariance) -> f32 {
    if k < 2 || covariance == Covariance::Cholesky {
        return 1.0;
    }
    let turn = 1.0 / (1.0 + (-n[4]).exp());
    std::f32::consts::TAU * turn * (1.0 - turn)
}

fn rounded(n: &[f32; NUMBERS], even: &Even, books: &Books, covariance: Covariance) -> [f32; NUMBERS] {
    let mut out = *n;
    (out[0], out[1]) = (half_precision(n[0]), half_precision(n[1]));
    let shape = shape(n, covariance);
    for k in 0..3 {
        out[2 + k] = even.rounded(shape[k], k);
    }
    if covariance == Covariance::RotationScale {
        let turn = (out[4] / std::f32::consts::TAU).clamp(1e-6, 1.0 - 1e-6);
        out[4] = (turn / (1.0 - turn)).ln();
    }
    out[5..].copy_from_slice(&books.rounded(&colors(n)));
    out
}

/// Returns the nearest number with 11 bits, or the nearest multiple of 2⁻²⁴ below 2⁻¹⁴.
fn half_precision(v: f32) -> f32 {
    if v.abs() < (-14.0f32).exp2() {
        return (v * 24.0f32.exp2()).round_ties_even() * (-24.0f32).exp2();
    }
    let bits = v.to_bits();
    f32::from_bits(bits.wrapping_add(0xfff + (bits >> 13 & 1)) & !0x1fff)
}

/// Uniform quantizers for three numbers.
struct Even {
    steps: [f32; 3],
    offsets: [f32; 3],
}

impl Even {
    fn new(numbers: &[[f32; NUMBERS]], covariance: Covariance) -> Self {
        let mut ranges = [[f32::INFINITY, f32::NEG_INFINITY]; 3];
        for n in numbers {
            for (range, v) in ranges.iter_mut().zip(shape(n, covariance)) {
                *range = [range[0].min(v), range[1].max(v)];
            }
        }
        // A single value has no range.
        Even { steps: ranges.map(|r| ((r[1] - r[0]) / MAX_CODE).max(1e-8)), offsets: ranges.map(|r| r[0]) }
    }

    fn numbers(&self) -> [f32; NUMBERS] {
        let ([a, b, c], [d, e, f]) = (self.steps, self.offsets);
        [a, b, c, d, e, f, 0.0, 0.0, 0.0]
    }

    fn set(&mut self, n: &[f32; NUMBERS]) {
        self.steps = [n[0], n[1], n[2]].map(|s| s.max(1e-8));
        self.offsets = [n[3], n[4], n[5]];
    }

    fn code(&self, v: f32, k: usize) -> f32 {
        ((v - self.offsets[k]) / self.steps[k]).clamp(0.0, MAX_CODE)
    }

    fn rounded(&self, v: f32, k: usize) -> f32 {
        self.code(v, k).round_ties_even() * self.steps[k] + self.offsets[k]
    }

    /// Returns the derivatives of the rounded number with respect to the number, the step and the offset, passed
    /// through the rounding.
    fn slopes(&self, v: f32, k: usize) -> [f32; 3] {
        let code = self.code(v, k);
        let inside = (v - self.offsets[k]) / self.steps[k] == code;
        let kept = if inside { code } else { 0.0 };
        [f32::from(u8::from(inside)), code.round_ties_even() - kept, f32::from(u8::from(!inside))]
    }
}

/// One codebook, with running means of the number of members of each vector and of their sum.
struct Book {
    vectors: [Color; VECTORS],
    sizes: [f32; VECTORS],
    sums: [Color; VECTORS],
}

fn square(a: &Color, b: &Color) -> f32 {
    (0..4).map(|k| (a[k] - b[k]).powi(2)).sum()
}

fn less(a: &Color, b: &Color) -> Color {
    std::array::from_fn(|k| a[k] - b[k])
}

impl Book {
    fn new(points: &[Color], rng: &mut Pcg64Mcg) -> Self {
        let vectors = std::array::from_fn(|_| points[rng.random_range(0..points.len())]);
        let mut book = Book { vectors, sizes: [0.0; VECTORS], sums: [[0.0; 4]; VECTORS] };
        for _ in 0..ROUNDS {
            (book.sizes, book.sums) = book.members(points.iter().copied());
            for i in 0..VECTORS {
                if book.sizes[i] > 0.0 {
                    book.vectors[i] = book.sums[i].map(|s| s / book.sizes[i]);
                }
            }
        }
        book.sums = std::array::from_fn(|i| book.vectors[i].map(|v| v * book.sizes[i]));
        book
    }

    fn nearest(&self, color: &Color) -> usize {
        let key = |i: &usize| square(&self.vectors[*i], color);
        (0..VECTORS).min_by(|a, b| key(a).total_cmp(&key(b))).expect("eight")
    }

    fn members(&self, points: impl Iterator<Item = Color>) -> ([f32; VECTORS], [Color; VECTORS]) {
        let (mut sizes, mut sums) = ([0.0; VECTORS], [[0.0; 4]; VECTORS]);
        for p in points {
            let i = self.nearest(&p);
            sizes[i] += 1.0;
            (0..4).for_each(|k| sums[i][k] += p[k]);
        }
        (sizes, sums)
    }

    /// Moves the vectors to the running means of their members.
    fn follow(&mut self, points: impl Iterator<Item = Color>) {
        let (sizes, sums) = self.members(points);
        for i in 0..VECTORS {
            self.sizes[i] = DECAY * self.sizes[i] + (1.0 - DECAY) * sizes[i];
            (0..4).for_each(|k| self.sums[i][k] = DECAY * self.sums[i][k] + (1.0 - DECAY) * sums[i][k]);
        }
        let all: f32 = self.sizes.iter().sum();
        for i in 0..VECTORS {
            let size = (self.sizes[i] + EPSILON) / (all + VECTORS as f32 * EPSILON) * all;
            self.vectors[i] = self.sums[i].map(|s| s / size);
        }
    }
}

/// Both codebooks.
struct Books([Book; 2]);

impl Books {
    fn new(points: Vec<Color>, rng: &mut Pcg64Mcg) -> Self {
        let first = Book::new(&points, rng);
        let left: Vec<Color> = points.iter().map(|p| less(p, &first.vectors[first.nearest(p)])).collect();
        let second = Book::new(&left, rng);
        Books([first, second])
    }

    /// Returns the remainder of a colour after the first codebook, and after both.
    fn left(&self, color: &Color) -> [Color; 2] {
        let first = less(color, &self.0[0].vectors[self.0[0].nearest(color)]);
        [first, less(&first, &self.0[1].vectors[self.0[1].nearest(&first)])]
    }

    fn indices(&self, color: &Color) -> [u8; 2] {
        let left = self.left(color)[0];
        [self.0[0].nearest(color) as u8, self.0[1].nearest(&left) as u8]
    }

    fn rounded(&self, color: &Color) -> Color {
        less(color, &self.left(color)[1])
    }

    fn follow(&mut self, points: impl Iterator<Item = Color> + Clone) {
        let left: Vec<Color> = points.clone().map(|p| self.left(&p)[0]).collect();
        self.0[0].follow(points);
        self.0[1].follow(left.into_iter());
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use super::*;

    fn some_numbers() -> Vec<[f32; NUMBERS]> {
        let mut rng = Pcg64Mcg::seed_from_u64(3);
        (0..400).map(|_| std::array::from_fn(|_| rng.random())).collect()
    }

    #[test]
    fn half_precision_is_what_sixteen_bits_hold() {
        let known = [
            (0.1, 0.099_975_586),
            (1.0 / 3.0, 0.333_251_95),
            (2049.0, 2048.0),
            (2051.0, 2052.0),
            (-0.1, -0.099_975_586),
        ];
        for (v, want) in known {
            assert_eq!(half_precision(v), want, "{v}");
        }
        assert_eq!(half_precision(3e-8), (-24.0f32).exp2() * 1.0);
        assert_eq!(half_precision(1e-8), 0.0);
    }

    #[test]
    fn rounded_numbers_have_as_many_values_as_their_bits() {
        for covariance in [Covariance::Cholesky, Covariance::RotationScale] {
            let numbers = some_numbers();
            let even = Even::new(&numbers, covariance);
            let books = Books::new(numbers.iter().map(colors).collect(), &mut Pcg64Mcg::seed_from_u64(1));
            let all: Vec<_> = numbers.iter().map(|n| rounded(n, &even, &books, covariance)).collect();
            for k in 2..5 {
                let mut values: Vec<u32> = all.iter().map(|n| n[k].to_bits()).collect();
                values.sort_unstable();
                values.dedup();
                assert!((50..=64).contains(&values.len()), "{k}: {}", values.len());
            }
            // Differences to the colour are rounded again, so remainders are compared in units of 1e−5.
            let mut values: Vec<[i64; 4]> = all.iter().map(|n| colors(n).map(|c| (c * 1e5).round() as i64)).collect();
            values.sort_unstable();
            values.dedup();
            assert!((30..=90).contains(&values.len()), "{}", values.len());
            let error: f32 = numbers.iter().zip(&all).map(|(a, b)| square(&colors(a), &colors(b))).sum::<f32>() / 400.0;
            // Four numbers in 0..1 have a total variance of 4/12.
            assert!(error < 0.12, "{error}");
        }
    }

    #[test]
    fn slopes_of_even_steps_are_those_of_what_is_rounded_beside_the_rounding() {
        let even = Even { steps: [0.1; 3], offsets: [0.5; 3] };
        let [by_input, by_step, by_offset] = even.slopes(0.83, 1);
        // 3.3 steps are rounded to 3.
        assert!((by_input - 1.0).abs() < 1e-6 && (by_step + 0.3).abs() < 1e-4 && by_offset == 0.0, "{by_step}");
        assert_eq!(even.slopes(99.0, 1), [0.0, 63.0, 1.0]);
        assert_eq!(even.slopes(-99.0, 1), [0.0, 0.0, 1.0]);
    }

    #[test]
    fn codebooks_follow_their_members() {
        let points: Vec<Color> = some_numbers().iter().map(colors).collect();
        let mut books = Books::new(points.clone(), &mut Pcg64Mcg::seed_from_u64(1));
        let moved: Vec<Color> = points.iter().map(|p| p.map(|v| v + 0.5)).collect();
        let error = |books: &Books| moved.iter().map(|p| square(p, &books.rounded(p))).sum::<f32>();
        let before = error(&books);
        for _ in 0..30 {
            books.follow(moved.iter().copied());
        }
        assert!(error(&books) < 0.5 * before, "{before} {}", error(&books));
    }
}
