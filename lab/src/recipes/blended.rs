//! Blending of 2D Gaussians as in the kernels of `gsplat` and of 3D Gaussian Splatting, tile by tile: with opacity
//! from front to back, or as a sum.
//!
//! At a pixel, `α = min(limit, o exp(−σ))` with `σ = ½ dᵀ Σ⁻¹ d`. Gaussians with a negative `σ` or an `α` below 1/255
//! are skipped. From front to back (Kerbl et al. 2023, equation 3): `I = Σ cᵢ αᵢ Π (1 − αⱼ)` over the `j` before `i`,
//! with a limit of 0.99, up to the Gaussian after which less than 1e-4 of the light would remain. As a sum: `I = Σ cᵢ
//! αᵢ` with a limit of 0.999. As in the original, gradients pass through the limit. The Gaussians at a pixel are those
//! of its tile of 16 × 16 pixels.

use std::ops::Range;

use super::moments::Slope;
use super::tiles::{Reach, TILE, Tiles};
use ssplat::unstable::fit::model::drawing::field::Field;
use ssplat::unstable::fit::model::objective::planes::Planes;
use ssplat::unstable::parallel;
use ssplat::unstable::simd::{self, LANES, Lanes, Simd, Task};

/// Minimum alpha that is drawn.
pub(super) const MIN_ALPHA: f32 = 1.0 / 255.0;
/// Transmittance that counts as zero.
const MIN_TRANSMITTANCE: f32 = 1e-4;

/// Rule that combines Gaussians.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Rule {
    FrontToBack,
    Sum,
}

/// A Gaussian in the form that the pixel loops use.
#[derive(Debug, Clone, Copy)]
pub(super) struct Splat {
    /// Centre in coordinates where pixel `i` has its centre at `i`.
    pub center: [f32; 2],
    /// The inverse covariance `[[a, b], [b, c]]`; it need not be positive definite.
    pub conic: [f32; 3],
    /// Bounding box, which determines its tiles.
    pub reach: Reach,
    pub opacity: f32,
    pub color: [f32; 4],
}

/// Gradient of the error with respect to the parameters of a Gaussian.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Gradient {
    pub slope: Slope,
    /// With respect to the logarithm of the opacity.
    pub log_opacity: f32,
}

/// A rendered picture and its inputs.
#[derive(Debug, Default)]
pub(super) struct Drawing {
    tiles: Tiles,
    ready: Vec<Ready>,
    pub pixels: Vec<[f32; 4]>,
}

/// Colours that are blended; the fourth is always 0.
const COLORS: usize = 3;
/// Groups of adjacent pixels in a row of a tile.
const GROUPS: usize = TILE / LANES;
/// Sums over the pixels of a Gaussian: its moments up to the second order, the total, and those of its colour.
const SUMS: usize = 6 + COLORS;

/// A Gaussian with everything that does not depend on the pixel.
#[derive(Debug, Clone, Copy)]
struct Ready {
    center: [f32; 2],
    /// `log₂ exp(−σ) = (a dx + b dy) dx + c dy²`.
    exponent: [f32; 3],
    opacity: f32,
    color: [f32; COLORS],
    /// Half extent of the area where it may be drawn, pixels.
    half: [f32; 2],
}

impl Ready {
    fn new(s: &Splat) -> Self {
        const L2E: f32 = std::f32::consts::LOG2_E;
        let [a, b, c] = s.conic;
        let determinant = a * c - b * b;
        // Distance at which `α` falls to the minimum.
        let sigma = (s.opacity / MIN_ALPHA).ln();
        let half = if sigma <= 0.0 {
            [-1.0; 2]
        } else if a > 0.0 && determinant > 0.0 {
            [c, a].map(|v| 1.001 * (2.0 * sigma * v / determinant).sqrt() + 0.01)
        } else {
            // Without an ellipse, the Gaussian is unbounded.
            [f32::INFINITY; 2]
        };
        let mut color = [0.0; COLORS];
        color.copy_from_slice(&s.color[..COLORS]);
        Ready {
            center: s.center,
            exponent: [-0.5 * L2E * a, -L2E * b, -0.5 * L2E * c],
            opacity: s.opacity,
            color,
            half,
        }
    }

    /// Returns the rows or columns of a tile, which starts at `first`, in which the Gaussian may be drawn.
    #[inline(always)]
    fn range(&self, k: usize, first: f32) -> Range<usize> {
        let at = self.center[k] - first;
        // Casts saturate, and NaN is drawn nowhere.
        (at - self.half[k]).ceil() as usize..((at + self.half[k]).floor() + 1.0).min(TILE as f32) as usize
    }

    /// Returns `α` at eight pixels; 0 where the Gaussian is not drawn.
    #[inline(always)]
    fn alpha<S: Simd>(&self, simd: S, limit: f32, dx: S::Vector, dy: f32) -> S::Vector {
        let [a, b, c] = self.exponent;
        let slope = simd.add(simd.mul(simd.splat(a), dx), simd.splat(b * dy));
        let exponent = simd.add(simd.mul(slope, dx), simd.splat(c * dy * dy));
        let alpha = simd.min(simd.mul(simd.splat(self.opacity), simd.exp2(exponent)), simd.splat(limit));
        let alpha = simd.keep_above(alpha, simd.splat(f32::MIN_POSITIVE), exponent);
        simd.keep_above(alpha, alpha, simd.splat(MIN_ALPHA))
    }
}

/// State of eight pixels from front to back.
#[derive(Debug, Clone, Copy)]
struct PixelState {
    light: Lanes,
    /// 1, or 0 where no light is left.
    goes_on: Lanes,
    color: [Lanes; COLORS],
}

impl PixelState {
    const START: PixelState =
        PixelState { light: Lanes([1.0; LANES]), goes_on: Lanes([1.0; LANES]), color: [Lanes([0.0; LANES]); 3] };

    /// Passes a Gaussian. Returns its `α`, or 0 where no light reaches it, and the light that reaches it.
    #[inline(always)]
    fn pass<S: Simd>(&mut self, simd: S, alpha: S::Vector) -> (S::Vector, S::Vector) {
        let (one, light) = (simd.splat(1.0), simd.load(&self.light));
        let left = simd.mul(light, simd.sub(one, alpha));
        let goes_on = simd.keep_above(simd.load(&self.goes_on), left, simd.splat(MIN_TRANSMITTANCE.next_down()));
        let alpha = simd.keep_above(alpha, goes_on, simd.splat(0.5));
        simd.store(&mut self.goes_on, goes_on);
        simd.store(&mut self.light, simd.mul(light, simd.sub(one, alpha)));
        (alpha, light)
    }
}

/// The pixels of a tile, in rows of groups.
type Block<T> = [[T; GROUPS]; TILE];

/// The Gaussians of a tile, and the position of the tile.
#[derive(Clone, Copy)]
struct TileGaussians<'a> {
    ready: &'a [Ready],
    members: &'a [u32],
    first: [f32; 2],
    rule: Rule,
}

impl TileGaussians<'_> {
    fn limit(&self) -> f32 {
        if self.rule == Rule::Sum { 0.999 } else { 0.99 }
    }

    /// Returns the distances from the centre of `s` to the eight pixels of a group.
    #[inline(always)]
    fn dx<S: Simd>(&self, simd: S, s: &Ready, group: usize) -> S::Vector {
        simd.add(simd.index(), simd.splat(self.first[0] + (group * LANES) as f32 - s.center[0]))
    }
}

/// Renders a tile.
struct Paint<'a> {
    tile: TileGaussians<'a>,
    ways: &'a mut Block<PixelState>,
}

impl Task for Paint<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let (tile, limit) = (self.tile, self.tile.limit());
        for &id in tile.members {
            let s = &tile.ready[id as usize];
            let (rows, columns) = (s.range(1, tile.first[1]), s.range(0, tile.first[0]));
            if columns.is_empty() {
                continue;
            }
            for y in rows {
                let dy = tile.first[1] + y as f32 - s.center[1];
                for group in columns.start / LANES..columns.end.div_ceil(LANES) {
                    let way = &mut self.ways[y][group];
                    let mut alpha = s.alpha(simd, limit, tile.dx(simd, s, group), dy);
                    if tile.rule == Rule::FrontToBack {
                        let light;
                        (alpha, light) = way.pass(simd, alpha);
                        alpha = simd.mul(alpha, light);
                    }
                    for k in 0..COLORS {
                        let sum = simd.add(simd.load(&way.color[k]), simd.mul(alpha, simd.splat(s.color[k])));
                        simd.store(&mut way.color[k], sum);
                    }
                }
            }
        }
    }
}

/// Second pass over a tile, which computes the sums of its Gaussians.
struct Gather<'a> {
    tile: TileGaussians<'a>,
    ways: &'a mut Block<PixelState>,
    /// The rendered picture.
    whole: &'a Block<[Lanes; COLORS]>,
    /// The gradient with respect to the picture.
    slopes: &'a Block<[Lanes; COLORS]>,
    /// Sums of the members, in their order.
    sums: &'a mut Vec<[f32; SUMS]>,
}

impl Task for Gather<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let (tile, limit, zero) = (self.tile, self.tile.limit(), simd.splat(0.0));
        for &id in tile.members {
            let s = &tile.ready[id as usize];
            let (rows, columns) = (s.range(1, tile.first[1]), s.range(0, tile.first[0]));
            if columns.is_empty() || rows.is_empty() {
                self.sums.push([0.0; SUMS]);
                continue;
            }
            let mut sums = [zero; SUMS];
            for y in rows {
                let dy = tile.first[1] + y as f32 - s.center[1];
                let mut row = [zero; 3];
                for group in columns.start / LANES..columns.end.div_ceil(LANES) {
                    let (way, slopes) = (&mut self.ways[y][group], &self.slopes[y][group]);
                    let dx = tile.dx(simd, s, group);
                    let mut alpha = s.alpha(simd, limit, dx, dy);
                    let (mut weight, mut by_alpha) = (alpha, zero);
                    if tile.rule == Rule::FrontToBack {
                        let light;
                        (alpha, light) = way.pass(simd, alpha);
                        weight = simd.mul(alpha, light);
                        let behind = simd.div(simd.splat(1.0), simd.sub(simd.splat(1.0), alpha));
                        for k in 0..COLORS {
                            let color = simd.splat(s.color[k]);
                            let front = simd.add(simd.load(&way.color[k]), simd.mul(weight, color));
                            simd.store(&mut way.color[k], front);
                            // The Gaussian attenuates the light from behind it.
                            let rest = simd.mul(simd.sub(simd.load(&self.whole[y][group][k]), front), behind);
                            let by_color = simd.sub(simd.mul(light, color), rest);
                            by_alpha = simd.add(by_alpha, simd.mul(simd.load(&slopes[k]), by_color));
                        }
                    } else {
                        for k in 0..COLORS {
                            by_alpha = simd.add(by_alpha, simd.mul(simd.load(&slopes[k]), simd.splat(s.color[k])));
                        }
                    }
                    let v = simd.mul(alpha, by_alpha);
                    let along = simd.mul(v, dx);
                    for (sum, v) in row.iter_mut().zip([v, along, simd.mul(along, dx)]) {
                        *sum = simd.add(*sum, v);
                    }
                    for k in 0..COLORS {
                        sums[6 + k] = simd.add(sums[6 + k], simd.mul(weight, simd.load(&slopes[k])));
                    }
                }
                let (down, [all, along, square]) = (simd.splat(dy), row);
                let aslant = simd.mul(along, down);
                let parts = [along, simd.mul(all, down), square, aslant, simd.mul(simd.mul(all, down), down), all];
                for k in 0..6 {
                    sums[k] = simd.add(sums[k], parts[k]);
                }
            }
            let mut out = [0.0; SUMS];
            for k in 0..SUMS {
                out[k] = simd.sum(sums[k]);
            }
            self.sums.push(out);
        }
    }
}

/// Returns a tile of `pixels`, with rows of `width` pixels; 0 outside.
fn block(pixels: &[[f32; 4]], width: usize, column: usize) -> Block<[Lanes; COLORS]> {
    let mut block = [[[Lanes([0.0; LANES]); COLORS]; GROUPS]; TILE];
    for (row, pixels) in block.iter_mut().zip(pixels.chunks_exact(width)) {
        for (x, pixel) in pixels.iter().skip(column * TILE).take(TILE).enumerate() {
            (0..COLORS).for_each(|k| row[x / LANES][k].0[x % LANES] = pixel[k]);
        }
    }
    block
}

impl Drawing {
    pub(super) fn new(splats: &[Splat], [width, height]: [usize; 2], rule: Rule) -> Self {
        let tiles = Tiles::new(splats.iter().map(|s| s.reach), [width, height]);
        let ready: Vec<Ready> = splats.iter().map(Ready::new).collect();
        let mut drawing = Drawing { tiles, ready, pixels: Vec::new() };
        let mut pixels = vec![[0.0; 4]; width * height];
        parallel::map_chunks(&mut pixels, TILE * width, |band, pixels| {
            for column in 0..drawing.tiles.columns {
                let mut ways = [[PixelState::START; GROUPS]; TILE];
                simd::dispatch(Paint { tile: drawing.tile(band, column, rule), ways: &mut ways });
                for (row, ways) in pixels.chunks_exact_mut(width).zip(&ways) {
                    for (x, pixel) in row.iter_mut().skip(column * TILE).take(TILE).enumerate() {
                        (0..COLORS).for_each(|k| pixel[k] = ways[x / LANES].color[k].0[x % LANES]);
                    }
                }
            }
        });
        drawing.pixels = pixels;
        drawing
    }

    fn tile(&self, band: usize, column: usize, rule: Rule) -> TileGaussians<'_> {
        let first = [column, band].map(|i| (i * TILE) as f32);
        TileGaussians { ready: &self.ready, members: self.tiles.members(band, column), first, rule }
    }

    /// Returns the gradients with respect to the Gaussians, for the gradient `slopes` with respect to the picture.
    pub(super) fn gradients(&self, splats: &[Splat], width: usize, rule: Rule, slopes: &[[f32; 4]]) -> Vec<Gradient> {
        let height = self.pixels.len() / width;
        // Neither the bands nor the order of summation depends on the number of threads.
        let bands = parallel::map(height.div_ceil(TILE), |band| {
            let mut places = vec![u32::MAX; splats.len()];
            let mut found: Vec<(u32, [f32; SUMS])> = Vec::new();
            let mut sums = Vec::new();
            let rows = band * TILE * width..height.min((band + 1) * TILE) * width;
            for column in 0..self.tiles.columns {
                let mut ways = [[PixelState::START; GROUPS]; TILE];
                let tile = self.tile(band, column, rule);
                let [whole, slopes] = [&self.pixels, slopes].map(|p| block(&p[rows.clone()], width, column));
                sums.clear();
                let (whole, slopes) = (&whole, &slopes);
                simd::dispatch(Gather { tile, ways: &mut ways, whole, slopes, sums: &mut sums });
                for (&id, sums) in tile.members.iter().zip(&sums) {
                    let place = &mut places[id as usize];
                    if *place == u32::MAX {
                        *place = found.len() as u32;
                        found.push((id, [0.0; SUMS]));
                    }
                    found[*place as usize].1.iter_mut().zip(sums).for_each(|(f, s)| *f += s);
                }
            }
            found
        });
        let mut all = vec![[0.0f32; SUMS]; splats.len()];
        for (id, part) in bands.iter().flatten() {
            all[*id as usize].iter_mut().zip(part).for_each(|(s, v)| *s += v);
        }
        let gradient = |(sums, splat): (&[f32; SUMS], &Splat)| {
            let [m10, m01, m20, m11, m02, log_opacity, c0, c1, c2] = *sums;
            let slope = Slope::from_moments([m10, m01, m20, m11, m02], splat.conic, [c0, c1, c2, 0.0]);
            Gradient { slope, log_opacity }
        };
        all.iter().zip(splats).map(gradient).collect()
    }
}

/// Converts the pixels to the layout of [`Field::planes`] for `target`.
pub(super) fn field(target: &Planes, pixels: &[[f32; 4]]) -> Field {
    let (channels, stride, width) = (target.channels.count(), target.stride, target.width as usize);
    let mut planes = vec![0.0; target.height as usize * (channels + 1) * stride];
    for (row, pixels) in planes.chunks_exact_mut((channels + 1) * stride).zip(pixels.chunks_exact(width)) {
        for (x, pixel) in pixels.iter().enumerate() {
            (0..channels).for_each(|k| row[k * stride + x] = pixel[k]);
        }
    }
    Field { planes, stride, ..Field::default() }
}

/// Converts planes in the layout of [`Field::planes`] to pixels.
pub(super) fn from_field(target: &Planes, field: &Field) -> Vec<[f32; 4]> {
    let (channels, stride) = (target.channels.count(), field.stride);
    let rows = field.planes.chunks_exact((channels + 1) * stride).take(target.height as usize);
    rows.flat_map(|row| {
        let pixel = move |x| std::array::from_fn(|k| if k < channels { row[k * stride + x] } else { 0.0 });
        (0..target.width as usize).map(pixel)
    })
    .collect()
}

/// Returns the target's pixels.
pub(super) fn pixels_of(target: &Planes) -> Vec<[f32; 4]> {
    let (channels, stride) = (target.channels.count(), target.stride);
    (0..target.height)
        .flat_map(|y| {
            let row = target.row(y);
            let pixel = move |x| std::array::from_fn(|k| if k < channels { row[k * stride + x] } else { 0.0 });
            (0..target.width as usize).map(pixel)
        })
        .collect()
}

/// Returns the squared error of the clamped pixels over all samples.
pub(super) fn squared_error(truth: &[[f32; 4]], pixels: &[[f32; 4]]) -> f64 {
    let of =
        |(t, p): (&[f32; 4], &[f32; 4])| (0..4).map(|k| f64::from(p[k].clamp(0.0, 1.0) - t[k]).powi(2)).sum::<f64>();
    truth.iter().zip(pixels).map(of).sum()
}

/// Compares gradients with finite differences, for the tests of the methods that blend this way.
#[cfg(test)]
pub(super) mod differences {
    use crate::recipes::optimizer::NUMBERS;

    /// Returns the gradient of a weighted sum, `by`, of the samples.
    pub(in crate::recipes) fn slopes(size: [usize; 2], by: impl Fn(usize, usize, usize) -> f64) -> Vec<[f32; 4]> {
        (0..size[0] * size[1])
            .map(|i| {
                let at = |k| by(i % size[0], i / size[0], k) as f32;
                [at(0), at(1), at(2), 0.0]
            })
            .collect()
    }

    /// Compares the gradient `found` with respect to the numbers of Gaussian `i` with finite differences of `mixture`.
    #[track_caller]
    pub(in crate::recipes) fn assert_near(
        found: &[f32],
        numbers: &[[f64; NUMBERS]],
        i: usize,
        mixture: impl Fn(&[[f64; NUMBERS]]) -> f64,
    ) {
        let largest = found.iter().fold(0.0f32, |a, b| a.max(b.abs()));
        for (k, found) in found.iter().enumerate() {
            let at = |step: f64| {
                let mut moved = numbers.to_vec();
                moved[i][k] += step;
                mixture(&moved)
            };
            let want = ((at(1e-7) - at(-1e-7)) / 2e-7) as f32;
            let near = (found - want).abs() < 2e-3 * want.abs() + 2e-3 * largest;
            assert!(near, "{i} {k}: {found} {want}");
        }
    }
}
