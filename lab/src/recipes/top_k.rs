//! The blend of Image-GS: at each pixel, the ten Gaussians with the largest values, weighted by their values over
//! their sum.
//!
//! `I = Σ cₖ aₖ / (Σ aₖ + ε)` with `aₖ = exp(−σₖ)`. The candidates at a pixel are those of its tile of 16 × 16 pixels:
//! the Gaussians whose circle with three times the larger scale meets the tile.

use super::tiles::{Reach, TILE, Tiles};
use ssplat::unstable::fit::model::drawing::project::Projected;
use ssplat::unstable::parallel;
use ssplat::unstable::simd::{self, LANES, Lanes, Simd, Task};

/// Number of Gaussians per pixel.
pub(super) const K: usize = 10;
/// Groups of adjacent pixels in a row of a tile.
const GROUPS: usize = TILE / LANES;
/// Constant added to the sum of the weights.
const EPSILON: f32 = 1e-4;

/// The largest Gaussians of eight adjacent pixels; `used` is their number for each pixel.
#[derive(Debug, Clone, Copy)]
struct Picks {
    /// Their indices among the members of the tile.
    ranks: [[u32; LANES]; K],
    /// Their values, 0 for unused entries.
    values: [Lanes; K],
    used: [u32; LANES],
}

impl Picks {
    const NONE: Picks =
        Picks { ranks: [[0; LANES]; K], values: [Lanes([f32::NEG_INFINITY; LANES]); K], used: [0; LANES] };

    /// Adds a Gaussian at one pixel if there is room, or replaces the smallest. Values are still exponents. Returns
    /// the smallest exponent once there is no room.
    #[inline(always)]
    fn offer(&mut self, lane: usize, rank: u32, exponent: f32) -> f32 {
        let mut place = self.used[lane] as usize;
        if place == K {
            place = self.smallest(lane);
        } else {
            self.used[lane] += 1;
        }
        self.ranks[place][lane] = rank;
        self.values[place].0[lane] = exponent;
        if self.used[lane] as usize == K { self.values[self.smallest(lane)].0[lane] } else { f32::NEG_INFINITY }
    }

    #[inline(always)]
    fn smallest(&self, lane: usize) -> usize {
        let mut smallest = 0;
        for k in 1..K {
            if self.values[k].0[lane] < self.values[smallest].0[lane] {
                smallest = k;
            }
        }
        smallest
    }

    /// Returns the inverses of the normalization.
    #[inline(always)]
    fn inverses<S: Simd>(&self, simd: S) -> S::Vector {
        let mut sum = simd.splat(EPSILON);
        for values in &self.values {
            sum = simd.add(sum, simd.load(values));
        }
        simd.div(simd.splat(1.0), sum)
    }
}

/// A Gaussian and the radius of its circle, pixels.
#[derive(Debug, Clone, Copy)]
pub(super) struct Circle {
    pub projected: Projected,
    pub radius: f32,
}

/// The sums of [`Slope::from_moments`](super::moments::Slope::from_moments) for one Gaussian, then those of its colour.
pub(super) type Sums = [f32; 9];

/// A circle with its index among the members of a tile, and an upper bound of its exponent in the tile.
type Ranked<'a> = (&'a Circle, u32, f32);

/// The pixels of one drawing.
#[derive(Debug, Default)]
pub(super) struct Drawing {
    tiles: Tiles,
    /// The largest Gaussians of each row, padded to whole tiles.
    picks: Vec<Picks>,
}

/// Renders a row of tiles into planes.
struct Paint<'a> {
    circles: &'a [Circle],
    tiles: &'a Tiles,
    band: usize,
    picks: &'a mut [Picks],
    planes: &'a mut [f32],
    width: usize,
    stride: usize,
    channels: usize,
}

impl Task for Paint<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let (row_size, groups) = ((self.channels + 1) * self.stride, self.tiles.columns * GROUPS);
        let mut ranked = Vec::new();
        for column in 0..self.tiles.columns {
            let members = self.tiles.members(self.band, column);
            rank(self.circles, members, [column, self.band], &mut ranked);
            for y in 0..self.picks.len() / groups {
                let py = (self.band * TILE + y) as f32;
                for group in column * GROUPS..(column + 1) * GROUPS {
                    let picks = &mut self.picks[y * groups + group];
                    choose(simd, &ranked, [(group * LANES) as f32, py], picks);
                    let inverses = picks.inverses(simd);
                    for k in 0..K {
                        let mut weights = Lanes([0.0; LANES]);
                        simd.store(&mut weights, simd.mul(simd.load(&picks.values[k]), inverses));
                        for lane in 0..LANES.min(self.width.saturating_sub(group * LANES)) {
                            if picks.used[lane] as usize > k {
                                let id = members[picks.ranks[k][lane] as usize];
                                let color = &self.circles[id as usize].projected.color;
                                for c in 0..self.channels {
                                    let at = y * row_size + c * self.stride + group * LANES + lane;
                                    self.planes[at] += weights.0[lane] * color[c];
                                }
                            }
                        }
                    }
                }
            }
        }
    }
}

/// Lists the members of a tile in descending order of their upper bounds.
fn rank<'a>(circles: &'a [Circle], members: &[u32], tile: [usize; 2], out: &mut Vec<Ranked<'a>>) {
    out.clear();
    for (i, &id) in members.iter().enumerate() {
        let circle = &circles[id as usize];
        let outside = |k: usize| {
            let (first, center) = ((tile[k] * TILE) as f32, circle.projected.center[k]);
            (first - center).max(center - (first + (TILE - 1) as f32)).max(0.0)
        };
        // The radius is three times the larger scale or more.
        let most = -4.5 * (outside(0).powi(2) + outside(1).powi(2)) / (circle.radius * circle.radius);
        out.push((circle, i as u32, if most.is_nan() { 0.0 } else { most }));
    }
    out.sort_by(|a, b| b.2.total_cmp(&a.2));
}

/// Finds the ten largest at eight pixels, and their values.
#[inline(always)]
fn choose<S: Simd>(simd: S, ranked: &[Ranked<'_>], [x, y]: [f32; 2], picks: &mut Picks) {
    *picks = Picks::NONE;
    let mut least = Lanes([f32::NEG_INFINITY; LANES]);
    let mut lowest = f32::NEG_INFINITY;
    for &(circle, rank, most) in ranked {
        // All following ones are smaller than those found.
        if most < lowest {
            break;
        }
        let p = &circle.projected;
        let (dx, dy) = (simd.add(simd.index(), simd.splat(x - p.center[0])), y - p.center[1]);
        let [a, b, c] = p.conic;
        let slope = simd.add(simd.mul(simd.splat(-0.5 * a), dx), simd.splat(-b * dy));
        let mut exponents = Lanes([0.0; LANES]);
        simd.store(&mut exponents, simd.add(simd.mul(slope, dx), simd.splat(-0.5 * c * dy * dy)));
        let mut has_changed = false;
        for lane in 0..LANES {
            // As in the published program, NaN is skipped. The largest exponents have the largest values.
            let exponent = exponents.0[lane];
            if exponent > least.0[lane] && exponent <= 0.0 {
                least.0[lane] = picks.offer(lane, rank, exponent);
                has_changed = true;
            }
        }
        if has_changed {
            lowest = least.0[0];
            for lane in 1..LANES {
                lowest = lowest.min(least.0[lane]);
            }
        }
    }
    for values in &mut picks.values {
        let exponents = simd.mul(simd.load(values), simd.splat(std::f32::consts::LOG2_E));
        // The exponent of unused entries is below all that are kept.
        let value = simd.keep_above(simd.exp2(exponents), exponents, simd.splat(-125.0));
        simd.store(values, value);
    }
}

impl Drawing {
    /// Renders `circles` into `planes`: rows of `channels` planes of `stride` floats, and one that is not changed.
    pub(super) fn draw(
        &mut self,
        circles: &[Circle],
        [width, height]: [usize; 2],
        channels: usize,
        (planes, stride): (&mut Vec<f32>, usize),
    ) {
        let row_size = (channels + 1) * stride;
        planes.clear();
        planes.resize(height * row_size, 0.0);
        let reach = |c: &Circle| Reach { center: c.projected.center, half: [c.radius; 2] };
        self.tiles = Tiles::new(circles.iter().map(reach), [width, height]);
        let (tiles, groups) = (&self.tiles, self.tiles.columns * GROUPS);
        self.picks.resize(groups * height, Picks::NONE);
        parallel::map_chunk_pairs(
            (&mut self.picks, TILE * groups),
            (planes, TILE * row_size),
            |band, picks, planes| {
                simd::dispatch(Paint { circles, tiles, band, picks, planes, width, stride, channels });
            },
        );
    }

    /// Returns the sums for each of `circles` of the gradient `slopes` with respect to the picture `drawn`, both as
    /// planes.
    pub(super) fn sums(
        &self,
        circles: &[Circle],
        [width, height]: [usize; 2],
        channels: usize,
        (slopes, drawn, stride): (&[f32], &[f32], usize),
    ) -> Vec<Sums> {
        let (row_size, groups) = ((channels + 1) * stride, self.tiles.columns * GROUPS);
        // Neither the bands nor the order of summation depends on the number of threads.
        let bands = parallel::map(height.div_ceil(TILE), |band| {
            let mut found: Vec<(u32, Sums)> = Vec::new();
            for column in 0..self.tiles.columns {
                let members = self.tiles.members(band, column);
                let first = found.len();
                found.extend(members.iter().map(|&id| (id, [0.0; 9])));
                let found = &mut found[first..];
                for y in band * TILE..height.min((band + 1) * TILE) {
                    for x in column * TILE..width.min((column + 1) * TILE) {
                        let (picks, lane) = (&self.picks[y * groups + x / LANES], x % LANES);
                        let used = picks.used[lane] as usize;
                        let inverse = 1.0 / (EPSILON + (0..used).map(|k| picks.values[k].0[lane]).sum::<f32>());
                        let at = y * row_size + x;
                        for k in 0..used {
                            let (id, sums) = &mut found[picks.ranks[k][lane] as usize];
                            let p = &circles[*id as usize].projected;
                            let weight = picks.values[k].0[lane] * inverse;
                            let mut by_value = 0.0;
                            for c in 0..channels {
                                let slope = slopes[at + c * stride];
                                by_value += slope * (p.color[c] - drawn[at + c * stride]);
                                sums[5 + c] += weight * slope;
                            }
                            let t = weight * by_value;
                            let (dx, dy) = (x as f32 - p.center[0], y as f32 - p.center[1]);
                            for (sum, v) in sums.iter_mut().zip([dx, dy, dx * dx, dx * dy, dy * dy]) {
                                *sum += t * v;
                            }
                        }
                    }
                }
            }
            found
        });
        let mut sums = vec![[0.0; 9]; circles.len()];
        for (id, part) in bands.iter().flatten() {
            sums[*id as usize].iter_mut().zip(part).for_each(|(s, v)| *s += v);
        }
        sums
    }
}

/// `−½ xᵀ C x` at a pixel.
#[cfg(test)]
fn exponent(p: &Projected, x: f32, y: f32) -> f32 {
    let (dx, dy) = (x - p.center[0], y - p.center[1]);
    let [a, b, c] = p.conic;
    -0.5 * (a * dx * dx + c * dy * dy) - b * dx * dy
}

#[cfg(test)]
mod tests {
    use super::*;
    use ssplat::unstable::fit::model::drawing::project::Primitive;

    const SIZE: [usize; 2] = [37, 33];
    const STRIDE: usize = 40;

    fn circles(count: u32) -> Vec<Circle> {
        (0..count)
            .map(|i| {
                let f = |k: u32| (f64::from(i) * f64::from(k).sqrt()).fract() as f32;
                let scale = [1.5 + 4.0 * f(2), 1.0 + 3.0 * f(3)];
                let p = Primitive {
                    mean: [37.0 * f(5), 33.0 * f(7)],
                    log_scale: scale.map(f32::ln),
                    rotation: 3.0 * f(11),
                    color: [f(13), f(17), f(19), 0.0],
                };
                Circle { projected: Projected::new(&p, 33), radius: (3.0 * scale[0].max(scale[1])).ceil() }
            })
            .collect()
    }

    fn draw(circles: &[Circle]) -> (Drawing, Vec<f32>) {
        let (mut drawing, mut planes) = (Drawing::default(), Vec::new());
        drawing.draw(circles, SIZE, 3, (&mut planes, STRIDE));
        (drawing, planes)
    }

    #[test]
    fn a_pixel_shows_the_mean_of_its_ten_largest() {
        let circles = circles(90);
        let (_, planes) = draw(&circles);
        let mut full = 0;
        for (x, y) in [(3usize, 4usize), (20, 17), (36, 32), (15, 16), (16, 15)] {
            let tile = [x / TILE, y / TILE].map(|t| (t * TILE) as f32);
            let mut values: Vec<(f32, [f32; 4])> = circles
                .iter()
                .filter(|c| {
                    let center = c.projected.center;
                    (0..2).all(|k| center[k] + c.radius >= tile[k] && center[k] - c.radius < tile[k] + 16.0)
                })
                .map(|c| (exponent(&c.projected, x as f32, y as f32).exp(), c.projected.color))
                .collect();
            values.sort_by(|a, b| b.0.total_cmp(&a.0));
            full += usize::from(values.len() > K);
            values.truncate(K);
            let sum: f32 = values.iter().map(|v| v.0).sum::<f32>() + EPSILON;
            for c in 0..3 {
                let want: f32 = values.iter().map(|v| v.0 * v.1[c]).sum::<f32>() / sum;
                let found = planes[y * 4 * STRIDE + c * STRIDE + x];
                assert!((found - want).abs() < 1e-5, "{x} {y}: {found} {want}");
            }
        }
        assert!(full > 2, "too few Gaussians to choose from");
    }

    #[test]
    fn sums_are_slopes_of_the_picture() {
        use super::super::moments::Slope;
        let circles = circles(40);
        let (drawing, planes) = draw(&circles);
        // The loss is a fixed weighted sum of all samples.
        let slopes: Vec<f32> = (0..planes.len()).map(|i| ((i * 37 % 101) as f32 - 50.0) / 50.0).collect();
        let loss = |circles: &[Circle]| {
            let planes = draw(circles).1;
            let at = |i: usize| f64::from(planes[i]) * f64::from(slopes[i]);
            (0..33)
                .flat_map(|y| (0..3).flat_map(move |c| (0..37).map(move |x| y * 4 * STRIDE + c * STRIDE + x)))
                .map(at)
                .sum::<f64>()
        };
        let sums = drawing.sums(&circles, SIZE, 3, (&slopes, &planes, STRIDE));
        for i in [3usize, 17, 31] {
            let mut geometry = [0.0; 5];
            geometry.copy_from_slice(&sums[i][..5]);
            let slope = Slope::from_moments(geometry, circles[i].projected.conic, [0.0; 4]);
            let moved = |change: &dyn Fn(&mut Projected)| {
                let mut circles = circles.clone();
                change(&mut circles[i].projected);
                loss(&circles)
            };
            for k in 0..2 {
                let at = |by: f32| moved(&|p: &mut Projected| p.center[k] += by);
                let want = ((at(1e-2) - at(-1e-2)) / 2e-2) as f32;
                assert!((slope.mean[k] - want).abs() < 0.03 * want.abs() + 0.02, "{i} {k}: {} {want}", slope.mean[k]);
            }
            for c in 0..3 {
                let at = |by: f32| moved(&|p: &mut Projected| p.color[c] += by);
                let want = ((at(0.1) - at(-0.1)) / 0.2) as f32;
                assert!((sums[i][5 + c] - want).abs() < 1e-3 * want.abs() + 1e-3, "{i} {c}");
            }
        }
    }
}
