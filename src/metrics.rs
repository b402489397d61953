//! Measures of the difference between two pictures: PSNR, SSIM and MS-SSIM, on sample values where 255 is white.
//!
//! No measure takes account of colours under alpha 0. PSNR uses one mean squared error over all pixels and channels.
//! In pictures with alpha, the squared error of a colour is weighted by the opacity of the first picture at that
//! pixel. The encoder reports the same measure. All other measures compare pictures with alpha composited onto a dark
//! and onto a light grey ([`BACKGROUNDS`]), and return the worse result.
//!
//! SSIM and MS-SSIM (Wang, Simoncelli and Bovik, 2003) use an 11-tap Gaussian window with σ = 1.5 pixels, K₁ = 0.01
//! and K₂ = 0.03. They are evaluated where the whole window lies inside the picture, on each colour channel
//! separately, and averaged over the channels. MS-SSIM has five scales with 2×2 mean pooling between them.
//!
//! ```
//! # #[cfg(feature = "unstable")] {
//! use ssplat::unstable::metrics;
//! use ssplat::{Channels, Pixels, Samples};
//!
//! let a = Pixels::new(16, 16, Channels::Grey, Samples::U8(vec![100; 256]))?;
//! let b = Pixels::new(16, 16, Channels::Grey, Samples::U8(vec![110; 256]))?;
//! let difference = metrics::compare(&a, &b)?;
//! assert!((difference.psnr - 28.13).abs() < 0.01);
//! assert!(difference.ssim.is_some() && difference.ms_ssim.is_none());
//! # }
//! # Ok::<(), ssplat::Error>(())
//! ```

use crate::error::{Error, Result};
use crate::parallel;
use crate::parameter::Parameter;
use crate::pixels::{Pixels, Samples};
use crate::strict_math::StrictMath;
use crate::weighting::opacity;

/// Grey backgrounds for pictures with alpha, as sRGB values. SSIMULACRA2 uses the same.
pub const BACKGROUNDS: [f32; 2] = [0.1, 0.9];

/// Minimum side of a picture that has an MS-SSIM, pixels: the window fits into a sixteenth of it.
#[cfg(feature = "encode")]
pub(crate) const MIN_MS_SSIM_SIDE: u32 = 161;
/// Taps of the window.
const TAPS: usize = 11;
/// Standard deviation of the window, pixels.
const SIGMA: f64 = 1.5;
/// Constant that keeps the luminance term finite: `K₁²` for values in 0..=1.
const C1: f32 = 0.0001;
/// Constant that keeps the contrast term finite: `K₂²` for values in 0..=1.
const C2: f32 = 0.0009;
/// Exponents of the five scales, finest first.
const WEIGHTS: [f64; 5] = [0.0448, 0.2856, 0.3001, 0.2363, 0.1333];
/// Output rows of one unit of work. Sums are computed per band, so the last bits of the result depend on this value.
const BAND: usize = 64;
/// Output columns that are filtered together, so that the intermediate values of a band fit into the cache of a core.
const BLOCK: usize = 256;

#[cfg(all(feature = "quality", any(test, feature = "unstable")))]
pub use crate::ssimulacra2::{linear_light, ssimulacra2};

/// Result of [`compare`].
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct Comparison {
    /// Peak signal-to-noise ratio, dB; infinite when the samples are equal.
    pub psnr: f64,
    /// Structural similarity, at most 1; `None` when a side is under 11 pixels.
    pub ssim: Option<f64>,
    /// Multi-scale structural similarity, `0..=1`; `None` when a side is under 161 pixels.
    pub ms_ssim: Option<f64>,
}

/// Returns the PSNR, SSIM and MS-SSIM of two pictures of the same size, channels and depth.
///
/// # Errors
/// [`Error::Parameter`] if the two differ in width, height, channels or depth.
pub fn compare(a: &Pixels, b: &Pixels) -> Result<Comparison> {
    let psnr = psnr(a, b)?;
    let [ssim, ms_ssim] = similarities(a, b);
    Ok(Comparison { psnr, ssim, ms_ssim })
}

/// Returns the peak signal-to-noise ratio over all samples, dB; infinite if they are equal. `a` is the original, whose
/// opacity weights the errors of colours.
///
/// # Errors
/// [`Error::Parameter`] if the two differ in width, height, channels or depth.
pub fn psnr(a: &Pixels, b: &Pixels) -> Result<f64> {
    check_alike(a, b)?;
    let mse = squared_error(a, b) / (a.width() as f64 * f64::from(a.height()) * a.channels().count() as f64);
    let peak = f64::from(a.depth().max());
    Ok(10.0 * (peak * peak / mse).strict_log10())
}

/// Checks that both pictures have the same size, channels and depth.
pub(crate) fn check_alike(a: &Pixels, b: &Pixels) -> Result<()> {
    let size = |p: &Pixels| format!("{}×{}", p.width(), p.height());
    let channels = |p: &Pixels| format!("{:?}", p.channels());
    let bits = |p: &Pixels| (8 * p.depth().bytes()).to_string();
    for (what, of) in [("size", &size as &dyn Fn(&Pixels) -> String), ("channels", &channels), ("bits", &bits)] {
        let [a, b] = [of(a), of(b)];
        if a != b {
            let problem = format!("the pictures differ in {what}: {a} and {b}");
            return Err(Error::Parameter { parameter: Parameter::Pixels, problem });
        }
    }
    Ok(())
}

/// Returns the sum of squared sample differences, in squared code values; those of colours are multiplied by the opacity
/// of `a`. The integers are exact, so the result does not depend on the order of summation.
///
/// # Panics
/// Panics if the two differ in depth.
pub(crate) fn squared_error(a: &Pixels, b: &Pixels) -> f64 {
    let (count, alpha) = (a.channels().count(), a.channels().alpha());
    let Some(alpha) = alpha else {
        return match (a.samples(), b.samples()) {
            (Samples::U8(a), Samples::U8(b)) => summed(a, b, 1, |p, q| square(p[0], q[0])),
            (Samples::U16(a), Samples::U16(b)) => summed(a, b, 1, |p, q| square(p[0], q[0])),
            _ => unreachable!("both have the same depth"),
        };
    };
    let most = u64::from(a.depth().max());
    // At most 4·2³²·2¹⁶.
    fn pixel<T: Copy + Into<u64>>(p: &[T], q: &[T], alpha: usize, white: T) -> u64 {
        (0..p.len()).map(|k| square(p[k], q[k]) * opacity(p, k, Some(alpha), white).into()).sum()
    }
    let sum = match (a.samples(), b.samples()) {
        (Samples::U8(a), Samples::U8(b)) => summed(a, b, count, |p, q| pixel(p, q, alpha, u8::MAX)),
        (Samples::U16(a), Samples::U16(b)) => summed(a, b, count, |p, q| pixel(p, q, alpha, u16::MAX)),
        _ => unreachable!("both have the same depth"),
    };
    sum / most as f64
}

fn square<T: Into<u64>>(p: T, q: T) -> u64 {
    p.into().abs_diff(q.into()).pow(2)
}

/// Returns the sum of `value` over every `count` samples of `a` and `b`.
fn summed<T: Sync>(a: &[T], b: &[T], count: usize, value: impl Fn(&[T], &[T]) -> u64 + Sync) -> f64 {
    /// Values of one unit of work. The largest value is below 2⁵⁰, so that their sum does not overflow.
    const CHUNK: usize = 1 << 14;
    let length = CHUNK * count;
    let chunk = |i| {
        let pairs = part(a, i, length).chunks_exact(count).zip(part(b, i, length).chunks_exact(count));
        pairs.map(|(p, q)| value(p, q)).sum::<u64>()
    };
    parallel::map(a.len().div_ceil(length), chunk).into_iter().map(u128::from).sum::<u128>() as f64
}

/// Returns the `i`-th piece of `length` items.
fn part<T>(all: &[T], i: usize, length: usize) -> &[T] {
    &all[i * length..all.len().min((i + 1) * length)]
}

/// Returns SSIM and MS-SSIM, averaged over the colours, for the background that gives the lower values. `None` where a
/// scale is smaller than the window.
fn similarities(a: &Pixels, b: &Pixels) -> [Option<f64>; 2] {
    let backgrounds = if a.channels().alpha().is_some() { &BACKGROUNDS[..] } else { &BACKGROUNDS[..1] };
    let worse = |[a, b]: [[Option<f64>; 2]; 2]| std::array::from_fn(|k| a[k].zip(b[k]).map(|(a, b)| a.min(b)));
    let found = backgrounds.iter().map(|&background| similarities_over(a, b, background));
    found.reduce(|a, b| worse([a, b])).expect("one background at least")
}

/// Returns SSIM and MS-SSIM over a grey of the value `background`, averaged over the colours.
fn similarities_over(a: &Pixels, b: &Pixels, background: f32) -> [Option<f64>; 2] {
    let count = a.channels().count() - usize::from(a.channels().alpha().is_some());
    let mut total = [Some(0.0); 2];
    for channel in 0..count {
        let found =
            channel_similarities(Plane::channel(a, channel, background), Plane::channel(b, channel, background));
        for (total, found) in total.iter_mut().zip(found) {
            *total = total.zip(found).map(|(t, f)| t + f / count as f64);
        }
    }
    total
}

/// Returns SSIM and MS-SSIM of one channel.
fn channel_similarities(mut a: Plane<'_>, mut b: Plane<'_>) -> [Option<f64>; 2] {
    let mut ssim = None;
    let mut product = 1.0;
    for (scale, weight) in WEIGHTS.into_iter().enumerate() {
        if a.width.min(a.height) < TAPS {
            return [ssim, None];
        }
        let (whole, contrast) = mean_similarity(&a, &b);
        if scale == 0 {
            ssim = Some(whole);
        }
        let is_last = scale + 1 == WEIGHTS.len();
        product *= if is_last { whole } else { contrast }.max(0.0).strict_powf(weight);
        if !is_last {
            (a, b) = (a.pooled(), b.pooled());
        }
    }
    [ssim, Some(product)]
}

/// Returns the means of SSIM and of its contrast and structure term over the positions where the window lies inside
/// the plane.
fn mean_similarity(a: &Plane<'_>, b: &Plane<'_>) -> (f64, f64) {
    let window = window();
    let (width, height) = (a.width - (TAPS - 1), a.height - (TAPS - 1));
    let sums = parallel::map(height.div_ceil(BAND), |band| {
        let top = band * BAND;
        let rows = BAND.min(height - top);
        let mut sums = [0.0; 2];
        let mut scratch = Scratch::default();
        for left in (0..width).step_by(BLOCK) {
            let columns = BLOCK.min(width - left);
            let block = scratch.block(a, b, &window, [left, top], [columns, rows]);
            sums = [sums[0] + block[0], sums[1] + block[1]];
        }
        sums
    });
    let count = width as f64 * height as f64;
    let mean = |k: usize| sums.iter().map(|s| s[k]).sum::<f64>() / count;
    (mean(0), mean(1))
}

/// Working memory of one band: a few hundred kilobytes.
#[derive(Default)]
struct Scratch {
    a: Vec<f32>,
    b: Vec<f32>,
    /// Rows after the horizontal pass: means of a, b, a² + b² and a·b.
    rows: [Vec<f32>; 4],
}

impl Scratch {
    /// Returns the sums of SSIM and of its contrast term over the block of `size` outputs at `corner`.
    fn block(
        &mut self,
        a: &Plane<'_>,
        b: &Plane<'_>,
        window: &[f32; TAPS],
        [left, top]: [usize; 2],
        [columns, rows]: [usize; 2],
    ) -> [f64; 2] {
        let (wide, tall) = (columns + TAPS - 1, rows + TAPS - 1);
        self.a.resize(wide, 0.0);
        self.b.resize(wide, 0.0);
        for r in &mut self.rows {
            r.resize(columns * tall, 0.0);
        }
        for y in 0..tall {
            a.read(left, top + y, &mut self.a);
            b.read(left, top + y, &mut self.b);
            let [ma, mb, squares, products] = self.rows.each_mut().map(|r| &mut r[y * columns..(y + 1) * columns]);
            horizontal(window, &self.a, ma);
            horizontal(window, &self.b, mb);
            for (a, b) in self.a.iter_mut().zip(&mut self.b) {
                (*a, *b) = (*a * *a + *b * *b, *a * *b);
            }
            horizontal(window, &self.a, squares);
            horizontal(window, &self.b, products);
        }
        let mut sums = [0.0; 2];
        let mut filtered = [[0.0f32; BLOCK]; 4];
        for y in 0..rows {
            for (out, rows) in filtered.iter_mut().zip(&self.rows) {
                vertical(window, &rows[y * columns..], columns, &mut out[..columns]);
            }
            let [ma, mb, squares, products] = &filtered;
            // A sum in f32 over a row of at most 256 values near 1 is exact to about 1e-6 of its mean.
            let (mut whole_row, mut contrast_row) = (0.0f32, 0.0f32);
            for x in 0..columns {
                let (product, power) = (ma[x] * mb[x], ma[x] * ma[x] + mb[x] * mb[x]);
                let contrast = (2.0 * (products[x] - product) + C2) / (squares[x] - power + C2);
                whole_row += contrast * (2.0 * product + C1) / (power + C1);
                contrast_row += contrast;
            }
            sums = [sums[0] + f64::from(whole_row), sums[1] + f64::from(contrast_row)];
        }
        sums
    }
}

/// Horizontal filter pass: `out[x] = Σ window[k] · row[x + k]`.
fn horizontal(window: &[f32; TAPS], row: &[f32], out: &mut [f32]) {
    out.fill(0.0);
    for (k, &w) in window.iter().enumerate() {
        for (o, &v) in out.iter_mut().zip(&row[k..]) {
            *o += w * v;
        }
    }
}

/// Vertical filter pass over rows of `stride` values.
fn vertical(window: &[f32; TAPS], rows: &[f32], stride: usize, out: &mut [f32]) {
    out.fill(0.0);
    for (&w, row) in window.iter().zip(rows.chunks_exact(stride)) {
        for (o, &v) in out.iter_mut().zip(row) {
            *o += w * v;
        }
    }
}

/// Returns the normalized window.
fn window() -> [f32; TAPS] {
    let raw: [f64; TAPS] = std::array::from_fn(|i| (-(i as f64 - 5.0).powi(2) / (2.0 * SIGMA * SIGMA)).strict_exp());
    let sum: f64 = raw.iter().sum();
    raw.map(|v| (v / sum) as f32)
}

/// One channel of a picture, or its pooled version; values in `0..=1`.
struct Plane<'a> {
    width: usize,
    height: usize,
    values: Values<'a>,
}

/// Storage of a plane's values. The finest scale is read from the samples, so that a large picture is never copied as
/// a whole.
enum Values<'a> {
    Channel { pixels: &'a Pixels, channel: usize, background: f32 },
    Pooled(Vec<f32>),
}

impl<'a> Plane<'a> {
    /// Returns a channel of `pixels`, composited onto a grey of the value `background`.
    fn channel(pixels: &'a Pixels, channel: usize, background: f32) -> Self {
        let (width, height) = (pixels.width() as usize, pixels.height() as usize);
        Plane { width, height, values: Values::Channel { pixels, channel, background } }
    }

    /// Copies the values that start at `(left, y)` and lie to its right.
    fn read(&self, left: usize, y: usize, out: &mut [f32]) {
        let start = y * self.width + left;
        match &self.values {
            Values::Pooled(values) => out.copy_from_slice(&values[start..start + out.len()]),
            Values::Channel { pixels, channel, background } => {
                let step = pixels.channels().count();
                let first = start * step + channel;
                match pixels.samples() {
                    Samples::U8(v) => {
                        for (o, &v) in out.iter_mut().zip(v[first..].iter().step_by(step)) {
                            *o = f32::from(v) / 255.0;
                        }
                    }
                    Samples::U16(v) => {
                        for (o, &v) in out.iter_mut().zip(v[first..].iter().step_by(step)) {
                            *o = f32::from(v) / 65535.0;
                        }
                    }
                }
                if let Some(alpha) = pixels.channels().alpha() {
                    for (x, o) in out.iter_mut().enumerate() {
                        *o = background + pixels.value((start + x) * step + alpha) * (*o - background);
                    }
                }
            }
        }
    }

    /// Returns the plane pooled by means of 2×2 values. A plane with an odd side gets a leading row or column of
    /// zeros, as in the reference implementation (`avg_pool2d` with padding). This halves the means at that edge in
    /// both pictures.
    fn pooled(&self) -> Plane<'static> {
        let (width, height) = (self.width.div_ceil(2), self.height.div_ceil(2));
        let (pad_x, pad_y) = (self.width % 2, self.height % 2);
        let bands = parallel::map(height.div_ceil(BAND), |band| {
            let mut rows = [vec![0.0f32; 2 * width], vec![0.0f32; 2 * width]];
            let mut out = Vec::with_capacity(width * BAND);
            for y in band * BAND..height.min((band + 1) * BAND) {
                for (k, row) in rows.iter_mut().enumerate() {
                    match (2 * y + k).checked_sub(pad_y) {
                        Some(source) => self.read(0, source, &mut row[pad_x..]),
                        None => row.fill(0.0),
                    }
                }
                let pairs = rows[0].chunks_exact(2).zip(rows[1].chunks_exact(2));
                out.extend(pairs.map(|(t, b)| (t[0] + b[0] + t[1] + b[1]) * 0.25));
            }
            out
        });
        Plane { width, height, values: Values::Pooled(bands.concat()) }
    }
}
