//! Blends of 2D Gaussians as the kernels of `gsplat` and of 3D Gaussian Splatting draw them, tile by tile: with opacity, from
//! front to back or as a sum.
//!
//! At a pixel `α = min(limit, o exp(−σ))` with `σ = ½ dᵀ Σ⁻¹ d`. What has a negative `σ` or an `α` below 1/255 is passed over.
//! From front to back (Kerbl et al. 2023, equation 3): `I = Σ cᵢ αᵢ Π (1 − αⱼ)` over the `j` before `i`, with a limit of 0.99, up to
//! the Gaussian behind which less than 1e-4 of the light would be left. As a sum: `I = Σ cᵢ αᵢ` with a limit of 0.999. Gradients
//! pass through the limit, as there. Which Gaussians a pixel looks at is decided by tiles of 16 × 16 pixels.

use super::moments::Slope;
use super::tiles::{Reach, TILE, Tiles};
use crate::fit::model::field::Field;
use crate::fit::model::planes::Planes;
use crate::parallel;

/// What is below this is not drawn.
pub(super) const FAINTEST: f32 = 1.0 / 255.0;
/// Light that is as good as none.
const DARK: f32 = 1e-4;

/// How Gaussians add up.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Rule {
    FrontToBack,
    Sum,
}

/// A Gaussian as the pixel loops need it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Splat {
    /// Middle in coordinates where pixel `i` has its centre at `i`.
    pub center: [f32; 2],
    /// The inverse covariance `[[a, b], [b, c]]`; it may be that of no ellipse.
    pub conic: [f32; 3],
    /// The box whose tiles look at it.
    pub reach: Reach,
    pub opacity: f32,
    pub color: [f32; 4],
}

/// What a picture's gradient is with respect to a Gaussian.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Gradient {
    pub slope: Slope,
    /// With respect to the logarithm of the opacity.
    pub log_opacity: f32,
}

/// A picture and what drew it.
#[derive(Debug, Default)]
pub(super) struct Drawing {
    tiles: Tiles,
    pub pixels: Vec<[f32; 4]>,
}

/// One Gaussian at one pixel.
struct Touch {
    id: u32,
    /// Offset from the Gaussian's middle.
    offset: [f32; 2],
    alpha: f32,
    /// The light that reaches it.
    light: f32,
}

/// Calls `f` for each Gaussian that the pixel shows, in order.
#[inline(always)]
fn walk(splats: &[Splat], members: &[u32], [x, y]: [f32; 2], rule: Rule, mut f: impl FnMut(Touch)) {
    let limit = if rule == Rule::Sum { 0.999 } else { 0.99 };
    let mut light = 1.0f32;
    for &id in members {
        let s = &splats[id as usize];
        let [dx, dy] = [x - s.center[0], y - s.center[1]];
        let [a, b, c] = s.conic;
        let sigma = 0.5 * (a * dx * dx + c * dy * dy) + b * dx * dy;
        // exp(−5.55) is a little above 1/255: the exact test is below.
        if !(0.0..=5.55).contains(&sigma) {
            continue;
        }
        let alpha = (s.opacity * (-sigma).exp()).min(limit);
        if alpha < FAINTEST {
            continue;
        }
        let left = light * (1.0 - alpha);
        if rule == Rule::FrontToBack && left < DARK {
            break;
        }
        f(Touch { id, offset: [dx, dy], alpha, light });
        if rule == Rule::FrontToBack {
            light = left;
        }
    }
}

impl Drawing {
    pub(super) fn new(splats: &[Splat], [width, height]: [usize; 2], rule: Rule) -> Self {
        let tiles = Tiles::new(splats.iter().map(|s| s.reach), [width, height]);
        let mut pixels = vec![[0.0; 4]; width * height];
        parallel::map_chunks(&mut pixels, TILE * width, |band, pixels| {
            for column in 0..tiles.columns {
                let members = tiles.members(band, column);
                for (y, row) in pixels.chunks_exact_mut(width).enumerate() {
                    let last = width.min((column + 1) * TILE);
                    for (x, pixel) in row.iter_mut().enumerate().take(last).skip(column * TILE) {
                        walk(splats, members, [x as f32, (band * TILE + y) as f32], rule, |t| {
                            let color = &splats[t.id as usize].color;
                            (0..4).for_each(|k| pixel[k] += t.light * t.alpha * color[k]);
                        });
                    }
                }
            }
        });
        Drawing { tiles, pixels }
    }

    /// The gradients of what has the gradient `slopes` with respect to the picture.
    pub(super) fn gradients(&self, splats: &[Splat], width: usize, rule: Rule, slopes: &[[f32; 4]]) -> Vec<Gradient> {
        let height = self.pixels.len() / width;
        // Bands do not depend on the number of threads, and neither does the order of sums.
        let bands = parallel::map(height.div_ceil(TILE), |band| {
            let mut places = vec![u32::MAX; splats.len()];
            let mut found: Vec<(u32, [f32; 10])> = Vec::new();
            for column in 0..self.tiles.columns {
                let members = self.tiles.members(band, column);
                for y in band * TILE..height.min((band + 1) * TILE) {
                    for x in column * TILE..width.min((column + 1) * TILE) {
                        let (slope, whole) = (&slopes[y * width + x], &self.pixels[y * width + x]);
                        let mut front = [0.0f32; 4];
                        walk(splats, members, [x as f32, y as f32], rule, |t| {
                            let color = &splats[t.id as usize].color;
                            let weight = t.light * t.alpha;
                            let mut by_alpha = 0.0;
                            for k in 0..4 {
                                front[k] += weight * color[k];
                                // What lies behind is dimmed by it.
                                let behind =
                                    if rule == Rule::Sum { 0.0 } else { (whole[k] - front[k]) / (1.0 - t.alpha) };
                                by_alpha += slope[k] * (t.light * color[k] - behind);
                            }
                            let place = &mut places[t.id as usize];
                            if *place == u32::MAX {
                                *place = found.len() as u32;
                                found.push((t.id, [0.0; 10]));
                            }
                            let sums = &mut found[*place as usize].1;
                            let (v, [dx, dy]) = (t.alpha * by_alpha, t.offset);
                            for (sum, m) in sums.iter_mut().zip([dx, dy, dx * dx, dx * dy, dy * dy, 1.0]) {
                                *sum += v * m;
                            }
                            (0..4).for_each(|k| sums[6 + k] += weight * slope[k]);
                        });
                    }
                }
            }
            found
        });
        let mut all = vec![[0.0f32; 10]; splats.len()];
        for (id, part) in bands.iter().flatten() {
            all[*id as usize].iter_mut().zip(part).for_each(|(s, v)| *s += v);
        }
        let gradient = |(sums, splat): (&[f32; 10], &Splat)| {
            let [m10, m01, m20, m11, m02, log_opacity, c0, c1, c2, c3] = *sums;
            let slope = Slope::from_moments([m10, m01, m20, m11, m02], splat.conic, [c0, c1, c2, c3]);
            Gradient { slope, log_opacity }
        };
        all.iter().zip(splats).map(gradient).collect()
    }
}

/// The pixels in the layout of [`Field::planes`] for `target`.
pub(super) fn field(target: &Planes, pixels: &[[f32; 4]]) -> Field {
    let (channels, stride, width) = (target.channels.count(), target.stride, target.width as usize);
    let mut planes = vec![0.0; target.height as usize * (channels + 1) * stride];
    for (row, pixels) in planes.chunks_exact_mut((channels + 1) * stride).zip(pixels.chunks_exact(width)) {
        for (x, pixel) in pixels.iter().enumerate() {
            (0..channels).for_each(|k| row[k * stride + x] = pixel[k]);
        }
    }
    Field { planes, stride, rows: None }
}

/// The pixels of planes in the layout of [`Field::planes`].
pub(super) fn from_field(target: &Planes, field: &Field) -> Vec<[f32; 4]> {
    let (channels, stride) = (target.channels.count(), field.stride);
    let rows = field.planes.chunks_exact((channels + 1) * stride).take(target.height as usize);
    rows.flat_map(|row| {
        let pixel = move |x| std::array::from_fn(|k| if k < channels { row[k * stride + x] } else { 0.0 });
        (0..target.width as usize).map(pixel)
    })
    .collect()
}

/// The target's pixels.
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

/// Squared error of the clamped pixels over all samples.
pub(super) fn squared_error(truth: &[[f32; 4]], pixels: &[[f32; 4]]) -> f64 {
    let of =
        |(t, p): (&[f32; 4], &[f32; 4])| (0..4).map(|k| f64::from(p[k].clamp(0.0, 1.0) - t[k]).powi(2)).sum::<f64>();
    truth.iter().zip(pixels).map(of).sum()
}

/// Gradients beside differences, for the tests of the methods that blend so.
#[cfg(test)]
pub(super) mod differences {
    use crate::recipes::optimizer::NUMBERS;

    /// The slopes of a mixture `by` of the samples.
    pub(in crate::recipes) fn slopes(size: [usize; 2], by: impl Fn(usize, usize, usize) -> f64) -> Vec<[f32; 4]> {
        (0..size[0] * size[1])
            .map(|i| {
                let at = |k| by(i % size[0], i / size[0], k) as f32;
                [at(0), at(1), at(2), 0.0]
            })
            .collect()
    }

    /// Compares the gradient `found` with respect to the numbers of Gaussian `i` with differences of `mixture`.
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
